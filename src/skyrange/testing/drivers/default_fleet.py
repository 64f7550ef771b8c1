"""Defaults of the check of engines: aircraft, their world and their mail."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime

from skyrange.codec.mavlink import Packer, dialect
from skyrange.contracts.components import Engine, World
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port, owner_of
from skyrange.core.time import NS_PER_MS, Epoch
from skyrange.testing.drivers.messages import InputMessage
from skyrange.vehicle.contract import VehicleSpec
from skyrange.world import Body, SensorSpec
from skyrange.world import World as Bodies
from skyrange.world.sensing.geomagnetism import magnetic_field_at

ORIGIN = Origin(-35.363328, 149.1652241, 584.0, 19.0)
EPOCH = Epoch.from_datetime(datetime(2026, 1, 1, 12, tzinfo=UTC))
CHANCE = Chance(7)
FLEET = tuple(
    VehicleSpec(vehicle=vehicle, system_id=system, airframe="iris", home_enu_m=(east, north, 0.0), heading_deg=heading)
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
    bodies = [Body(s.vehicle, s.airframe, s.home_enu_m[0], s.home_enu_m[1], 0.0, s.heading_deg) for s in specs]
    return Bodies(bodies, sensors=SensorSpec(1.0, magnetic_field_at(ORIGIN), CHANCE))


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
