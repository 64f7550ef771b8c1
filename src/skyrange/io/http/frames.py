"""Conversion between approval frames and HTTP messages: method, path and status move, the body stays JSON.

A frame is the JSON object of `skyrange.utm.messages`: `{"method", "path", "body"}` or
`{"status", "path", "body"}`. Frames are serialised as the agents do (ASCII, keys sorted, no spaces), so the frames
of the agents cross HTTP byte for byte. The agents alone interpret the members.
"""

from __future__ import annotations

import json
import re
from typing import Any, NamedTuple

from yarl import URL

from skyrange.codec.strict_json import MAX_DEPTH, parse_json_object
from skyrange.core.errors import DecodeError

MAX_BYTES = 1_048_576
"""Longest frame, as the agents': `skyrange.utm.messages.MAX_FRAME_BYTES`."""
JSON_TYPE = "application/json"
_METHOD = re.compile(r"[A-Z]{1,16}")


class Request(NamedTuple):
    """The content of a request frame; `body` is JSON."""

    method: str
    path: str
    body: bytes


class Response(NamedTuple):
    """The content of a response frame; `body` is JSON."""

    status: int
    path: str
    body: bytes


def read_request(payload: bytes, max_bytes: int = MAX_BYTES) -> Request:
    """The request in a frame; `DecodeError` if there is none that HTTP could carry."""
    frame = _members(payload, max_bytes)
    method = frame.get("method")
    if not isinstance(method, str) or not _METHOD.fullmatch(method):
        raise DecodeError("method: expected the name of an HTTP method")
    return Request(method, _path(frame), _dump(frame.get("body")))


def read_response(payload: bytes, max_bytes: int = MAX_BYTES) -> Response:
    """The response in a frame; `DecodeError` if there is none that HTTP could carry."""
    frame = _members(payload, max_bytes)
    status = frame.get("status")
    # 1xx announce another response, and 204, 205 and 304 have no body (RFC 9110, 15)
    if type(status) is not int or not 200 <= status <= 599 or status in (204, 205, 304):
        raise DecodeError("status: expected that of a response with a body")
    return Response(status, _path(frame), _dump(frame.get("body")))


def request_frame(method: str, path: str, body: bytes) -> bytes:
    """The frame of a received request; `DecodeError` if its body is not a JSON object."""
    return _dump({"method": method, "path": path, "body": parse_json_object(body, MAX_DEPTH - 1)})


def response_frame(status: int, path: str, body: bytes) -> bytes:
    """The frame of a received response; `DecodeError` if its body is not a JSON object."""
    return _dump({"status": status, "path": path, "body": parse_json_object(body, MAX_DEPTH - 1)})


def error_body(message: str) -> bytes:
    """The body of a response that the transport itself gives (F3548 ErrorResponse, as the agents' own)."""
    return _dump({"message": message})


def quoted(path: str) -> str:
    """A path as written in a request line or header; `DecodeError` if HTTP could not carry it unchanged."""
    try:
        raw = URL.build(path=path).raw_path
        if path.startswith("/") and unquoted(raw) == path:
            return raw
    except ValueError:
        pass
    raise DecodeError("path: expected an absolute one, without '.' and '..'")


def unquoted(raw: str) -> str:
    """The path that `quoted` was given. `ValueError` if it is no path."""
    return URL(raw, encoded=True).path


def _members(payload: bytes, max_bytes: int) -> dict[str, Any]:
    if len(payload) > max_bytes:
        raise DecodeError(f"{len(payload)} bytes, at most {max_bytes} are carried")
    return parse_json_object(payload)


def _path(frame: dict[str, Any]) -> str:
    path = frame.get("path")
    if not isinstance(path, str):
        raise DecodeError("path: expected text")
    quoted(path)
    return path


def _dump(value: object) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
