"""Reactions of two kinds of autopilot to false GNSS: a hundred settings, each flown by both in one run.

Every setting has two aircraft, one per kind, which hover at a waypoint of their mission, with very little sensor noise
and far from all others. Then both receivers get the same false GNSS. The reactions are read from events and truth;
nothing is used of an estimator that an operator could not see as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.metrics.paths import AIRBORNE_M
from skyrange.metrics.time_series import RecordedNote, read_notes, truth_tracks
from skyrange.parity.flights import DEADLINE_S, KINDS
from skyrange.record import RunRecord
from skyrange.runtime.run import OnProgress
from skyrange.scenario.model.scenario import Scenario
from skyrange.study.runs import fly

START_S: Final = 31.0
"""When the attacks begin. All aircraft hover by then, and for more than 30 s: no EKF failsafe is raised earlier."""
SECONDS: Final = 45.0
"""How long they last: four times `posRetryTimeUseVel_ms`, which is enough for a second reset in most drifts."""
NOISE: Final = 0.01
"""Scale of the sensor noise: so small that both kinds see the same values, but not 0. With noise, GNSS receivers report
5 times a second, with a delay, and claim 1.5 m and 0.2 m/s; ideal ones would claim 0.01 m at every tick."""
APART_M: Final = 2_000.0
"""Distance between aircraft, so large that none meets another wherever it is led."""
ABREAST: Final = 14
ALT_M: Final = 20.0
NOT_IN_THE_AIR: Final = "not in the air"
MOVED_M: Final = 2.0
"""Two aircraft are led to different places if their distances differ by more than this and by more than `SHARE`."""
SHARE: Final = 0.1
RESET_M: Final = 1.5
"""A smaller reset cannot be distinguished from noise in ArduPilot's reports."""
TIME_S: Final = 1.0
"""Resets at most this far apart count as simultaneous."""

HOLD: Final = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t-35.363328\t149.1652241\t10\t1
1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t{alt:g}\t1
2\t0\t3\t16\t{hold:g}\t0\t0\t0\t-35.363328\t149.1652241\t{alt:g}\t1
3\t0\t3\t21\t0\t0\t0\t0\t-35.363328\t149.1652241\t0\t1
"""
"""Take-off, a waypoint above it at which the aircraft waits, landing (MAV_CMD 22, 16, 21)."""


@dataclass(frozen=True, slots=True)
class Setting:
    """One GNSS attack: its kind, `gnss.jump` or `gnss.drift`, and its parameters without `vehicles`."""

    kind: str
    params: Mapping[str, Any]

    @property
    def description(self) -> str:
        """A short description, in metres and m/s east, north, up."""
        if self.kind == "gnss.jump":
            return f"jump {_vector(self.params['offset_m'])} m"
        until = f", {self.params['at_largest']} at {self.params['largest_m']:g} m" if "largest_m" in self.params else ""
        return f"drift {_vector(self.params['rate_mps'])} m/s, velocity {self.params['velocity']}{until}"


@dataclass(frozen=True, slots=True)
class Reaction:
    """Reaction of one aircraft. Times are in s after the attack's beginning, `None` if an event never happened.

    `resets` are jumps of the estimate of at least `RESET_M`, (time, metres). `led_m` is the true distance from the
    original position at the end of the run or, if a failsafe took over, at that time.
    """

    glitch_s: float | None
    cleared_s: float | None
    resets: tuple[tuple[float, float], ...]
    failsafe_s: float | None
    led_m: float
    took_off: bool = True
    """Whether it was in the air when the attack began."""

    @property
    def reset_s(self) -> float | None:
        """Time of the first reset."""
        return self.resets[0][0] if self.resets else None

    @property
    def outcome(self) -> str:
        """The most severe of ignored, followed, doubted, "doubted, then followed", reset and failsafe that applies.

        Or "not in the air", whatever it reports on the ground.
        """
        if not self.took_off:
            return NOT_IN_THE_AIR
        if self.failsafe_s is not None:
            return "failsafe"
        if self.resets:
            return "reset"
        if self.glitch_s is not None:
            return "doubted, then followed" if self.cleared_s is not None else "doubted"
        return "followed" if self.led_m > MOVED_M else "ignored"


@dataclass(frozen=True, slots=True)
class ComparedReaction:
    """One setting and the reactions of the two, in the order of `KINDS`."""

    setting: Setting
    first: Reaction
    second: Reaction

    @property
    def alike(self) -> bool:
        """Whether the outcomes are the same and the aircraft are led equally far, to within 2 m or a tenth.

        Aircraft that are not in the air agree with none.
        """
        if NOT_IN_THE_AIR in (self.first.outcome, self.second.outcome):
            return False
        near = abs(self.first.led_m - self.second.led_m) <= max(MOVED_M, SHARE * self.second.led_m)
        return self.first.outcome == self.second.outcome and (near or self.first.outcome == "failsafe")

    @property
    def reset_apart_s(self) -> float | None:
        """How much later the first of `KINDS` was reset, in s; `None` unless both were."""
        if self.first.reset_s is None or self.second.reset_s is None:
            return None
        return self.first.reset_s - self.second.reset_s


def settings() -> list[Setting]:
    """A hundred settings: offsets of 2 m to 1 km, drifts of 0.2 to 15 m/s with true and consistent velocity, heights.

    They were chosen in advance as a grid, finer near the gates of EKF3 for a receiver that claims 1.5 m and 0.2 m/s.
    """
    return [*_jumps(), *_drifts()]


def _jumps() -> Iterator[Setting]:
    for metres in (2, 4, 6, 8, 9, 10, 11, 12, 13, 14, 16, 20, 30, 50, 100, 300, 1000):
        yield Setting("gnss.jump", {"offset_m": [float(metres), 0.0, 0.0]})
        yield Setting("gnss.jump", {"offset_m": [-0.6 * metres, 0.8 * metres, 0.0]})
    for up in (-30.0, 10.0, 30.0, 100.0):
        yield Setting("gnss.jump", {"offset_m": [0.0, 0.0, up]})


def _drifts() -> Iterator[Setting]:
    for velocity in ("unaltered", "consistent"):
        for rate in (0.2, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0):
            yield _drift([rate, 0.0, 0.0], velocity)
            yield _drift([0.6 * rate, -0.8 * rate, 0.0], velocity)
        for rate in (0.5, 1.0, 3.0):
            yield _drift([0.0, 0.0, rate], velocity)
        yield _drift([2.0, 0.0, 0.0], velocity, largest_m=20.0, at_largest="hold")
        yield _drift([2.0, 0.0, 0.0], velocity, largest_m=20.0, at_largest="return")


def _drift(rate: Sequence[float], velocity: str, **more: Any) -> Setting:
    return Setting("gnss.drift", {"rate_mps": list(rate), "velocity": velocity, **more})


def scenario(chosen: Sequence[Setting], mission: Path, rates: str = "reduced") -> Scenario:
    """The scenario with both aircraft of every setting and the attacks.

    `mission` is a file with the mission `HOLD`; `rates` are ArduPilot's.
    """
    rows = [
        {
            "id": kind,
            "vehicles": [
                {
                    "id": _name(number),
                    "autopilot": kind,
                    "start": _start(2 * number + place),
                    "plan": {"file": str(mission), "anchor": "start"},
                }
                for number in range(len(chosen))
            ],
        }
        for place, kind in enumerate(KINDS)
    ]
    attacks = [
        {
            "id": f"lie-{_name(number)}",
            "kind": setting.kind,
            "start_s": START_S,
            "params": {"vehicles": [f"{kind}/{_name(number)}" for kind in KINDS], **setting.params},
        }
        for number, setting in enumerate(chosen)
    ]
    return Scenario.model_validate(
        {
            "name": "gnss-reactions",
            "duration_s": START_S + SECONDS,
            "origin": {"lat": -35.363328, "lon": 149.1652241, "alt_msl_m": 10.0},
            "sensors": {"noise": NOISE},
            "autopilots": {"deadline_s": DEADLINE_S, "options": {"ardupilot": {"rates": rates}}},
            "operators": rows,
            "attacks": attacks,
        }
    )


def compare(
    folder: Path,
    chosen: Sequence[Setting],
    rates: str = "reduced",
    *,
    on_progress: OnProgress | None = None,
) -> list[ComparedReaction]:
    """Fly the settings with both autopilots in one run, into the run folder `folder`, and read the reactions.

    `rates` are ArduPilot's. Raises the errors of `study.runs.fly`.
    """
    with TemporaryDirectory() as scratch:
        mission = Path(scratch) / "hold.waypoints"
        mission.write_text(HOLD.format(alt=ALT_M, hold=START_S + SECONDS))
        record = fly(scenario(chosen, mission, rates), folder, on_progress=on_progress, report=False)
    return read(record, chosen)


def read(record: RunRecord, chosen: Sequence[Setting]) -> list[ComparedReaction]:
    """The reactions recorded in a run of `scenario`."""
    events: dict[str, list[RecordedNote]] = {}
    for event in read_notes(record, "events"):
        events.setdefault(event.about, []).append(event)
    tracks = truth_tracks(record)

    def reaction(vehicle: str) -> Reaction:
        return _reaction([event for event in events[vehicle] if event.time_ns >= start_ns], tracks[vehicle])

    start_ns = from_seconds(START_S)
    return [
        ComparedReaction(setting, *(reaction(f"{kind}/{_name(number)}") for kind in KINDS))
        for number, setting in enumerate(chosen)
    ]


def _reaction(events: Sequence[RecordedNote], track: Any) -> Reaction:
    def first(kind: str, **data: Any) -> float | None:
        times = (e.time_ns for e in events if e.kind == kind and data.items() <= dict(e.data).items())
        at_ns = next(times, None)
        return None if at_ns is None else at_ns / NS_PER_S - START_S

    resets = [
        (
            event.time_ns / NS_PER_S - START_S,
            hypot(*(float(event.data[axis]) for axis in ("east_m", "north_m", "up_m"))),
        )
        for event in events
        if event.kind == "event.estimator" and "reset" in event.data
    ]
    failsafe_s = first("event.ekf_failsafe", on=True)
    end_s = SECONDS if failsafe_s is None else failsafe_s
    ends_ns = np.array([from_seconds(START_S), from_seconds(START_S + end_s)])
    begin, end = track.at(ends_ns)
    return Reaction(
        glitch_s=first("event.glitch", on=True),
        cleared_s=first("event.glitch", on=False),
        resets=tuple((at_s, by_m) for at_s, by_m in resets if by_m >= RESET_M),
        failsafe_s=failsafe_s,
        led_m=float(np.sqrt(((end - begin) ** 2).sum())),
        took_off=bool(begin[2] - track.enu_m[0, 2] > AIRBORNE_M),
    )


@dataclass(frozen=True, slots=True)
class ReactionAgreement:
    """Number of settings with equal outcomes, and time differences of the first resets if both were reset."""

    settings: int
    alike: int
    resets: int
    together: int
    """Number of those resets that were at most `TIME_S` apart."""
    reset_apart_max_s: float


def agreement(compared: Sequence[ComparedReaction]) -> ReactionAgreement:
    """The agreement of all compared settings."""
    apart_s = [abs(reaction.reset_apart_s) for reaction in compared if reaction.reset_apart_s is not None]
    return ReactionAgreement(
        settings=len(compared),
        alike=sum(reaction.alike for reaction in compared),
        resets=len(apart_s),
        together=sum(each <= TIME_S for each in apart_s),
        reset_apart_max_s=max(apart_s, default=0.0),
    )


def _name(number: int) -> str:
    return f"s{number + 1:03}"


def _start(place: int) -> list[float]:
    row, column = divmod(place, ABREAST)
    return [(column - 0.5 * (ABREAST - 1)) * APART_M, row * APART_M, 0.0]


def _vector(parts: Sequence[float]) -> str:
    return ", ".join(f"{part:g}" for part in parts)
