"""Parity of two kinds of autopilot, or of one kind at two loop rates: one scenario, flown twice and measured.

Measures are computed from truth, events and the frames that an autopilot sent, never from its own estimate. Times count
from lift-off or from the end of the previous leg, so that one late start is one difference and not many.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.assembly.build import Additions, build
from skyrange.codec.mavlink import decode, message_name
from skyrange.contracts.links import TapPlacement
from skyrange.core.ids import endpoint, link_name
from skyrange.core.time import NS_PER_S
from skyrange.metrics.paths import AIRBORNE_M, deviations_m, received_waypoints
from skyrange.metrics.time_series import RecordedNote, Vehicle, read_notes, truth_tracks, vehicles
from skyrange.record import RunRecord
from skyrange.runtime.run import OnProgress
from skyrange.scenario.model.scenario import Scenario
from skyrange.study.runs import fly

Floats = NDArray[np.float64]

KINDS: Final = ("builtin", "ardupilot")
"""The kinds of autopilot that are compared."""
DEADLINE_S: Final = 60.0
"""Wall time in which ArduPilots have to answer: a hundred of them on a busy machine are slow."""
NEAR_M = 2.0
"""A waypoint is passed when the aircraft first comes this near; ArduCopter's WPNAV_RADIUS."""
TRUTH_HZ = 50.0
"""Rate at which `compare` records truth."""
_TRUTH = ("east_m", "north_m", "up_m", "vel_east_mps", "vel_north_mps", "vel_up_mps", "qw", "qx", "qy", "qz")


@dataclass(frozen=True, slots=True)
class FlightMeasures:
    """One aircraft's flight. Times are in s since the scenario's start.

    `modes` are its mode changes, (time, name); `items` the mission items that it reported as reached, (time, sequence
    number). `measures` are numbers by name, with the unit in the name. `sent` counts its messages on the `autopilot`
    link by name; `rates_hz` are their rates from lift-off to touchdown.
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
class MeasureRow:
    """One measure of one aircraft under both autopilots."""

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
        """The difference divided by the absolute second value; NaN if that is 0."""
        return self.difference / abs(self.second) if self.second else np.nan


@dataclass(frozen=True, slots=True)
class Parity:
    """The two flights of every aircraft, by vehicle id."""

    first: Mapping[str, FlightMeasures]
    second: Mapping[str, FlightMeasures]

    def rows(self) -> Iterator[MeasureRow]:
        """Every measure that both flights have."""
        for name, flight in self.first.items():
            other = self.second[name]
            for measure, value in flight.measures.items():
                if measure in other.measures:
                    yield MeasureRow(name, measure, value, other.measures[measure])

    def apart_m(self, vehicle: str) -> float:
        """Largest distance in metres between its positions in the two flights at equal times after lift-off."""
        (mine_s, mine_m), (other_s, other_m) = self.first[vehicle].path, self.second[vehicle].path
        if not len(mine_s) or not len(other_s):
            return np.nan
        both_s = mine_s[mine_s <= other_s[-1]]
        other_at_both_s = np.stack([np.interp(both_s, other_s, other_m[:, axis]) for axis in range(3)], axis=1)
        return float(np.sqrt(((mine_m[: len(both_s)] - other_at_both_s) ** 2).sum(axis=1)).max(initial=0.0))


def compare(
    scenario: Scenario,
    folder: Path,
    autopilots: tuple[str, str] = ("builtin", "ardupilot"),
    *,
    taps: Sequence[TapPlacement] = (),
    on_progress: OnProgress | None = None,
) -> Parity:
    """Run `scenario` with all aircraft under each of two autopilots, into `folder`, and measure the flights.

    `taps` are placed on the links of both runs. Raises the errors of `study.runs.fly`; `ValueError` for equal kinds.
    """
    if len(set(autopilots)) < len(autopilots):
        raise ValueError(f"expected two kinds of autopilot that differ, got {autopilots[0]} twice")
    return _run_both({kind: with_autopilot(scenario, kind) for kind in autopilots}, folder, taps, on_progress)


def compare_rates(
    scenario: Scenario,
    folder: Path,
    rates: str = "reduced",
    *,
    taps: Sequence[TapPlacement] = (),
    on_progress: OnProgress | None = None,
) -> Parity:
    """Run `scenario` with all aircraft under ArduPilot, at its own rates and at others, and measure as `compare` does.

    `rates` is a value of `options.ardupilot.rates` other than "full", ArduPilot's own rates, which raises
    `ValueError`. Raises `InputError` if the scenario's other options do not allow these rates.
    """
    if rates == "full":
        raise ValueError("full rates are the reference; expected the rates to compare with them, single or reduced")
    under = with_autopilot(scenario, "ardupilot")
    return _run_both(
        {rates_name: _with_rates(under, rates_name) for rates_name in ("full", rates)}, folder, taps, on_progress
    )


def with_autopilot(scenario: Scenario, kind: str) -> Scenario:
    """`scenario` with all aircraft under autopilot `kind`, and with truth recorded at `TRUTH_HZ`."""
    operators = tuple(
        operator.model_copy(
            update={"vehicles": tuple(vehicle.model_copy(update={"autopilot": kind}) for vehicle in operator.vehicles)}
        )
        for operator in scenario.operators
    )
    record = scenario.record.model_copy(update={"truth_hz": TRUTH_HZ})
    return scenario.model_copy(update={"operators": operators, "record": record})


def _run_both(
    scenarios: Mapping[str, Scenario], folder: Path, taps: Sequence[TapPlacement], on_progress: OnProgress | None
) -> Parity:
    for scenario in scenarios.values():
        build(scenario)  # raises errors in the second one before the first one flies
    flown = [
        measured(fly(scenario, folder / name, additions=Additions(taps), on_progress=on_progress, report=False))
        for name, scenario in scenarios.items()
    ]
    return Parity(*flown)


def _with_rates(scenario: Scenario, rates: str) -> Scenario:
    autopilots = scenario.autopilots.with_options("ardupilot", {"rates": rates}, f"{scenario.name} at rates {rates}")
    return scenario.model_copy(update={"autopilots": autopilots})


def measured(record: RunRecord) -> dict[str, FlightMeasures]:
    """The measured flight of every aircraft of a run."""
    fleet = vehicles(record)
    events = read_notes(record, "events")
    waypoints = received_waypoints(record)
    tracks = truth_tracks(record)
    beside = deviations_m(fleet, tracks, waypoints)
    truth = _truth(record)
    windows = {vehicle.id: _airborne_span_s(vehicle, truth[vehicle.id]) for vehicle in fleet}
    sent = _sent_messages(record, windows)
    flown = {}
    for vehicle in fleet:
        vehicle_events = [event for event in events if event.about == vehicle.id]
        lift_s, down_s = windows[vehicle.id]
        rows = truth[vehicle.id]
        airborne = rows[(rows[:, 0] >= lift_s) & (rows[:, 0] <= down_s)]
        measures = dict(
            _measures(vehicle_events, airborne, waypoints.get(vehicle.id, np.zeros((0, 3))), lift_s, down_s)
        )
        if vehicle.id in beside and len(beside[vehicle.id][1]):
            away_m = beside[vehicle.id][1]
            measures["cross_track_max_m"] = float(away_m.max())
            measures["cross_track_rms_m"] = float(np.sqrt((away_m**2).mean()))
        flown[vehicle.id] = FlightMeasures(
            vehicle=vehicle.id,
            autopilot=vehicle.autopilot,
            outcome=str(record.outcomes.get(vehicle.id, {}).get("state") or "unfinished"),
            modes=tuple((e.time_ns / NS_PER_S, str(e.data["mode"])) for e in vehicle_events if e.kind == "event.mode"),
            items=tuple(sent[vehicle.id].items),
            measures=measures,
            sent=sent[vehicle.id].counts,
            rates_hz={name: count / (down_s - lift_s) for name, count in sent[vehicle.id].airborne.items()},
            path=(airborne[:, 0] - lift_s, airborne[:, 1:4]),
        )
    return flown


def _truth(record: RunRecord) -> dict[str, Floats]:
    """(n, 11) by vehicle: time in s, then the columns of `_TRUTH`."""
    table = record.table("truth", ["time_ns", "vehicle", *_TRUTH])
    names = np.asarray(table.column("vehicle").to_pylist())
    rows = np.stack([table.column(name).to_numpy().astype(np.float64) for name in ("time_ns", *_TRUTH)], axis=1)
    rows[:, 0] /= NS_PER_S
    return {vehicle.id: rows[names == vehicle.id] for vehicle in vehicles(record)}


def _airborne_span_s(vehicle: Vehicle, rows: Floats) -> tuple[float, float]:
    """First and last time at which it was higher than `AIRBORNE_M` above home; NaN if it never was."""
    home_m = vehicle.home_enu_m[2] if vehicle.home_enu_m is not None else 0.0
    airborne = rows[rows[:, 3] > home_m + AIRBORNE_M, 0]
    return (float(airborne[0]), float(airborne[-1])) if len(airborne) else (np.nan, np.nan)


def _measures(
    events: Sequence[RecordedNote], airborne: Floats, waypoints: Floats, lift_s: float, down_s: float
) -> Iterator[tuple[str, float]]:
    if not len(airborne):
        return
    armed = [e.time_ns / NS_PER_S for e in events if e.kind == "event.armed"]
    off = [e.time_ns / NS_PER_S for e in events if e.kind == "event.disarmed"]
    yield "lift_off_s", lift_s
    before_s = lift_s
    for number, place in enumerate(waypoints, start=1):
        if place[2] <= AIRBORNE_M:  # the landing
            continue
        rows = airborne[airborne[:, 0] >= before_s]
        near = rows[np.sqrt(((rows[:, 1:4] - place) ** 2).sum(axis=1)) < NEAR_M, 0]
        if len(near):
            yield f"leg_{number}_s", float(near[0]) - before_s
            before_s = float(near[0])
    yield "rest_s", down_s - before_s
    yield "in_the_air_s", down_s - lift_s
    if armed and off:
        yield "disarmed_after_s", off[-1] - down_s
    yield "height_max_m", float(airborne[:, 3].max())
    yield "speed_max_mps", float(np.hypot(airborne[:, 4], airborne[:, 5]).max())
    yield "climb_max_mps", float(airborne[:, 6].max())
    yield "descent_max_mps", float(-airborne[:, 6].min())
    qx, qy = airborne[:, 8], airborne[:, 9]
    tilt_deg = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (qx * qx + qy * qy), -1.0, 1.0)))
    yield "tilt_max_deg", float(tilt_deg.max())
    qw, qz = airborne[:, 7], airborne[:, 10]
    yaw = np.unwrap(np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz)))
    yield "turned_deg", float(np.degrees(np.abs(np.diff(yaw)).sum()))
    window = 10  # samples: 0.2 s
    if len(yaw) > window:
        spun = np.abs(yaw[window:] - yaw[:-window]) / (airborne[window:, 0] - airborne[:-window, 0])
        yield "yaw_rate_max_degps", float(np.degrees(spun.max()))


@dataclass(slots=True)
class _SentMessages:
    """The messages that one autopilot sent."""

    counts: dict[str, int] = field(default_factory=dict)
    airborne: dict[str, int] = field(default_factory=dict)
    items: list[tuple[float, int]] = field(default_factory=list)


def _sent_messages(record: RunRecord, windows: Mapping[str, tuple[float, float]]) -> dict[str, _SentMessages]:
    owners = {link_name("autopilot", name): name for name in windows}
    sent_by_vehicle = {name: _SentMessages() for name in windows}
    for frame in record.frames_with_payloads():
        owner = owners.get(frame.link)
        if owner is None or frame.sender != endpoint(owner, "autopilot"):
            continue
        sent, at_s = sent_by_vehicle[owner], frame.sent_ns / NS_PER_S
        name = message_name(frame.payload) or "garbage"
        sent.counts[name] = sent.counts.get(name, 0) + 1
        lift_s, down_s = windows[owner]
        if lift_s <= at_s <= down_s:
            sent.airborne[name] = sent.airborne.get(name, 0) + 1
        if name == "MISSION_ITEM_REACHED":
            sent.items.append((at_s, int(decode(frame.payload).seq)))
    return sent_by_vehicle
