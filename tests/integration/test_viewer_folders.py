"""Does the viewer's stream of a folder hold what the record holds?"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skyrange.core.errors import InputError
from skyrange.metrics.paths import NO_ITEM
from skyrange.metrics.time_series import belief_tracks, labelled_acts, read_notes, truth_tracks
from skyrange.record import RunRecord
from skyrange.view.folders import encode_folder
from skyrange.view.opening import LEAD_S, find_opening_s
from skyrange.view.stream.events import EventTables
from skyrange.view.stream.messages import Message, decode_file
from skyrange.view.stream.positions import Layer, Samples
from tests.flights import shared_pair, shared_run

pytestmark = pytest.mark.rotating

SHORT = ("duration_s=42",)


def read(folder: Path, seed: int | None = None) -> tuple[Message, list[Message]]:
    scene, *others = decode_file(encode_folder(folder, seed))
    return scene, others


def layer(messages: list[Message], arm: int, which: Layer) -> list[Samples]:
    decoded = [Samples.decode(message) for message in messages if message.kind == "P"]
    return [samples for samples in decoded if samples.arm == arm and samples.layer is which]


def events(messages: list[Message], arm: int) -> EventTables:
    found = EventTables()
    for message in messages:
        if message.kind == "E" and message.head["arm"] == arm:
            for table, rows in EventTables.decode(message).rows.items():
                found.rows[table] += rows
    return found


def require_run(record: RunRecord, scene: Message, messages: list[Message], arm: int) -> None:
    truth, heard = truth_tracks(record), belief_tracks(record)
    ids = [row["id"] for row in scene.head["vehicles"]]
    for samples in layer(messages, arm, Layer.TRUTH):
        for row, place in enumerate(samples.rows):
            expected = truth[ids[place]].at(samples.grid.times).T
            known = np.isfinite(samples.enu_m[row])
            assert known.all(axis=0).sum() > 1
            assert np.abs(samples.enu_m[row] - expected)[known].max() <= 0.006
    latest = layer(messages, arm, Layer.STATION)[-1]
    for row, place in enumerate(latest.rows):
        track = heard[ids[place]].until(int(latest.grid.times[-1]))
        assert np.abs(latest.enu_m[row, :, -1] - track.enu_m[-1]).max() <= 0.006
    assert layer(messages, arm, Layer.AUTOPILOT)
    found = events(messages, arm).rows
    assert len(found["notes"]) == sum(len(read_notes(record, name)) for name in ("events", "decisions"))
    assert sum(row["n"] for row in found["acts"]) == len(labelled_acts(record))
    assert len(found["receptions"]) == record.table("observations").num_rows
    for rows in found.values():
        assert [row["t"] for row in rows] == sorted(row["t"] for row in rows)


def test_a_run() -> None:
    record = shared_run("rid-spoofing", *SHORT)
    scene, messages = read(record.path)
    require_run(record, scene, messages, 0)
    nodes = [row["id"] for row in (*scene.head["vehicles"], *scene.head["radios"])]
    (lie,) = {
        (row["e"], row["n"], row["u"]) for row in events(messages, 0).rows["claims"] if nodes[row["node"]] == "ghost"
    }
    assert np.abs(np.array(lie) - (0.0, 110.0, 30.0)).max() < 5.0  # what the attack claims, near its transmitter
    assert scene.head["radios"][-1] == {"id": "ghost", "kind": "attack", "at": [0.0, 110.0, 2.0], "arms": [0]}
    assert len(scene.arrays["heights"]) == len(record.city)
    assert int(scene.arrays["corners"].sum()) * 2 == len(scene.arrays["outlines"])
    assert [row["id"] for row in scene.head["vehicles"]] == [row["id"] for row in record.manifest["vehicles"]]
    assert all(row["plan"] for row in scene.head["vehicles"])
    for row in scene.head["vehicles"]:
        assert len(row["plan_items"]) == len(row["plan"])
        numbered = [item for item in row["plan_items"] if item != NO_ITEM]
        assert numbered == sorted(set(numbered))
        assert min(numbered) > 0


def test_a_pair_is_both_arms_on_one_clock_with_a_verdict() -> None:
    pair = shared_pair("rid-spoofing", "duration_s=75")
    scene, messages = read(pair.path)
    assert [arm["id"] for arm in scene.head["arms"]] == ["attacked", pair.twin]
    for arm, name in enumerate(("attacked", pair.twin)):
        require_run(pair.run(name), scene, messages, arm)
    assert "seed 7" in scene.head["verdict"]
    departed_s = min(row["departed_s"] for row in pair.effects.to_pylist() if row["departed_s"] is not None)
    assert find_opening_s([pair.run("attacked"), pair.run(pair.twin)]) == pytest.approx(departed_s - LEAD_S)
    assert find_opening_s([pair.run("attacked")] * 2) is None
    with pytest.raises(InputError, match="one of 7"):
        encode_folder(pair.path, 8)


def test_what_is_no_folder_of_a_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=str(tmp_path)):
        encode_folder(tmp_path)


def test_levels_with_less_show_less_or_say_what_is_missing() -> None:
    scene, messages = read(shared_run("squares", "record.level=study", "duration_s=12").path)
    assert {samples.layer for samples in map(Samples.decode, messages[::2])} == {Layer.TRUTH}
    assert scene.head["arms"][0]["missions"] == [0, 5]
    with pytest.raises(InputError, match=r"no truth\. Run it again"):
        encode_folder(shared_run("squares", "record.level=summary", "duration_s=12").path)
