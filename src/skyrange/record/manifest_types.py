"""Types of the entries of a run's manifest that readers rely on; each may be absent, and there may be others."""

from __future__ import annotations

from typing import Annotated, Any, Required

from pydantic import AfterValidator, ConfigDict, Field, with_config
from pydantic_core import PydanticCustomError
from typing_extensions import TypedDict

from skyrange.core.typed_json import Count, Finite, Int64

Metres = Annotated[float, Field(ge=-2e7, le=2e7, allow_inf_nan=False)]
"""A length in east, north or up: no two places on Earth are further apart, and its decimetres fit in 32 bits."""
Place = Annotated[list[Metres], Field(min_length=3, max_length=3)]
"""East, north and up in metres."""
Corner = Annotated[list[Metres], Field(min_length=2, max_length=2)]
"""East and north in metres."""
_OTHERS = ConfigDict(extra="allow")


def _require_place_or_none(numbers: list[float]) -> list[float]:
    """A radio that is not in the scenario's space has the place []."""
    if len(numbers) not in (0, 3):
        raise PydanticCustomError("place", "three numbers or none")
    return numbers


@with_config(_OTHERS)
class _Origin(TypedDict, total=False):
    lat_deg: Annotated[float, Field(ge=-90.0, le=90.0)]
    lon_deg: Annotated[float, Field(ge=-180.0, le=180.0)]
    alt_msl_m: Finite | None
    geoid_m: Finite | None


@with_config(_OTHERS)
class _Operator(TypedDict, total=False):
    id: Required[str]
    color: str


@with_config(_OTHERS)
class _Vehicle(TypedDict, total=False):
    id: Required[str]
    operator: Required[str]
    uas_id: str
    color: str
    autopilot: str
    airframe: str
    plan: str
    expected: str
    home_enu_m: Place | None
    network: Count
    system_id: Count


@with_config(_OTHERS)
class _Link(TypedDict, total=False):
    name: Required[str]
    a: str
    b: str
    channel: dict[str, Any]


@with_config(_OTHERS)
class _Receiver(TypedDict, total=False):
    id: Required[str]
    operator: str
    at_enu_m: Place


@with_config(_OTHERS)
class _Identified(TypedDict, total=False):
    id: Required[str]


@with_config(_OTHERS)
class _Radio(TypedDict, total=False):
    endpoint: Required[str]
    at_enu_m: Annotated[list[Metres], AfterValidator(_require_place_or_none)]


@with_config(_OTHERS)
class _Act(TypedDict, total=False):
    id: Required[str]
    kind: Required[str]
    muted: bool
    sham: bool
    honest: bool
    manual: bool
    start_s: Finite | None
    stop_s: Finite | None
    for_s: Finite | None
    anchor: str
    params: dict[str, Any]
    touches: list[str]
    technique: str
    family: str
    persists: str | None
    threat: dict[str, Any]
    radios: list[_Radio]
    shown: dict[str, Place]


@with_config(_OTHERS)
class _Defence(TypedDict, total=False):
    id: Required[str]
    kind: Required[str]
    muted: bool
    params: dict[str, Any]
    touches: list[str]


@with_config(_OTHERS)
class _HonestAircraft(TypedDict, total=False):
    id: Required[str]
    uas_id: Required[str]
    airframe: Required[str]


@with_config(_OTHERS)
class _Constraint(TypedDict, total=False):
    id: Required[str]
    corners_m: Required[Annotated[list[Corner], Field(min_length=3)]]
    lower_m: Required[Finite]
    upper_m: Required[Finite]
    start_s: Required[Finite]
    end_s: Required[Finite]
    published_s: Required[Finite]


@with_config(_OTHERS)
class _Reading(TypedDict, total=False):
    kept: Count
    features: Count
    dropped: dict[str, Count]
    repaired: Count
    heights: dict[str, Count]
    height_keys: dict[str, Count]
    unreadable_heights: Count
    notes: list[str]


@with_config(_OTHERS)
class _City(TypedDict, total=False):
    name: str
    source: Required[str]
    buildings: Count
    reading: _Reading | None


@with_config(_OTHERS)
class _Placing(TypedDict, total=False):
    vehicle: str
    receiver: str
    moved_m: Required[Finite]
    nearest: str
    nearest_m: Finite
    declared_m: Finite
    protected_m: Finite


@with_config(_OTHERS)
class _IgnoredKey(TypedDict, total=False):
    harmless: Required[bool]


@with_config(_OTHERS)
class _MissionFile(TypedDict, total=False):
    file: Required[str]
    items: Required[Count]
    fence: Required[Count]
    rally: Required[Count]
    ignored: Required[list[_IgnoredKey]]


@with_config(_OTHERS)
class _Outcome(TypedDict):
    state: str
    reason: str
    finished_s: Finite | None


@with_config(_OTHERS)
class _CorePart(TypedDict):
    vehicles: Count
    waited_s: Finite


@with_config(_OTHERS)
class _Cores(TypedDict, total=False):
    asked: Required[Count]
    used: Required[Count]
    reason: Required[str]
    parts: list[_CorePart]


@with_config(_OTHERS)
class _Repeatable(TypedDict, total=False):
    kind: str
    repeatable: Required[str]


@with_config(_OTHERS)
class _Medium(_Repeatable, total=False):
    builtin_waveforms: list[Any]


@with_config(_OTHERS)
class _Live(TypedDict, total=False):
    outside: list[str]


@with_config(_OTHERS)
class RunManifest(TypedDict, total=False):
    """Contents of a run's `manifest.json`, but for `format`, `status` and `record`, which have their own checks."""

    skyrange: str
    versions: dict[str, str]
    platform: dict[str, str]
    name: str | None
    seed: Int64 | None
    start_utc: str
    start_unix_ns: Int64 | None
    duration_s: Finite | None
    simulated_s: Annotated[float, Field(ge=0.0, lt=2**63 / 1e9)] | None
    reason: str | None
    error: str | None
    origin: _Origin | None
    operators: list[_Operator]
    vehicles: list[_Vehicle]
    links: list[_Link]
    receivers: list[_Receiver]
    constraints: list[_Constraint]
    city: _City | None
    mission_files: list[_MissionFile]
    placing: list[_Placing]
    attacks: list[_Act]
    faults: list[_Act]
    defences: list[_Defence]
    detectors: list[_Identified]
    honest: list[_HonestAircraft]
    engines: list[_Repeatable]
    medium: _Medium | None
    live: _Live | None
    warnings: list[str]
    withheld: list[str]
    counts: dict[str, Count]
    messages: dict[str, Count]
    files: dict[str, Any]
    digests: dict[str, str]
    outcomes: dict[str, _Outcome]
    timings: dict[str, Finite | None]
    not_kept: dict[str, Count]
    cores: _Cores | None
    spooled: bool


@with_config(_OTHERS)
class Building(TypedDict, total=False):
    """One building of `city.json`."""

    height_m: Metres
    base_m: Metres
    rings: Required[list[Annotated[list[Corner], Field(min_length=3)]]]
