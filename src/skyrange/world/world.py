"""World: the true state of every aircraft in one table of arrays, and its advance from tick to tick.

A tick: the gusts that are due, dynamics, imposed poses, the batteries that are due, collisions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import BodyInputs, Contacts, Floats, Poses, Sensors, Source
from skyrange.contracts.mailboxes import Note
from skyrange.core import elementary_python
from skyrange.core.arrays import as_read_only
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_S, Time
from skyrange.world import battery, multirotor, turbulence
from skyrange.world.airframes import AIRFRAMES, GRAVITY_MPS2, MOTORS, Airframe
from skyrange.world.bodies import CALM, Body, Wind, check_bodies
from skyrange.world.body_state import BodyState
from skyrange.world.collision.broad_phase import shape_row
from skyrange.world.collision.contact_tracker import ContactSearch, ContactTracker, apply_contacts
from skyrange.world.imposed_poses import ImposedPoses
from skyrange.world.run_view import RunView
from skyrange.world.sensing.sensor_errors import SensingArrays
from skyrange.world.sensing.sensors import IDEAL, SensorSpec, SensorSuite

if TYPE_CHECKING:
    from skyrange.city.city import City

DEFAULT_QUANTUM_NS: Time = 2_500_000
RunNote = tuple[int, Note]
"""A note, and the run that it is of."""
_NO_NOTES: tuple[RunNote, ...] = ()


def make_state(airframes: Sequence[Airframe], step_s: float, runs: Sequence[int] | None = None) -> BodyState:
    """Bodies at rest in calm air at the origin, one of each airframe of the list, with full batteries.

    `step_s` is the quantum, on which the lag of motors depends. `runs` has the run of each; without it, all are of one.
    """
    n = len(airframes)
    run = np.array([0] * n if runs is None else runs, dtype=np.int64)
    kinds = list(dict.fromkeys(sorted(airframes, key=lambda airframe: airframe.name)))
    motors = np.array([multirotor.motor_rows(airframe, step_s) for airframe in airframes])
    expo, lag_up, lag_down = (np.repeat(motors[:, k : k + 1], MOTORS, axis=1) for k in range(3))
    return BodyState(
        parameters=np.array([multirotor.parameter_row(airframe) for airframe in kinds]),
        batteries=np.array([battery.battery_row(airframe) for airframe in kinds]),
        shape=np.array([shape_row(airframe) for airframe in kinds]),
        airframe=np.array([kinds.index(airframe) for airframe in airframes], dtype=np.int64),
        run=run,
        expo=expo,
        lag_up=lag_up,
        lag_down=lag_down,
        air=np.zeros((n, 3)),
        floor=np.zeros(n),
        commands=np.zeros((n, MOTORS)),
        alive=np.ones((n, MOTORS), dtype=np.uint8),
        speed_share=np.ones((n, MOTORS)),
        limit=np.zeros((n, MOTORS)),
        is_imposed=np.zeros(n, dtype=np.uint8),
        before=np.zeros((n, 3)),
        position=np.zeros((n, 3)),
        velocity=np.zeros((n, 3)),
        attitude=np.zeros((n, 4)),
        rates=np.zeros((n, 3)),
        accel=np.zeros((n, 3)),
        rotor_radps=np.zeros((n, MOTORS)),
        height=np.zeros(n),
        flags=np.zeros((n, 4), dtype=np.uint8),
        impact_mps=np.zeros(n),
        odometer_m=np.zeros(n),
        max_step2_m2=np.zeros(run[-1] + 1),
        impulse=np.zeros((n, 6)),
        work_j=np.zeros(n),
        charge=np.ones(n),
        battery_v=np.zeros(n),
        battery_a=np.zeros(n),
    )


class World:
    """Truth: bodies in wind over flat ground and among buildings (the contract `skyrange.contracts.components.World`).

    The first `advance` sets the time of the initial state and moves nothing. Deep copies are independent and continue
    identically; the immutable city is shared between them.

    A world may have the bodies of several runs (`Body.run`): each run moves as in a world of its own, to the bit. Time,
    wind, city and the quality of sensors are the same for all.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        quantum_ns: Time = DEFAULT_QUANTUM_NS,
        wind: Wind = CALM,
        city: City | None = None,
        sensors: SensorSpec = IDEAL,
    ) -> None:
        """Raises `InputError` with every problem of the bodies at once."""
        check_bodies(bodies, quantum_ns, wind, city)
        n = len(bodies)
        step_s = quantum_ns / NS_PER_S
        self.quantum_ns: Time = quantum_ns
        self.vehicles: Sequence[str] = tuple(body.vehicle for body in bodies)
        self.airframes: Sequence[Airframe] = tuple(AIRFRAMES[body.airframe] for body in bodies)
        self.city = city
        self._now: Time | None = None
        self._step_s = step_s
        self._bodies = state = make_state(self.airframes, step_s, [body.run for body in bodies])
        self.runs: int = len(state.max_step2_m2)
        """Number of runs whose bodies it has."""
        bounds = np.searchsorted(state.run, np.arange(self.runs + 1)).tolist()
        self._rows = tuple(slice(start, stop) for start, stop in pairwise(bounds))
        self._truth: Mapping[str, Floats] | None = None  # the columns, until something changes them
        self._arrays = tuple(state)
        state.position[:] = [(body.east_m, body.north_m, body.up_m) for body in bodies]
        state.before[:] = state.position
        state.charge[:] = [body.charge for body in bodies]
        self._wind = wind
        steady = np.array(wind.steady_enu_mps, dtype=np.float64)
        state.air[:] = steady
        seeds = np.array([body.seed & 0xFFFFFFFFFFFFFFFF for body in bodies], dtype=np.uint64)
        who = np.array([hash64(body.vehicle) for body in bodies], dtype=np.uint64)
        self._gusts = turbulence.Gusts(
            seeds=seeds,
            stream=np.uint64(hash64(turbulence.STREAM)),
            who=who,
            steady_enu_mps=steady,
            w20_mps=float(wind.turbulence_mps),
            state=np.zeros((n, turbulence.STATES)),
        )
        self._gusted_ns: Time | None = None
        self._discharged_ns: Time = 0
        self._mean_air: Floats | None = None  # the air without gusts, from the first gust on
        self._gust_mps = np.zeros((n, 3))
        self._imposed = ImposedPoses(state.is_imposed, step_s)
        self._reported: list[tuple[NDArray[np.int64], Contacts, Floats]] = []  # until the next tick
        self._sources: tuple[Source, ...] = (Source.DYNAMIC,) * n
        self._present = np.array([body.present for body in bodies], dtype=np.bool_)
        self._soon_present = self._present.copy()
        self._appearing = np.zeros(n, dtype=np.bool_)
        self._contact_tracker = ContactTracker(self.vehicles, self._rows, city)
        self._sensing = SensorSuite(sensors, seeds, who, state)
        self._contact_tracker.begin(state)
        battery.discharge(0.0, state)
        for i, body in enumerate(bodies):
            half_yaw = 0.5 * math.radians(90.0 - body.heading_deg)
            state.attitude[i, 0], state.attitude[i, 3] = (
                elementary_python.cos(half_yaw),
                elementary_python.sin(half_yaw),
            )
            standing = body.up_m == state.floor[i]
            state.flags[i, multirotor.ON_GROUND if standing else multirotor.ALOFT] = 1
            state.accel[i, 2] = GRAVITY_MPS2 if standing else 0.0
            state.height[i] = body.up_m - state.floor[i]

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._truth = None
        self._sensing.bind(self._bodies)

    def advance(self, now: Time) -> Sequence[Note]:
        """Move all bodies by the whole quanta between the last tick and `now` under the last actuators.

        Notes: `event.contact` {speed_mps} once per touchdown, after which the aircraft has to climb 5 cm for another;
        `event.crash` {tilt_deg, speed_mps} when it touches down too hard, or tips over on the ground (the speed is its
        last touchdown's); `event.collision` {with, speed_mps, east_m, north_m, up_m, energy_j} about each aircraft in
        it (see `collision.contact_tracker`); `event.jump` {distance_m} where an imposed pose was far away, of a
        body that has not just appeared. Raises `ValueError` if `now` is before the last tick.
        """
        return [note for _, note in self.advance_runs(now)]

    def advance_runs(self, now: Time) -> Sequence[RunNote]:
        """`advance`, with the run of each note; the names in a note are those of its run."""
        if self._now is None:
            self._now = self._discharged_ns = now
            self._sensing.sample(now)
            return _NO_NOTES
        steps = (now - self._now) // self.quantum_ns
        if steps < 0:
            raise ValueError(f"world: asked to advance to {now} ns from {self._now} ns; time only runs forward")
        notes: list[RunNote] = []
        for _ in range(steps):
            notes += self._tick(self._now)
        self._sensing.sample(self._now)
        return notes

    def _tick(self, start: Time) -> Sequence[RunNote]:
        """One quantum from `start`."""
        self._truth = None
        end = self._now = start + self.quantum_ns
        if self._gust_due(start):
            self._gust(start)
        events = multirotor.advance_arrays(self._step_s, self._arrays)
        touched: Sequence[RunNote] = _NO_NOTES
        if len(self._imposed.rows):
            self._present[:] = self._soon_present
            touched = self._take_contacts(end)
            followed = self._imposed.follow(self._bodies)
            if followed:
                self._stop_crashed_motors()
            events += followed
        if end // battery.BATTERY_NS > self._discharged_ns // battery.BATTERY_NS:
            battery.discharge((end - self._discharged_ns) / NS_PER_S, self._bodies)
            self._discharged_ns = end
        return [*touched, *self._resolve(end, events)]

    def _take_contacts(self, end: Time) -> Sequence[RunNote]:
        """Apply the contacts of simulated bodies in the tick that ends at `end`; returns their notes."""
        notes: list[RunNote] = []
        for rows, contacts, after_mps in self._reported:
            hits = apply_contacts(rows, contacts, after_mps, self._bodies)
            notes += self._contact_tracker.note_contacts(end, hits, self._bodies)
        self._reported.clear()
        return notes

    def _stop_crashed_motors(self) -> None:
        """Stop the motors of simulated bodies that have crashed, as `multirotor` does of its own."""
        crashed = self._bodies.flags[:, multirotor.CRASHED] & (self._bodies.is_imposed == multirotor.SIMULATED)
        if crashed.any():
            rows = np.flatnonzero(crashed)
            self._bodies.alive[rows] = 0
            self._bodies.limit[rows] = 0.0

    def _resolve(self, end: Time, events: int) -> Sequence[RunNote]:
        """Resolve the collisions of the tick that ended; returns notes of these and of the bodies' events."""
        collided = self._contact_tracker.resolve_tick(end, self._step_s, self._bodies)
        if events == 0:
            return collided
        return [*collided, *self._notes()]

    def only_moves(self, first: Time) -> bool:
        """Whether the tick `first` is the next, moves bodies by forces alone, and does not change the air."""
        start = first - self.quantum_ns
        return self._now == start and not len(self._imposed.rows) and not self._gust_due(start)

    def batch_state(self) -> SensingArrays:
        """What a compiled call needs that runs ticks: the sensors, and with them the bodies."""
        return self._sensing.arrays

    def lost_motors(self, vehicle: str) -> list[int]:
        """The motors of an aircraft that turn no more, counted from 0. Raises `ValueError` for an unknown aircraft.

        Of several runs, it is the aircraft of the first that has one of this name; see `of_run`.
        """
        return self.lost_motors_of(self.vehicles.index(vehicle))

    def lost_motors_of(self, row: int) -> list[int]:
        """`lost_motors`, of the aircraft of a row."""
        return np.flatnonzero(self._bodies.alive[row] == 0).tolist()

    def rows_of(self, run: int) -> slice:
        """The rows of a run. Raises `IndexError` for one that the world does not have."""
        if not 0 <= run < self.runs:
            raise IndexError(f"run {run} of a world with {self.runs}")
        return self._rows[run]

    def of_run(self, run: int) -> RunView:
        """The world as a run alone would have it. Raises `IndexError` for a run that it does not have."""
        return RunView(self, self.rows_of(run))

    @property
    def discharged_ns(self) -> Time:
        """When the batteries were discharged last."""
        return self._discharged_ns

    @property
    def contact_search(self) -> ContactSearch:
        """`ContactTracker.search`, in which a batch of ticks updates how far aircraft have travelled."""
        return self._contact_tracker.search

    def end_batch(self, ticks: int, discharged_ns: Time) -> None:
        """Take over what `ticks` complete ticks of a batch have done: `discharged_ns` is when batteries were
        discharged.
        """
        assert self._now is not None
        self._truth = None
        self._discharged_ns = discharged_ns
        if ticks:
            self._now += ticks * self.quantum_ns
            self._sensing.end_batch(self._now)

    def complete_tick(self, events: int) -> Sequence[Note]:
        """Do the rest of a tick whose bodies a batch has moved, with this number of `events`; returns its notes."""
        return [note for _, note in self.complete_tick_runs(events)]

    def complete_tick_runs(self, events: int) -> Sequence[RunNote]:
        """`complete_tick`, with the run of each note."""
        assert self._now is not None
        self._truth = None
        self._now += self.quantum_ns
        notes = self._resolve(self._now, events)
        self._sensing.sample(self._now)
        return notes

    def _gust_due(self, start: Time) -> bool:
        if self._wind.turbulence_mps <= 0.0:
            return False
        return self._gusted_ns is None or start // turbulence.GUST_NS > self._gusted_ns // turbulence.GUST_NS

    def _gust(self, now: Time) -> None:
        since = self._gusted_ns
        turbulence.gust(
            np.uint64(now & 0xFFFFFFFFFFFFFFFF),
            -1.0 if since is None else (now - since) / NS_PER_S,
            self._gusts,
            self._bodies.velocity,
            self._bodies.height,
            self._bodies.air if self._mean_air is None else self._mean_air,
        )
        self._gusted_ns = now
        if self._mean_air is not None:
            self._blow(self._mean_air)

    def _notes(self) -> list[RunNote]:
        """The events that the last step of the dynamics flagged, in vehicle order; clears them."""
        notes = []
        for i in np.flatnonzero(self._bodies.flags[:, multirotor.EVENTS]).tolist():
            vehicle, run = self.vehicles[i], int(self._bodies.run[i])
            event = int(self._bodies.flags[i, multirotor.EVENTS])
            speed = float(self._bodies.impact_mps[i])
            if event & multirotor.TOUCHED:
                notes.append((run, Note("event.contact", vehicle, {"speed_mps": speed})))
            if event & (multirotor.TIPPED | multirotor.BROKEN):
                _, x, y, _ = self._bodies.attitude[i].tolist()
                tilt = math.degrees(elementary_python.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y)))))
                notes.append((run, Note("event.crash", vehicle, {"tilt_deg": tilt, "speed_mps": speed})))
            if event & multirotor.JUMPED and not self._appearing[i]:
                notes.append((run, Note("event.jump", vehicle, {"distance_m": float(self._imposed.jump_m[i])})))
            if event & multirotor.JUMPED:
                self._appearing[i] = False
            self._bodies.flags[i, multirotor.EVENTS] = 0
        return notes

    def sensors(self, rows: slice | NDArray[np.int64]) -> Sensors:
        """The sensors of some vehicles: for a slice, read-only views that later ticks refill; otherwise copies.

        The accelerometer reads the mean specific force over the last quantum. The barometer reads the height of the
        gear over the origin, the rangefinder the height over the ground or roof below.
        """
        return self._sensing.read(rows)

    def actuate(self, rows: slice | NDArray[np.int64], actuators: Floats) -> None:
        """Set motor commands, (rows, motors) in 0…1; values beyond are clipped by the motors, a NaN stops one."""
        self._truth = None
        self._bodies.commands[rows] = actuators

    def disturb(self, rows: NDArray[np.int64], thrust_share: Floats, wind_enu_mps: Floats) -> None:
        """Set what faults make of some bodies, until it is set anew; all 1 and 0 undo it.

        `thrust_share` (rows, motors) 0 to 1 of a sound motor's thrust, `wind_enu_mps` (rows, 3) on top of the wind.
        A motor with a share s of its thrust turns at √s of its speed at every command, because thrust is k·ω².
        """
        self._truth = None
        share = np.sqrt(thrust_share)
        if (share != self._bodies.speed_share[rows]).any():
            self._bodies.speed_share[rows] = share
            self._bodies.limit[rows] = battery.speed_limits(
                self._bodies.batteries[self._bodies.airframe[rows]],
                self._bodies.alive[rows],
                share,
                self._bodies.battery_v[rows],
            )
        if self._mean_air is None:
            if not wind_enu_mps.any():
                return
            self._mean_air = self._bodies.air.copy()
        self._gust_mps[rows] = wind_enu_mps
        self._blow(self._mean_air)

    def _blow(self, mean_air: Floats) -> None:
        """The air's velocity, with the gusts of faults; without one it is the mean to the bit."""
        self._bodies.air[:] = np.where(self._gust_mps != 0.0, mean_air + self._gust_mps, mean_air)

    @property
    def sources(self) -> Sequence[Source]:
        """What moves each body, in vehicle order."""
        return self._sources

    def set_source(self, rows: NDArray[np.int64], source: Source) -> None:
        """Set what moves some bodies from now on; each continues from where it is, with motors at rest."""
        self._truth = None
        kind = multirotor.SIMULATED if source is Source.SIMULATOR else multirotor.IMPOSED
        self._imposed.set_imposed(rows, 0 if source is Source.DYNAMIC else kind, self._bodies.velocity)
        self._bodies.commands[rows] = 0.0
        sources = list(self._sources)
        for row in rows.tolist():
            sources[row] = source
        self._sources = tuple(sources)

    def impose(self, rows: slice | NDArray[np.int64], poses: Poses) -> None:
        """Set the current pose of bodies that are not dynamic; the next tick continues from there (see
        `imposed_poses`).

        Raises `ValueError` for an invalid pose, or a pose of a body that is dynamic; none is taken then.
        """
        chosen = np.arange(len(self.vehicles))[rows]
        self._imposed.accept(chosen, poses, self.vehicles)
        if poses.contacts is not None and len(poses.contacts.vehicle):
            self._reported.append((chosen, poses.contacts, poses.vel_enu_mps))
        if poses.present is not None:
            self._appearing[chosen] |= poses.present != self._soon_present[chosen]
            self._soon_present[chosen] = poses.present  # from the next tick on, as the pose

    def body_inputs(self, rows: slice | NDArray[np.int64]) -> BodyInputs:
        """What acts on some bodies from this tick to the next; the impulses are handed out once."""
        impulse = self._bodies.impulse[rows].copy()
        self._bodies.impulse[rows] = 0.0
        return BodyInputs(
            self._bodies.rotor_radps[rows],
            self._bodies.air[rows],
            impulse[:, :3],
            impulse[:, 3:],
            self._bodies.position,
            self._bodies.attitude,
        )

    @property
    def present(self) -> NDArray[np.bool_] | None:
        """(n,) which bodies exist; `None` where all do."""
        return None if self._present.all() else self._present.copy()

    def motion(self) -> tuple[Floats, Floats]:
        """Position of the gear and velocity, (n, 3) each: read-only views that later ticks refill."""
        return as_read_only(self._bodies.position), as_read_only(self._bodies.velocity)

    def truth(self) -> Mapping[str, Floats]:
        """The true state as (n,) columns; `throttle` is the mean motor command, flags are 0 or 1."""
        return self._compute_truth()

    def shared_truth(self) -> Mapping[str, Floats]:
        """`truth`, computed once for all runs while nothing changes it: its columns are read-only."""
        if self._truth is None:
            self._truth = {name: as_read_only(column) for name, column in self._compute_truth().items()}
        return self._truth

    def _compute_truth(self) -> dict[str, Floats]:
        columns: dict[str, Floats] = {}
        for names, table in (
            (("east_m", "north_m", "up_m"), self._bodies.position),
            (("vel_east_mps", "vel_north_mps", "vel_up_mps"), self._bodies.velocity),
            (("qw", "qx", "qy", "qz"), self._bodies.attitude),
            (("rate_x_radps", "rate_y_radps", "rate_z_radps"), self._bodies.rates),
        ):
            for k, name in enumerate(names):
                columns[name] = table[:, k].copy()
        throttle = np.zeros(len(self.vehicles))
        commands = np.fmin(np.fmax(self._bodies.commands, 0.0), 1.0)  # a NaN is no command
        for m in range(MOTORS):  # motor by motor: a row's sum must not depend on how many rows there are
            throttle += commands[:, m]
        columns["throttle"] = throttle / MOTORS
        columns["on_ground"] = self._bodies.flags[:, multirotor.ON_GROUND].astype(np.float64)
        columns["crashed"] = self._bodies.flags[:, multirotor.CRASHED].astype(np.float64)
        for name, values in (
            ("battery_v", self._bodies.battery_v),
            ("battery_a", self._bodies.battery_a),
            ("charge", self._bodies.charge),
            ("wind_east_mps", self._bodies.air[:, 0]),
            ("wind_north_mps", self._bodies.air[:, 1]),
            ("wind_up_mps", self._bodies.air[:, 2]),
        ):
            columns[name] = values.copy()
        return columns
