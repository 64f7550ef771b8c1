"""Requests and responses of F3548's interface as frames on `uss` links: one JSON object each, HTTP-like.

A request is `{"exchange", "method", "path", "token", "body"}`, a response `{"exchange", "status", "body"}`. `exchange`
numbers the requests of a sender; the response repeats the number, as an HTTP connection pairs the two. `token` is what
HTTP carries in `Authorization: Bearer`. Bodies are those of the standard.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from skyrange.codec.json_errors import describe
from skyrange.codec.strict_json import parse_json
from skyrange.core.errors import DecodeError

MAX_FRAME_BYTES: Final = 4_194_304
"""Longest frame that is looked at: an intent with the most vertices of F3548 (OiMaxVertices) takes about 0.6 MB."""


class _Frame(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    exchange: Annotated[int, Field(ge=0, le=2**53)]
    body: dict[str, Any] | None = None


class UssRequest(_Frame):
    """What a USS asks of a DSS, or of another USS."""

    method: Literal["GET", "POST", "PUT", "DELETE"]
    path: Annotated[str, Field(pattern=r"^/", max_length=512)]
    token: Annotated[str, Field(max_length=8_192)] = ""


class UssResponse(_Frame):
    """The answer to a request."""

    status: Annotated[int, Field(ge=200, le=599)]


def encode(frame: UssRequest | UssResponse) -> bytes:
    """The bytes of a frame: ASCII JSON, keys sorted, no spaces; equal frames give equal bytes."""
    data = frame.__dict__ if frame.body is not None else {k: v for k, v in frame.__dict__.items() if k != "body"}
    return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def decode(payload: bytes) -> UssRequest | UssResponse:
    """The frame in `payload`; any other bytes raise `DecodeError`."""
    if len(payload) > MAX_FRAME_BYTES:
        raise DecodeError(f"{len(payload)} bytes, a message between USSs has at most {MAX_FRAME_BYTES}")
    data = parse_json(payload)
    model = UssRequest if isinstance(data, dict) and "method" in data else UssResponse
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise describe(error) from error
