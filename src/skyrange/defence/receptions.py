"""Received Remote ID broadcasts as a defence reads them, and what the receiving aircraft knows of itself.

A tap at the companion's end of `rid_down` sees each broadcast with what a receiver adds to it: transport, sender
address, signal strength and time of reception. A second one at the companion's end of `rid_data` learns the aircraft's
own position and clock from its autopilot, as the companion does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import radians
from typing import Final, NamedTuple

from skyrange.codec.f3411 import BasicId, Location, MessagePack, Status, decode
from skyrange.codec.f3411.values import (
    HORIZONTAL_ACCURACY_M,
    SPEED_ACCURACY_MPS,
    SPEED_MAX_MPS,
    VERTICAL_ACCURACY_M,
    VERTICAL_MAX_MPS,
)
from skyrange.codec.mavlink import decode as decode_mavlink
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import message_id
from skyrange.codec.remote_id.link_payload import NO_RSSI, unpack
from skyrange.contracts.frames import Frame
from skyrange.contracts.verdicts import Verdict
from skyrange.core.elementary import cos, sin
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, NS_PER_US, Time
from skyrange.defence.placement import DefenceTap

Place = tuple[float, float, float]
"""East, north and up in metres from the origin."""
POSITION_AGE_NS: Final[Time] = 5 * NS_PER_S
"""An own position that is older than this is not used, as in `remoteid.broadcaster`."""
MAX_SENDERS: Final = 64
"""Senders that are followed at once, as in `remoteid.tracks`; the one heard longest ago makes room."""
HOUR_S: Final = 3600.0
UNKNOWN_M: Final = 30.0
"""Horizontal accuracy where none is said: code 9 of F3411-22a, the last that receivers of navigation satellites reach
with an ordinary fix (assumed)."""


class Sender(NamedTuple):
    """Who a broadcast says that it is from."""

    address: bytes
    uas_id: str
    """"" where none has come from this address."""


class Claim(NamedTuple):
    """A Location that was received, in metres from the origin, metres per second and seconds; `None` is unknown."""

    sender: Sender
    at_ns: Time
    """End of the reception."""
    rssi_dbm: float | None
    place: Place | None
    """`None` without position or height."""
    velocity: Place | None
    horizontal_m: float | None
    """The horizontal error is below this with 95 % (F3411-22a, table of horizontal accuracies)."""
    vertical_m: float | None
    speed_error_mps: float | None
    timestamp_s: float | None
    """Since the full hour."""
    timestamp_error_s: float
    """Accuracy of that time; 1.5 s, the largest that can be said, where it is not said."""
    height_m: float | None
    """Above the take-off or the ground."""
    grounded: bool
    failing: bool = False
    """Whether the sender says that its Remote ID system fails (F3411-22a, status 4): its position may be old."""


@dataclass(slots=True)
class OwnAircraft:
    """What an aircraft's companion knows of its own aircraft, from the autopilot's messages. Times in ns."""

    origin: Origin
    system_id: int
    since_ns: Time = -1
    """When its autopilot first reported a position; -1 never."""
    _at_ns: Time = -1
    _place: Place = (0.0, 0.0, 0.0)
    _velocity: Place = (0.0, 0.0, 0.0)
    _clock_ns: Time | None = None
    """UTC less range time."""

    def learn(self, now: Time, payload: bytes) -> None:
        """Take in a frame of `rid_data`; frames of other systems and malformed ones are passed over."""
        number = message_id(payload)
        if number not in (mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mav.MAVLINK_MSG_ID_SYSTEM_TIME):
            return
        try:
            message = decode_mavlink(payload)
        except DecodeError:
            return
        if message.get_srcSystem() != self.system_id:
            return
        if number == mav.MAVLINK_MSG_ID_SYSTEM_TIME:
            if message.time_unix_usec > 0:
                self._clock_ns = int(message.time_unix_usec) * NS_PER_US - now
            return
        east_m, north_m = self.origin.enu_of(message.lat * 1e-7, message.lon * 1e-7)
        if self.since_ns < 0:
            self.since_ns = now
        self._at_ns, self._place = now, (east_m, north_m, message.alt * 1e-3 - self.origin.alt_msl_m)
        self._velocity = (message.vy * 1e-2, message.vx * 1e-2, -message.vz * 1e-2)

    def place_at(self, now: Time) -> Place | None:
        """Its position, extrapolated at its velocity; `None` if none was reported lately."""
        if self._at_ns < 0 or now - self._at_ns > POSITION_AGE_NS:
            return None
        age_s = (now - self._at_ns) / NS_PER_S
        (x, y, z), (u, v, w) = self._place, self._velocity
        return (x + u * age_s, y + v * age_s, z + w * age_s)

    @property
    def velocity(self) -> Place:
        """The velocity that was reported last, east, north and up in m/s."""
        return self._velocity

    def clock_us(self, now: Time) -> int:
        """UTC in µs since 1970 by its clock; -1 before it has one."""
        return -1 if self._clock_ns is None else (now + self._clock_ns) // NS_PER_US

    def hour_s(self, at_ns: Time) -> float | None:
        """Seconds since the full hour of UTC by its clock; `None` before it has one."""
        return None if self._clock_ns is None else (at_ns + self._clock_ns) / NS_PER_S % HOUR_S


@dataclass(slots=True)
class Reader:
    """Reads broadcasts: Bluetooth 4 sends Basic ID and Location apart, so identities are kept by sender address."""

    origin: Origin
    _names: dict[bytes, str] = field(default_factory=dict)

    def read(self, payload: bytes) -> tuple[Sender, Claim | None] | None:
        """The sender, and its Location if there is one; `None` for a payload that is malformed."""
        try:
            header, body = unpack(payload)
            message = decode(body)
        except (DecodeError, ValueError):
            return None
        rssi_dbm = None if header.rssi_cdbm == NO_RSSI else header.rssi_cdbm * 0.01
        return self.take(header.address, header.time_ns, rssi_dbm, message)

    def take(self, address: bytes, at_ns: Time, rssi_dbm: float | None, message: object) -> tuple[Sender, Claim | None]:
        """The same of a decoded message or pack."""
        parts = message.messages if isinstance(message, MessagePack) else (message,)
        name = self._names.pop(address, "")
        location: Location | None = None
        for part in parts:
            if isinstance(part, BasicId) and part.uas_id:
                name = part.uas_id
            elif isinstance(part, Location) and location is None:
                location = part
        self._names[address] = name
        if len(self._names) > MAX_SENDERS:
            del self._names[next(iter(self._names))]
        sender = Sender(address, name)
        return sender, None if location is None else self._claim(sender, at_ns, rssi_dbm, location)

    def _claim(self, sender: Sender, at_ns: Time, rssi_dbm: float | None, location: Location) -> Claim:
        place: Place | None = None
        lat_deg, lon_deg, up_m = location.lat_deg, location.lon_deg, location.alt_geo_m
        if lat_deg is None or lon_deg is None or up_m is None:
            pass
        elif abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0:
            east_m, north_m = self.origin.enu_of(lat_deg, lon_deg)
            place = (east_m, north_m, self.origin.msl_of(up_m) - self.origin.alt_msl_m)
        return Claim(
            sender,
            at_ns,
            rssi_dbm,
            place,
            _velocity(location),
            _limit(HORIZONTAL_ACCURACY_M, location.horizontal_accuracy),
            _limit(VERTICAL_ACCURACY_M, location.vertical_accuracy),
            _limit(SPEED_ACCURACY_MPS, location.speed_accuracy),
            location.timestamp_s,
            0.1 * (location.timestamp_accuracy or 15),
            location.height_m,
            location.status == Status.GROUND,
            location.status == Status.REMOTE_ID_SYSTEM_FAILURE,
        )


def _velocity(location: Location) -> Place | None:
    """East, north and up in m/s; `None` where a part is unknown or not in range, as a saturated speed is."""
    speed, climb, track = location.speed_mps, location.vertical_mps, location.track_deg
    if speed is None or climb is None or speed >= SPEED_MAX_MPS or abs(climb) >= VERTICAL_MAX_MPS:
        return None
    if speed == 0.0:  # an aircraft at rest has no course
        return (0.0, 0.0, climb)
    if track is None:
        return None
    return (speed * sin(radians(track)), speed * cos(radians(track)), climb)


def _limit(table: tuple[float | None, ...], code: int) -> float | None:
    return table[code] if 0 <= code < len(table) else None


@dataclass(slots=True)
class OwnTap(DefenceTap):
    """Learns from the autopilot's messages on `rid_data`."""

    own: OwnAircraft

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Let it pass."""
        if frame.direction == "fwd":
            self.own.learn(now, frame.payload)
        return ()


@dataclass(slots=True)
class Held:
    """Senders that are followed, at most `MAX_SENDERS`, each with a state of its own."""

    senders: dict[Sender, object] = field(default_factory=dict)

    def touch(self, sender: Sender) -> object | None:
        """The state of a sender, which becomes the one heard last; `None` for a new one."""
        state = self.senders.pop(sender, None)
        if state is not None:
            self.senders[sender] = state
        return state

    def put(self, sender: Sender, state: object) -> None:
        """Follow a new sender; the one heard longest ago makes room."""
        self.senders[sender] = state
        if len(self.senders) > MAX_SENDERS:
            del self.senders[next(iter(self.senders))]


@dataclass(frozen=True, slots=True)
class Finding:
    """What is wrong with a broadcast: the kind of the alarm, its score, and its data."""

    kind: str
    """"" for a broadcast that is dropped without an alarm."""
    score: float
    data: tuple[tuple[str, str | float], ...] = ()
