"""Ticks of a world with a builtin fleet as one compiled call."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from skyrange.contracts.components import Floats, Sensors
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.tick_batches import TickProgress
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S, Time
from skyrange.vehicle.builtin.estimation.estimator import step_strapdown
from skyrange.vehicle.builtin.layout import Records
from skyrange.vehicle.builtin.loop import run_loop
from skyrange.vehicle.builtin.telemetry.schedule import SERVICE_NS
from skyrange.world.battery import discharge
from skyrange.world.collision.broad_phase import count_due, is_search_due
from skyrange.world.multirotor import advance
from skyrange.world.sensing.sensor_errors import SensingArrays, name_arrays, sample
from skyrange.world.world import World

_STOPS = tuple(TickProgress)
_COMPLETE, _WORLD, _ENGINE, _SERVICE = (int(stop) for stop in TickProgress)


@compiled
def run_ticks(  # noqa: PLR0917
    first: int,
    quantum_ns: int,
    count: int,
    service: bool,  # noqa: FBT001
    discharged_ns: int,
    search: Any,
    arrays: SensingArrays,
    navigation: Any,
    control: Any,
    outputs: Any,
) -> tuple[int, int, int]:
    """Run at most `count` ticks, and with `service` the world's part of one more, which discharges the batteries.

    Returns how many were begun, a `TickProgress`, and the events that the bodies flagged in the last. `search` is
    `World.contact_search`, in which is updated how far aircraft have travelled; `arrays` is `World.batch_state`;
    `navigation`, `control` and `outputs` are `BuiltinFleet.batch_state`.
    """
    idle, travelled, census_due, pairs, pair_due, wall_due = search
    sensing = name_arrays(arrays)
    bodies = sensing.bodies
    commands, odometer_m, max_step2_m2 = bodies.commands, bodies.odometer_m, bodies.max_step2_m2
    step_s = quantum_ns / NS_PER_S
    far = np.empty(travelled.shape[0])
    for tick in range(count + service):
        now = first + tick * quantum_ns
        events = advance(step_s, bodies)
        if tick == count:
            discharge((now - discharged_ns) / NS_PER_S, bodies)
        if idle:
            if events > 0:
                return tick + 1, _WORLD, events
        else:
            searches = is_search_due(travelled, max_step2_m2, census_due, far)
            if events > 0 or searches or count_due(far, bodies.run, pairs, pair_due, odometer_m, wall_due) > 0:
                return tick + 1, _WORLD, events
            travelled[:] = far
        sample(now, step_s, tick == count, sensing)
        if tick == count:
            return count + 1, _SERVICE, 0
        step_strapdown(*navigation)
        if run_loop(*control) > 0:
            return tick + 1, _ENGINE, 0
        for row in range(outputs.shape[0]):
            for motor in range(outputs.shape[1]):
                commands[row, motor] = outputs[row, motor]
    return count, _COMPLETE, 0


class BatchedFleet(Protocol):
    """The builtin fleet, as a batch of ticks sees it."""

    @property
    def only_flies(self) -> bool:
        """Whether the next tick, if it comes when due, has nothing but estimator and control loops to run."""
        ...

    @property
    def gains(self) -> Records:
        """The gains of the control loops; another object where they were computed anew."""
        ...

    def batch_state(self, sensors: Sensors) -> tuple[tuple[Any, ...], tuple[Any, ...], Floats]:
        """The arguments of `step_strapdown` and of `run_loop`, and of these the motor commands."""
        ...

    def end_batch(self, last: Time, *, flagged: bool) -> None:
        """Take over complete ticks of a batch, the last at `last`; `flagged` if its loop raised an event."""
        ...


class FleetTickBatch:
    """The ticks of a world all of whose bodies are one builtin fleet (contract: `TickBatch`). Deep-copyable."""

    period_ns: Time = SERVICE_NS

    def __init__(self, world: World, fleet: BatchedFleet, rows: slice) -> None:
        self._world = world
        self._fleet = fleet
        self._rows = rows
        self._events = 0
        self._arguments: tuple[Any, ...] | None = None
        self._gains: Records | None = None

    def __getstate__(self) -> dict[str, Any]:
        """All but the arguments, which refer to the arrays of the world and of the fleet."""
        return {**self.__dict__, "_arguments": None, "_gains": None}

    def run(self, first: Time, count: int, *, service: bool) -> tuple[int, TickProgress]:
        """Run at most `count` ticks, and with `service` the world's part of the next.

        0 where air, poses or gains have to change first.
        """
        world, fleet = self._world, self._fleet
        if not world.only_moves(first) or not fleet.only_flies:
            return 0, TickProgress.COMPLETE
        gains = fleet.gains
        if self._arguments is None or gains is not self._gains:
            self._gains = gains
            self._arguments = (world.batch_state(), *fleet.batch_state(world.sensors(self._rows)))
        quantum_ns = world.quantum_ns
        begun, stop, self._events = run_ticks(
            first, quantum_ns, count, service, world.discharged_ns, world.contact_search, *self._arguments
        )
        moved = begun - (stop == _WORLD)
        discharged_ns = first + count * quantum_ns if begun > count else world.discharged_ns
        world.end_batch(moved, discharged_ns)
        flown = min(moved, count)
        if flown:
            fleet.end_batch(first + (flown - 1) * quantum_ns, flagged=stop == _ENGINE)
        return begun, _STOPS[stop]

    def complete_world_tick(self) -> Sequence[Note]:
        """Resolve contacts and report events of the tick in which the batch ended, and sample its sensors."""
        return self._world.complete_tick(self._events)

    def complete_world_tick_runs(self) -> Sequence[tuple[int, Note]]:
        """`complete_world_tick`, with the run of each note."""
        return self._world.complete_tick_runs(self._events)
