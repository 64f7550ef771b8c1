"""Series of MAVLink messages at each link end: steps from one message to the next, last values, and moving means.

Only messages that claim to be an autopilot's count. Values that are not finite are left out, and others are cut at
`MOST`, so that no arithmetic on them overflows.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.frames import Ints
from skyrange.contracts.monitors import ObservedFrames
from skyrange.contracts.plugins.form import state
from skyrange.core import elementwise
from skyrange.core.time import NS_PER_S
from skyrange.detect.messages import read_messages

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

AUTOPILOT: Final = 1
"""MAV_COMP_ID_AUTOPILOT1."""
MOST: Final = 1e18
STEP_M: Final = 0.05
CHANGE_MPS2: Final = 5.0
_BOOT: Final = "time_boot_ms"
_NORTH_M: Final = (111_132.92, -559.82, 1.175)
_EAST_M: Final = (111_412.84, -93.5, 0.118)
"""Metres per degree of latitude (constant, cos 2φ, cos 4φ) and of longitude (cos φ, cos 3φ, cos 5φ) on WGS 84."""


class Steps(NamedTuple):
    """Messages of one kind, one row each, by link end and then in order of arrival."""

    places: Ints
    """(n,) the link end: a place in `ObservedFrames.ports`."""
    at_ns: Ints
    """(n,) when each arrived, in ns."""
    before: Floats
    """(n, fields) values of the message before; NaN in the first one of a link end."""
    after: Floats
    """(n, fields) its values, in wire units."""
    time_s: Floats
    """(n,) its time by the sender's `time_boot_ms`, or when it arrived if it has none."""
    seconds: Floats
    """(n,) time since the message before; NaN in the first one."""

    def take(self, rows: Ints) -> Steps:
        """Some of the rows."""
        return Steps._make(column[rows] for column in self)


class Series:
    """The messages called `message`, and of each link end the values of `fields` in the last one."""

    def __init__(self, message: str, fields: Sequence[str], *, timed: bool = True) -> None:
        """`timed` says that the message has a `time_boot_ms`."""
        self.message = message
        self._fields = tuple(fields)
        self._timed = timed
        self.values: Floats = np.zeros((0, len(self._fields)))
        """(ends, fields) the last values; NaN before the first message."""
        self.time_s: Floats = np.zeros(0)
        """(ends,) the time of the last message; NaN before the first."""

    def read(self, frames: ObservedFrames) -> Steps:
        """Take in the messages among `frames`, which arrived at their link ends."""
        self._grow(len(frames.ports))
        messages = read_messages(frames, self.message)
        table = messages.values
        values = np.empty((len(messages.rows), len(self._fields)))
        for column, name in enumerate(self._fields):
            values[:, column] = table[name]
        at_ns = frames.at_ns[messages.rows]
        time_s = table[_BOOT] / 1e3 if self._timed else at_ns / NS_PER_S
        usable = np.flatnonzero((messages.components == AUTOPILOT) & np.isfinite(values).all(axis=1))
        places = frames.places[messages.rows]
        rows = usable[np.argsort(places[usable], kind="stable")]
        places, at_ns, time_s, after = places[rows], at_ns[rows], time_s[rows], np.clip(values[rows], -MOST, MOST)
        before, since = np.empty_like(after), np.empty(len(rows))
        if len(rows):
            before[1:], since[1:] = after[:-1], time_s[:-1]
            first = np.flatnonzero(np.diff(places, prepend=-1))
            before[first], since[first] = self.values[places[first]], self.time_s[places[first]]
            last = np.append(first[1:], len(rows)) - 1
            self.values[places[last]], self.time_s[places[last]] = after[last], time_s[last]
        return Steps(places, at_ns, before, after, time_s, time_s - since)

    def _grow(self, count: int) -> None:
        self.values, self.time_s = grown(self.values, count, np.nan), grown(self.time_s, count, np.nan)


def series(message: str, *fields: str, timed: bool = True) -> Any:
    """State of a detector that is a `Series`."""
    return state(partial(Series, message, fields, timed=timed))


def grown(values: Floats, count: int, fill: float = 0.0) -> Floats:
    """The array with rows of `fill` appended up to `count` rows."""
    missing = count - len(values)
    if missing <= 0:
        return values
    return np.concatenate([values, np.full((missing, *values.shape[1:]), fill)])


def offset_m(lat_0: Floats, lon_0: Floats, lat_1: Floats, lon_1: Floats) -> tuple[Floats, Floats]:
    """(east, north) in metres from the first points to the second, each (n,) in 1e-7 degrees, near each other."""
    angle = np.radians(lat_0 * 1e-7)
    north = sum(part * elementwise.cos(2 * order * angle) for order, part in enumerate(_NORTH_M))
    east = sum(part * elementwise.cos((2 * order + 1) * angle) for order, part in enumerate(_EAST_M))
    around = (lon_1 - lon_0 + 1.8e9) % 3.6e9 - 1.8e9
    return around * 1e-7 * east, (lat_1 - lat_0) * 1e-7 * north


def step_errors(before: Floats, after: Floats, seconds: Floats) -> tuple[Floats, Floats]:
    """Errors of (n,) steps of GLOBAL_POSITION_INT against the mean of their velocities, and their standard deviation.

    `before` and `after` are (n, 7): lat, lon, alt, relative_alt, vx, vy, vz in wire units; `seconds` is the time
    between. The errors are (n, 3) in metres, east, north and up. The deviation (n,), of the horizontal error and of
    that in height, is `STEP_M` and the error of the trapezoid rule with an acceleration that changes by `CHANGE_MPS2`
    within the step.
    """
    east, north = offset_m(before[:, 0], before[:, 1], after[:, 0], after[:, 1])
    up = (after[:, 2] - before[:, 2]) * 1e-3
    flown = 0.5 * (before[:, 4:] + after[:, 4:]) * 1e-2 * seconds[:, None]
    errors = np.column_stack([east - flown[:, 1], north - flown[:, 0], up + flown[:, 2]])
    return errors, elementwise.hypot(STEP_M, CHANGE_MPS2 * (seconds * seconds) / 12.0)


def rounds(places: Ints) -> list[Ints]:
    """Rows by how many rows of the same place are before them: each round has a place at most once."""
    order = np.argsort(places, kind="stable")
    ordered = places[order]
    if not len(ordered):
        return []
    first = np.flatnonzero(np.diff(ordered, prepend=-1))
    rank = np.arange(len(ordered)) - np.repeat(first, np.diff(np.append(first, len(ordered))))
    if len(first) == len(ordered):
        return [order]
    return [order[rank == number] for number in range(int(rank.max()) + 1)]


class MovingMean:
    """Exponentially weighted moving means of one quantity at every link end.

    Their time constant is `seconds`; they begin at `first`, or with the first value.
    """

    def __init__(self, seconds: float, first: float = np.nan) -> None:
        self._seconds, self._first = seconds, first
        self._means: Floats = np.zeros(0)

    def add(self, places: Ints, seconds: Floats, values: Floats) -> Floats:
        """Take in (n,) values, each `seconds` after the one before at its link end; returns the mean after each.

        Values of one end are in order of time. One that is not finite leaves the mean as it is, and NaN seconds count
        as none.
        """
        self._means = grown(self._means, int(places.max(initial=-1)) + 1, self._first)
        weights = -elementwise.expm1(-np.maximum(np.nan_to_num(seconds), 0.0) / self._seconds)
        means = np.empty(len(places))
        for rows in rounds(places):
            at = places[rows]
            mean, value = self._means[at], values[rows]
            mean = np.where(np.isfinite(mean), mean, value)
            mean = np.where(np.isfinite(value), mean + weights[rows] * (value - mean), mean)
            self._means[at] = means[rows] = mean
        return means
