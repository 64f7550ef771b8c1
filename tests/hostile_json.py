"""Texts that some JSON readers take and others do not, or that stop them."""

from __future__ import annotations

from typing import Final

HOSTILE: Final[dict[str, bytes]] = {
    "NaN": b"NaN",
    "Infinity": b"Infinity",
    "-Infinity": b"-Infinity",
    "beyond double precision": b"1e999",
    "below double precision": b"-1e999",
    "thousands of digits": b"1" * 5_000,
    "a lone surrogate": b'"\\ud800"',
    "a lone low surrogate": b'"\\udc00"',
    "surrogates in the wrong order": b'"\\udc00\\ud800"',
    "a lone surrogate in UTF-8": b'"\xed\xa0\x80"',
    "a name with a lone surrogate": b'{"\\ud800": 1}',
    "Latin-1": b'"\xe9"',
    "UTF-16": '"text"'.encode("utf-16"),
    "a byte order mark": b"\xef\xbb\xbf1",
    "a control character": b'"\x01"',
    "nested arrays": b"[" * 100_000 + b"]" * 100_000,
    "nested objects": b'{"a":' * 100_000 + b"1" + b"}" * 100_000,
    "nested a little too deep": b"[" * 150 + b"]" * 150,
    "nested as deep as some parsers take": b"[" * 199 + b"]" * 199,
    "not closed": b"[1",
    "a comma too many": b"[1,]",
    "a leading zero": b"01",
    "two values": b"1 2",
    "single quotes": b"'a'",
    "a comment": b"1 // one",
}


def in_object(text: bytes, **more: bytes) -> bytes:
    """An object with the text as its member `hostile`, beside others."""
    members = [b'"hostile":' + text, *(b'"%s":%s' % (name.encode(), value) for name, value in more.items())]
    return b"{" + b",".join(members) + b"}"
