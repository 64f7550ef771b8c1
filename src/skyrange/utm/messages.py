"""Messages between operators and a flight approval: one JSON object per frame, HTTP-like.

A request is `{"method", "path", "body"}`, a response `{"status", "path", "body"}`. PUT asks for an intent, or tells
that it has another state; DELETE ends it. A response that nobody asked for says that an accepted intent is rejected.
Bodies use the JSON names of ASTM F3548-21 annex A4 (its OpenAPI interface): `outline_polygon.vertices[].lat/lng`,
`altitude_lower/upper` in metres above the WGS 84 ellipsoid, `time_start/end` in RFC 3339; so a service
that speaks F3548 needs no other message. Unknown keys are ignored, as HTTP peers do.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    StringConstraints,
    Tag,
    ValidationError,
    field_validator,
    model_validator,
)

from skyrange.codec.json_errors import describe
from skyrange.codec.strict_json import parse_json
from skyrange.core.errors import DecodeError
from skyrange.core.time import Epoch, Time, parse_rfc3339, to_seconds
from skyrange.core.volumes import Volume4D
from skyrange.utm.contract import Alternative, ApprovalDecision, OperationalIntent, Overruled
from skyrange.utm.intent_states import IntentState

MAX_FRAME_BYTES = 1_048_576
"""Longest frame that is looked at. A leg takes about 1.2 kB, so this holds the longest mission (700 items)."""
MAX_VOLUMES = 2_048
MAX_VERTICES = 1_024
MAX_ALTERNATIVES = 16
PATH = "/v1/operational_intents/"
"""Followed by the intent's id."""

_Id = Annotated[
    str,
    StringConstraints(
        pattern=r"^[0-9a-fA-F]{8}-[0-9a-fA-F]{4}-4[0-9a-fA-F]{3}-[89abAB][0-9a-fA-F]{3}-[0-9a-fA-F]{12}$", to_lower=True
    ),
]
"""A UUID, which is the same in upper case (RFC 9562, 4)."""
_M = TypeVar("_M", bound=BaseModel)
_Text = Annotated[str, Field(max_length=256, pattern=r"^[^\x00]*$")]
_Version = Annotated[int, Field(ge=1, le=1_000_000)] | None


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


class Vertex(_Model):
    """One corner, WGS 84 degrees."""

    lat: Annotated[float, Field(ge=-90.0, le=90.0)]
    lng: Annotated[float, Field(ge=-180.0, le=180.0)]


class OutlinePolygon(_Model):
    """A ring without the repeated last vertex."""

    vertices: Annotated[tuple[Vertex, ...], Field(min_length=3, max_length=MAX_VERTICES)]


class Altitude(_Model):
    """Metres above the WGS 84 ellipsoid; F3548 allows no other reference or unit."""

    value: Annotated[float, Field(ge=-8_000.0, le=100_000.0)]
    reference: Literal["W84"] = "W84"
    units: Literal["M"] = "M"


class Instant(_Model):
    """A moment in UTC, to the microsecond."""

    value: Annotated[str, Field(max_length=40)]
    format: Literal["RFC3339"] = "RFC3339"

    @field_validator("value")
    @classmethod
    def _is_rfc3339(cls, value: str) -> str:
        parse_rfc3339(value)
        return value

    def time(self, epoch: Epoch) -> Time:
        """The simulated time of this moment."""
        return epoch.parse(self.value)


class Volume3D(_Model):
    """A prism."""

    outline_polygon: OutlinePolygon
    altitude_lower: Altitude
    altitude_upper: Altitude


class Volume4DMessage(_Model):
    """F3548 Volume4D: a prism and its time window."""

    volume: Volume3D
    time_start: Instant
    time_end: Instant

    @model_validator(mode="after")
    def _ordered(self) -> Volume4DMessage:
        if not self.volume.altitude_lower.value < self.volume.altitude_upper.value:
            raise ValueError("altitude_lower must lie below altitude_upper")
        if not parse_rfc3339(self.time_start.value) < parse_rfc3339(self.time_end.value):
            raise ValueError("time_start must lie before time_end")
        return self

    @classmethod
    def of(cls, volume: Volume4D, epoch: Epoch) -> Volume4DMessage:
        """The message that claims `volume`, its times widened to whole microseconds."""
        return cls.model_validate(_volume_data(volume, epoch))

    def volume4d(self, epoch: Epoch) -> Volume4D:
        """The claimed volume on the scenario's clock."""
        return Volume4D(
            outline=tuple((vertex.lat, vertex.lng) for vertex in self.volume.outline_polygon.vertices),
            lower_m=self.volume.altitude_lower.value,
            upper_m=self.volume.altitude_upper.value,
            start_ns=self.time_start.time(epoch),
            end_ns=self.time_end.time(epoch),
        )


_Volumes = Annotated[tuple[Volume4DMessage, ...], Field(max_length=MAX_VOLUMES)]


class IntentBody(_Model):
    """An operational intent that its operator wants accepted."""

    id: _Id
    operator: _Text
    vehicle: _Text
    state: IntentState = IntentState.ACCEPTED
    priority: Annotated[int, Field(ge=0, le=1_000)] = 0
    volumes: Annotated[tuple[Volume4DMessage, ...], Field(min_length=1, max_length=MAX_VOLUMES)]
    version: _Version = None
    """Number of the request among those for the intent, which its answer repeats; none is the first."""


class EndBody(_Model):
    """An operational intent that its operator withdraws, or has flown."""

    id: _Id
    operator: _Text
    vehicle: _Text


_INTENT, _END = "<intent>", "<end>"


def _kind_of_body(body: Any) -> str:
    """Which body JSON data is: one with volumes is an intent, even a wrong one."""
    return _END if isinstance(body, EndBody) or (isinstance(body, dict) and "volumes" not in body) else _INTENT


class Request(_Model):
    """Operator → approval."""

    method: Literal["PUT", "DELETE"] = "PUT"
    path: Annotated[_Text, StringConstraints(to_lower=True)]
    body: Annotated[Annotated[IntentBody, Tag(_INTENT)] | Annotated[EndBody, Tag(_END)], Discriminator(_kind_of_body)]

    @model_validator(mode="after")
    def _names_its_intent(self) -> Request:
        if self.path != PATH + self.body.id:
            raise ValueError(f"path must be {PATH}<id of the body>")
        if (self.method == "DELETE") != isinstance(self.body, EndBody):
            raise ValueError("PUT takes volumes, and DELETE takes none")
        if isinstance(self.body, IntentBody) and self.body.state is IntentState.ENDED:
            raise ValueError("an intent is ended by DELETE")
        return self

    @classmethod
    def end(cls, intent: OperationalIntent) -> Request:
        """The message that ends `intent`."""
        body = EndBody(id=intent.id, operator=intent.operator, vehicle=intent.vehicle)
        return cls(method="DELETE", path=PATH + intent.id, body=body)

    @classmethod
    def of(cls, intent: OperationalIntent, epoch: Epoch, version: int = 0) -> Request:
        """The message that asks for `intent` in its state, the `version`-th after the first."""
        return cls.model_validate(_request_data(intent, epoch, version))

    def intent(self, epoch: Epoch) -> OperationalIntent:
        """What is asked for, on the scenario's clock; without volumes where it is to end."""
        body = self.body
        if isinstance(body, EndBody):
            return OperationalIntent(body.id, body.operator, body.vehicle, (), state=IntentState.ENDED)
        volumes = tuple(volume.volume4d(epoch) for volume in body.volumes)
        return OperationalIntent(body.id, body.operator, body.vehicle, volumes, body.priority, body.state)


class AlternativeMessage(_Model):
    """What would be accepted instead: by how much the flight would be delayed, raised and shifted."""

    delay_s: Annotated[float, Field(ge=0.0, le=2_592_000.0)] = 0.0
    climb_m: Annotated[float, Field(ge=-10_000.0, le=10_000.0)] = 0.0
    east_m: Annotated[float, Field(ge=-100_000.0, le=100_000.0)] = 0.0
    north_m: Annotated[float, Field(ge=-100_000.0, le=100_000.0)] = 0.0
    volumes: _Volumes = ()


class DecisionBody(_Model):
    """The approval's answer to one intent."""

    id: _Id
    decision: Literal["Accepted", "Rejected", "Ended"]
    reason: _Text = ""
    alternatives: Annotated[tuple[AlternativeMessage, ...], Field(max_length=MAX_ALTERNATIVES)] = ()
    ovn: Annotated[str, Field(max_length=128)] = ""
    version: _Version = None
    """That of the request which it answers."""
    conflicts: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """How many intents of lower priority an accepted one overlaps."""
    tracked: Literal[True] | None = None
    """Whether the approval is to be told of further states of the intent."""
    overruled: Literal[True] | None = None
    """Whether it answers no request: an intent of higher priority overlaps this one, which is rejected, or
    stays accepted if it is activated."""
    closed: _Volumes | None = None
    """What the intent of higher priority claims, for an aircraft in flight to fly around."""


class ErrorBody(_Model):
    """Why a request was not understood (F3548 ErrorResponse)."""

    message: Annotated[str, Field(max_length=1_024)]


class Response(_Model):
    """Approval → operator. Status 200 decides (either way), 4xx did not get that far."""

    status: Annotated[int, Field(ge=100, le=599)]
    path: _Text
    body: DecisionBody | ErrorBody

    @classmethod
    def of(
        cls,
        intent_id: str,
        decision: ApprovalDecision,
        epoch: Epoch,
        version: int | None = None,
        overruled: Overruled | None = None,
    ) -> Response:
        """The message that tells `decision`."""
        return cls.model_validate(_decision_data(intent_id, decision, epoch, version, overruled))

    @classmethod
    def ended(cls, intent_id: str) -> Response:
        """The message that tells that an intent has ended."""
        return cls(status=200, path=PATH + intent_id, body=DecisionBody(id=intent_id, decision="Ended"))

    @classmethod
    def error(cls, status: int, path: str, message: str) -> Response:
        """The message that tells what is wrong with a request."""
        return cls(status=status, path=path[:256], body=ErrorBody(message=message[:1_024]))


def encode(message: Request | Response) -> bytes:
    """The frame of a message: ASCII JSON, keys sorted, no spaces; equal messages give equal bytes."""
    return _dump(message.model_dump(mode="json", exclude_none=True))


def _dump(data: dict[str, Any]) -> bytes:
    return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def encode_request(intent: OperationalIntent, epoch: Epoch, version: int = 0) -> bytes:
    """The frame of `Request.of`, made without the model: a plan has many volumes, which take a while to check."""
    return _dump(_request_data(intent, epoch, version))


def _request_data(intent: OperationalIntent, epoch: Epoch, version: int) -> dict[str, Any]:
    body = {
        "id": intent.id,
        "operator": intent.operator,
        "vehicle": intent.vehicle,
        "state": intent.state.value,
        "priority": intent.priority,
        "volumes": [_volume_data(volume, epoch) for volume in intent.volumes],
        **({"version": version} if version else {}),
    }
    return {"method": "PUT", "path": PATH + intent.id, "body": body}


def encode_decision(
    intent_id: str,
    decision: ApprovalDecision,
    epoch: Epoch,
    version: int | None = None,
    overruled: Overruled | None = None,
) -> bytes:
    """The frame of `Response.of`, made without the model: alternatives are most of it, and take a while to check."""
    return _dump(_decision_data(intent_id, decision, epoch, version, overruled))


def _decision_data(
    intent_id: str, decision: ApprovalDecision, epoch: Epoch, version: int | None, overruled: Overruled | None
) -> dict[str, Any]:
    """The JSON of a response that tells a decision."""
    optional = {
        "version": version,
        "conflicts": decision.conflicts or None,
        "tracked": True if decision.tracked else None,
        "overruled": True if overruled is not None else None,
        "closed": [_volume_data(volume, epoch) for volume in overruled.closed]
        if overruled and overruled.in_flight
        else None,
    }
    body = {
        "id": intent_id,
        "decision": "Accepted" if decision.accepted else "Rejected",
        "reason": decision.reason[:256],
        "alternatives": [_alternative_data(alternative, epoch) for alternative in decision.alternatives],
        "ovn": decision.ovn,
        **{name: value for name, value in optional.items() if value is not None},
    }
    return {"status": 200, "path": PATH + intent_id, "body": body}


def _alternative_data(alternative: Alternative, epoch: Epoch) -> dict[str, Any]:
    return {
        "delay_s": to_seconds(alternative.delay_ns),
        "climb_m": float(alternative.climb_m),
        "east_m": float(alternative.east_m),
        "north_m": float(alternative.north_m),
        "volumes": [_volume_data(volume, epoch) for volume in alternative.volumes],
    }


def _volume_data(volume: Volume4D, epoch: Epoch) -> dict[str, Any]:
    """A volume as JSON, its times widened to whole microseconds."""
    return {
        "volume": {
            "outline_polygon": {"vertices": [{"lat": float(lat), "lng": float(lng)} for lat, lng in volume.outline]},
            "altitude_lower": {"value": float(volume.lower_m), "reference": "W84", "units": "M"},
            "altitude_upper": {"value": float(volume.upper_m), "reference": "W84", "units": "M"},
        },
        "time_start": {"value": epoch.rfc3339(volume.start_ns), "format": "RFC3339"},
        "time_end": {"value": epoch.rfc3339(volume.end_ns, up=True), "format": "RFC3339"},
    }


def decode_request(payload: bytes) -> Request:
    """The request in `payload`; any other bytes raise `DecodeError`."""
    return _decode(Request, payload)


def decode_request_body(method: str, path: str, content: bytes) -> Request:
    """The request that an HTTP message carries. Raises `DecodeError`."""
    if len(content) > MAX_FRAME_BYTES:
        raise DecodeError(f"{len(content)} bytes, an approval message has at most {MAX_FRAME_BYTES}")
    try:
        return Request.model_validate({"method": method, "path": path, "body": parse_json(content)})
    except ValidationError as error:
        raise describe(error, (_INTENT, _END)) from error


def decode_response(payload: bytes) -> Response:
    """The response in `payload`; any other bytes raise `DecodeError`."""
    return _decode(Response, payload)


def _decode(model: type[_M], payload: bytes) -> _M:
    if len(payload) > MAX_FRAME_BYTES:
        raise DecodeError(f"{len(payload)} bytes, an approval message has at most {MAX_FRAME_BYTES}")
    try:
        return model.model_validate_json(payload)
    except ValidationError as error:
        raise describe(error, (_INTENT, _END)) from error
