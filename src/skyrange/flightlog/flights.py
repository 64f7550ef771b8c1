"""The flights in a log: each from arming to disarming, if the vehicle left the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from skyrange.codec.mission import Mission
from skyrange.core.geodesy import Origin
from skyrange.flightlog.model import FlightLog, Rows

AIRBORNE_M: Final = 1.5
"""Height above the place of arming from which a vehicle flies."""
_AUTO: Final = frozenset({"AUTO", "MISSION"})


@dataclass(frozen=True, slots=True)
class Flight:
    """One flight of a log."""

    log: FlightLog
    number: int
    """From 1 on."""
    armed_s: float
    take_off_s: float
    landing_s: float
    disarmed_s: float
    home: tuple[float, float, float]
    """Latitude and longitude in degrees, and the altitude in metres above mean sea level."""
    home_source: str
    """Where home is from: HOME_POSITION and the like, or the place of arming."""
    modes: tuple[str, ...]
    """The flight modes in order."""
    mission: Mission | None
    """The mission that the autopilot had, if it flew in the mode of missions; else None."""

    def rows(self, table: str, first_s: float | None = None, last_s: float | None = None) -> Rows:
        """The rows of a table between two times of the log, or from take-off to landing."""
        rows = self.log.tables[table]
        low = self.take_off_s if first_s is None else first_s
        high = self.landing_s if last_s is None else last_s
        return rows[(rows["time_s"] >= low) & (rows["time_s"] <= high)]

    @property
    def origin(self) -> Origin:
        """A local frame whose origin is home."""
        return Origin(*self.home)


def split_flights(log: FlightLog) -> list[Flight]:
    """The flights of a log, in order.

    A log that never says whether the vehicle is armed has one flight, if it leaves the ground.
    """
    flights: list[Flight] = []
    for armed_s, disarmed_s in _list_armed(log):
        position = log.tables["position"]
        within = position[(position["time_s"] >= armed_s) & (position["time_s"] <= disarmed_s)]
        if not len(within):
            continue
        up_m = within["alt_msl_m"] - within["alt_msl_m"][0]
        flying = np.flatnonzero(up_m > AIRBORNE_M)
        if not len(flying):
            continue
        home, source = _find_home(log, armed_s, disarmed_s, within)
        modes = _list_modes(log, armed_s, disarmed_s)
        sent = [each.mission for each in log.missions if each.time_s <= disarmed_s]
        mission = sent[-1] if sent and _AUTO & {*modes} else None
        times_s = within["time_s"]
        flights.append(
            Flight(
                log, len(flights) + 1, armed_s, float(times_s[flying[0]]), float(times_s[flying[-1]]), disarmed_s,
                home, source, modes, mission,
            )
        )  # fmt: skip
    return flights


def _list_armed(log: FlightLog) -> list[tuple[float, float]]:
    states = log.tables["states"]
    if not len(states):
        return [(0.0, log.duration_s)]
    spans, since = [], None
    for time_s, armed in zip(states["time_s"].tolist(), states["armed"].tolist(), strict=True):
        if armed and since is None:
            since = time_s
        elif not armed and since is not None:
            spans.append((since, time_s))
            since = None
    return spans if since is None else [*spans, (since, log.duration_s)]


def _find_home(
    log: FlightLog, armed_s: float, disarmed_s: float, within: Rows
) -> tuple[tuple[float, float, float], str]:
    homes = log.tables["homes"]
    known = homes[homes["time_s"] <= disarmed_s]
    after = known[known["time_s"] >= armed_s - 2.0]
    if len(after):
        row, source = after[0], "the home that the autopilot set at arming"
    else:
        row, source = within[0], "the place of arming"
    return (float(row["lat_deg"]), float(row["lon_deg"]), float(row["alt_msl_m"])), source


def _list_modes(log: FlightLog, armed_s: float, disarmed_s: float) -> tuple[str, ...]:
    states = log.tables["states"]
    modes: list[str] = []
    for time_s, mode in zip(states["time_s"].tolist(), states["mode"].tolist(), strict=True):
        if armed_s <= time_s <= disarmed_s and (not modes or modes[-1] != mode):
            modes.append(mode)
    return tuple(modes)
