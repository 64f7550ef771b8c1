"""Base of kinds that forge Remote ID: identities, claimed positions, frames and their times, and keys that sign them.

The frames are well-formed ASTM F3411-22a, as an honest transmitter makes them; only their content is false.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import degrees
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, NamedTuple, Self

from skyrange.attack.bases.transmission import Transmission
from skyrange.attack.contract import Attack, AttackContext, Place, RemoteIdKeys
from skyrange.attack.declaration import Facts
from skyrange.attack.params import place_param
from skyrange.attack.radio import check_vehicle, place_transmitter
from skyrange.codec.drip import parse_session_id
from skyrange.codec.f3411 import (
    EPOCH_2019_S,
    BasicId,
    IdType,
    Location,
    MessagePack,
    SelfId,
    SingleMessage,
    Status,
    System,
    UaType,
    encode,
)
from skyrange.codec.f3411.encode import MAX_PACK_MESSAGES, PACK_HEADER, SIZE
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.contracts.claims import ClaimedTrack
from skyrange.contracts.params import Enu, Number
from skyrange.contracts.plugins.form import param
from skyrange.core.elementary import atan2, hypot
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Epoch, Time
from skyrange.remoteid.broadcast_profiles import TRANSPORTS, sender_address, serial_number

if TYPE_CHECKING:  # its imports are slow, and only authenticated broadcasts need them
    from skyrange.remoteid.drip.registry import Registration

_HOUR_NS = 3600 * NS_PER_S
_STOPPED = (0.0, 0.0, 0.0)

Transports = tuple[Literal["wifi_beacon", "wifi_nan", "bt5", "bt4", "bluetooth"], ...]


class ClaimedIdentity(NamedTuple):
    """The identity that a forged aircraft claims: its UAS ID and sender address."""

    uas_id: str
    address: bytes


def claim_identity(name: str, uas_id: str = "") -> ClaimedIdentity:
    """The identity of `name`: the address and, unless `uas_id` is given, the serial number of a node of that name."""
    return ClaimedIdentity(uas_id or serial_number(name), sender_address(name))


class ForgedRemoteId(Transmission):
    """Broadcasts forged aircraft, one after another within each period, from the start of the attack on.

    In the sham all of them report that they are on the ground where the transmitter is, which harms nobody. A kind with
    this base has the parameter `vehicle`, and sets in `prepare` whom it claims.
    """

    attack_facts: ClassVar[Facts] = {"honest": True}

    needs: ClassVar[tuple[str, ...]] = ("prepare",)

    at: Enu = place_param("Claimed position at the start of the attack")
    velocity_mps: Enu = param("Claimed velocity, [east, north, up] in m/s.", default=(0.0, 0.0, 0.0))
    rate_hz: Number = param(
        "Broadcasts per second of each forged aircraft on each transport.", default=1.0, ge=0.1, le=10
    )
    transports: Transports = param("Transports; each carries all broadcasts.", default=("wifi_beacon",), min_length=1)
    transmitter_m: Enu | None = place_param(
        "Position of the attacker's transmitter, by default 2 m above the ground or roof at the claimed position",
        default=None,
    )
    power_dbm: Number = param("Radiated power (EIRP) in dBm; 20 is the limit in Europe.", default=20.0, ge=-30, le=50)
    vehicle: str | None
    identities: Sequence[ClaimedIdentity]
    places: Sequence[Place]
    """The claimed positions at the start of the attack: `at`, unless a kind has others."""
    stands_enu_m: Place | None
    """Where all aircraft of a sham are."""
    carriers: Sequence[Transport]
    period_ns: Time
    origin: Origin
    epoch: Epoch
    turn: int = 0
    counter: int = 0

    def assemble(self, context: AttackContext) -> Any:
        """See `Acting`."""
        place = place_transmitter(context, self.transmitter_m, self.at)
        self.transmitter_m, self.places = place, [self.at]
        self.stands_enu_m = (place[0], place[1], 0.0) if context.sham else None
        self.carriers = [carrier for name in self.transports for carrier in TRANSPORTS[name]]
        self.period_ns = round(NS_PER_S / self.rate_hz)
        self.origin, self.epoch = context.origin, context.epoch
        return super().assemble(context)

    def prepare(self, context: AttackContext) -> None:
        """Set `identities`, and `places` if it claims several."""
        raise NotImplementedError

    def build(self, context: AttackContext) -> Attack:
        """Its radio, with the tracks that it claims."""
        claims = [
            ClaimedTrack(context.radio, start, self.velocity_mps, identity.uas_id)
            for start, identity in zip(self.places, self.identities, strict=True)
        ]
        return replace(super().build(context), shown=self.shown(), claims=claims)

    def shown(self) -> dict[str, Place]:
        """The claimed places, by what a map calls them."""
        return {"ghost" if self.vehicle is None else f"{self.vehicle} as claimed": self.at}

    @property
    def due(self) -> Time:
        """When the next payload is due."""
        return self.broadcast_due

    @property
    def broadcast_due(self) -> Time:
        """When the next broadcast of a position is due."""
        return self.turn * self.period_ns // len(self.identities)

    def transmit(self, now: Time) -> list[bytes]:
        """The payloads that are due; none before the attack starts."""
        return [payload for _, payload in self.transmit_numbered(now)]

    def transmit_numbered(self, now: Time) -> list[tuple[int, bytes]]:
        """The same, each with the number of the forged aircraft that it is about."""
        payloads: list[tuple[int, bytes]] = []
        while self.broadcast_due <= now:
            if self.schedule.start_ns <= now:
                number = self.turn % len(self.identities)
                payloads += [(number, payload) for payload in self._broadcast(now, number)]
            self.turn += 1
        return payloads

    def _broadcast(self, now: Time, number: int) -> list[bytes]:
        basic, location, system = self._messages(now, number)
        whole = encode(MessagePack((basic, location, system)))
        payloads = []
        for transport in self.carriers:
            header = RidHeader(
                transport, counter=self.counter & 0xFF, address=self.identities[number].address, time_ns=now
            )
            # Bluetooth 4 carries one message per advertisement, the others packs (F3411-22a, broadcast methods)
            bodies = [encode(basic), encode(location)] if transport == Transport.BT4 else [whole]
            payloads += [link_payload.pack(header, body) for body in bodies]
        self.counter += 1
        return payloads

    def _messages(self, now: Time, number: int) -> tuple[BasicId, Location, System]:
        seconds = (now - self.schedule.start_ns) / NS_PER_S
        velocity = self.velocity_mps if self.stands_enu_m is None else _STOPPED
        start = self.places[number] if self.stands_enu_m is None else self.stands_enu_m
        east_m, north_m, up_m = (x + v * seconds for x, v in zip(start, velocity, strict=True))
        lat_deg, lon_deg = self.origin.geodetic_of(east_m, north_m)
        ground_m = self.origin.ellipsoid_of(self.origin.alt_msl_m)  # F3411 heights are above the ellipsoid
        unix_ns = self.epoch.unix_ns + now
        location = Location(
            status=Status.AIRBORNE if self.stands_enu_m is None else Status.GROUND,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            alt_geo_m=ground_m + up_m,
            height_m=up_m,
            speed_mps=hypot(velocity[0], velocity[1]),
            vertical_mps=velocity[2],
            track_deg=degrees(atan2(velocity[0], velocity[1])) % 360.0,
            horizontal_accuracy=11,  # better than 3 m, as a usual receiver claims
            vertical_accuracy=5,
            speed_accuracy=3,
            timestamp_s=unix_ns % _HOUR_NS / NS_PER_S,
        )
        system = System(
            operator_lat_deg=lat_deg,
            operator_lon_deg=lon_deg,
            operator_alt_geo_m=ground_m,
            timestamp_s=unix_ns // NS_PER_S - EPOCH_2019_S,
        )
        uas_id = self.identities[number].uas_id
        kind = IdType.SERIAL_NUMBER if parse_session_id(uas_id) is None else IdType.SPECIFIC_SESSION
        who = BasicId(kind, UaType.HELICOPTER_OR_MULTIROTOR, uas_id)
        return who, location, system


LONGEST: Final = PACK_HEADER + MAX_PACK_MESSAGES * SIZE
"""Bytes of the longest body."""


@dataclass(frozen=True, slots=True)
class StandingAircraft:
    """What the aircraft sends: position, identity, and Self-IDs as far as wanted."""

    messages: Sequence[SingleMessage]

    @classmethod
    def at(cls, place: Place, origin: Origin, name: str) -> Self:
        """The aircraft at a place, with the serial number of a node of that name."""
        lat_deg, lon_deg = origin.geodetic_of(place[0], place[1])
        altitude_m = origin.ellipsoid_of(origin.alt_msl_m) + place[2]
        where = Location(status=Status.GROUND, lat_deg=lat_deg, lon_deg=lon_deg, alt_geo_m=altitude_m)
        who = BasicId(IdType.SERIAL_NUMBER, UaType.HELICOPTER_OR_MULTIROTOR, serial_number(name))
        return cls((where, who, *[SelfId(0, "standing here")] * MAX_PACK_MESSAGES))

    def body(self, length: int = LONGEST) -> bytes:
        """A pack of as many messages as fit in a length; its position alone, if no pack fits."""
        if length < PACK_HEADER + SIZE:
            return encode(self.messages[0])
        return encode(MessagePack(tuple(self.messages[: (length - PACK_HEADER) // SIZE])))


KeyOrigin = Literal["registered", "stolen", "unregistered"]


def find_keys(context: AttackContext) -> RemoteIdKeys:
    """The keys of the scenario; raises `InputError` if it has no registry."""
    if context.keys is None:
        raise InputError.one(context.id, "kind", "an attack on DRIP", "a scenario with a registry of DRIP keys")
    return context.keys


def find_root(context: AttackContext) -> bytes:
    """The entity tag of the root of the registry, 16 bytes: it is public. Raises `InputError` without a registry."""
    anchors = context.anchors("apex")
    if not anchors:
        raise InputError.one(context.id, "kind", "an attack on DRIP", "a scenario with a registry of DRIP keys")
    return anchors[0].tag


def find_registration(context: AttackContext, origin: KeyOrigin, vehicle: str | None) -> Registration:
    """The key, tag and Links of an adversary; raises `InputError` for a vehicle that has no key to steal."""
    keys = find_keys(context)
    if origin == "registered":
        return keys.registered(context.id)
    if origin == "unregistered":
        return keys.unregistered(context.id)
    assert vehicle is not None  # the parameters' own check
    check_vehicle(context, "vehicle", vehicle)
    stolen = keys.stolen(vehicle)
    if stolen is None:
        raise InputError.one(context.id, "vehicle", vehicle, 'an aircraft with remote_id.auth = "drip"')
    return stolen
