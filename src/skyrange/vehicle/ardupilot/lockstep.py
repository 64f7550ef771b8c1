"""ArduPilot in lockstep with our world: its JSON physics backend.

Every tick each process gets the tick's sensors, all compute side by side, and the tick ends when all have answered. No
clock of the machine takes part: the same inputs give the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from skyrange.agent.contracts import Finished, InstanceStatus, Sensors
from skyrange.agent.messages import Inbox, Outbox
from skyrange.codec.mavlink import Message
from skyrange.core.errors import ComponentError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch, Time
from skyrange.io.sitl import LockstepSitl, wall_s
from skyrange.vehicle.ardupilot import parameters
from skyrange.vehicle.ardupilot.fleet import QUANTUM_NS, START_S, WARM_UP_NS, Fleet, Instance
from skyrange.vehicle.ardupilot.options import Options
from skyrange.vehicle.ardupilot.packets import MeanForce, Motion, between, commands_of, lines, motion_of, stamp_s
from skyrange.vehicle.spec import VehicleSpec
from skyrange.world.airframes import AIRFRAMES

_TRIES = 5


@dataclass(slots=True)
class _Stepper:
    """How time passes for one process."""

    sitl: LockstepSitl
    per_tick: int
    ticks: int
    """Exchanges per tick, ticks per exchange: one of them is 1."""
    steps: int = 0
    step_ns: Time = field(init=False)
    """Between two exchanges."""

    def __post_init__(self) -> None:
        self.step_ns = QUANTUM_NS * self.ticks // self.per_tick


class LockstepFleet(Fleet):
    """Flown by our physics (contract: `agent.contracts.Engine`)."""

    physics: Literal["shared", "native"] = "shared"
    clock: Literal["lockstep", "wall"] = "lockstep"
    repeatable: Literal["bytes", "outcome"] = "bytes"
    preroll_ns: Time = WARM_UP_NS

    def __init__(self, name: str, specs: Sequence[VehicleSpec], origin: Origin, epoch: Epoch, options: Options) -> None:
        """As `Fleet`."""
        super().__init__(name, specs, origin, epoch, options)
        self._home_up_m = np.array([spec.home_enu_m[2] for spec in specs])
        self._steppers: list[_Stepper] = []
        self._tick: Time | None = None
        self._mean = MeanForce(len(specs))
        self._skips = False
        """Whether any has no exchange in some ticks."""
        self._rates: list[int] = []
        """Exchanges per tick, as some have them."""
        self._motion: Motion | None = None
        """At the last tick."""
        self._lines: dict[tuple[int, int], list[bytes]] = {}
        """What each is sent in this tick, by exchanges per tick and which of them."""
        self._due: list[int] = []

    def _values(self, spec: VehicleSpec, gnss_lag_ms: int) -> dict[str, float]:
        airframe = AIRFRAMES[spec.airframe]
        return parameters.start_values(spec.vehicle, airframe, spec.params, self._listed, gnss_lag_ms)

    def _launch(self, **arguments: Any) -> LockstepSitl:
        return LockstepSitl(**arguments, logs=self._options.keep_logs)

    def _come_up(self) -> None:
        """Wait until the last process has spoken, each from a port of its own."""
        deadline = wall_s() + START_S
        taken: set[int] = set()
        for one in self._instances:
            sitl = self._sitl(one)
            for again in range(_TRIES):
                if sitl.servos(deadline) is None:
                    raise sitl.lost(f"did not come up within {START_S:g} s")
                if sitl.port not in taken:
                    break
                self._launch_again(one, f"-{again + 2}")  # two at one port: one of them would not hear us
                sitl = self._sitl(one)
            taken.add(sitl.port)
            rates = parameters.steps_of(one.values, self._listed, QUANTUM_NS / NS_PER_S)
            self._steppers.append(_Stepper(sitl, *rates))
        self._skips = any(stepper.ticks > 1 for stepper in self._steppers)
        self._rates = sorted({stepper.per_tick for stepper in self._steppers})

    def _sitl(self, one: Instance) -> LockstepSitl:
        assert isinstance(one.sitl, LockstepSitl)
        return one.sitl

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        """Hand everyone its mail, its fix and the first step of the tick."""
        if not self._instances:
            self._start(tick, sensors)
            self._come_up()
        self._hand_over(sensors, inbox)
        if self._tick is not None and tick - self._tick != QUANTUM_NS:
            raise ComponentError(
                f"engine {self.name}", f"a tick of {tick - self._tick} ns", f"It flies in a world of {QUANTUM_NS} ns"
            )
        self._tick = tick
        number = tick // QUANTUM_NS
        self._due = due = [row for row, one in enumerate(self._instances) if one.alive and self._exchanges(row, number)]
        if self._skips:
            self._mean.feel(sensors.accel_mps2)
        if not due:
            return
        after = motion_of(sensors, self._home_up_m)
        if self._skips:
            self._mean.put(after, due)
        before, self._motion = (self._motion if self._motion is not None else after), after
        for per_tick in self._rates:
            for turn in range(per_tick):
                stamps = [stamp_s(one.steps + turn + 1, one.step_ns) for one in self._steppers]
                motion = after if turn + 1 == per_tick else between(before, after, (turn + 1) / per_tick)
                self._lines[per_tick, turn] = lines(stamps, motion)
        for row in due:
            self._send(row)

    def _exchanges(self, row: int, number: int) -> bool:
        """Whether it does in a tick."""
        ticks = self._steppers[row].ticks
        return ticks == 1 or number % ticks == 0

    def _send(self, row: int) -> None:
        """Let a process compute the tick, all its steps without a pause: it takes one line at a time."""
        stepper = self._steppers[row]
        for turn in range(stepper.per_tick):
            stepper.sitl.send(self._lines[stepper.per_tick, turn][row])
        stepper.steps += stepper.per_tick

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        """Motor commands, and what was said; whoever has not answered by the deadline is given up."""
        booting = any(one.status is InstanceStatus.BOOTING for one in self._instances)
        deadline = wall_s() + (max(START_S, wall_deadline_s) if booting else wall_deadline_s)
        outbox = Outbox()
        answers: dict[int, bytes] = {}
        for row in self._due:
            answer = self._answer(row, deadline, outbox)
            if answer is not None:
                answers[row] = answer
        if answers:
            self._commands[[*answers]] = commands_of([*answers.values()])
        for row, one in enumerate(self._instances):
            if not one.alive:
                self._commands[row] = 0.0  # speed controllers without a signal stop
        self._hear(tick, outbox)
        return Finished(self._commands, outbox, [one.status for one in self._instances])

    def _answer(self, row: int, deadline: float, outbox: Outbox) -> bytes | None:
        """What it answered to the last of its steps."""
        one, stepper = self._instances[row], self._steppers[row]
        restarts = stepper.sitl.restarts
        answer: bytes | None = None
        for _ in range(stepper.per_tick):
            answer = stepper.sitl.servos(deadline)
            if answer is None:
                one.lose(InstanceStatus.SILENT if one.sitl.program.running else InstanceStatus.DEAD, outbox)
                self._skew.forget(row)
                break
            if stepper.sitl.restarts > restarts:  # lines that waited for the old one are gone with it
                stepper.steps = 0
                one.restarted(outbox)
                break
        return answer

    def _reported(self, tick: Time, row: int, message: Message, outbox: Outbox) -> None:
        if tick >= 0 and message.get_type() == "GLOBAL_POSITION_INT":
            stepper = self._steppers[row]
            self._skew.seen(row, message.time_boot_ms * NS_PER_MS - stepper.steps * stepper.step_ns)
