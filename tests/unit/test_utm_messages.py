"""Approval messages: JSON of ASTM F3548-21's names, there and back, and nothing but DecodeError."""

from __future__ import annotations

import json
import uuid
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import pytest

from skyrange.core.errors import DecodeError
from skyrange.core.time import NS_PER_S, Epoch
from skyrange.core.volumes import Volume4D
from skyrange.utm.contract import Alternative, ApprovalDecision, OperationalIntent, intent_id
from skyrange.utm.intent_states import IntentState
from skyrange.utm.messages import (
    MAX_FRAME_BYTES,
    PATH,
    DecisionBody,
    ErrorBody,
    Request,
    Response,
    decode_request,
    decode_response,
    encode,
    encode_request,
)

EPOCH = Epoch.from_datetime(datetime(2026, 1, 1, 12, tzinfo=UTC))
VOLUME = Volume4D(((-35.0, 149.0), (-35.0, 149.1), (-35.1, 149.1)), 600.25, 640.0, 1_500_000_000, 90 * NS_PER_S)
INTENT = OperationalIntent(intent_id("blue/b1"), "blue", "blue/b1", (VOLUME, VOLUME), 3)


def test_a_request_says_what_f3548_asks_in_its_words() -> None:
    # ASTM F3548-21 annex A4, schemas Volume4D, Volume3D, Polygon, Altitude, Time.
    frame = json.loads(encode(Request.of(INTENT, EPOCH)))
    assert frame["method"] == "PUT"
    assert frame["path"] == PATH + INTENT.id
    assert frame["body"]["state"] == "Accepted"
    volume = frame["body"]["volumes"][0]
    assert volume == {
        "volume": {
            "outline_polygon": {
                "vertices": [{"lat": -35.0, "lng": 149.0}, {"lat": -35.0, "lng": 149.1}, {"lat": -35.1, "lng": 149.1}]
            },
            "altitude_lower": {"value": 600.25, "reference": "W84", "units": "M"},
            "altitude_upper": {"value": 640.0, "reference": "W84", "units": "M"},
        },
        "time_start": {"value": "2026-01-01T12:00:01.500000Z", "format": "RFC3339"},
        "time_end": {"value": "2026-01-01T12:01:30.000000Z", "format": "RFC3339"},
    }


@pytest.mark.parametrize("state", [IntentState.ACCEPTED, IntentState.ACTIVATED])
@pytest.mark.parametrize("version", [0, 7])
def test_a_request_made_without_the_model_has_the_bytes_of_the_model(state: IntentState, version: int) -> None:
    intent = replace(INTENT, state=state)
    assert encode_request(intent, EPOCH, version) == encode(Request.of(intent, EPOCH, version))


def test_round_trips() -> None:
    frame = encode(Request.of(INTENT, EPOCH))
    assert decode_request(frame).intent(EPOCH) == INTENT
    assert encode(decode_request(frame)) == frame
    decision = ApprovalDecision(
        accepted=False,
        reason="Ümlaut conflict",
        alternatives=(Alternative((VOLUME,), 5 * NS_PER_S, 15.0, -2.0, 3.5),),
        ovn="x",
    )
    answer = decode_response(encode(Response.of(INTENT.id, decision, EPOCH)))
    assert isinstance(answer.body, DecisionBody)
    assert answer.body.decision == "Rejected"
    assert answer.body.reason == "Ümlaut conflict"
    offered = answer.body.alternatives[0]
    assert offered.volumes[0].volume4d(EPOCH) == VOLUME
    assert (offered.delay_s, offered.climb_m, offered.east_m, offered.north_m) == (5.0, 15.0, -2.0, 3.5)
    error = decode_response(encode(Response.error(400, PATH, "no")))
    assert isinstance(error.body, ErrorBody)


def test_odd_nanoseconds_are_widened_to_microseconds() -> None:
    odd = Volume4D(VOLUME.outline, 0.0, 1.0, 1_999, 2_001)
    back = Request.of(OperationalIntent(INTENT.id, "blue", "blue/b1", (odd,)), EPOCH).intent(EPOCH).volumes[0]
    assert (back.start_ns, back.end_ns) == (1_000, 3_000)


def test_intent_ids_are_version_4_uuids_and_stable() -> None:
    parsed = uuid.UUID(intent_id("blue/b1"))
    assert parsed.version == 4
    assert parsed.variant == uuid.RFC_4122
    assert intent_id("blue/b1") == "38fbe533-cdf3-498f-a12d-175671e1ebe6"
    assert len({intent_id(f"blue/b{n}", v) for n in range(50) for v in range(3)}) == 150


def changed(path: str, value: Any) -> bytes:
    frame = json.loads(encode(Request.of(INTENT, EPOCH)))
    place: Any = frame
    *way, last = path.split(".")
    for key in way:
        place = place[int(key)] if key.isdigit() else place[key]
    place[last] = value
    return json.dumps(frame).encode()


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("method", "GET"),
        ("path", "/v1/other"),
        ("body.id", "not-a-uuid"),
        ("body.id", 7),
        ("body.volumes", []),
        ("body.volumes.0.volume.outline_polygon.vertices", [{"lat": 0, "lng": 0}]),
        ("body.volumes.0.volume.altitude_lower.value", 641.0),
        ("body.volumes.0.volume.altitude_lower.reference", "MSL"),
        ("body.volumes.0.volume.altitude_lower.value", float("nan")),
        ("body.volumes.0.time_start.value", "2026-01-01T12:09:00Z"),
        ("body.volumes.0.time_start.value", "2026-01-01T12:00:00"),
        ("body.volumes.0.time_start.value", "yesterday"),
        ("body.volumes.0.time_start.value", "9" * 100),
        ("body.priority", -1),
        ("body.state", "Done"),
        ("body.operator", "x" * 300),
    ],
)
def test_a_wrong_request_is_a_decode_error(path: str, value: Any) -> None:
    with pytest.raises(DecodeError):
        decode_request(changed(path, value))


def test_every_truncation_is_a_decode_error_and_size_is_capped() -> None:
    frame = encode(Request.of(INTENT, EPOCH))
    for size in range(len(frame)):
        with pytest.raises(DecodeError):
            decode_request(frame[:size])
    with pytest.raises(DecodeError, match="at most"):
        decode_request(frame + b" " * MAX_FRAME_BYTES)
    with pytest.raises(DecodeError):
        decode_request(b'{"body":' + b"[" * 100_000)


def test_unknown_keys_are_ignored() -> None:
    assert decode_request(changed("body.flight_type", "VLOS")).intent(EPOCH) == INTENT
