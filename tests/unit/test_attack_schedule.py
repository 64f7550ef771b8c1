"""Do attacks start and stop when they should: by the clock, for a while, and by what truth shows?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from skyrange.attack.triggers import Near
from skyrange.contracts.components import SensorAct, Sensors
from skyrange.contracts.links import Act, LinkSpec, Schedule
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.time import NEVER, Time
from skyrange.kernel import EngineMount, Kernel, Wiring
from tests.probes.toys import MS, Bodies, Climber, Log

FLEET = ["blue/b1", "blue/b2"]


@dataclass(frozen=True)
class Above:
    """Holds from a height on."""

    vehicles: Sequence[str]
    up_m: float

    def holds(self, now: Time, truth: Mapping[str, NDArray[np.float64]], rows: Sequence[int]) -> bool:
        return bool(truth["up_m"][rows[0]] >= self.up_m)


@dataclass
class Lift:
    """Says at every tick that it acted, and keeps what it reads of its schedule."""

    vehicles: Sequence[str]
    schedule: Schedule
    name: str = "lift"
    told: list[tuple[Time, Time]] = field(default_factory=list)

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct]:
        self.told.append((self.schedule.start_ns, self.schedule.stop_ns))
        return [SensorAct(self.vehicles[0], "baro")]


def flown(until: Time = 200 * MS, **plan: object) -> tuple[Log, Lift, Kernel]:
    schedule = Schedule()
    lift = Lift(["blue/b1"], schedule)
    links = [LinkSpec(f"autopilot:{v}", f"{v}.proxy", f"{v}.autopilot") for v in FLEET]
    attack = Act("liar", sensor_hooks=[lift], schedule=schedule, **plan)  # type: ignore[arg-type]
    engines = [EngineMount(Climber("all", FLEET), slice(None))]
    log = Log()
    kernel = Kernel(Wiring(1, links, world=Bodies(FLEET), acts=[attack], engines=engines), [log])
    kernel.advance(until)
    return log, lift, kernel


def acted(log: Log) -> list[Time]:
    return [label.at_ns for label in log.labels]


def said(log: Log) -> list[tuple[object, ...]]:
    return [(note[0], note[2], dict(note[4])["at_s"]) for note in log.notes if str(note[2]).startswith("event.attack")]


def test_by_the_clock_and_for_a_while() -> None:
    log, lift, _ = flown(start_ns=50 * MS, lasts_ns=30 * MS)
    assert (min(acted(log)), max(acted(log))) == (50 * MS, 80 * MS - 2_500_000)
    assert lift.told[0] == (50 * MS, 80 * MS)  # known from the beginning
    assert said(log) == [(50 * MS, "event.attack_start", 0.05), (80 * MS, "event.attack_stop", 0.08)]


def test_the_earlier_of_two_stops_counts() -> None:
    assert max(acted(flown(start_ns=50 * MS, lasts_ns=100 * MS, stop_ns=70 * MS)[0])) < 70 * MS
    assert max(acted(flown(start_ns=50 * MS, lasts_ns=10 * MS, stop_ns=70 * MS)[0])) < 60 * MS


def test_a_trigger_starts_it_at_the_tick_at_which_it_holds() -> None:
    # b1 climbs at 1 m/s from the tick at 0 on, and is asked every 10 ms: 0.1 m is reached at 100 ms
    log, lift, _ = flown(trigger=Above(["blue/b1"], 0.0999), lasts_ns=30 * MS)
    assert (min(acted(log)), max(acted(log))) == (100 * MS, 130 * MS - 2_500_000)
    assert lift.told[:40] == [(NEVER, NEVER)] * 40
    assert lift.told[40] == (100 * MS, 130 * MS)  # at the very tick
    assert said(log) == [(100 * MS, "event.attack_start", 0.1), (130 * MS, "event.attack_stop", 0.13)]


def test_a_trigger_waits_for_its_time_and_does_not_fire_after_it() -> None:
    assert min(acted(flown(trigger=Above(["blue/b1"], 0.05), start_ns=150 * MS)[0])) == 150 * MS
    assert acted(flown(trigger=Above(["blue/b1"], 0.15), stop_ns=120 * MS)[0]) == []


def test_it_fires_once() -> None:
    log, _, _ = flown(trigger=Above(["blue/b1"], 0.0), lasts_ns=10 * MS)
    assert max(acted(log)) < 20 * MS


def test_muted_it_fires_for_its_own_parts_and_for_nobody_else() -> None:
    live, lift, _ = flown(trigger=Above(["blue/b1"], 0.0999), lasts_ns=30 * MS)
    muted, same, _ = flown(trigger=Above(["blue/b1"], 0.0999), lasts_ns=30 * MS, muted=True)
    assert same.told == lift.told
    assert acted(muted) == []
    assert said(muted) == []
    assert muted.truth == live.truth


def test_a_fork_before_the_trigger_fires_alike_and_apart() -> None:
    _, lift, kernel = flown(60 * MS, trigger=Above(["blue/b1"], 0.0999))
    log = Log()
    twin = kernel.fork([log])
    twin.advance(200 * MS)
    assert min(acted(log)) == 100 * MS
    assert lift.schedule.start_ns == NEVER
    kernel.advance(200 * MS)
    assert lift.schedule.start_ns == 100 * MS


def test_near_measures_in_space() -> None:
    truth = {"east_m": np.array([3.0, 0.0]), "north_m": np.array([4.0, 0.0]), "up_m": np.array([12.0, 0.0])}
    place = Near(["a"], 13.0, (0.0, 0.0, 0.0))
    assert place.holds(0, truth, [0])
    assert not Near(["a"], 12.99, (0.0, 0.0, 0.0)).holds(0, truth, [0])
    assert Near(["a", "b"], 13.0).holds(0, truth, [0, 1])
    assert not Near(["a", "b"], 12.99).holds(0, truth, [0, 1])


def test_a_trigger_needs_a_world_and_vehicles_of_it() -> None:
    with pytest.raises(InputError, match=r"liar\.trigger: blue/b7 .*Did you mean 'blue/b"):
        flown(trigger=Above(["blue/b7"], 1.0))
    plan = Act("liar", trigger=Above(["blue/b1"], 1.0))
    with pytest.raises(InputError, match="no world"):
        Kernel(Wiring(1, [LinkSpec("l", "a.x", "b.y")], acts=[plan]))


def test_a_trigger_that_raises_is_blamed() -> None:
    with pytest.raises(ComponentError, match="trigger of attack liar"):
        flown(trigger=Near(["blue/b1"], 1.0, (0.0, 0.0, 0.0)))  # the toy world knows no east


def test_a_trigger_that_held_elsewhere_is_told_and_begins_it_once() -> None:
    schedule = Schedule()
    attack = Act("liar", start_ns=NEVER, stop_ns=90 * MS, lasts_ns=30 * MS, schedule=schedule)
    kernel = Kernel(Wiring(1, [LinkSpec("gcs:blue/b1", "blue.gcs", "blue/b1.companion")], acts=[attack]), [])
    kernel.advance(40 * MS)
    assert schedule.start_ns == NEVER
    kernel.begin("liar", 35 * MS)
    kernel.begin("liar", 60 * MS)
    assert (schedule.start_ns, schedule.stop_ns) == (35 * MS, 65 * MS)
    assert kernel.triggered == {}  # it is not this one that saw it
    with pytest.raises(KeyError):
        kernel.begin("nobody", 70 * MS)


def test_what_a_trigger_began_is_known() -> None:
    assert flown(start_ns=0)[2].triggered == {}
    kernel = flown(start_ns=0, trigger=Above(["blue/b1"], 0.0))[2]
    assert list(kernel.triggered) == ["liar"]
    assert flown(start_ns=0, trigger=Above(["blue/b1"], 1e9))[2].triggered == {}
