"""ArduPilot in lockstep with the range's world, by its JSON physics backend.

Every tick each process gets the tick's sensors, or with the last tick of an iteration of its main loop those of all
(a batch); all processes compute side by side, and the tick ends when all have answered. The machine's clock
plays no part: the same inputs give the same bytes.

Batches of exchanges: those of one iteration of ArduPilot's main loop are sent together. Its loop sets the motors once
per iteration and reads its gyros about twice. So the pulse widths of all exchanges but the last are known already, the
world can advance with them, and a process that gets all lines of an iteration at once wakes up half as often. Its
answers show which exchange is the last of an iteration.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import Message
from skyrange.contracts.components import Finished, InstanceStatus, Sensors
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.compiled import compiled
from skyrange.core.errors import ComponentError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch, Time
from skyrange.io.ardupilot.batch_exchange import BatchExchange
from skyrange.io.ardupilot.sitl import LockstepSitl, wall_s
from skyrange.io.processes.core_sharing import CoreSharing
from skyrange.vehicle.ardupilot import parameters
from skyrange.vehicle.ardupilot.arducopter_binary import BATTERY
from skyrange.vehicle.ardupilot.json_backend.json_lines import LineWriter
from skyrange.vehicle.ardupilot.json_backend.motion import MeanForce, Motion, read_commands, to_ardupilot_motion
from skyrange.vehicle.ardupilot.options import ProcessOptions
from skyrange.vehicle.ardupilot.process_fleet import QUANTUM_NS, START_S, WARM_UP_NS, Instance, ProcessFleet
from skyrange.vehicle.contract import VehicleSpec
from skyrange.world.airframes import AIRFRAMES, MOTORS


class ExchangeBatches:
    """The batches of all aircraft of a fleet. A moment is a tick with exchanges, whose lines are
    always sent together.
    """

    def __init__(self, per_tick: Ints, ticks: Ints, moments: Ints) -> None:
        """Arrays (n,): exchanges per tick and ticks per exchange, as `parameters.exchange_steps`; `moments` per
        iteration.
        """
        self.pending_lines: Ints = np.zeros(len(ticks), dtype=np.int64)
        """(n,) how many lines are written and not answered."""
        self._per_tick, self._ticks, self._moments = per_tick, ticks, moments
        self._all_at_once = not (ticks > 1).any()
        self._wanted: Ints = moments.copy()
        """Number of moments in the next batch."""
        self._pulses: NDArray[np.uint8] = np.zeros((len(ticks), 2 * MOTORS), dtype=np.uint8)

    def due_rows(self, number: int, rows: Ints) -> Ints:
        """Those of `rows` that have a moment in the tick with this number."""
        return rows if self._all_at_once else _at(number, self._ticks, rows)

    def mark_written(self, rows: Ints) -> Ints:
        """Count the lines of a moment as written for `rows`; returns the rows whose batch is complete and has to be
        sent.
        """
        return _written(rows, self._per_tick, self._wanted, self.pending_lines)

    def mark_answered(self, rows: Ints, taken: Ints, answers: NDArray[np.uint8]) -> None:
        """Take in that `rows` have answered all their lines, or are lost: of `answers` (k, n, bytes) the first `taken`
        (n,).
        """
        _answered(rows, taken, answers, self._per_tick, self._moments, self._pulses, self._wanted, self.pending_lines)


@compiled
def _at(number: int, ticks: Ints, rows: Ints) -> Ints:
    there = np.empty_like(rows)
    count = 0
    for row in rows:
        if number % ticks[row] == 0:
            there[count] = row
            count += 1
    return there[:count]


@compiled
def _written(rows: Ints, per_tick: Ints, wanted: Ints, lines: Ints) -> Ints:
    due = np.empty_like(rows)
    count = 0
    for row in rows:
        lines[row] += per_tick[row]
        if lines[row] >= wanted[row] * per_tick[row]:
            due[count] = row
            count += 1
    return due[:count]


@compiled
def _answered(  # noqa: PLR0917
    rows: Ints,
    taken: Ints,
    answers: NDArray[np.uint8],
    per_tick: Ints,
    moments: Ints,
    pulses: NDArray[np.uint8],
    wanted: Ints,
    lines: Ints,
) -> None:
    for row in rows:
        last = lines[row] // per_tick[row] - 1
        changed = last
        for turn in range(taken[row] if moments[row] > 1 else 0):
            new = False
            for k in range(pulses.shape[1]):
                new |= answers[turn, row, k] != pulses[row, k]
                pulses[row, k] = answers[turn, row, k]
            if new:
                changed = min(changed, turn // per_tick[row])
        # an iteration ends where the pulses change; if that was not the last moment, the next batch ends there
        wanted[row] = changed + 1 if changed < last else moments[row]
        lines[row] = 0


Ints = NDArray[np.int64]

_TRIES = 5


class LockstepFleet(ProcessFleet):
    """A fleet moved by the range's physics (contract: `contracts.components.Engine`)."""

    physics: Literal["shared", "native"] = "shared"
    clock: Literal["lockstep", "wall"] = "lockstep"
    repeatable: Literal["bytes", "outcome"] = "bytes"
    preroll_ns: Time = WARM_UP_NS

    def __init__(
        self, name: str, specs: Sequence[VehicleSpec], origin: Origin, epoch: Epoch, options: ProcessOptions
    ) -> None:
        """As `ProcessFleet`."""
        super().__init__(name, specs, origin, epoch, options)
        self._feeds_battery = BATTERY in self.binary.capabilities
        self._home_up_m = np.array([spec.home_enu_m[2] for spec in specs])
        self._sitls: list[LockstepSitl] = []
        self._tick: Time | None = None
        self._mean = MeanForce(len(specs))
        self._skips_ticks = False
        """Whether any aircraft has no exchange in some ticks."""
        self._motion: Motion | None = None
        """At the last tick with exchanges."""
        self._writer = LineWriter(0)
        """The lines that each process is sent."""
        self._batches: ExchangeBatches | None = None
        self._exchanges: BatchExchange | None = None
        self._steps: Ints = np.zeros(len(specs), dtype=np.int64)
        """Since the start of each process."""
        self._step_ns: Ints = np.zeros(len(specs), dtype=np.int64)
        """Between two exchanges."""
        self._per_tick: Ints = np.ones(len(specs), dtype=np.int64)
        """Exchanges per tick that has any."""
        self._live: Ints = np.empty(0, dtype=np.int64)
        """The rows that are not lost."""
        self._due: Ints = np.empty(0, dtype=np.int64)
        """Those of them that answer in this tick."""
        self._status = [InstanceStatus.BOOTING for _ in specs]
        """As last returned."""
        self._core_sharing: CoreSharing | None = None
        """Shares the processor with the process, if there is only one."""

    def _values(self, spec: VehicleSpec, gnss_lag_ms: int) -> dict[str, float]:
        airframe = AIRFRAMES[spec.airframe]
        return parameters.start_values(
            spec.vehicle, airframe, spec.params, self._listed, gnss_lag_ms, self._options.rates
        )

    def _start_process(self, **arguments: Any) -> LockstepSitl:
        return LockstepSitl(**arguments, logs=self._options.keep_logs)

    def _wait_for_start(self) -> None:
        """Wait until every process has sent its first packet, each from a port of its own."""
        deadline = wall_s() + START_S
        used_ports: set[int] = set()
        ticks, moments = np.ones_like(self._per_tick), np.ones_like(self._per_tick)
        for row, instance in enumerate(self._instances):
            sitl = self._sitl(instance)
            for again in range(_TRIES):
                if sitl.servos(deadline) is None:
                    raise sitl.lost(f"did not come up within {START_S:g} s")
                if sitl.port not in used_ports:
                    break
                self._restart_process(instance, f"-{again + 2}")  # two share a port: one of them would not receive
                sitl = self._sitl(instance)
            used_ports.add(sitl.port)
            self._sitls.append(sitl)
            rates = parameters.exchange_steps(instance.values, self._listed, QUANTUM_NS / NS_PER_S)
            self._per_tick[row], ticks[row] = rates
            moments[row] = parameters.moments_per_iteration(instance.values, self._listed, QUANTUM_NS / NS_PER_S)
        self._step_ns = QUANTUM_NS * ticks // self._per_tick
        self._skips_ticks = bool((ticks > 1).any())
        count, most = len(self._sitls), int((self._per_tick * moments).max())
        self._live = np.arange(count)
        self._exchanges = BatchExchange(self._sitls, most)
        self._batches = ExchangeBatches(self._per_tick, ticks, moments)
        self._writer = LineWriter(count, most, battery=self._feeds_battery)
        if count == 1:
            self._core_sharing = CoreSharing(self._sitls[0].program)

    def _sitl(self, instance: Instance) -> LockstepSitl:
        assert isinstance(instance.sitl, LockstepSitl)
        return instance.sitl

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        """Give each process its frames, its fix and the first step of the tick."""
        if not self._instances:
            self._start(tick, sensors)
            self._wait_for_start()
        self._deliver_inputs(sensors, inbox)
        if self._tick is not None and tick - self._tick != QUANTUM_NS:
            raise ComponentError(
                f"engine {self.name}", f"a tick of {tick - self._tick} ns", f"It needs a quantum of {QUANTUM_NS} ns"
            )
        self._tick = tick
        assert self._batches is not None
        rows = self._batches.due_rows(tick // QUANTUM_NS, self._live)
        if self._skips_ticks:
            self._mean.add(sensors.accel_mps2)
        self._due = rows
        if len(rows):
            after = to_ardupilot_motion(sensors, self._home_up_m, battery=self._feeds_battery)
            if self._skips_ticks:
                self._mean.apply(after, rows)
            before, self._motion = (self._motion if self._motion is not None else after), after
            self._due = self._send(rows, before, after)

    def _send(self, rows: Ints, before: Motion, after: Motion) -> Ints:
        """Write the lines of a tick for `rows`; send those of complete iterations, and return their rows."""
        batches, exchanges = self._batches, self._exchanges
        assert batches is not None
        assert exchanges is not None
        self._writer.write(
            rows,
            first=batches.pending_lines,
            per_tick=self._per_tick,
            steps=self._steps,
            step_ns=self._step_ns,
            before=before,
            after=after,
        )
        due = batches.mark_written(rows)
        exchanges.send(due, batches.pending_lines, self._writer.text, self._writer.lengths)
        return due

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        """Motor commands, and what was sent; a process that has not answered by the deadline is lost."""
        if not len(self._due):  # no process computes, so none sends anything
            return Finished(self._commands, Outbox(), self._status)
        booting = any(instance.status is InstanceStatus.BOOTING for instance in self._instances)
        deadline = wall_s() + (max(START_S, wall_deadline_s) if booting else wall_deadline_s)
        outbox = Outbox()
        if self._core_sharing is not None:
            self._core_sharing.yield_core()
        self._collect(deadline, outbox)
        if len(self._live) < len(self._instances):
            lost = np.setdiff1d(np.arange(len(self._instances)), self._live)
            self._commands[lost] = 0.0  # speed controllers stop without a signal
        self._read_ports(tick, outbox)
        self._status = [instance.status for instance in self._instances]
        return Finished(self._commands, outbox, self._status)

    def _collect(self, deadline: float, outbox: Outbox) -> None:
        """Take the answers of all that are due; the answer to the last step of each holds its commands."""
        exchanges, batches, due = self._exchanges, self._batches, self._due
        assert exchanges is not None
        assert batches is not None
        # the last was started last: while we wait for it the others answer too, without waking us one by one
        if len(due) > 1:
            self._sitls[due[-1]].await_word()
        lost = False
        for row in exchanges.take(due, batches.pending_lines):
            while exchanges.taken[row] < batches.pending_lines[row]:
                if not self._wait_late(row, deadline, outbox):
                    lost = True
                    break
        batches.mark_answered(due, exchanges.taken, exchanges.answers)
        if lost:
            live = [row for row in self._live.tolist() if self._instances[row].alive]
            self._live = np.array(live, dtype=np.int64)
            due = np.intersect1d(due, self._live)
        read_commands(exchanges.answers, exchanges.taken - 1, due, self._commands)

    def _wait_late(self, row: int, deadline: float, outbox: Outbox) -> bool:
        """Wait for an answer that was not there; returns whether more answers to this tick can come
        from that process.
        """
        assert self._exchanges is not None
        instance, sitl = self._instances[row], self._sitls[row]
        restarts = sitl.restarts
        if not self._exchanges.take_late(row, deadline):
            instance.lose(InstanceStatus.SILENT if sitl.program.running else InstanceStatus.DEAD, outbox)
            self._clock_offsets.forget(row)
            return False
        if sitl.restarts > restarts:  # lines sent to the old process are lost
            self._steps[row] = 0
            instance.restarted(outbox)
            return False
        return True

    def _on_report(self, tick: Time, row: int, message: Message, outbox: Outbox) -> None:
        if tick >= 0 and message.get_type() == "GLOBAL_POSITION_INT":
            self._clock_offsets.record(
                row, message.time_boot_ms * NS_PER_MS - int(self._steps[row] * self._step_ns[row])
            )
