"""View of a world for one run of a batch: the rows and names of that run alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import BodyInputs, Floats, Poses, Sensors, Source
from skyrange.contracts.mailboxes import Note
from skyrange.core.time import Time

if TYPE_CHECKING:
    from skyrange.city.city import City
    from skyrange.world.airframes import Airframe
    from skyrange.world.world import World

Rows = slice | NDArray[np.int64]


class RunView:
    """The bodies of one run (contract: `contracts.components.World`): row 0 is its first.

    It keeps nothing of its own: what is read is the world's state now, and what is set is set in the world. Only
    `World.advance_runs` moves the bodies, those of all runs at once. A deep copy is of the whole world.
    """

    def __init__(self, world: World, rows: slice) -> None:
        """`rows` are those of the run."""
        self._world = world
        self._first: int = rows.start
        self._rows = rows
        self.quantum_ns: Time = world.quantum_ns
        self.vehicles: Sequence[str] = world.vehicles[rows]
        self.airframes: Sequence[Airframe] = world.airframes[rows]

    @property
    def city(self) -> City | None:
        """The city, which all runs share."""
        return self._world.city

    def _place(self, rows: Rows) -> Rows:
        """The world's rows of some of the run's; a slice of a slice, so that views remain views."""
        if not isinstance(rows, slice):
            count = len(self.vehicles)
            chosen = np.arange(self._first, self._first + count)
            found: NDArray[np.int64] = chosen[rows]
            return found
        start, stop, step = rows.indices(len(self.vehicles))
        start, stop = self._first + start, self._first + stop
        return slice(start, stop if stop >= 0 else None, step)

    def _places(self, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        placed = self._place(rows)
        assert not isinstance(placed, slice)
        return placed

    def advance(self, now: Time) -> Sequence[Note]:
        """Raises `ValueError`: the runs of a world move together."""
        raise ValueError("a run of a batch is advanced with the others, by its world")

    def sensors(self, rows: Rows) -> Sensors:
        """`World.sensors`, of the run's rows."""
        return self._world.sensors(self._place(rows))

    def actuate(self, rows: Rows, actuators: Floats) -> None:
        """`World.actuate`, of the run's rows."""
        self._world.actuate(self._place(rows), actuators)

    def disturb(self, rows: NDArray[np.int64], thrust_share: Floats, wind_enu_mps: Floats) -> None:
        """`World.disturb`, of the run's rows."""
        self._world.disturb(self._places(rows), thrust_share, wind_enu_mps)

    def lost_motors(self, vehicle: str) -> list[int]:
        """The motors of an aircraft that turn no more, counted from 0. Raises `ValueError` for an unknown aircraft."""
        return self._world.lost_motors_of(self._first + self.vehicles.index(vehicle))

    @property
    def sources(self) -> Sequence[Source]:
        """What moves each body, in vehicle order."""
        return self._world.sources[self._rows]

    def set_source(self, rows: NDArray[np.int64], source: Source) -> None:
        """`World.set_source`, of the run's rows."""
        self._world.set_source(self._places(rows), source)

    def impose(self, rows: Rows, poses: Poses) -> None:
        """`World.impose`, of the run's rows."""
        self._world.impose(self._place(rows), poses)

    def body_inputs(self, rows: Rows) -> BodyInputs:
        """`World.body_inputs`, of the run's rows; the bodies of the world that they show are the run's."""
        inputs = self._world.body_inputs(self._place(rows))
        inputs.world_position_enu_m = inputs.world_position_enu_m[self._rows]
        inputs.world_attitude = inputs.world_attitude[self._rows]
        return inputs

    @property
    def present(self) -> NDArray[np.bool_] | None:
        """(n,) which bodies exist; `None` where all do."""
        present = self._world.present
        if present is None or present[self._rows].all():
            return None
        return present[self._rows]

    def motion(self) -> tuple[Floats, Floats]:
        """Position of the gear and velocity, (n, 3) each: read-only views that later ticks refill."""
        position, velocity = self._world.motion()
        return position[self._rows], velocity[self._rows]

    def truth(self) -> Mapping[str, Floats]:
        """The true state as (n,) columns, which are read-only; see `World.truth`."""
        rows = self._rows
        return {name: column[rows] for name, column in self._world.shared_truth().items()}
