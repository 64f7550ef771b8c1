"""Broadcast profiles: messages, rates and transports that regulations require, and the identity of an aircraft.

`us` is 14 CFR 89.305 and 89.310: every element at least once a second, counted on the air. `astm` is F3411-22a:
dynamic messages once a second, static ones every three. Packs (Bluetooth 5, Wi-Fi) hold everything that is due;
Bluetooth 4 carries one message at a time, spread evenly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from skyrange.codec.f3411 import IdType, MessageType, UaType, is_serial_number
from skyrange.codec.remote_id.link_payload import Transport
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time

if TYPE_CHECKING:  # its imports are slow, and only authenticated broadcasts need them
    from skyrange.remoteid.drip.sender import Credentials

PROFILES: Final = ("us", "astm")
TRANSPORTS: Final = {
    "wifi_beacon": (Transport.WIFI_BEACON,),
    "wifi_nan": (Transport.WIFI_NAN,),
    "bt5": (Transport.BT5,),
    "bt4": (Transport.BT4,),
    "bluetooth": (Transport.BT4, Transport.BT5),
}
"""Transports by name; F3411-22a requires that Bluetooth 4 and 5 are sent together."""
US_PERIOD_NS: Final[Time] = 980 * NS_PER_MS
"""Period of each element of `us`. On the air an advertisement comes up to 10 ms later than it was requested (advDelay,
Bluetooth Core 5.4 vol. 6 part B 4.4.2.2.1), and a Wi-Fi frame when the channel is free: 20 ms are left for that, so
that the interval stays within a second on the air too."""
STATIC_PERIOD_S: Final = 3
"""F3411-22a: static messages at least every 3 s."""
_MAKER: Final = "SKYR"
"""Used in place of the manufacturer's code of ANSI/CTA-2063-A."""
_ALPHABET: Final = "0123456789ABCDEFGHJKLMNPQRSTUVWXYZ"
"""ANSI/CTA-2063-A leaves out I and O."""


@dataclass(frozen=True, slots=True)
class Broadcast:
    """How one aircraft broadcasts. Raises `InputError` for invalid values.

    `operator_place` is the control station: latitude and longitude in degrees, height above the ellipsoid in metres;
    without one, the take-off location is broadcast, as 14 CFR 89.315 requires of broadcast modules.
    """

    vehicle: str
    uas_id: str = ""
    """Serial number or session id; empty: `serial_number(vehicle)`."""
    id_type: int = IdType.SERIAL_NUMBER
    ua_type: int = UaType.HELICOPTER_OR_MULTIROTOR
    profile: str = "us"
    transports: tuple[str, ...] = ("wifi_beacon",)
    """Keys of `TRANSPORTS`; without any the aircraft does not broadcast."""
    operator_place: tuple[float, float, float] | None = None
    operator_id: str = ""
    """Sent if given, as is the text below."""
    text: str = ""
    autopilot_location: bool = False
    """Whether the autopilot makes the Location itself (Open Drone ID, DID_ENABLE), as this transmitter then says it."""
    credentials: Credentials | None = None
    """Key and endorsements with which it signs; `uas_id` is then the session id of its DRIP entity tag."""

    def __post_init__(self) -> None:
        problems = []
        if self.profile not in PROFILES:
            problems.append(Problem("profile", self.profile, "us or astm", nearest(self.profile, PROFILES)))
        problems += [
            Problem("transports", name, "a known transport", nearest(name, TRANSPORTS))
            for name in self.transports
            if name not in TRANSPORTS
        ]
        kinds = [kind for name in self.transports for kind in TRANSPORTS.get(name, ())]
        if len(set(kinds)) != len(kinds):
            problems.append(Problem("transports", ", ".join(self.transports), "each transport once"))
        if self.id_type == IdType.SERIAL_NUMBER and self.uas_id and not is_serial_number(self.uas_id):
            problems.append(Problem("uas_id", self.uas_id, "a serial number by ANSI/CTA-2063-A", "Or set id_type."))
        for name, length in (("uas_id", 20), ("operator_id", 20), ("text", 23)):
            value = getattr(self, name)
            readable = value.isascii() or (name == "uas_id" and self.id_type == IdType.SPECIFIC_SESSION)
            if len(value) > length or not readable:
                problems.append(Problem(name, value, f"at most {length} ASCII characters"))
        if problems:
            raise InputError(f"Remote ID of {self.vehicle}", problems)

    @property
    def id(self) -> str:
        """The identifier in its Basic ID."""
        return self.uas_id or serial_number(self.vehicle)


def serial_number(vehicle: str) -> str:
    """A serial number in the form of ANSI/CTA-2063-A, fixed by the vehicle id: maker, length F, 15 characters."""
    left = hash64(f"serial/{vehicle}") << 64 | hash64(f"number/{vehicle}")
    text = ""
    for _ in range(15):
        left, digit = divmod(left, len(_ALPHABET))
        text += _ALPHABET[digit]
    return f"{_MAKER}F{text}"


def sender_address(node: str) -> bytes:
    """The 6-byte sender address of a node, derived from its name; the same over Wi-Fi and Bluetooth.

    A locally administered unicast address (IEEE 802-2014, 8.2) that is also a random static one (Bluetooth Core 5.4,
    Vol 6 Part B, 1.3.2.1): the first byte is 11xxxx10.
    """
    raw = bytearray((hash64(f"address/{node}") & 0xFFFFFFFFFFFF).to_bytes(6, "big"))
    raw[0] = raw[0] & 0b00111100 | 0b11000010
    return bytes(raw)


class BroadcastSlot(NamedTuple):
    """One transmission of a profile's cycle."""

    offset_ns: Time
    transport: int
    messages: tuple[int, ...]
    """`MessageType`s: those of a pack, or the one message of Bluetooth 4."""


class BroadcastCycle(NamedTuple):
    """A schedule that repeats every period: slots in order of their offset."""

    period_ns: Time
    slots: tuple[BroadcastSlot, ...]


def broadcast_cycle(broadcast: Broadcast) -> BroadcastCycle:
    """The broadcast schedule for an aircraft's profile, transports and messages."""
    static = [int(MessageType.BASIC_ID), int(MessageType.SYSTEM)]
    if broadcast.operator_id:
        static.append(int(MessageType.OPERATOR_ID))
    if broadcast.text:
        static.append(int(MessageType.SELF_ID))
    where = int(MessageType.LOCATION)
    whole = (static[0], where, *static[1:])
    us = broadcast.profile == "us"
    period_ns = US_PERIOD_NS if us else STATIC_PERIOD_S * NS_PER_S
    slots = []
    for transport in [kind for name in broadcast.transports for kind in TRANSPORTS[name]]:
        if transport is not Transport.BT4:
            slots.append(BroadcastSlot(0, transport, whole))
            if not us:
                slots += [BroadcastSlot(second * NS_PER_S, transport, (where,)) for second in range(1, STATIC_PERIOD_S)]
        elif us:
            slots += [BroadcastSlot(period_ns * i // len(whole), transport, (kind,)) for i, kind in enumerate(whole)]
        else:
            slots += [BroadcastSlot(second * NS_PER_S, transport, (where,)) for second in range(STATIC_PERIOD_S)]
            first = period_ns // (2 * len(static))
            slots += [
                BroadcastSlot(first + period_ns * i // len(static), transport, (kind,)) for i, kind in enumerate(static)
            ]
    return BroadcastCycle(period_ns, tuple(sorted(slots)))
