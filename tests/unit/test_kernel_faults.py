"""Do sensor faults stand between sensors and autopilots, act when their attack does, and leave a trace?"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from skyrange.contracts.components import Finished, SensorAct, SensorHook, Sensors
from skyrange.contracts.links import Act, LinkSpec
from skyrange.contracts.mailboxes import Inbox
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.time import Time
from skyrange.kernel import EngineMount, Kernel, Wiring
from tests.probes.toys import MS, Bodies, Climber, Log

FLEET = ["blue/b1", "blue/b2", "green/g1"]


class Listener(Climber):
    """Climbs, and keeps what it was told of heights."""

    def __init__(self, name: str, vehicles: Sequence[str]) -> None:
        super().__init__(name, vehicles)
        self.heard: list[tuple[Time, list[float]]] = []
        self.same: list[bool] = []
        self.last: Sensors | None = None

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        super().begin(tick, sensors, inbox)
        self.heard.append((tick, sensors.baro_up_m.tolist()))
        self.last = sensors

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        done = super().finish(tick, wall_deadline_s)
        done.outbox.departures.clear()
        return done


@dataclass
class Lift:
    """Adds to the barometer, says so once, and counts its calls."""

    name: str
    vehicles: Sequence[str]
    by_m: float = 100.0
    times: float = 1.0
    calls: int = 0
    seen: list[float] = field(default_factory=list)

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct]:
        self.seen.append(float(sensors.baro_up_m[0]))
        sensors.baro_up_m[:] = sensors.baro_up_m * self.times + self.by_m
        self.calls += 1
        return [SensorAct(vehicle, "baro") for vehicle in self.vehicles] if self.calls == 9 else []


def rig(*attacks: Act, split: bool = False) -> tuple[Kernel, list[Listener], Log]:
    parts = [FLEET[:1], FLEET[1:]] if split else [FLEET]
    engines = [Listener(f"part{i}", part) for i, part in enumerate(parts)]
    rows: list[Any] = [np.array([FLEET.index(v) for v in part]) for part in parts] if split else [slice(None)]
    links = [LinkSpec(f"autopilot:{v}", f"{v}.proxy", f"{v}.autopilot") for v in FLEET]
    log = Log()
    wiring = Wiring(
        1, links, world=Bodies(FLEET), acts=attacks,
        engines=[EngineMount(engine, row) for engine, row in zip(engines, rows, strict=True)],
    )  # fmt: skip
    return Kernel(wiring, [log]), engines, log


def plan(*faults: SensorHook, muted: bool = False, id_: str = "liar") -> Act:
    return Act(id_, 20 * MS, 40 * MS, muted, sensor_hooks=faults)


def heights(engines: list[Listener]) -> dict[str, list[float]]:
    told: dict[str, list[float]] = {}
    for engine in engines:
        for column, vehicle in enumerate(engine.vehicles):
            told[vehicle] = [values[column] for _, values in engine.heard]
    return told


@pytest.mark.parametrize("split", [False, True])
def test_a_fault_alters_its_vehicles_sensors_while_its_attack_acts(split: bool) -> None:
    kernel, engines, _ = rig(plan(Lift("lift", ["green/g1", "blue/b1"])), split=split)
    clean, quiet, _ = rig(split=split)
    kernel.advance(60 * MS)
    clean.advance(60 * MS)
    told, true = heights(engines), heights(quiet)
    assert told["blue/b2"] == true["blue/b2"]
    for vehicle in ("blue/b1", "green/g1"):
        wrong = [a - b for a, b in zip(told[vehicle], true[vehicle], strict=True)]
        assert wrong == pytest.approx([100.0 if 8 <= tick < 16 else 0.0 for tick in range(len(wrong))])


def test_faults_act_on_what_earlier_ones_have_left_in_order_of_attack_and_name() -> None:
    twice, lift = Lift("z", ["blue/b1"], 0.0, 2.0), Lift("a", ["blue/b1"], 5.0)
    for faults in ((twice, lift), (lift, twice)):
        kernel, engines, _ = rig(plan(*(copy.deepcopy(fault) for fault in faults)))
        clean, quiet, _ = rig()
        kernel.advance(30 * MS)
        clean.advance(30 * MS)
        assert heights(engines)["blue/b1"][-1] == pytest.approx(2.0 * (heights(quiet)["blue/b1"][-1] + 5.0))


def test_those_that_are_first_come_before_others_whatever_their_names() -> None:
    class First(Lift):
        first = True

    twice, lift = Lift("a", ["blue/b1"], 0.0, 2.0), First("z", ["blue/b1"], 5.0)
    kernel, engines, _ = rig(plan(twice, id_="a"), plan(lift, id_="z"))
    clean, quiet, _ = rig()
    kernel.advance(30 * MS)
    clean.advance(30 * MS)
    assert heights(engines)["blue/b1"][-1] == pytest.approx(2.0 * (heights(quiet)["blue/b1"][-1] + 5.0))


def test_muted_it_works_on_a_copy_that_nobody_sees() -> None:
    fault = Lift("lift", ["blue/b1"])
    kernel, engines, log = rig(plan(fault, muted=True))
    clean, quiet, _ = rig()
    kernel.advance(60 * MS)
    clean.advance(60 * MS)
    assert heights(engines) == heights(quiet)
    assert log.labels == []
    assert fault.calls == len(quiet[0].heard)
    assert fault.seen == heights(quiet)["blue/b1"]  # its own writing does not come back to it


def test_acts_are_labelled_with_an_id_of_their_own() -> None:
    kernel, _, log = rig(plan(Lift("lift", ["blue/b1", "green/g1"])))
    kernel.advance(60 * MS)
    assert [(label.at_ns, label.attack, label.actor, label.action) for label in log.labels] == [
        (20 * MS, "liar", "lift", "sensor")
    ] * 2
    assert [str(label.frame) for label in log.labels] == ["baro:blue/b1|fwd|lift|0", "baro:green/g1|fwd|lift|0"]


def test_a_fork_goes_on_alike_and_apart() -> None:
    kernel, engines, _ = rig(plan(Lift("lift", ["blue/b1"])))
    kernel.advance(25 * MS)
    twin = kernel.fork([])
    kernel.advance(60 * MS)
    before = len(heights([twin._engines[0].engine])["blue/b1"])  # type: ignore[list-item]
    twin.advance(60 * MS)
    assert before < len(engines[0].heard)
    assert heights([twin._engines[0].engine]) == heights(engines)  # type: ignore[list-item]


def test_engines_without_a_faulty_vehicle_keep_the_worlds_arrays_and_the_others_may_not_write() -> None:
    kernel, engines, _ = rig(plan(Lift("lift", ["blue/b1"])), split=True)
    kernel.advance(25 * MS)
    assert engines[0].last is not None
    with pytest.raises(ValueError, match="read-only"):
        engines[0].last.baro_up_m[0] = 1.0
    assert engines[1].last is not None
    assert engines[1].last.baro_up_m.flags.writeable  # the toy world's own copy, passed through


def test_what_is_wrong_with_a_fault_is_named() -> None:
    with pytest.raises(InputError) as caught:
        rig(plan(Lift("lift", ["blue/b7"]), Lift("lift", ["blue/b1", "blue/b1"])))
    text = str(caught.value)
    assert "blue/b7" in text
    assert "a name that no other sensor fault has" in text
    assert "each vehicle once" in text


def test_a_fault_that_raises_or_lies_about_whom_it_reached_is_blamed() -> None:
    class Bad(Lift):
        def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct]:
            if self.by_m > 0.0:
                raise RuntimeError("no")
            return [SensorAct("blue/b2", "baro")]

    for by_m, words in ((1.0, "sensor fault bad"), (-1.0, "not its own")):
        kernel, _, _ = rig(plan(Bad("bad", ["blue/b1"], by_m)))
        with pytest.raises(ComponentError, match=words):
            kernel.advance(60 * MS)
