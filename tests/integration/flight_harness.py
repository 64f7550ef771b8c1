"""Harness that flies a fleet without a kernel: world and autopilot, tick by tick, and a ground station of bytes."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from skyrange.codec.mavlink import Packer, decode, dialect
from skyrange.contracts.components import Sensors
from skyrange.contracts.mailboxes import Arrival, Inbox, Note
from skyrange.core.geodesy import Origin
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S, Epoch, from_seconds
from skyrange.vehicle.builtin.engine import BuiltinFleet
from skyrange.vehicle.contract import VehicleSpec
from skyrange.world import Body, SensorSpec, Wind, World
from skyrange.world.sensing.geomagnetism import magnetic_field_at

ORIGIN = Origin(-35.363328, 149.1652241, 584.0, 19.0)
EPOCH = Epoch.from_datetime(datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC))
QUANTUM_NS = 2_500_000
GCS = (255, 190)

Item = tuple[int, int, tuple[float, float, float, float], tuple[float, float, float]]
"""frame, command, param1…4, and (east m, north m, altitude m)."""
RELATIVE = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT


@dataclass(frozen=True)
class Said:
    """One message from an aircraft, when it was sent, and the frames it quotes."""

    at_s: float
    vehicle: str
    message: Any
    causes: tuple[FrameId, ...]


class Range:
    """Aircraft in a world under one or more engines: `send` to them, look at `said`, `notes` and `track`."""

    def __init__(
        self,
        specs: Sequence[VehicleSpec],
        split: int = 1,
        wind_enu_mps: tuple[float, float, float] = (0.0, 0.0, 0.0),
        origin: Origin = ORIGIN,
        seed: int = 7,
        noise: float = 0.0,
    ) -> None:
        self.specs = [replace(spec, seed=seed) for spec in specs]
        bodies = [Body(s.vehicle, s.airframe, *s.home_enu_m, s.heading_deg, seed=seed) for s in specs]
        sensors = SensorSpec(noise, magnetic_field_at(origin))
        self.world = World(bodies, QUANTUM_NS, Wind(wind_enu_mps), sensors=sensors)
        size = -(-len(self.specs) // split)
        parts = [self.specs[start : start + size] for start in range(0, len(self.specs), size)]
        self.engines = [BuiltinFleet(f"part{i}", p, origin, EPOCH) for i, p in enumerate(parts)]
        self.bounds = [slice(start, start + size) for start in range(0, len(self.specs), size)]
        self.origin = origin
        self.now = 0
        self.said: list[Said] = []
        self.frames: dict[str, list[bytes]] = {s.vehicle: [] for s in specs}
        self.notes: list[tuple[float, Note]] = []
        self.waiting: list[tuple[str, bytes]] = []
        self.serial = 0
        self.packers = {s.vehicle: Packer(*GCS) for s in specs}
        self.system = {s.vehicle: s.system_id for s in specs}
        self.port = {v: port for e in self.engines for v, port in zip(e.vehicles, e.ports, strict=True)}
        self.track: list[tuple[float, np.ndarray]] = []
        self.tamper: Callable[[int, Sensors], None] | None = None
        """What is done to the sensors before the autopilot reads them."""

    def copy(self) -> Range:
        """An independent continuation."""
        return copy.deepcopy(self)

    def send(self, vehicle: str, message: Any) -> None:
        """Queue a message from the ground station for the next service."""
        self.waiting.append((vehicle, self.packers[vehicle].pack(message)))

    def send_bytes(self, vehicle: str, payload: bytes) -> None:
        """Queue anything at all."""
        self.waiting.append((vehicle, payload))

    def tick(self) -> None:
        """One world tick: dynamics, engines, actuators."""
        self.notes += [(self.seconds, note) for note in self.world.advance(self.now)]
        service = self.now % self.engines[0].service_ns == 0
        mail: list[list[Arrival]] = [[] for _ in self.engines]
        if service:
            for vehicle, payload in self.waiting:
                ref = FrameId(f"autopilot:{vehicle}", "fwd", f"{vehicle}.proxy", self.serial)
                self.serial += 1
                arrival = Arrival(self.port[vehicle], self.now, payload, f"{vehicle}.proxy", ref)
                mail[next(i for i, e in enumerate(self.engines) if vehicle in e.vehicles)].append(arrival)
            self.waiting = []
        for engine, rows, letters in zip(self.engines, self.bounds, mail, strict=True):
            sensors = self.world.sensors(rows)
            if self.tamper is not None:
                sensors = Sensors(*(np.array(getattr(sensors, field.name)) for field in fields(Sensors)))
                self.tamper(self.now, sensors)
            engine.begin(self.now, sensors, Inbox(letters))
        for engine, rows in zip(self.engines, self.bounds, strict=True):
            done = engine.finish(self.now, 1.0)
            self.world.actuate(rows, done.actuators)
            for port, payload, causes in done.outbox.each(engine.ports):
                vehicle = port.endpoint.rsplit(".", 1)[0]
                self.frames[vehicle].append(payload)
                self.said.append(Said(self.seconds, vehicle, decode(payload), causes))
            self.notes += [(self.seconds, note) for note in done.outbox.notes]
        self.now += QUANTUM_NS

    @property
    def seconds(self) -> float:
        """Simulated time."""
        return self.now / NS_PER_S

    def run(self, seconds: float, every: Callable[[Range], None] | None = None) -> None:
        """Go on for so long; positions are kept in `track` every 50 ms."""
        end = self.now + from_seconds(seconds)
        while self.now < end:
            if self.now % 50_000_000 == 0:
                self.track.append((self.seconds, self.positions()))
                if every:
                    every(self)
            self.tick()

    def run_until(self, done: Callable[[Range], bool], limit_s: float) -> None:
        """Go on until something is so; fails the test after `limit_s`."""
        end = self.seconds + limit_s
        while not done(self):
            assert self.seconds < end, f"not within {limit_s} s; last notes {self.notes[-4:]}, said {self.words()[-6:]}"
            self.run(0.05)

    def positions(self) -> np.ndarray:
        """True positions, (n, 3) ENU metres."""
        truth = self.world.truth()
        return np.stack([truth["east_m"], truth["north_m"], truth["up_m"]], axis=1)

    def velocities(self) -> np.ndarray:
        """True velocities, (n, 3) ENU m/s."""
        truth = self.world.truth()
        return np.stack([truth["vel_east_mps"], truth["vel_north_mps"], truth["vel_up_mps"]], axis=1)

    def heard(self, kind: str, vehicle: str | None = None) -> list[Any]:
        """Messages of a type so far."""
        return [s.message for s in self.said if s.message.get_type() == kind and vehicle in (None, s.vehicle)]

    def words(self) -> list[str]:
        """STATUSTEXTs so far."""
        return [m.text.decode() if isinstance(m.text, bytes) else m.text for m in self.heard("STATUSTEXT")]

    def events(self, kind: str, vehicle: str | None = None) -> list[Note]:
        """Notes of a kind so far."""
        return [n for _, n in self.notes if n.kind == kind and vehicle in (None, n.about)]

    def has(self, kind: str, count: int = 1, vehicle: str | None = None) -> Callable[[Range], bool]:
        """A condition for `run_until`: so many notes of a kind."""
        return lambda r: len(r.events(kind, vehicle)) >= count

    def command(self, vehicle: str, number: int, *params: float) -> int:
        """Send a COMMAND_LONG, run until the ack comes, return the MAV_RESULT."""
        full = [*params, *([0.0] * (7 - len(params)))]
        before = len(self.heard("COMMAND_ACK", vehicle))
        self.send(vehicle, dialect.MAVLink_command_long_message(self.system[vehicle], 1, number, 0, *full))
        self.run(0.02)
        acks = self.heard("COMMAND_ACK", vehicle)[before:]
        assert [a.command for a in acks] == [number]
        return int(acks[0].result)

    def mode(self, vehicle: str, number: int) -> int:
        """DO_SET_MODE."""
        return self.command(vehicle, dialect.MAV_CMD_DO_SET_MODE, 1.0, float(number))

    def arm(self, vehicle: str) -> int:
        """Arm."""
        return self.command(vehicle, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def item(self, vehicle: str, seq: int, item: Item) -> Any:
        """A MISSION_ITEM_INT."""
        frame, command, params, (east, north, alt) = item
        lat, lon = self.origin.geodetic_of(east, north)
        x, y = (round(lat * 1e7), round(lon * 1e7))
        if frame == dialect.MAV_FRAME_MISSION or command == dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            x, y = round(east), round(north)
        return dialect.MAVLink_mission_item_int_message(
            self.system[vehicle], 1, seq, frame, command, 0, 1, *params, x, y, alt, 0
        )

    def upload(self, vehicle: str, items: Sequence[Item]) -> int:
        """Upload home and items by the protocol; the MAV_MISSION_RESULT."""
        rows = [waypoint(0.0, 0.0, 0.0), *items]
        asked, acked = len(self.heard("MISSION_REQUEST", vehicle)), len(self.heard("MISSION_ACK", vehicle))
        self.send(vehicle, dialect.MAVLink_mission_count_message(self.system[vehicle], 1, len(rows), 0))
        for _ in range(3 * len(rows) + 3):
            self.run(0.01)
            if len(self.heard("MISSION_ACK", vehicle)) > acked:
                break
            requests = self.heard("MISSION_REQUEST", vehicle)
            if len(requests) > asked:
                asked = len(requests)
                self.send(vehicle, self.item(vehicle, requests[-1].seq, rows[requests[-1].seq]))
        return int(self.heard("MISSION_ACK", vehicle)[-1].type)

    def go_to(self, vehicle: str, east: float, north: float, up: float) -> None:
        """In GUIDED, to a place of the map."""
        frame, only_position = dialect.MAV_FRAME_LOCAL_NED, 0xDF8
        place = (north, east, -up, 0, 0, 0, 0, 0, 0, 0, 0)
        system = self.system[vehicle]
        self.send(
            vehicle,
            dialect.MAVLink_set_position_target_local_ned_message(0, system, 1, frame, only_position, *place),
        )
        self.run(0.02)

    def take_off(self, vehicle: str, alt_m: float) -> None:
        """GUIDED, armed, up to a height, and there."""
        assert self.mode(vehicle, 4) == 0
        assert self.arm(vehicle) == 0
        assert self.command(vehicle, dialect.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, alt_m) == 0
        row = [s.vehicle for s in self.specs].index(vehicle)
        home = self.specs[row].home_enu_m[2]
        self.run_until(lambda r: abs(r.positions()[row, 2] - home - alt_m) < 0.15, 30.0)
        self.run(2.0)


def waypoint(east: float, north: float, alt: float, hold_s: float = 0.0) -> Item:
    """NAV_WAYPOINT above home."""
    return (RELATIVE, dialect.MAV_CMD_NAV_WAYPOINT, (hold_s, 0.0, 0.0, 0.0), (east, north, alt))


def takeoff(alt: float) -> Item:
    """NAV_TAKEOFF."""
    return (RELATIVE, dialect.MAV_CMD_NAV_TAKEOFF, (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, alt))


def rtl() -> Item:
    """NAV_RETURN_TO_LAUNCH."""
    return (RELATIVE, dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH, (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def jump(seq: int, times: int) -> Item:
    """DO_JUMP."""
    return (dialect.MAV_FRAME_MISSION, dialect.MAV_CMD_DO_JUMP, (seq, times, 0.0, 0.0), (0.0, 0.0, 0.0))


def speed(mps: float) -> Item:
    """DO_CHANGE_SPEED over the ground."""
    return (dialect.MAV_FRAME_MISSION, dialect.MAV_CMD_DO_CHANGE_SPEED, (1.0, mps, -1.0, 0.0), (0.0, 0.0, 0.0))


def land(east: float, north: float) -> Item:
    """NAV_LAND at a place."""
    return (RELATIVE, dialect.MAV_CMD_NAV_LAND, (0.0, 0.0, 0.0, 0.0), (east, north, 0.0))


def square(side: float, alt: float) -> list[Item]:
    """Take off, a square with a corner at home, back home."""
    corners = [(0.0, side), (side, side), (side, 0.0), (0.0, 0.0)]
    return [takeoff(alt), *[waypoint(e, n, alt) for e, n in corners], rtl()]


def start(fly: Range, vehicle: str) -> None:
    """GUIDED, arm, MISSION_START."""
    assert fly.mode(vehicle, 4) == 0
    assert fly.arm(vehicle) == 0
    assert fly.command(vehicle, dialect.MAV_CMD_MISSION_START) == 0
