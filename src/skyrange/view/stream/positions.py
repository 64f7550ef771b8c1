"""Positions in the viewer's stream: tracks sampled on one grid, and coded as second differences in centimetres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.metrics.time_series import Track
from skyrange.view.stream.messages import POSITIONS, Message

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Known = NDArray[np.bool_]

_CM: Final = 100.0
_LIMIT_M: Final = 2e7
"""Farther places than half way around the Earth are drawn there."""
TURN: Final = 256
"""Headings are whole parts of a turn."""
AGES_PER_S: Final = 10
"""Ages are whole tenths of a second."""
OLD: Final = 255
"""An age of so many tenths or more."""
_EARLY: Final = 1e-6
"""A tenth that is reached but for rounding is reached."""


class Layer(StrEnum):
    """Whose knowledge of an aircraft's place it is."""

    TRUTH = "truth"
    AUTOPILOT = "autopilot"
    STATION = "station"


@dataclass(frozen=True)
class Grid:
    """Times at which positions are sampled: `count` from `start_ns` on, `step_ns` apart."""

    start_ns: int
    step_ns: int
    count: int

    @property
    def times(self) -> Ints:
        """(count,) ns."""
        return self.start_ns + self.step_ns * np.arange(self.count, dtype=np.int64)


@dataclass(frozen=True)
class Samples:
    """Positions of n aircraft at m times."""

    arm: int
    layer: Layer
    grid: Grid
    rows: Sequence[int]
    """(n,) places of the aircraft in the scene."""
    enu_m: Floats
    """(n, 3, m); NaN where there is none."""
    heading_rad: Floats | None = None
    """(n, m) clockwise from north, of the truth."""
    age_s: Floats | None = None
    """(n, m) how long ago the position was heard, of what a station heard."""

    def encode(self) -> Message:
        """As a message."""
        known: Known = np.asarray(np.isfinite(self.enu_m).all(axis=1))
        whole = np.rint(np.clip(_held(self.enu_m, known), -_LIMIT_M, _LIMIT_M) * _CM).astype(np.int64)
        bends = np.diff(whole, n=2, axis=2)
        fits = bends.size == 0 or bool(np.abs(bends).max() < 1 << 15)
        arrays: dict[str, NDArray[Any]] = {
            "starts": whole[:, :, :2].astype("<i4").ravel(),
            "bends": bends.astype("<i2" if fits else "<i4").ravel(),
        }
        if self.heading_rad is not None:
            parts = np.rint(np.nan_to_num(self.heading_rad) / (2 * np.pi) * TURN).astype(np.int64)
            arrays["turns"] = (np.diff(parts, axis=1, prepend=0) % TURN).astype("<u1").ravel()
        if self.age_s is not None:
            tenths = np.floor(np.clip(np.nan_to_num(self.age_s) * AGES_PER_S + _EARLY, 0, OLD))
            arrays["ages"] = tenths.astype("<u1").ravel()
        head = {
            "arm": self.arm,
            "layer": str(self.layer),
            "from_s": self.grid.start_ns / NS_PER_S,
            "step_s": self.grid.step_ns / NS_PER_S,
            "samples": self.grid.count,
            "rows": list(self.rows),
            "gaps": _gaps(known),
        }
        return Message(POSITIONS, head, arrays)

    @classmethod
    def decode(cls, message: Message) -> Samples:
        """The samples of a message of positions, to the centimetre."""
        head, arrays = message.head, message.arrays
        rows, count = len(head["rows"]), int(head["samples"])
        starts = arrays["starts"].reshape(rows, 3, min(2, count)).astype(np.int64)
        whole = np.zeros((rows, 3, count), dtype=np.int64)
        whole[:, :, : starts.shape[2]] = starts
        if count > 2:
            steps = np.cumsum(arrays["bends"].reshape(rows, 3, count - 2).astype(np.int64), axis=2)
            first = starts[:, :, 1:] - starts[:, :, :1]
            whole[:, :, 2:] = starts[:, :, 1:] + np.cumsum(first + steps, axis=2)
        enu_m = whole / _CM
        for row, first_gap, until in head["gaps"]:
            enu_m[row, :, first_gap:until] = np.nan
        grid = Grid(round(head["from_s"] * NS_PER_S), round(head["step_s"] * NS_PER_S), count)
        heading: Floats | None = None
        if "turns" in arrays:
            parts = np.cumsum(arrays["turns"].reshape(rows, count).astype(np.int64), axis=1) % TURN
            heading = np.asarray(parts * (2 * np.pi / TURN), dtype=np.float64)
        ages = arrays["ages"].reshape(rows, count) / AGES_PER_S if "ages" in arrays else None
        return cls(head["arm"], Layer(head["layer"]), grid, head["rows"], enu_m, heading, ages)


def sample_line(track: Track, grid: Grid) -> Floats:
    """(3, m) positions on the straight lines between a track's samples; NaN before the first and after the last."""
    return _within(track, grid, track.at(grid.times).T if len(track) else np.zeros((3, grid.count)))


def sample_last(track: Track, grid: Grid) -> tuple[Floats, Floats]:
    """(3, m) the last position at each time, and (m,) its age in seconds; NaN before the first."""
    found, age_s = np.full((3, grid.count), np.nan), np.full(grid.count, np.nan)
    rows = np.searchsorted(track.time_ns, grid.times, side="right") - 1
    known = rows >= 0
    found[:, known] = track.enu_m[rows[known]].T
    age_s[known] = (grid.times[known] - track.time_ns[rows[known]]) / NS_PER_S
    return found, age_s


def _within(track: Track, grid: Grid, found: Floats) -> Floats:
    times = grid.times
    inside = (times >= track.time_ns[0]) & (times <= track.time_ns[-1]) if len(track) else np.zeros(len(times), bool)
    return np.where(inside, found, np.nan)


def _held(enu_m: Floats, known: Known) -> Floats:
    """The same positions, where there is none the last one before, or else the first."""
    count = enu_m.shape[2]
    last = np.maximum.accumulate(np.where(known, np.arange(count), -1), axis=1)
    last = np.where(last < 0, np.argmax(known, axis=1)[:, None], last)
    held: Floats = np.nan_to_num(np.take_along_axis(enu_m, last[:, None, :], axis=2))
    return held


def _gaps(known: Known) -> list[list[int]]:
    """Row, first and end of each span without positions."""
    edges = np.diff(np.pad(~known, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (rows, firsts), (_, ends) = np.nonzero(edges > 0), np.nonzero(edges < 0)
    spans: list[list[int]] = np.stack([rows, firsts, ends], axis=1).tolist()
    return spans
