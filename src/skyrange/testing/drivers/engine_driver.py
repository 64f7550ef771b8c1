"""Driver of engines, as a kernel drives them, one or more at once; and the fleet, world and mail of their check."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import Packer, dialect
from skyrange.contracts.components import Engine, Finished, InstanceStatus, Poses, Sensors, SimulatorEngine, World
from skyrange.contracts.mailboxes import EMPTY_INBOX, Arrival, Departure, Inbox, Note
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.ids import FrameId, Port, owner_of
from skyrange.core.time import NS_PER_MS, Epoch, Time, ceil_to
from skyrange.testing.drivers.messages import InputMessage
from skyrange.testing.drivers.outbox_form import Said, said
from skyrange.testing.drivers.purity import Call, plainly
from skyrange.testing.rules import Broken, short
from skyrange.vehicle.contract import VehicleSpec
from skyrange.world import Body, SensorSpec
from skyrange.world import World as Bodies
from skyrange.world.sensing.geomagnetism import magnetic_field_at

ORIGIN = Origin(-35.363328, 149.1652241, 584.0, 19.0)
EPOCH = Epoch.from_datetime(datetime(2026, 1, 1, 12, tzinfo=UTC))
CHANCE = Chance(7)
FLEET = tuple(
    VehicleSpec(
        vehicle=vehicle,
        system_id=system,
        airframe="iris",
        home_enu_m=(east, north, 0.0),
        heading_deg=heading,
        seed=CHANCE.seed,
    )
    for vehicle, system, east, north, heading in (
        ("blue/b1", 1, 5.0, 5.0, 0.0),
        ("blue/b2", 2, 10.0, 0.0, 90.0),
        ("green/g1", 1, -5.0, -10.0, 200.0),
        ("green/g2", 2, -15.0, 0.0, 359.0),
    )
)
"""The aircraft that an engine is checked with."""

Factory = Callable[[str, Sequence[VehicleSpec], Origin, Epoch, Chance], Engine]
"""Makes an engine: `factory(name, specs, origin, epoch, chance)`."""


def open_field(specs: Sequence[VehicleSpec]) -> World:
    """The shipped world: bodies at their homes, no wind, no city, sensors with noise."""
    bodies = [
        Body(s.vehicle, s.airframe, s.home_enu_m[0], s.home_enu_m[1], 0.0, s.heading_deg, seed=s.seed) for s in specs
    ]
    return Bodies(bodies, sensors=SensorSpec(1.0, magnetic_field_at(ORIGIN)))


def take_off(ports: Sequence[Port], specs: Sequence[VehicleSpec]) -> list[InputMessage]:
    """What a ground station says to fly a MAVLink copter: heartbeats, GUIDED, arm, take off to 5 m, telemetry."""
    messages = []
    for spec in specs:
        system = spec.system_id
        port = next((port for port in ports if owner_of(port.endpoint) == spec.vehicle), None)
        if port is None:
            continue
        packer = Packer(255, 190)

        def command(number: int, *params: float, system: int = system) -> object:
            seven = [*params, *([0.0] * (7 - len(params)))]
            return dialect.MAVLink_command_long_message(system, 1, number, 0, *seven)

        script = [(second * 1_000, dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)) for second in range(10)]
        script += [
            (200, command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 200_000.0)),
            (300, command(dialect.MAV_CMD_DO_SET_MODE, 1.0, 4.0)),
            (400, command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)),
            (500, command(dialect.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5.0)),
        ]
        messages += [InputMessage(at * NS_PER_MS, port, packer.pack(message)) for at, message in script]
    return messages


WALL_DEADLINE_S = 5.0
"""What the kernel allows an engine for one tick by default."""
_ARRAYS = tuple(Sensors.__dataclass_fields__)


@dataclass(frozen=True, slots=True)
class Tick:
    """What one vehicle did in one tick."""

    now: Time
    actuators: bytes
    departures: tuple[Departure, ...]
    notes: tuple[Note, ...]
    status: InstanceStatus
    pose: bytes = b""
    """Imposed at that tick, if one was."""


@dataclass
class Flight:
    """Engines in a world, with their mail; a deep copy of it is an independent continuation."""

    engines: Sequence[Engine]
    world: World
    arrivals: Sequence[Arrival]
    at: Time = field(init=False)
    """The next tick."""
    taken: int = 0
    received: set[FrameId] = field(default_factory=set)
    ticks: dict[str, list[Tick]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.at = -ceil_to(max(engine.preroll_ns for engine in self.engines), self.world.quantum_ns)
        self._rows = list(_rows_of(self.engines))
        for rows, engine in zip(self._rows, self.engines, strict=True):
            moved = [
                row for row, vehicle in zip(rows.tolist(), engine.vehicles, strict=True) if vehicle in engine.moves
            ]
            if moved:
                self.world.set_source(np.array(moved), engine.source)
        self._boxes: dict[int, list[Arrival]] = {number: [] for number in range(len(self.engines))}

    def fly(
        self,
        until: Time,
        *,
        call: Call = plainly,
        backwards: bool = False,
        scramble: bool = False,
        look: Callable[[Engine, Finished, Said], None] | None = None,
    ) -> Flight:
        """Tick up to `until`; returns itself.

        `backwards` finishes the engines in the opposite order; `scramble` spoils the sensors that were
        handed over once the tick is finished; `look` is shown what each engine hands back.
        """
        numbers = list(range(len(self.engines)))
        while self.at <= until:
            now = self.at
            self.world.advance(now)
            while self.taken < len(self.arrivals) and self.arrivals[self.taken].at <= now:
                arrival = self.arrivals[self.taken]
                self._boxes[self._owner(arrival.port)].append(arrival)
                self.taken += 1
            handed = [self._begin(number, now, call) for number in numbers]
            for number in reversed(numbers) if backwards else numbers:
                self._finish(number, now, call, look)
            for given, kept in handed:
                _check_untouched(given, kept)
                if scramble:
                    for name in _ARRAYS:
                        array = getattr(given, name)
                        array.fill(np.nan if array.dtype.kind == "f" else -1)
            self.at += self.world.quantum_ns
        return self

    def _owner(self, port: Port) -> int:
        return next(number for number, engine in enumerate(self.engines) if port in tuple(engine.ports))

    def _begin(self, number: int, now: Time, call: Call) -> tuple[Sensors, Sensors]:
        engine = self.engines[number]
        inbox = EMPTY_INBOX
        if self._boxes[number] and now % engine.service_ns == 0:
            inbox = Inbox(self._boxes[number])
            self._boxes[number] = []
            self.received |= {arrival.ref for arrival in inbox}
        given, kept = (_copy(self.world.sensors(self._rows[number])) for _ in range(2))
        if isinstance(engine, SimulatorEngine):
            engine.set_body_inputs(now, self.world.body_inputs(self._rows[number]))
        try:
            call(engine.begin, now, given, inbox)
        except Broken:
            raise
        except Exception as error:
            mail = short(inbox.payloads)
            raise Broken(f"begin({now}) with mail {mail} raised {error!r}", "no error, whatever arrived") from error
        return given, kept

    def _finish(
        self, number: int, now: Time, call: Call, look: Callable[[Engine, Finished, Said], None] | None
    ) -> None:
        engine = self.engines[number]
        try:
            finished = call(engine.finish, now, WALL_DEADLINE_S)
        except Broken:
            raise
        except Exception as error:
            raise Broken(f"finish({now}) raised {error!r}", "a Finished") from error
        if not isinstance(finished, Finished):
            raise Broken(f"finished with {short(finished)}", "a Finished", "finishes")
        contents = said(finished.outbox, tuple(engine.ports))
        check_finished(engine, finished)
        if look is not None:
            look(engine, finished, contents)
        self.world.actuate(self._rows[number], finished.actuators)
        if finished.poses is not None:
            try:
                self.world.impose(self._rows[number], finished.poses)
            except ValueError as error:
                raise Broken(str(error), "poses of vehicles it moves, as `Poses` says", "poses") from error
        self._keep(engine, now, finished, contents)

    def _keep(self, engine: Engine, now: Time, finished: Finished, contents: Said) -> None:
        owner = {port: engine.vehicles[row] for row, port in _owned(engine)}
        for row, vehicle in enumerate(engine.vehicles):
            departures = tuple(d for d in contents[0] if owner.get(d.port) == vehicle)
            notes = tuple(note for note in contents[1] if note.about == vehicle)
            status = InstanceStatus.READY if finished.status is None else finished.status[row]
            pose = b"" if finished.poses is None else _pose(finished.poses, row)
            tick = Tick(now, finished.actuators[row].tobytes(), departures, notes, status, pose)
            self.ticks.setdefault(vehicle, []).append(tick)


def check_finished(engine: Engine, finished: Finished) -> None:
    """`Broken` (rules `actuators`, `status`) unless rows, range and status are those of the engine's vehicles."""
    count = len(engine.vehicles)
    actuators = finished.actuators
    expected = f"a float64 array of shape ({count}, motors), each finite and in 0…1"
    proper = isinstance(actuators, np.ndarray) and actuators.dtype == np.float64 and actuators.ndim == 2
    if not proper or actuators.shape[0] != count:
        what = f"{actuators.dtype} {actuators.shape}" if isinstance(actuators, np.ndarray) else short(actuators)
        raise Broken(f"actuators are {what}", expected, "actuators")
    if not bool(np.all((actuators >= 0.0) & (actuators <= 1.0))):  # a NaN is neither
        raise Broken(f"actuators are {short(actuators.tolist())}", expected, "actuators")
    poses = finished.poses
    if poses is not None and not isinstance(poses, Poses):
        raise Broken(f"poses are {short(poses)}", "None, or Poses", "poses")
    status = finished.status
    if status is None:
        return
    expected = f"None, or an InstanceStatus for each of {count} vehicles"
    whole = isinstance(status, list | tuple) and len(status) == count
    if not whole or not all(isinstance(state, InstanceStatus) for state in status):
        raise Broken(f"status is {short(status)}", expected, "status")


def _rows_of(engines: Sequence[Engine]) -> list[NDArray[np.int64]]:
    ends = list(itertools.accumulate((len(engine.vehicles) for engine in engines), initial=0))
    return [np.arange(begin, end, dtype=np.int64) for begin, end in itertools.pairwise(ends)]


def _owned(engine: Engine) -> list[tuple[int, Port]]:
    """(row, port): an endpoint belongs to the vehicle that its name begins with."""
    return [
        (row, port)
        for row, vehicle in enumerate(engine.vehicles)
        for port in engine.ports
        if port.endpoint.rsplit(".", 1)[0] == vehicle
    ]


def _pose(poses: Poses, row: int) -> bytes:
    if not poses.fresh[row]:
        return b""
    numbers = (poses.position_enu_m, poses.vel_enu_mps, poses.attitude, poses.rates_radps)
    return b"".join(array[row].tobytes() for array in numbers)


def _copy(sensors: Sensors) -> Sensors:
    return Sensors(*(np.array(getattr(sensors, name)) for name in _ARRAYS))


def _check_untouched(given: Sensors, kept: Sensors) -> None:
    for name in _ARRAYS:
        if not np.array_equal(getattr(given, name), getattr(kept, name), equal_nan=True):
            raise Broken(f"changed the sensors' {name}", "sensors left as they are", "sensors")
