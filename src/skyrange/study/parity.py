"""How differently do two kinds of autopilot fly, or one kind at two rates? One scenario, twice, and measures of both.

Measures are of the truth, the events and the frames that an autopilot sent; nothing is taken from its own estimate.
Times count from the lift-off or from the end of the leg before, so that one late start is one difference and not many.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skyrange.agent.links import TapPlacement
from skyrange.codec.mavlink import decode, message_name
from skyrange.core.ids import endpoint, link_name
from skyrange.core.time import NS_PER_S
from skyrange.record import RunRecord
from skyrange.runtime.run import OnProgress
from skyrange.scenario.schema import Scenario
from skyrange.study.deviation import AIRBORNE_M, deviations_m
from skyrange.study.series import Happening, Vehicle, happenings, truth_tracks, vehicles
from skyrange.study.session import fly
from skyrange.study.waypoints import uploaded

Floats = NDArray[np.float64]

NEAR_M = 2.0
"""A waypoint is passed where the aircraft first comes so near: ArduCopter's WPNAV_RADIUS."""
TRUTH_HZ = 50.0
"""What `compare` asks to be recorded."""
_TRUTH = ("east_m", "north_m", "up_m", "vel_east_mps", "vel_north_mps", "vel_up_mps", "qw", "qx", "qy", "qz")


@dataclass(frozen=True, slots=True)
class Flown:
    """One aircraft's flight. Times in s since the scenario's start.

    `modes` are the modes that it changed to, (time, name); `items` what it told to be reached, (time, sequence number).
    `measures` are numbers by name, the unit in the name. `sent` counts its messages by name on the `autopilot` link,
    `rates_hz` says how often each came from lift-off to touchdown.
    """

    vehicle: str
    autopilot: str
    outcome: str
    modes: tuple[tuple[float, str], ...]
    items: tuple[tuple[float, int], ...]
    measures: Mapping[str, float]
    sent: Mapping[str, int]
    rates_hz: Mapping[str, float]
    path: tuple[Floats, Floats]
    """(n,) s since lift-off and (n, 3) m, in the air."""


@dataclass(frozen=True, slots=True)
class Row:
    """One measure of one aircraft under both autopilots; `relative` is the difference over the second's value."""

    vehicle: str
    measure: str
    first: float
    second: float

    @property
    def difference(self) -> float:
        """First minus second."""
        return self.first - self.second

    @property
    def relative(self) -> float:
        """NaN where the second is 0."""
        return self.difference / abs(self.second) if self.second else np.nan


@dataclass(frozen=True, slots=True)
class Parity:
    """Two flights of every aircraft, by vehicle id."""

    first: Mapping[str, Flown]
    second: Mapping[str, Flown]

    def rows(self) -> Iterator[Row]:
        """Every measure that both have."""
        for name, one in self.first.items():
            other = self.second[name]
            for measure, value in one.measures.items():
                if measure in other.measures:
                    yield Row(name, measure, value, other.measures[measure])

    def apart_m(self, vehicle: str) -> float:
        """How far it was at most from where it was under the other autopilot as long after lift-off."""
        (mine_s, mine_m), (other_s, other_m) = self.first[vehicle].path, self.second[vehicle].path
        if not len(mine_s) or not len(other_s):
            return np.nan
        both_s = mine_s[mine_s <= other_s[-1]]
        there = np.stack([np.interp(both_s, other_s, other_m[:, axis]) for axis in range(3)], axis=1)
        return float(np.sqrt(((mine_m[: len(both_s)] - there) ** 2).sum(axis=1)).max(initial=0.0))


def compare(
    scenario: Scenario,
    folder: Path,
    autopilots: tuple[str, str] = ("builtin", "ardupilot"),
    *,
    taps: Sequence[TapPlacement] = (),
    on_progress: OnProgress | None = None,
) -> Parity:
    """Fly `scenario` with all aircraft under each of two autopilots, into `folder`, and measure.

    `taps` are placed on the links of both runs. Raises as `session.fly` does, and `ValueError` for a kind twice.
    """
    if len(set(autopilots)) < len(autopilots):
        raise ValueError(f"two kinds of autopilot are compared, not {autopilots[0]} with itself")
    return _both({kind: _under(scenario, kind) for kind in autopilots}, folder, taps, on_progress)


def compare_rates(
    scenario: Scenario,
    folder: Path,
    rates: str = "reduced",
    *,
    taps: Sequence[TapPlacement] = (),
    on_progress: OnProgress | None = None,
) -> Parity:
    """Fly `scenario` with all aircraft under ArduPilot, at its own rates and at others, and measure as `compare` does.

    `rates` as of `options.ardupilot.rates`; "full" is ArduPilot's own, and raises `ValueError`. Raises `InputError`
    where the scenario's other options do not go with them.
    """
    if rates == "full":
        raise ValueError("full rates are compared with others, not with themselves")
    under = _under(scenario, "ardupilot")
    return _both({each: _at(under, each) for each in ("full", rates)}, folder, taps, on_progress)


def _both(
    scenarios: Mapping[str, Scenario], folder: Path, taps: Sequence[TapPlacement], on_progress: OnProgress | None
) -> Parity:
    flown = [
        measured(fly(scenario, folder / name, taps=taps, on_progress=on_progress, report=False))
        for name, scenario in scenarios.items()
    ]
    return Parity(*flown)


def _at(scenario: Scenario, rates: str) -> Scenario:
    told = scenario.autopilots.with_options("ardupilot", {"rates": rates}, f"{scenario.name} at rates {rates}")
    return scenario.model_copy(update={"autopilots": told})


def _under(scenario: Scenario, kind: str) -> Scenario:
    operators = tuple(
        operator.model_copy(
            update={"vehicles": tuple(one.model_copy(update={"autopilot": kind}) for one in operator.vehicles)}
        )
        for operator in scenario.operators
    )
    record = scenario.record.model_copy(update={"truth_hz": TRUTH_HZ})
    return scenario.model_copy(update={"operators": operators, "record": record})


def measured(record: RunRecord) -> dict[str, Flown]:
    """Every aircraft of a run."""
    fleet = vehicles(record)
    events = happenings(record, "events")
    waypoints = uploaded(record)
    tracks = truth_tracks(record)
    beside = deviations_m(fleet, tracks, waypoints)
    truth = _truth(record)
    windows = {one.id: _in_air_s(one, truth[one.id]) for one in fleet}
    said = _said(record, windows)
    flown = {}
    for one in fleet:
        own = [event for event in events if event.about == one.id]
        lift_s, down_s = windows[one.id]
        rows = truth[one.id]
        aloft = rows[(rows[:, 0] >= lift_s) & (rows[:, 0] <= down_s)]
        measures = dict(_measures(own, aloft, waypoints.get(one.id, np.zeros((0, 3))), lift_s, down_s))
        if one.id in beside and len(beside[one.id][1]):
            away_m = beside[one.id][1]
            measures["cross_track_max_m"] = float(away_m.max())
            measures["cross_track_rms_m"] = float(np.sqrt((away_m**2).mean()))
        flown[one.id] = Flown(
            vehicle=one.id,
            autopilot=one.autopilot,
            outcome=str(record.outcomes.get(one.id, {}).get("state") or "unfinished"),
            modes=tuple((e.time_ns / NS_PER_S, str(e.data["mode"])) for e in own if e.kind == "event.mode"),
            items=tuple(said[one.id].items),
            measures=measures,
            sent=said[one.id].counts,
            rates_hz={name: count / (down_s - lift_s) for name, count in said[one.id].aloft.items()},
            path=(aloft[:, 0] - lift_s, aloft[:, 1:4]),
        )
    return flown


def _truth(record: RunRecord) -> dict[str, Floats]:
    """(n, 11) by vehicle: s, then `_TRUTH`."""
    table = record.table("truth", ["time_ns", "vehicle", *_TRUTH])
    names = np.asarray(table.column("vehicle").to_pylist())
    rows = np.stack([table.column(name).to_numpy().astype(np.float64) for name in ("time_ns", *_TRUTH)], axis=1)
    rows[:, 0] /= NS_PER_S
    return {one.id: rows[names == one.id] for one in vehicles(record)}


def _in_air_s(vehicle: Vehicle, rows: Floats) -> tuple[float, float]:
    """When it was first and last higher than `AIRBORNE_M` above home; NaN where never."""
    home_m = vehicle.home_enu_m[2] if vehicle.home_enu_m is not None else 0.0
    aloft = rows[rows[:, 3] > home_m + AIRBORNE_M, 0]
    return (float(aloft[0]), float(aloft[-1])) if len(aloft) else (np.nan, np.nan)


def _measures(
    events: Sequence[Happening], aloft: Floats, waypoints: Floats, lift_s: float, down_s: float
) -> Iterator[tuple[str, float]]:
    if not len(aloft):
        return
    armed = [e.time_ns / NS_PER_S for e in events if e.kind == "event.armed"]
    off = [e.time_ns / NS_PER_S for e in events if e.kind == "event.disarmed"]
    yield "lift_off_s", lift_s
    before_s = lift_s
    for number, place in enumerate(waypoints, start=1):
        if place[2] <= AIRBORNE_M:  # a landing's
            continue
        rows = aloft[aloft[:, 0] >= before_s]
        near = rows[np.sqrt(((rows[:, 1:4] - place) ** 2).sum(axis=1)) < NEAR_M, 0]
        if len(near):
            yield f"leg_{number}_s", float(near[0]) - before_s
            before_s = float(near[0])
    yield "rest_s", down_s - before_s
    yield "in_the_air_s", down_s - lift_s
    if armed and off:
        yield "disarmed_after_s", off[-1] - down_s
    yield "height_max_m", float(aloft[:, 3].max())
    yield "speed_max_mps", float(np.hypot(aloft[:, 4], aloft[:, 5]).max())
    yield "climb_max_mps", float(aloft[:, 6].max())
    yield "descent_max_mps", float(-aloft[:, 6].min())
    qx, qy = aloft[:, 8], aloft[:, 9]
    tilt_deg = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (qx * qx + qy * qy), -1.0, 1.0)))
    yield "tilt_max_deg", float(tilt_deg.max())
    qw, qz = aloft[:, 7], aloft[:, 10]
    yaw = np.unwrap(np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz)))
    yield "turned_deg", float(np.degrees(np.abs(np.diff(yaw)).sum()))
    fifth = 10  # samples: 0.2 s
    if len(yaw) > fifth:
        spun = np.abs(yaw[fifth:] - yaw[:-fifth]) / (aloft[fifth:, 0] - aloft[:-fifth, 0])
        yield "yaw_rate_max_degps", float(np.degrees(spun.max()))


@dataclass(slots=True)
class _Said:
    """What one autopilot said."""

    counts: dict[str, int] = field(default_factory=dict)
    aloft: dict[str, int] = field(default_factory=dict)
    items: list[tuple[float, int]] = field(default_factory=list)


def _said(record: RunRecord, windows: Mapping[str, tuple[float, float]]) -> dict[str, _Said]:
    owners = {link_name("autopilot", name): name for name in windows}
    found = {name: _Said() for name in windows}
    for frame in record.frames_with_payloads():
        owner = owners.get(frame.link)
        if owner is None or frame.sender != endpoint(owner, "autopilot"):
            continue
        said, at_s = found[owner], frame.sent_ns / NS_PER_S
        name = message_name(frame.payload) or "garbage"
        said.counts[name] = said.counts.get(name, 0) + 1
        lift_s, down_s = windows[owner]
        if lift_s <= at_s <= down_s:
            said.aloft[name] = said.aloft.get(name, 0) + 1
        if name == "MISSION_ITEM_REACHED":
            said.items.append((at_s, int(decode(frame.payload).seq)))
    return found
