"""Measures of a flight from its log, be it of a real aircraft or of a simulated one's ground station.

Both logs are measured by the same code and at their own rates. Times at which a height is passed are interpolated
between two positions; the begin of a mission item lies half-way between the last message with the item before and the
first with this one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect
from typing_extensions import TypedDict

from skyrange.codec.mission.items import LANDINGS, TAKEOFFS
from skyrange.core.typed_json import Finite
from skyrange.flightlog.flights import Flight
from skyrange.flightlog.flown_path import track_m
from skyrange.flightlog.model import Rows

Floats = NDArray[np.float64]

LIFTED_M: Final = 1.5
"""Height above home from which a flight climbs, and down to which its track is compared."""
LOW_M: Final = 2.0
"""Height above home at which the descent that is measured ends."""
SLOW_M: Final = 10.0
"""Height below which ArduCopter lands slowly: the default of LAND_ALT_LOW."""
_CLIMBED: Final = 0.9
"""Share of the height of take-off at which the climb has ended: 18 m of 20 m."""
_ENDS: Final = LANDINGS | {dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH}
PERCENTILES: Final = (5.0, 50.0, 95.0)


class Quantity(NamedTuple):
    """What is measured of a flight."""

    name: str
    unit: str
    definition: str
    relative: bool = True
    """Whether differences are relative to the log; else they are in the unit."""


QUANTITIES: Final[Mapping[str, Quantity]] = {
    "climb": Quantity("climb", "s", f"from {LIFTED_M:g} m to {_CLIMBED:.0%} of the height of take-off"),
    "leg": Quantity("leg", "s", "from the end of the climb until the item of the landing begins"),
    "descent": Quantity("descent", "s", f"from the begin of the item of the landing to {SLOW_M:g} m"),
    "landing": Quantity("landing", "s", f"from {SLOW_M:g} m to {LOW_M:g} m"),
    "lean": Quantity("lean", "°", "mean over the leg of the angle between thrust and the vertical", relative=False),
}
SPREADS: Final[Mapping[str, tuple[str, tuple[str, ...]]]] = {
    "vibration, m/s²": ("vibration", ("x_mps2", "y_mps2", "z_mps2")),
    "test ratios of the estimator": ("estimator", ("velocity", "horizontal", "vertical", "compass")),
    "GNSS": ("gnss", ("hdop", "satellites")),
}
"""Tables and columns whose percentiles are shown without a verdict."""


@dataclass(frozen=True, slots=True)
class Measured:
    """One value and the span of the flight that it is of, in seconds of the log."""

    value: float
    begin_s: float
    end_s: float


class DescribedMeasures(TypedDict):
    """The JSON data of `FlightMeasures.describe`."""

    lifted_s: Finite
    quantities: dict[str, tuple[Finite, Finite, Finite]]
    track: list[tuple[Finite, Finite, Finite, Finite]]
    lean: list[tuple[Finite, Finite]]
    spreads: dict[str, dict[str, tuple[Finite, ...]]]


@dataclass(frozen=True, slots=True)
class FlightMeasures:
    """What is measured of one flight; times are s since it passed `LIFTED_M` in the climb, places m from home."""

    lifted_s: float
    """That time in the log."""
    quantities: Mapping[str, Measured]
    """By name; those that the log does not have are missing."""
    track: Floats
    """(n, 4) time, east, north and up, until it passed `LIFTED_M` in the landing; of a simulated flight until the end
    of its log."""
    lean: Floats
    """(n, 2) time, and the angle between thrust and the vertical in degrees."""
    spreads: Mapping[str, Mapping[str, tuple[float, ...]]]
    """By subject and column: `PERCENTILES` in the air. Columns without a value are missing."""

    def find_leg_speed_mps(self) -> float | None:
        """Mean speed over ground from a fifth to four fifths of the distance of the leg; `None` without one."""
        leg = self.quantities.get("leg")
        if leg is None:
            return None
        times_s = self.track[:, 0] + self.lifted_s
        rows = self.track[(times_s >= leg.begin_s) & (times_s <= leg.end_s)]
        if len(rows) < 2:
            return None
        away_m = np.hypot(rows[:, 1] - rows[0, 1], rows[:, 2] - rows[0, 2])
        over = np.column_stack([rows[:, 0], np.zeros((len(rows), 2)), away_m])
        begin_s, end_s = (_pass_up(over, share * float(away_m.max()), -math.inf) for share in (0.2, 0.8))
        if begin_s is None or end_s is None or end_s <= begin_s:
            return None
        return 0.6 * float(away_m.max()) / (end_s - begin_s)

    def describe(self) -> DescribedMeasures:
        """As JSON data."""
        return {
            "lifted_s": round(self.lifted_s, 3),
            "quantities": {
                name: (round(found.value, 4), round(found.begin_s, 3), round(found.end_s, 3))
                for name, found in self.quantities.items()
            },
            "track": np.round(self.track, 3).tolist(),
            "lean": np.round(self.lean, 3).tolist(),
            "spreads": {
                subject: {column: tuple(round(value, 4) for value in values) for column, values in columns.items()}
                for subject, columns in self.spreads.items()
            },
        }


def restore_measures(told: DescribedMeasures) -> FlightMeasures:
    """Measures from JSON data of `FlightMeasures.describe`."""
    return FlightMeasures(
        told["lifted_s"],
        {name: Measured(*values) for name, values in told["quantities"].items()},
        np.array(told["track"], dtype=np.float64).reshape(-1, 4),
        np.array(told["lean"], dtype=np.float64).reshape(-1, 2),
        {
            subject: {column: tuple(values) for column, values in columns.items()}
            for subject, columns in told["spreads"].items()
        },
    )


def measure_flight(flight: Flight, *, whole: bool = False) -> FlightMeasures | None:
    """The measures of a flight; `None` if it never climbs above `LIFTED_M`.

    With `whole`, the track goes on to the end of the log.
    """
    track = _find_track(flight)
    lifted_s = _pass_up(track, LIFTED_M, -math.inf)
    if lifted_s is None:
        return None
    last_s = math.inf if whole else (_pass_down(track, LIFTED_M, lifted_s) or math.inf)
    shown = track[(track[:, 0] >= lifted_s) & (track[:, 0] <= last_s)]
    lean = _find_lean(flight, lifted_s, last_s)
    quantities = dict(_measure_phases(flight, track, lifted_s))
    if (leg := quantities.get("leg")) is not None:
        over = lean[(lean[:, 0] >= leg.begin_s) & (lean[:, 0] <= leg.end_s), 1]
        if len(over):
            quantities["lean"] = Measured(float(over.mean()), leg.begin_s, leg.end_s)
    begin = np.array([lifted_s, 0.0, 0.0, 0.0])
    return FlightMeasures(lifted_s, quantities, shown - begin, lean - begin[:2], _find_spreads(flight))


def _find_track(flight: Flight) -> Floats:
    """(n, 4) time of the log, and metres from home, from arming on."""
    rows = flight.log.tables["position"]
    return track_m(flight, rows[rows["time_s"] >= flight.armed_s])


def _measure_phases(flight: Flight, track: Floats, lifted_s: float) -> Iterator[tuple[str, Measured]]:
    climbed_s = _pass_up(track, _CLIMBED * _find_top_m(flight, track, lifted_s), lifted_s)
    if climbed_s is None:
        return
    yield "climb", Measured(climbed_s - lifted_s, lifted_s, climbed_s)
    landing_s = _find_landing_s(flight, climbed_s)
    if landing_s is None:
        return
    yield "leg", Measured(landing_s - climbed_s, climbed_s, landing_s)
    slow_s = _pass_down(track, SLOW_M, landing_s)
    if slow_s is None:
        return
    yield "descent", Measured(slow_s - landing_s, landing_s, slow_s)
    low_s = _pass_down(track, LOW_M, slow_s)
    if low_s is not None:
        yield "landing", Measured(low_s - slow_s, slow_s, low_s)


def _find_top_m(flight: Flight, track: Floats, lifted_s: float) -> float:
    """The height of the mission's take-off, or the greatest of the track."""
    for item in flight.mission.items if flight.mission is not None else ():
        if item.command in TAKEOFFS and item.z > LIFTED_M:
            return item.z
    return float(track[track[:, 0] >= lifted_s, 3].max())


def _find_landing_s(flight: Flight, after_s: float) -> float | None:
    """When the first landing or return of the mission begins."""
    if flight.mission is None:
        return None
    items = enumerate(flight.mission.items, start=1)
    end = next((number for number, item in items if item.command in _ENDS), None)
    if end is None:
        return None
    rows = flight.rows("items", flight.armed_s, flight.disarmed_s)
    late = np.flatnonzero((rows["number"] >= end) & (rows["time_s"] > after_s))
    if not len(late) or not late[0] or rows["number"][late[0] - 1] >= end:
        return None
    return float(rows["time_s"][late[0] - 1 : late[0] + 1].mean())


def _pass_up(track: Floats, up_m: float, after_s: float) -> float | None:
    """When the track first passes a height upwards after a time."""
    return _pass(track, track[:, 3] - up_m, after_s)


def _pass_down(track: Floats, up_m: float, after_s: float) -> float | None:
    """When the track first passes a height downwards after a time."""
    return _pass(track, up_m - track[:, 3], after_s)


def _pass(track: Floats, over: Floats, after_s: float) -> float | None:
    passed = np.flatnonzero((over[1:] >= 0.0) & (over[:-1] < 0.0) & (track[1:, 0] > after_s))
    if not len(passed):
        return None
    row = int(passed[0])
    share = -over[row] / (over[row + 1] - over[row])
    return max(float(track[row, 0] + share * (track[row + 1, 0] - track[row, 0])), after_s)


def _find_lean(flight: Flight, first_s: float, last_s: float) -> Floats:
    rows = flight.log.tables["attitude"]
    rows = rows[(rows["time_s"] >= first_s) & (rows["time_s"] <= min(last_s, flight.disarmed_s))]
    lean_rad = np.arccos(np.clip(np.cos(rows["roll_rad"]) * np.cos(rows["pitch_rad"]), -1.0, 1.0))
    return np.stack([rows["time_s"], np.degrees(lean_rad)], axis=1)


def _find_spreads(flight: Flight) -> dict[str, dict[str, tuple[float, ...]]]:
    spreads: dict[str, dict[str, tuple[float, ...]]] = {}
    for subject, (table, columns) in SPREADS.items():
        rows = flight.rows(table)
        for column in columns:
            values = _known(rows, column)
            if len(values):
                shares = tuple(float(value) for value in np.percentile(values, PERCENTILES))
                spreads.setdefault(subject, {})[column] = shares
    return spreads


def _known(rows: Rows, column: str) -> Floats:
    values = rows[column].astype(np.float64)
    unknown = -1.0 if rows.dtype[column].kind == "i" else math.nan
    known: Floats = values[np.isfinite(values) & (values != unknown)]
    return known
