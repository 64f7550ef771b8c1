"""Missions flown by two kinds of autopilot in one run: its scenario, the flights in its record, their differences.

Every mission has two aircraft, one per kind, in one run with the same wind, so that both fly in the same world. A
mission agrees if both accept its items, take off, report the same items and modes in the same order, at the same times
after lift-off, fly along the same path, and end alike. A mission that both reject, in which neither takes off, or in
which both crash is undecided: it shows neither agreement nor a difference.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import decode, message_name
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mission import Mission, format_waypoints
from skyrange.core.geodesy import Origin
from skyrange.core.ids import endpoint, link_name
from skyrange.core.time import NS_PER_S, Time
from skyrange.gcs.plan.plans import FlightPlan, from_file
from skyrange.gcs.plan.routes import enu_points, estimated_duration_s
from skyrange.metrics.paths import AIRBORNE_M, path_distance_m
from skyrange.metrics.time_series import Track, read_notes, truth_tracks
from skyrange.parity.flights import DEADLINE_S
from skyrange.parity.missions.rounded_turns import read_headings, rounded_turn
from skyrange.record import RunRecord
from skyrange.runtime.run import OnProgress
from skyrange.scenario.model.scenario import Scenario
from skyrange.study.runs import fly
from skyrange.twins.failed_missions import rejected_missions

Floats = NDArray[np.float64]

KINDS: Final = ("builtin", "ardupilot")
"""The kinds of autopilot that are compared; each has an operator of the same name."""
TIME_S: Final = 0.5
TIME_SHARE: Final = 0.01
"""An item is reached at the same time if the times differ by at most `TIME_S` plus this share of the time."""
PATH_M: Final = 1.0
"""Two tracks are one path if no point of either is farther from the other track."""
MARGIN_S: Final = 75.0
DEPART_S: Final = 5.0
APART_M: Final = 1_000.0
"""Distance between starts, or more where missions lead farther."""
ABREAST: Final = 8
ORIGIN: Final = Origin(-35.363328, 149.1652241, 10.0)
TRUTH_HZ: Final = 20.0


class ComparableMission(Protocol):
    """A mission that can be flown from any start."""

    @property
    def number(self) -> int:
        """Its number, which names it in the results."""
        ...

    @property
    def words(self) -> str:
        """Its contents in one line."""
        ...

    @property
    def commands(self) -> tuple[int, ...]:
        """The commands of its items, from sequence number 1 on."""
        ...

    def at(self, origin: Origin, start_enu_m: tuple[float, float]) -> Mission:
        """The mission for an aircraft that starts at `start_enu_m`, at the height of the origin."""
        ...


@dataclass(frozen=True, slots=True)
class FlownMission:
    """One aircraft's flight of a mission. Times are in s after lift-off."""

    rejected: str
    """Why the autopilot rejected the mission, or ""."""
    items: tuple[tuple[float, int], ...]
    """Items reported as reached: time, sequence number."""
    modes: tuple[str, ...]
    outcome: str
    down_s: float
    """When it was last above `AIRBORNE_M`; NaN if it never was."""
    path_m: Floats
    """(n, 3) true positions in the air, relative to the start."""
    crashed: str = ""
    """When it crashed, and with what charge, or ""."""
    time_s: Floats = field(default_factory=lambda: np.zeros(0))
    """(n,) times of `path_m` and `heading_rad`."""
    heading_rad: Floats = field(default_factory=lambda: np.zeros(0))
    """(n,) true headings, clockwise from north, without jumps of a whole circle."""

    @property
    def took_off(self) -> bool:
        """Whether it has a path."""
        return len(self.path_m) >= 2


@dataclass(frozen=True, slots=True)
class ComparedMission:
    """One mission, flown by both in the order of `KINDS`, in a wind of `wind_mps` from `wind_from_deg`.

    `miss` says in which way the flights differ, "" for none; `undecided` why they show neither agreement nor a
    difference, "" if they do; `detail` gives the numbers.
    """

    mission: ComparableMission
    wind_mps: float
    wind_from_deg: float
    flights: tuple[FlownMission, FlownMission]
    miss: str
    detail: str
    path_apart_m: float
    time_apart_s: float
    """Greatest difference between the times of an item that both reached."""
    undecided: str = ""

    @property
    def alike(self) -> bool:
        """Whether they agree within the tolerances."""
        return not self.miss and not self.undecided


def flight_plan(mission: ComparableMission) -> FlightPlan:
    """The flight plan of a mission for an aircraft that starts at the origin."""
    with TemporaryDirectory() as scratch:
        file = Path(scratch) / "mission.waypoints"
        file.write_text(format_waypoints(mission.at(ORIGIN, (0.0, 0.0))))
        return from_file(ORIGIN, (0.0, 0.0, 0.0), file, anchor=False)


def compare_fleet(
    folder: Path,
    missions: Sequence[ComparableMission],
    wind: tuple[float, float],
    rates: str = "reduced",
    *,
    on_progress: OnProgress | None = None,
) -> list[ComparedMission]:
    """Fly missions with both autopilots in one run, into the run folder `folder`, and compare the flights."""
    with TemporaryDirectory() as scratch:
        record = fly(
            fleet_scenario(missions, wind, Path(scratch), rates), folder, on_progress=on_progress, report=False
        )
    return read(record, missions, wind)


def fleet_scenario(
    missions: Sequence[ComparableMission], wind: tuple[float, float], scratch: Path, rates: str = "reduced"
) -> Scenario:
    """The scenario with two aircraft for every mission, whose files are written into `scratch`; `rates` ArduPilot's."""
    plans = [flight_plan(mission) for mission in missions]
    apart_m = _apart_m(plans)
    operators: list[dict[str, Any]] = []
    for place, kind in enumerate(KINDS):
        vehicles = []
        for number, mission in enumerate(missions):
            east_m, north_m = _start(2 * number + place, apart_m)
            file = scratch / f"{kind}-{number}.waypoints"
            file.write_text(format_waypoints(mission.at(ORIGIN, (east_m, north_m))))
            vehicles.append(
                {
                    "id": _name(number),
                    "autopilot": kind,
                    "start": [east_m, north_m, 0.0],
                    "depart_s": DEPART_S,
                    "plan": {"file": str(file), "rejection_expected": True},
                }
            )
        operators.append({"id": kind, "vehicles": vehicles})
    longest_s = max(estimated_duration_s(plan) for plan in plans)
    return Scenario.model_validate(
        {
            "name": "mission-parity",
            "duration_s": DEPART_S + longest_s + MARGIN_S,
            "origin": {"lat": ORIGIN.lat_deg, "lon": ORIGIN.lon_deg, "alt_msl_m": ORIGIN.alt_msl_m},
            "wind": {"speed_mps": wind[0], "from_deg": wind[1]},
            "sensors": {"noise": 0.0},
            "record": {"truth_hz": TRUTH_HZ},
            "autopilots": {"deadline_s": DEADLINE_S, "options": {"ardupilot": {"rates": rates}}},
            "operators": operators,
        }
    )


def read(record: RunRecord, missions: Sequence[ComparableMission], wind: tuple[float, float]) -> list[ComparedMission]:
    """Compare the flights recorded in a run of `fleet_scenario`."""
    tracks, headings = truth_tracks(record), read_headings(record)
    names = [f"{kind}/{_name(number)}" for number in range(len(missions)) for kind in KINDS]
    lifts = {name: _airborne_span_s(tracks[name]) for name in names}
    items = _reached_items(record, lifts)
    rejected = rejected_missions(record)
    modes: dict[str, list[str]] = {name: [] for name in names}
    crashes: dict[str, Time] = {}
    for event in read_notes(record, "events"):
        if event.kind == "event.mode" and event.about in modes:
            modes[event.about].append(str(event.data["mode"]))
        elif event.kind == "event.crash":
            crashes.setdefault(event.about, event.time_ns)
    charge = _charges(record, crashes)

    def flown(name: str) -> FlownMission:
        lift_s, down_s = lifts[name]
        track = tracks[name]
        at_s = track.time_ns / NS_PER_S
        aloft = (at_s >= lift_s) & (at_s <= down_s)
        return FlownMission(
            rejected=rejected.get(name, ""),
            items=tuple(items[name]),
            modes=tuple(modes[name]),
            outcome=str(record.outcomes.get(name, {}).get("state") or "unfinished"),
            down_s=down_s - lift_s,
            path_m=track.enu_m[aloft] - track.enu_m[0],
            time_s=at_s[aloft] - lift_s,
            heading_rad=np.unwrap(headings[name][aloft]),
            crashed=f"{crashes[name] / NS_PER_S - lift_s:.1f} s, {charge[name]:.0%} charge" if name in crashes else "",
        )

    return [
        compare_flights(mission, wind, (flown(f"{KINDS[0]}/{_name(number)}"), flown(f"{KINDS[1]}/{_name(number)}")))
        for number, mission in enumerate(missions)
    ]


def compare_flights(
    mission: ComparableMission, wind: tuple[float, float], flights: tuple[FlownMission, FlownMission]
) -> ComparedMission:
    """Compare two flights of a mission: the first difference, in the order of their importance, is the miss.

    Flights that show nothing are undecided, before any difference is looked for: after a fall all differ.
    """
    first, second = flights
    path_apart_m, where = path_distance_m(first.path_m, second.path_m)
    both = list(zip(first.items, second.items, strict=False))
    time_apart_s = max((abs(a[0] - b[0]) for a, b in both if a[1] == b[1]), default=0.0)
    compared = ComparedMission(mission, *wind, flights, "", "", path_apart_m, time_apart_s)
    undecided, detail = _shows_nothing(mission, first, second)
    if undecided:
        return replace(compared, undecided=undecided, detail=detail)
    for miss, detail in _differences(mission, flights, path_apart_m, where):
        return replace(compared, miss=miss, detail=detail)
    return compared


def _shows_nothing(mission: ComparableMission, first: FlownMission, second: FlownMission) -> tuple[str, str]:
    """Why two flights show neither agreement nor a difference, with details; "" if they do."""
    if first.rejected and second.rejected:
        return "both reject it", f"{first.rejected} / {second.rejected}"
    if first.rejected or second.rejected:
        return "", ""
    if not first.took_off and not second.took_off:
        return "neither takes off", f"{first.outcome} / {second.outcome}"
    if first.crashed and second.crashed:
        return "both crash", f"{first.crashed} / {second.crashed}"
    if why := rounded_turn(mission, first, second):
        return "rounding", why
    return "", ""


def _differences(
    mission: ComparableMission, flights: tuple[FlownMission, FlownMission], path_apart_m: float, where: str
) -> Iterator[tuple[str, str]]:
    first, second = flights
    if bool(first.rejected) != bool(second.rejected):
        yield "accepted items", f"{first.rejected or 'accepted'} / {second.rejected or 'accepted'}"
    if first.took_off != second.took_off:
        yield "take-off", " / ".join("takes off" if flight.took_off else f"{flight.outcome}" for flight in flights)
    if bool(first.crashed) != bool(second.crashed):
        yield "crash", f"{first.crashed or first.outcome} / {second.crashed or second.outcome}"
    seqs = [[seq for _, seq in flight.items] for flight in flights]
    if seqs[0] != seqs[1]:
        short = min(map(len, seqs))
        at = next((n for n in range(short) if seqs[0][n] != seqs[1][n]), short)
        seq = next((each[at] for each in seqs if len(each) > at), 0)
        yield f"items: {_command(mission, seq)}", f"{_listed(seqs[0])} / {_listed(seqs[1])}"
    if first.modes != second.modes:
        yield "modes", f"{', '.join(first.modes)} / {', '.join(second.modes)}"
    for (mine_s, seq), (other_s, _) in zip(first.items, second.items, strict=False):
        if abs(mine_s - other_s) > TIME_S + TIME_SHARE * max(other_s, 0.0):
            yield f"time: {_command(mission, seq)}", f"item {seq} at {mine_s:.2f} s / {other_s:.2f} s"
    if not path_apart_m <= PATH_M:
        yield "path", f"{path_apart_m:.2f} m apart {where}"
    if first.outcome != second.outcome:
        yield "outcome", f"{first.outcome} / {second.outcome}"


def _command(mission: ComparableMission, seq: int) -> str:
    if not 1 <= seq <= len(mission.commands):
        return "end"
    return str(mav.enums["MAV_CMD"][mission.commands[seq - 1]].name.removeprefix("MAV_CMD_"))


def _listed(seqs: Sequence[int]) -> str:
    return ",".join(map(str, seqs)) or "none"


def _airborne_span_s(track: Track) -> tuple[float, float]:
    """First and last time above `AIRBORNE_M`; NaN if it never was."""
    high = track.time_ns[track.enu_m[:, 2] > AIRBORNE_M]
    return (float(high[0]) / NS_PER_S, float(high[-1]) / NS_PER_S) if len(high) else (np.nan, np.nan)


def _charges(record: RunRecord, crashes: Mapping[str, Time]) -> dict[str, float]:
    """By aircraft that has crashed, the charge of its battery then, 0 to 1."""
    if not crashes:
        return {}
    table = record.table("truth", ["time_ns", "vehicle", "charge"])
    names = np.asarray(table.column("vehicle").to_pylist())
    times_ns, charge = (table.column(name).to_numpy() for name in ("time_ns", "charge"))
    return {
        name: float(np.interp(at_ns, times_ns[names == name], charge[names == name])) for name, at_ns in crashes.items()
    }


def _reached_items(record: RunRecord, lifts: Mapping[str, tuple[float, float]]) -> dict[str, list[tuple[float, int]]]:
    """By aircraft, (s after lift-off, sequence number) of the items that it reported as reached while in the air.

    A delay before the take-off, and what is reported after the touchdown, depend on when the ground station acts.
    """
    owners = {link_name("autopilot", name): name for name in lifts}
    reached: dict[str, list[tuple[float, int]]] = {name: [] for name in lifts}
    for frame in record.frames_with_payloads():
        owner = owners.get(frame.link)
        if owner is None or frame.sender != endpoint(owner, "autopilot"):
            continue
        if message_name(frame.payload) != "MISSION_ITEM_REACHED":
            continue
        at_s = frame.sent_ns / NS_PER_S
        lift_s, down_s = lifts[owner]
        if lift_s <= at_s <= down_s:
            reached[owner].append((at_s - lift_s, int(decode(frame.payload).seq)))
    return reached


def _name(number: int) -> str:
    return f"m{number + 1:02}"


def _start(place: int, apart_m: float) -> tuple[float, float]:
    row, column = divmod(place, ABREAST)
    return (column - 0.5 * (ABREAST - 1)) * apart_m, row * apart_m


def _apart_m(plans: Sequence[FlightPlan]) -> float:
    """The distance between starts at which no two plans lead to one place."""
    points = (point for plan in plans for point in enu_points(plan))
    reach_m = max((max(abs(point.east_m), abs(point.north_m)) for point in points), default=0.0)
    return max(APART_M, 2.5 * reach_m)
