"""Is JSON of peers read by one strict reader, whatever comes?"""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import jwt
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st

import skyrange
from skyrange.codec.f3548 import frames as f3548_frames
from skyrange.codec.strict_json import MAX_DEPTH, parse_json, parse_json_object
from skyrange.core.errors import DecodeError
from skyrange.core.time import Epoch
from skyrange.io.http import frames as http_frames
from skyrange.radio import ground_receptions
from skyrange.runtime.live.transport.control import unpack_message
from skyrange.runtime.utm.federation import parse_body
from skyrange.utm import messages
from skyrange.utm.contract import intent_id
from skyrange.utm.federated.tokens import PublicKey, TokenChecker, TokenError
from skyrange.utm.hashgraph import messages as gossip
from skyrange.view.control_server import parse_command
from tests.hostile_json import HOSTILE, in_object

ROOT: Final = Path(skyrange.__file__).parent
HEARS_PEERS: Final = (
    "codec/f3548",
    "io",
    "utm",
    "runtime/utm",
    "runtime/live/transport",
    "runtime/live/supervisor",
    "view/control_server.py",
    "view/server.py",
)
"""Modules that read what strangers send."""
OWN: Final = ("runtime/utm/database/journal.py",)
"""Those of them that read back what they have written themselves."""

JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**40), 10**40)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)
READERS: Final[dict[str, Callable[[bytes], Any]]] = {
    "text": parse_json,
    "object": parse_json_object,
    "body of a UTM service": parse_body,
    "frame of F3548": f3548_frames.decode,
    "request on HTTP": lambda data: messages.decode_request_body("PUT", messages.PATH + intent_id("a"), data),
    "approval request": messages.decode_request,
    "approval response": messages.decode_response,
    "gossip": gossip.decode,
    "request frame": http_frames.read_request,
    "response frame": http_frames.read_response,
    "received request": lambda data: http_frames.request_frame("PUT", "/a", data),
    "received response": lambda data: http_frames.response_frame(200, "/a", data),
    "receptions": ground_receptions.decode,
    "control message": unpack_message,
    "command of a viewer": parse_command,
}


@given(value=JSON)
def test_what_others_write_is_read_as_it_is(value: Any) -> None:
    assert parse_json(json.dumps(value)) == value
    assert parse_json(json.dumps(value, ensure_ascii=False).encode()) == value


def test_as_deep_as_the_limit_and_no_deeper() -> None:
    parse_json(b"[" * MAX_DEPTH + b"]" * MAX_DEPTH)
    with pytest.raises(DecodeError, match="nested more than"):
        parse_json(b"[" * (MAX_DEPTH + 1) + b"]" * (MAX_DEPTH + 1))


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_what_not_every_reader_takes_is_refused(text: bytes) -> None:
    for data in (text, in_object(text), b"[[" + text + b"]]"):
        with pytest.raises(DecodeError):
            parse_json(data)


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_every_reader_of_peers_refuses_hostile_texts_with_its_one_error(read: Callable[[bytes], Any]) -> None:
    for name, text in HOSTILE.items():
        for data in (text, in_object(text), in_object(text, kind=b'"x"', body=text, method=b'"PUT"', path=b'"/a"')):
            with contextlib.suppress(DecodeError):
                assert read(data) is None, name


def test_what_a_body_has_fits_into_its_frame() -> None:
    """A body that is taken is not refused later, where nobody could answer its request."""
    for depth in range(1, MAX_DEPTH + 8):
        content = b'{"a":' * depth + b"1" + b"}" * depth
        try:
            body = parse_body(content)
        except DecodeError:
            continue
        frame = f3548_frames.UssRequest(exchange=1, method="PUT", path="/", body=body)
        assert f3548_frames.decode(f3548_frames.encode(frame)) == frame


def test_claims_of_a_token_are_read_alike() -> None:
    key = Ed25519PrivateKey.generate()
    checker = TokenChecker(frozenset({"dss"}), (PublicKey("EdDSA", key.public_key().public_bytes_raw()),), Epoch(0))
    for text in HOSTILE.values():
        token = jwt.PyJWS().encode(in_object(text, exp=b"9e9", aud=b'"dss"'), key, "EdDSA")
        with pytest.raises(TokenError):
            checker.check(0, token)


def test_no_module_that_hears_peers_reads_json_another_way() -> None:
    found = []
    for place in HEARS_PEERS:
        paths = [ROOT / place] if place.endswith(".py") else sorted((ROOT / place).rglob("*.py"))
        assert paths, place
        for path in paths:
            words = re.findall(r"\bjson\.loads?\(|\bfrom_json\(|\.json\(", path.read_text())
            if words and path.relative_to(ROOT).as_posix() not in OWN:
                found.append((str(path), words))
    assert not found
