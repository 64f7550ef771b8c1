"""Message types of ASTM F3411-22a as values; `None` is unknown.

Altitudes named `alt_geo_m` and `operator_alt_geo_m` are heights above the WGS 84 **ellipsoid**; MAVLink's are above
mean sea level (`core.geodesy.Origin.ellipsoid_of`, `.msl_of`). Codes are plain `int`s so that a reserved one can be
carried; the enumerations name the known ones. Nothing is checked here: `deviations` names what the standard does not
allow, and `encode` refuses what cannot be encoded.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final, NamedTuple, TypeAlias
from uuid import UUID

PROTOCOL_VERSION: Final = 2
"""Of F3411-22a; 0 is F3411-19, 1 its draft 1.1 and ASD-STAN prEN 4709-002 P1."""
EPOCH_2019_S: Final = 1_546_300_800
"""Unix time of 2019-01-01T00:00:00Z, the epoch of the seconds in System and Authentication."""


class MessageType(IntEnum):
    """The upper four bits of a message's first byte."""

    BASIC_ID = 0
    LOCATION = 1
    AUTHENTICATION = 2
    SELF_ID = 3
    SYSTEM = 4
    OPERATOR_ID = 5
    MESSAGE_PACK = 15


class IdType(IntEnum):
    """The kind of identifier in a Basic ID; 5…15 are reserved."""

    NONE = 0
    SERIAL_NUMBER = 1
    CAA_REGISTRATION = 2
    UTM_UUID = 3
    SPECIFIC_SESSION = 4


class UaType(IntEnum):
    """The kind of aircraft in a Basic ID."""

    NONE = 0
    AEROPLANE = 1
    HELICOPTER_OR_MULTIROTOR = 2
    GYROPLANE = 3
    HYBRID_LIFT = 4
    ORNITHOPTER = 5
    GLIDER = 6
    KITE = 7
    FREE_BALLOON = 8
    CAPTIVE_BALLOON = 9
    AIRSHIP = 10
    FREE_FALL_OR_PARACHUTE = 11
    ROCKET = 12
    TETHERED_POWERED = 13
    GROUND_OBSTACLE = 14
    OTHER = 15


class Status(IntEnum):
    """Operational status of a Location; 5…15 are reserved."""

    UNDECLARED = 0
    GROUND = 1
    AIRBORNE = 2
    EMERGENCY = 3
    REMOTE_ID_SYSTEM_FAILURE = 4


class HeightType(IntEnum):
    """The reference of a Location's height."""

    OVER_TAKEOFF = 0
    OVER_GROUND = 1


class AuthType(IntEnum):
    """The kind of data in an Authentication message; 6…9 are reserved, 10…15 private."""

    NONE = 0
    UAS_ID_SIGNATURE = 1
    OPERATOR_ID_SIGNATURE = 2
    MESSAGE_SET_SIGNATURE = 3
    NETWORK_REMOTE_ID = 4
    SPECIFIC_METHOD = 5


class DescriptionType(IntEnum):
    """The kind of text in a Self-ID; 3…200 are reserved, 201…255 private."""

    TEXT = 0
    EMERGENCY = 1
    EXTENDED_STATUS = 2


class OperatorLocationType(IntEnum):
    """The source of the operator's position in a System message; 3 is reserved."""

    TAKEOFF = 0
    LIVE_GNSS = 1
    FIXED = 2


class Classification(IntEnum):
    """The regulator whose categories and classes a System message uses; 2…7 are reserved."""

    UNDECLARED = 0
    EU = 1


class BasicId(NamedTuple):
    """Identity of an aircraft. An aircraft may send two, such as its serial number and a session id."""

    id_type: int
    ua_type: int
    uas_id: str
    """One character per byte (latin-1), up to 20, without trailing zeros. `label` formats binary identifiers."""
    version: int = PROTOCOL_VERSION

    @property
    def label(self) -> str:
        """The identifier in print: a UUID in its usual form, a session id as `session:` and hexadecimal digits."""
        raw = self.uas_id.encode("latin-1", "replace")
        if self.id_type == IdType.UTM_UUID:
            return str(UUID(bytes=raw[:16].ljust(16, b"\0")))
        if self.id_type == IdType.SPECIFIC_SESSION:
            return f"session:{raw.hex()}"
        return self.uas_id


def printable_id(uas_id: str) -> str:
    """An identifier of unknown type in print: as it is, or as a session id if it has bytes that cannot be printed."""
    return uas_id if uas_id.isprintable() and uas_id.isascii() else BasicId(IdType.SPECIFIC_SESSION, 0, uas_id).label


class Location(NamedTuple):
    """Position, velocity and status of an aircraft, with their accuracies."""

    status: int = Status.UNDECLARED
    lat_deg: float | None = None
    """WGS 84; unknown together with `lon_deg`."""
    lon_deg: float | None = None
    alt_geo_m: float | None = None
    """Above the WGS 84 ellipsoid."""
    alt_baro_m: float | None = None
    """Pressure altitude, against 1013.25 hPa."""
    height_m: float | None = None
    """Above what `height_type` says."""
    height_type: int = HeightType.OVER_TAKEOFF
    speed_mps: float | None = None
    """Over ground; 254.25 stands for that and faster."""
    vertical_mps: float | None = None
    """Up is positive; ±62 stands for that and faster."""
    track_deg: float | None = None
    """Course over ground from true north, 0…359."""
    horizontal_accuracy: int = 0
    """Code; metres in `values.HORIZONTAL_ACCURACY_M`."""
    vertical_accuracy: int = 0
    """Of `alt_geo_m`; code; metres in `values.VERTICAL_ACCURACY_M`."""
    baro_accuracy: int = 0
    """Of `alt_baro_m`; code; metres in `values.VERTICAL_ACCURACY_M`."""
    speed_accuracy: int = 0
    """Code; metres per second in `values.SPEED_ACCURACY_MPS`."""
    timestamp_accuracy: int = 0
    """Tenths of a second, 0 unknown."""
    timestamp_s: float | None = None
    """Seconds since the full hour of UTC at which this was so, 0…3600."""
    version: int = PROTOCOL_VERSION


class Authentication(NamedTuple):
    """One page of authentication data; `authentication.join_pages` joins
    them.
    """

    auth_type: int
    page: int
    """0…15."""
    data: bytes
    """17 bytes on page 0, 23 on the others; padded with zeros."""
    last_page: int | None = None
    """0…15; on page 0 only, as the two below."""
    length: int | None = None
    """Bytes of data on all pages together."""
    timestamp_s: int | None = None
    """Since `EPOCH_2019_S`."""
    version: int = PROTOCOL_VERSION


class SelfId(NamedTuple):
    """Free text by which the operator describes the flight."""

    description_type: int
    text: str
    """Up to 23 characters; one per byte (latin-1)."""
    version: int = PROTOCOL_VERSION


class System(NamedTuple):
    """Position of the operator, number of aircraft flying together, and their category."""

    operator_location_type: int = OperatorLocationType.TAKEOFF
    operator_lat_deg: float | None = None
    operator_lon_deg: float | None = None
    operator_alt_geo_m: float | None = None
    """Above the WGS 84 ellipsoid."""
    area_count: int = 1
    """Aircraft in the area."""
    area_radius_m: float = 0.0
    """In steps of 10 m, up to 2550."""
    area_ceiling_m: float | None = None
    area_floor_m: float | None = None
    classification: int = Classification.UNDECLARED
    category: int = 0
    """With `Classification.EU`: 1 open, 2 specific, 3 certified."""
    ua_class: int = 0
    """With `Classification.EU`: 1…7 are classes C0…C6."""
    timestamp_s: int = 0
    """Since `EPOCH_2019_S`."""
    version: int = PROTOCOL_VERSION


class OperatorId(NamedTuple):
    """Identifier that an authority assigned to the operator."""

    operator_id_type: int
    """0 is the operator id; 1…200 are reserved, 201…255 private."""
    operator_id: str
    """Up to 20 characters; one per byte (latin-1)."""
    version: int = PROTOCOL_VERSION


class Reserved(NamedTuple):
    """A message of a reserved type, or a pack within a pack; carried without being decoded."""

    message_type: int
    data: bytes
    """The 24 bytes after the first."""
    version: int = PROTOCOL_VERSION


SingleMessage: TypeAlias = BasicId | Location | Authentication | SelfId | System | OperatorId | Reserved
"""A message of 25 bytes."""


class MessagePack(NamedTuple):
    """Several messages in one broadcast, as Bluetooth 5 and Wi-Fi carry them."""

    messages: tuple[SingleMessage, ...]
    """1…9."""
    version: int = PROTOCOL_VERSION


Message: TypeAlias = SingleMessage | MessagePack
