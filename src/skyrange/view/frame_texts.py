"""Texts of frames: the name of the message in a payload, and its fields."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from skyrange.codec.f3411.decode import decode as decode_broadcast
from skyrange.codec.mavlink import decode, message_fields, message_name
from skyrange.codec.remote_id.link_payload import unpack
from skyrange.core.errors import DecodeError

MAX_TEXT: Final = 600
"""Characters of a frame's fields."""


def describe_payload(payload: bytes) -> tuple[str, str]:
    """The name of the message, and its fields as a text of at most `MAX_TEXT` characters.

    MAVLink, Remote ID broadcasts and JSON are known; of other bytes, the name is their number, and the text the first.
    """
    for read in _READERS:
        try:
            name, text = read(payload)
        except DecodeError:
            continue
        return name, text if len(text) <= MAX_TEXT else f"{text[: MAX_TEXT - 1]}…"
    return f"{len(payload)} bytes", payload[:32].hex(" ")


def _read_mavlink(payload: bytes) -> tuple[str, str]:
    message = decode(payload)
    fields = message_fields(message).items()
    return message_name(payload) or "", ", ".join(f"{name} {_shorten(value)}" for name, value in fields)


def _read_broadcast(payload: bytes) -> tuple[str, str]:
    body = decode_broadcast(unpack(payload).body)
    messages: Any = getattr(body, "messages", (body,))
    texts = []
    for message in messages:
        fields = (f"{name} {_shorten(value)}" for name, value in message._asdict().items() if value is not None)
        texts.append(f"{type(message).__name__}: {', '.join(fields)}")
    return "Remote ID", "; ".join(texts)


def _read_json(payload: bytes) -> tuple[str, str]:
    if payload[:1] not in (b"{", b"[") or not payload.isascii():
        raise DecodeError("no JSON")
    return "JSON", payload[: 2 * MAX_TEXT].decode()


_READERS: Final[tuple[Callable[[bytes], tuple[str, str]], ...]] = (_read_mavlink, _read_broadcast, _read_json)


def _shorten(value: object) -> str:
    if isinstance(value, bytes):
        return value.rstrip(b"\0").decode("ascii", "replace") if value.isascii() else value.hex()
    return f"{value:.7g}" if isinstance(value, float) else str(value)
