"""Each rule for autopilot engines is broken by an engine that breaks just that rule, and is found by its id."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from skyrange.contracts.components import EngineBase, Finished, InstanceStatus, Poses, Sensors
from skyrange.contracts.mailboxes import Inbox, Note, Outbox
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.testing import InputMessage, NonConformance, check_engine
from skyrange.testing.checks.engines import ENGINE
from skyrange.testing.drivers.engine_driver import FLEET
from skyrange.vehicle.contract import VehicleSpec

pytestmark = pytest.mark.rotating

MAIL = [
    InputMessage(
        k * 130 * NS_PER_MS, Port(f"{spec.vehicle}.autopilot", f"autopilot:{spec.vehicle}"), f"ask {k}".encode()
    )
    for k in range(6)
    for spec in FLEET
]


class Lifter(EngineBase):
    """Holds each aircraft at 3 m, tells its height five times a second, answers what it is asked: keeps every rule."""

    service_ns: Any = 10 * NS_PER_MS
    clock: Any = "lockstep"
    repeatable: Any = "bytes"
    preroll_ns: Any = 0
    moves: Any = ()

    def __init__(self, name: str, specs: Sequence[VehicleSpec], *given: object) -> None:
        self.name = name
        self.vehicles = [spec.vehicle for spec in specs]
        self.ports = [Port(f"{v}.autopilot", f"autopilot:{v}") for v in self.vehicles]
        self.up_m = np.zeros(len(specs))
        self.motors = np.zeros((len(specs), 4))
        self.out = Outbox()

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        self.out = Outbox()
        self.up_m = sensors.baro_up_m.copy()
        for arrival in inbox:
            if arrival.payload.startswith(b"ask"):
                self.answer(arrival)
        climb = sensors.gnss_vel_enu_mps[:, 2]
        self.motors[:] = np.clip(0.4 + 0.1 * (3.0 - self.up_m) - 0.1 * climb, 0.0, 1.0)[:, None]

    def answer(self, arrival: Any) -> None:
        self.out.send(arrival.port, b"told " + arrival.payload, (arrival.ref,))
        self.out.note("event.asked", arrival.port.endpoint.rsplit(".", 1)[0], {"size": 5}, (arrival.ref,))

    def finish(self, tick: Time, wall_deadline_s: float) -> Any:
        if tick % (200 * NS_PER_MS) == 0:
            for port, up_m in zip(self.ports, self.up_m.tolist(), strict=True):
                self.out.send(port, self.tell(up_m))
        return Finished(self.motors, self.out)

    def tell(self, up_m: float) -> bytes:
        return f"{up_m:.6f}".encode()


def check(factory: Any) -> None:
    check_engine(factory, mail=MAIL, until=NS_PER_S)


def test_the_unbroken_one_conforms() -> None:
    check(Lifter)


def test_one_that_moves_its_aircraft_itself_conforms() -> None:
    check(Carried)


def with_(**attributes: Any) -> type[Lifter]:
    return type("With", (Lifter,), attributes)


class Nameless(Lifter):
    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.name = ""


class Unending(Lifter):
    """Has everything but `close`."""

    def __getattribute__(self, name: str) -> Any:
        if name == "close":
            raise AttributeError(name)
        return super().__getattribute__(name)


class Backwards(Lifter):
    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.vehicles.reverse()


class OnePort(Lifter):
    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        del self.ports[1:]


class FiveRows(Lifter):
    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.vehicles.append("red/r1")
        self.ports.append(Port("red/r1.autopilot", "autopilot:red/r1"))


class Raises(Lifter):
    def finish(self, tick: Time, wall_deadline_s: float) -> Any:
        if tick > 500 * NS_PER_MS:
            raise RuntimeError("lost")
        return super().finish(tick, wall_deadline_s)


class Bare(Lifter):
    def finish(self, tick: Time, wall_deadline_s: float) -> Any:
        return self.motors, self.out


class LazyBox(Lifter):
    def finish(self, tick: Time, wall_deadline_s: float) -> Any:
        finished = super().finish(tick, wall_deadline_s)
        finished.outbox.departures = iter(finished.outbox.departures)
        return finished


def commanding(change: Any) -> type[Lifter]:
    class Commands(Lifter):
        def finish(self, tick: Time, wall_deadline_s: float) -> Any:
            finished = super().finish(tick, wall_deadline_s)
            finished.actuators = change(finished.actuators.copy(), tick)
            return finished

    return Commands


def stating(status: Any) -> type[Lifter]:
    class States(Lifter):
        def finish(self, tick: Time, wall_deadline_s: float) -> Any:
            finished = super().finish(tick, wall_deadline_s)
            finished.status = status(len(self.vehicles))
            return finished

    return States


def answering(do: Any) -> type[Lifter]:
    class Answers(Lifter):
        def answer(self, arrival: Any) -> None:
            do(self.out, arrival)

    return Answers


TICKETS = itertools.count()


class Unrepeatable(Lifter):
    def tell(self, up_m: float) -> bytes:
        return f"{next(TICKETS)}".encode()


class Mean(Lifter):
    """What it tells of one aircraft depends on which others are in the array."""

    def tell(self, up_m: float) -> bytes:
        return f"{up_m - self.up_m.mean():.9f} {len(self.vehicles)}".encode()


class Mixed(Lifter):
    """Minds which engine of the process finished a tick before it."""

    last: tuple[Time, str] = (-1, "")

    def finish(self, tick: Time, wall_deadline_s: float) -> Any:
        finished = super().finish(tick, wall_deadline_s)
        if Mixed.last[0] == tick and Mixed.last[1] > self.vehicles[0]:
            finished.outbox.send(self.ports[0], b"somebody was here before me")
        Mixed.last = (tick, self.vehicles[0])
        return finished


class Keeps(Lifter):
    """Keeps a view of the sensors instead of a copy: by the next tick it shows something else."""

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        before = self.up_m
        super().begin(tick, sensors, inbox)
        self.up_m = sensors.baro_up_m
        self.motors[:] = np.where(np.isnan(before), 0.0, 0.5)[:, None]


class Writes(Lifter):
    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        super().begin(tick, sensors, inbox)
        sensors.baro_up_m += 1.0


class Clocked(Lifter):
    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        time.monotonic_ns()
        super().begin(tick, sensors, inbox)


class SharedHistory(Lifter):
    """Its copies write into the same history."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.history: list[Time] = []

    def __deepcopy__(self, memo: object) -> SharedHistory:
        twin = type(self).__new__(type(self))
        twin.__dict__.update(self.__dict__, motors=self.motors.copy())
        return twin

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        super().begin(tick, sensors, inbox)
        self.history.append(tick)

    def tell(self, up_m: float) -> bytes:
        return f"{len(self.history)}".encode()


class Uncopyable(Lifter):
    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.numbers = (number for number in range(3))


class Trusting(Lifter):
    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        for arrival in inbox:
            arrival.payload.decode()
        super().begin(tick, sensors, inbox)


class Echoes(Lifter):
    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        super().begin(tick, sensors, inbox)
        for arrival in inbox:
            if not arrival.payload.startswith(b"ask"):
                self.out.send(arrival.port, b"what?")
                self.out.send(arrival.port, b"what??")


class Carried(Lifter):
    """Moves its aircraft itself: straight up at 1 m/s. Keeps every rule."""

    far_m = 0.0

    def __init__(self, name: str, specs: Sequence[VehicleSpec], *given: object) -> None:
        super().__init__(name, specs, *given)
        self.moves = list(self.vehicles)
        self.home = np.array([spec.home_enu_m for spec in specs])

    def finish(self, tick: Time, wall_deadline_s: float) -> Any:
        finished = super().finish(tick, wall_deadline_s)
        n = len(self.vehicles)
        up = np.tile((0.0, 0.0, 1.0), (n, 1))
        place = self.home + up * (max(tick, 0) / NS_PER_S + self.far_m)
        level = np.tile((1.0, 0.0, 0.0, 0.0), (n, 1))
        finished.poses = Poses(np.full(n, tick % self.service_ns == 0), place, up, level, np.zeros((n, 3)))
        return finished


class Unasked(Carried):
    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.moves = []


class Posed(Lifter):
    def finish(self, tick: Time, wall_deadline_s: float) -> Any:
        finished = super().finish(tick, wall_deadline_s)
        finished.poses = finished.actuators
        return finished


READY = InstanceStatus.READY

BREAKING: list[tuple[str, Any]] = [
    ("declares", Nameless),
    ("declares", with_(clock="sundial")),
    ("declares", with_(repeatable="mostly")),
    ("declares", with_(preroll_ns=-1)),
    ("vehicles", Backwards),
    ("vehicles", OnePort),
    ("vehicles", FiveRows),
    ("service", with_(service_ns=3 * NS_PER_MS)),
    ("service", with_(service_ns=0)),
    ("finishes", Raises),
    ("finishes", Bare),
    ("outbox", LazyBox),
    ("actuators", commanding(lambda motors, tick: motors * np.nan)),
    ("actuators", commanding(lambda motors, tick: motors + 1.0)),
    ("actuators", commanding(lambda motors, tick: motors.astype(np.float32))),
    ("actuators", commanding(lambda motors, tick: motors[:-1])),
    ("actuators", commanding(lambda motors, tick: motors[:, 0])),
    ("actuators", commanding(lambda motors, tick: motors if tick else motors[:, :1])),
    ("declares", with_(moves=["red/r1"])),
    ("declares", Unending),
    ("poses", Posed),
    ("poses", Unasked),
    ("poses", type("Lost", (Carried,), {"far_m": np.nan})),
    ("poses", type("Gone", (Carried,), {"far_m": 1e9})),
    ("status", stating(lambda n: ["ready"] * n)),
    ("status", stating(lambda n: [READY] * (n + 1))),
    ("status", stating(lambda n: [READY] * (n - 1) + [InstanceStatus.BOOTING])),
    ("status", stating(lambda n: [READY] * (n - 1) + [InstanceStatus.SILENT])),
    ("departures", answering(lambda out, arrival: out.send(Port("x.gcs", "gcs:x"), b""))),
    ("departures", answering(lambda out, arrival: out.send(arrival.port, "text"))),
    ("notes", answering(lambda out, arrival: out.note("event.asked", "red/r1"))),
    ("notes", answering(lambda out, arrival: out.note("event.asked", "blue/b1", {"size": np.int64(3)}))),
    ("notes", answering(lambda out, arrival: out.notes.append(Note("asked", "blue/b1", {})))),
    ("causes", answering(lambda out, arrival: out.send(arrival.port, b"", (arrival.ref._replace(serial=10**6),)))),
    ("repeatable", Unrepeatable),
    ("split", Mean),
    ("order", Mixed),
    ("sensors", Keeps),
    ("sensors", Writes),
    ("pure", Clocked),
    ("copies", SharedHistory),
    ("copies", Uncopyable),
    ("hostile", Trusting),
    ("modest", Echoes),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(("rule", "broken"), BREAKING, ids=[f"{rule}-{made.__name__}" for rule, made in BREAKING])
def test_a_broken_rule_is_found(rule: str, broken: Any) -> None:
    with pytest.raises(NonConformance) as found:
        check(broken)
    assert found.value.rule == f"engine.{rule}", str(found.value)


def test_every_rule_is_shown_to_fail() -> None:
    assert {f"engine.{rule}" for rule, _ in BREAKING} == {rule.id for rule in ENGINE.rules}


def test_an_engine_of_programs_need_not_repeat_to_the_byte() -> None:
    check(type("Outcome", (Unrepeatable,), {"repeatable": "outcome"}))
