"""Which claims the viewer calls lies: those of places where their sender has not been."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.view.stream.events import EventTables
from skyrange.view.stream.messages import Message, Part, encode_file
from skyrange.view.stream.positions import Grid, Layer, Samples
from tests.tiers import examples
from tests.viewer_modules import ask_modules

Floats = NDArray[np.float64]

SECONDS = 12
GHOST_M = 50.0
LIARS = """(store, { findLies }) =>
  Array.from({ length: 48 }, (_, k) => findLies(store, 0, k / 4).map((lie) => lie.node))"""
"""Who lies at each quarter of a second."""


@dataclass(frozen=True)
class Sender:
    """An aircraft on a curve, and its claims: how old they are when they are heard, how wrong, and for how long."""

    speed_mps: float
    climb_mps: float
    turn_rps: float
    age_s: float
    period_s: float
    error_m: float
    ghost: str

    def at(self, time_s: Floats) -> Floats:
        """(m, 3) metres; it stands before time 0."""
        flown = np.maximum(time_s, 0.0)
        turn = self.turn_rps * flown
        if abs(self.turn_rps) < 1e-6:
            east, north = np.zeros_like(flown), self.speed_mps * flown
        else:
            radius = self.speed_mps / self.turn_rps
            east, north = radius * (1 - np.cos(turn)), radius * np.sin(turn)
        return np.stack([east, north, 60.0 + self.climb_mps * flown], axis=-1)

    def claims(self, node: int) -> list[dict[str, object]]:
        """Rows of the table, heard `age_s` after the places were true."""
        rows = []
        for time_s in np.arange(0.3, SECONDS - 0.5, self.period_s):
            east, north, up = self.at(np.array([time_s - self.age_s]))[0]
            turn = self.turn_rps * time_s
            aside = {"right": (np.cos(turn), -np.sin(turn)), "ahead": (np.sin(turn), np.cos(turn))}
            if self.ghost in aside:  # of where it is when it is heard
                east, north, up = self.at(np.array([time_s]))[0]
                east, north = east + GHOST_M * aside[self.ghost][0], north + GHOST_M * aside[self.ghost][1]
            up += GHOST_M if self.ghost == "above" else self.error_m
            where = {"e": float(east), "n": float(north), "u": float(up)}
            rows.append({"t": round(float(time_s), 3), "node": node, "uas": f"uas{node}", **where})
        return rows


SENDERS = st.builds(
    Sender,
    st.floats(0.0, 20.0),
    st.floats(-3.0, 3.0),
    st.floats(-0.15, 0.15),
    st.floats(0.0, 3.0),
    st.sampled_from([0.5, 1.0, 2.0]),
    st.floats(-5.0, 5.0),
    st.sampled_from(["", "", "right", "above", "ahead"]),
)


def encode(senders: list[Sender]) -> bytes:
    """A file of the stream with their flights and claims, in two parts of which the first is read first."""
    rows, tables = list(range(len(senders))), EventTables()
    tables.rows["claims"] = sorted(
        (row for node, sender in enumerate(senders) for row in sender.claims(node)),
        key=lambda row: float(str(row["t"])),
    )
    parts = []
    for from_s in (0, SECONDS // 2):
        grid = Grid(from_s * NS_PER_S, 200 * NS_PER_MS, SECONDS * 5 // 2 + 1)
        places = np.stack([sender.at(grid.times / NS_PER_S).T for sender in senders])
        messages = [
            Samples(0, Layer.TRUTH, grid, rows, places, np.zeros(places[:, 0].shape)).encode(),
            tables.between(from_s, from_s + SECONDS // 2).encode(0, from_s, from_s + SECONDS // 2),
        ]
        parts.append(Part(from_s, from_s + SECONDS // 2, messages))
    head = {
        "version": 1, "name": "claims", "start_s": 0.0, "end_s": float(SECONDS), "arms": [{"id": "run"}],
        "operators": [{"id": "o"}], "vehicles": [{"id": f"o/v{node}", "operator": 0} for node in rows],
    }  # fmt: skip
    return encode_file(Message("S", head, {}), parts)


@given(st.lists(SENDERS, min_size=40, max_size=60))
@settings(max_examples=examples(10))
def test_honest_claims_of_up_to_three_seconds_ago_are_no_lies_and_those_of_a_ghost_are(senders: list[Sender]) -> None:
    with TemporaryDirectory() as folder:
        found = ask_modules(encode(senders), Path(folder), LIARS, "claims.js")
    ghosts = {node for node, sender in enumerate(senders) if sender.ghost}
    for quarter, liars in enumerate(found):
        assert set(liars) <= ghosts, f"at {quarter / 4} s"
        if quarter >= 4:  # each has claimed within the last three seconds
            assert set(liars) == ghosts, f"at {quarter / 4} s"
