"""Near misses and mishaps that the viewer marks on the chart of twins."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.metrics.safety import closest_approaches
from skyrange.view.stream.events import EventTables
from skyrange.view.stream.messages import Message, Part, encode_file
from skyrange.view.stream.positions import Grid, Layer, Samples
from tests.tiers import examples
from tests.viewer_modules import ask_modules

SECONDS = 40
COUNT = """(store, { findNearMisses, findMishaps }) =>
  store.scene.vehicles.map((_, v) =>
    [findNearMisses(store, 0, v).length, findMishaps(store, 0, v).map((one) => one.title)])"""
VEHICLE = st.tuples(
    st.floats(-150, 150), st.floats(-150, 150), st.floats(20, 40), st.floats(-15, 15), st.floats(-15, 15)
)


@given(st.lists(VEHICLE, min_size=30, max_size=40))
@settings(max_examples=examples(8))
def test_near_misses_are_as_many_as_the_reports_say(vehicles: list[tuple[float, float, float, float, float]]) -> None:
    grid = Grid(0, 200 * NS_PER_MS, SECONDS * 5 + 1)
    times = grid.times / NS_PER_S
    enu_m = np.array([[e + v * times, n + w * times, np.full(len(times), u)] for e, n, u, v, w in vehicles])
    enu_m = np.round(enu_m, 2)  # as the stream has them
    rows, tables = list(range(len(vehicles))), EventTables()
    where = {"e": 0.0, "n": 0.0, "u": 30.0}
    tables.rows["mishaps"] = [
        {"t": 3.0, "kind": "collision", **where, "text": "o/v1: collision with o/v10, 3.0 s"},
        {"t": 4.0, "kind": "breach", **where, "text": "o/v10: breach, 4.0 s"},
    ]
    truth = Samples(0, Layer.TRUTH, grid, rows, enu_m, np.zeros(enu_m[:, 0].shape))
    head = {
        "version": 1, "name": "near", "start_s": 0.0, "end_s": float(SECONDS), "arms": [{"id": "run"}],
        "operators": [{"id": "o"}], "vehicles": [{"id": f"o/v{row}", "operator": 0} for row in rows],
    }  # fmt: skip
    messages = [truth.encode(), tables.encode(0, 0.0, float(SECONDS))]
    with TemporaryDirectory() as folder:
        stream = encode_file(Message("S", head, {}), [Part(0.0, float(SECONDS), messages)])
        found = ask_modules(stream, Path(folder), COUNT, "encounters.js")
    known = closest_approaches(np.moveaxis(enu_m, 2, 0).copy(), np.ones((len(times), len(rows)), dtype=bool))
    assert [near for near, _ in found] == known.near_misses.tolist()
    assert found[1][1] == ["collision"]
    assert found[10][1] == ["breach"]
    assert not any(titles for row, (_, titles) in enumerate(found) if row not in (1, 10))
