"""What is broadcast how often, and over what? Profiles of regulations, and who an aircraft says it is.

`us` is 14 CFR 89.305 and 89.310: every element at least once a second, on the air too. `astm` is F3411-22a: what moves
once a second, what does not every three. Packs (Bluetooth 5, Wi-Fi) hold all that is due; Bluetooth 4 carries one
message at a time, spread evenly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from skyrange.codec.f3411 import IdType, MessageType, UaType, is_serial_number
from skyrange.codec.rid_link import Transport
from skyrange.core.errors import Fault, InputError, nearest
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time

PROFILES: Final = ("us", "astm")
TRANSPORTS: Final = {
    "wifi_beacon": (Transport.WIFI_BEACON,),
    "wifi_nan": (Transport.WIFI_NAN,),
    "bt5": (Transport.BT5,),
    "bt4": (Transport.BT4,),
    "bluetooth": (Transport.BT4, Transport.BT5),
}
"""By name; F3411-22a asks that Bluetooth 4 and 5 are sent together."""
US_NS: Final[Time] = 980 * NS_PER_MS
"""From each element of `us` to the same again. On the air an advertisement comes up to 10 ms later than it was asked
for (advDelay, Bluetooth Core 5.4 vol. 6 part B 4.4.2.2.1), and a Wi-Fi frame when the channel is free: 20 ms are
left for that, so that a second is kept there too."""
STATIC_S: Final = 3
"""F3411-22a: static messages at least every 3 s."""
_MAKER: Final = "SKYR"
"""Stands where ANSI/CTA-2063-A has the manufacturer's code."""
_ALPHABET: Final = "0123456789ABCDEFGHJKLMNPQRSTUVWXYZ"
"""ANSI/CTA-2063-A leaves out I and O."""


@dataclass(frozen=True, slots=True)
class Broadcast:
    """How one aircraft broadcasts. Raises `InputError` for what cannot be.

    `operator_place` is the control station: latitude and longitude in degrees, height above the ellipsoid in metres;
    without one, the take-off location stands for it, as 14 CFR 89.315 has it of broadcast modules.
    """

    vehicle: str
    uas_id: str = ""
    """Serial number or session id; empty: `serial_number(vehicle)`."""
    id_type: int = IdType.SERIAL_NUMBER
    ua_type: int = UaType.HELICOPTER_OR_MULTIROTOR
    profile: str = "us"
    transports: tuple[str, ...] = ("wifi_beacon",)
    """Keys of `TRANSPORTS`; none: it does not broadcast."""
    operator_place: tuple[float, float, float] | None = None
    operator_id: str = ""
    """Sent where it is given, as the text below."""
    text: str = ""
    of_autopilot: bool = False
    """Whether the autopilot makes the Location itself (Open Drone ID, DID_ENABLE), as this transmitter then says it."""

    def __post_init__(self) -> None:
        faults = []
        if self.profile not in PROFILES:
            faults.append(Fault("profile", self.profile, "us or astm", nearest(self.profile, PROFILES)))
        faults += [
            Fault("transports", name, "a way to broadcast", nearest(name, TRANSPORTS))
            for name in self.transports
            if name not in TRANSPORTS
        ]
        kinds = [kind for name in self.transports for kind in TRANSPORTS.get(name, ())]
        if len(set(kinds)) != len(kinds):
            faults.append(Fault("transports", ", ".join(self.transports), "each way once"))
        if self.id_type == IdType.SERIAL_NUMBER and self.uas_id and not is_serial_number(self.uas_id):
            faults.append(Fault("uas_id", self.uas_id, "a serial number by ANSI/CTA-2063-A", "Or set id_type."))
        for name, length in (("uas_id", 20), ("operator_id", 20), ("text", 23)):
            value = getattr(self, name)
            if len(value) > length or not value.isascii():
                faults.append(Fault(name, value, f"at most {length} ASCII characters"))
        if faults:
            raise InputError(f"Remote ID of {self.vehicle}", faults)

    @property
    def id(self) -> str:
        """What its Basic ID says."""
        return self.uas_id or serial_number(self.vehicle)


def serial_number(vehicle: str) -> str:
    """A serial number of ANSI/CTA-2063-A's form, always the same for a vehicle id: maker, length F, 15 characters."""
    left = hash64(f"serial/{vehicle}") << 64 | hash64(f"number/{vehicle}")
    text = ""
    for _ in range(15):
        left, digit = divmod(left, len(_ALPHABET))
        text += _ALPHABET[digit]
    return f"{_MAKER}F{text}"


def address_of(node: str) -> bytes:
    """The 6 bytes a node sends from, the same over Wi-Fi and Bluetooth: made of its name.

    A locally administered unicast address (IEEE 802-2014, 8.2) that is also a random static one (Bluetooth Core 5.4,
    Vol 6 Part B, 1.3.2.1): the first byte is 11xxxx10.
    """
    raw = bytearray((hash64(f"address/{node}") & 0xFFFFFFFFFFFF).to_bytes(6, "big"))
    raw[0] = raw[0] & 0b00111100 | 0b11000010
    return bytes(raw)


class Slot(NamedTuple):
    """One transmission of a profile's cycle."""

    offset_ns: Time
    transport: int
    messages: tuple[int, ...]
    """`MessageType`s: a pack, or the one message of Bluetooth 4."""


class Cycle(NamedTuple):
    """What is sent again and again: slots in their order within a period."""

    period_ns: Time
    slots: tuple[Slot, ...]


def cycle(broadcast: Broadcast) -> Cycle:
    """The cycle of an aircraft's profile, transports and messages."""
    static = [int(MessageType.BASIC_ID), int(MessageType.SYSTEM)]
    if broadcast.operator_id:
        static.append(int(MessageType.OPERATOR_ID))
    if broadcast.text:
        static.append(int(MessageType.SELF_ID))
    where = int(MessageType.LOCATION)
    whole = (static[0], where, *static[1:])
    us = broadcast.profile == "us"
    period_ns = US_NS if us else STATIC_S * NS_PER_S
    slots = []
    for transport in [kind for name in broadcast.transports for kind in TRANSPORTS[name]]:
        if transport is not Transport.BT4:
            slots.append(Slot(0, transport, whole))
            if not us:
                slots += [Slot(second * NS_PER_S, transport, (where,)) for second in range(1, STATIC_S)]
        elif us:
            slots += [Slot(period_ns * i // len(whole), transport, (kind,)) for i, kind in enumerate(whole)]
        else:
            slots += [Slot(second * NS_PER_S, transport, (where,)) for second in range(STATIC_S)]
            first = period_ns // (2 * len(static))
            slots += [Slot(first + period_ns * i // len(static), transport, (kind,)) for i, kind in enumerate(static)]
    return Cycle(period_ns, tuple(sorted(slots)))
