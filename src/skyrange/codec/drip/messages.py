"""DRIP messages (RFC 9575): authentication data of type 5, specific method, and the pages that carry them.

The first byte is the SAM type, the rest one of two structures. A Link (section 4.2) is an endorsement of a key by the
authority above it: 136 bytes. The other three (sections 4.3 to 4.5) share the evidence structure of section 4.1:
times, up to 112 bytes of evidence, entity tag and signature of the aircraft. Times are little-endian, as all of F3411,
and count seconds since 2019-01-01T00:00:00Z (section 3.2.4.3); tags, keys, hashes and signatures are byte strings.

A page (section 5) is an Authentication message of F3411: page 0 has 17 bytes of data behind 6 of header, the others 23.
Over Bluetooth 4 every page is a broadcast of its own, and a last page holds the XOR of the 23 bytes of all others,
which replaces one lost page. It stands in the message's additional data: one byte with their length, zeros up to the
end of the page, then the parity.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from itertools import pairwise
from typing import Final, NamedTuple, TypeAlias

from skyrange.codec.drip.entity_tags import HASH_BYTES, KEY_BYTES, TAG_BYTES, message_hash
from skyrange.codec.f3411 import EPOCH_2019_S, SIZE, Authentication, AuthType, MessageType
from skyrange.codec.f3411.encode import PAGE_0_DATA, PAGE_DATA
from skyrange.core.errors import DecodeError

SIGNATURE_BYTES: Final = 64
MAX_EVIDENCE: Final = 112
MAX_WRAPPED: Final = 4
"""Messages in a Wrapper (section 4.3)."""
MAX_HASHES: Final = 11
"""Messages in a Manifest (section 4.4)."""
RECOMMENDED_HASHES: Final = 10
"""Eleven would need a page more for the parity (section 4.4, appendix B.1.1.2)."""
EXPERIMENTAL_FRAMES: Final = range(0xF0, 0x100)
"""Frame types for experiments; there are no others yet (section 8.1)."""
WRAPPABLE: Final = frozenset(
    (
        MessageType.BASIC_ID, MessageType.LOCATION, MessageType.SELF_ID, MessageType.SYSTEM, MessageType.OPERATOR_ID,
    )
)  # fmt: skip
"""Types of messages that a Wrapper may hold (section 4.3)."""
_TIMES: Final = struct.Struct("<II")
_LINK_SIGNED: Final = _TIMES.size + TAG_BYTES + KEY_BYTES + TAG_BYTES
LINK_BYTES: Final = 1 + _LINK_SIGNED + SIGNATURE_BYTES
"""137, with the SAM type."""
EVIDENCE_BYTES: Final = 1 + _TIMES.size + TAG_BYTES + SIGNATURE_BYTES
"""89, with the SAM type and without evidence."""
_MAX_TIME: Final = 2**32 - 1


class SamType(IntEnum):
    """The structure after the first byte (section 3.2.3.1)."""

    LINK = 1
    WRAPPER = 2
    MANIFEST = 3
    FRAME = 4


class UnsupportedMethodError(DecodeError):
    """The data are of a SAM type that is not DRIP's."""


class Link(NamedTuple):
    """A Broadcast Endorsement: `parent` says that `child` is registered and that `child_key` is its key."""

    vnb_s: int
    """Valid not before."""
    vna_s: int
    """Valid not after."""
    child: bytes
    child_key: bytes
    parent: bytes
    signature: bytes = bytes(SIGNATURE_BYTES)

    @property
    def signed(self) -> bytes:
        """The bytes that the parent signs."""
        return _times(self.vnb_s, self.vna_s) + self.child + self.child_key + self.parent


class Evidence(NamedTuple):
    """A Wrapper, Manifest or Frame: something that the aircraft `tag` signed at `vnb_s`."""

    sam_type: int
    vnb_s: int
    vna_s: int
    evidence: bytes
    """0…112 bytes. A Wrapper without any signs the other messages of its pack."""
    tag: bytes
    signature: bytes = bytes(SIGNATURE_BYTES)

    def signed(self, collocated: bytes = b"") -> bytes:
        """The bytes that the aircraft signs; `collocated`: the messages beside a Wrapper in a pack (section 4.3.2)."""
        return _times(self.vnb_s, self.vna_s) + (self.evidence or collocated) + self.tag

    @property
    def signs_pack(self) -> bool:
        """Whether this is a Wrapper for extended transports, which signs what is beside it."""
        return self.sam_type == SamType.WRAPPER and not self.evidence


SamMessage: TypeAlias = Link | Evidence


class Manifest(NamedTuple):
    """The evidence of a Manifest: hashes of 8 bytes."""

    previous: bytes
    """Hash of the Manifest before this one; of the first, a random number."""
    current: bytes
    """Hash of this Manifest, computed with zeros in its place."""
    link: bytes
    """Hash of the Link in which the HDA endorses the aircraft."""
    messages: tuple[bytes, ...]
    """Of messages sent before, in the order of sending."""

    @property
    def own_hash(self) -> bytes:
        """What `current` has to be. RFC 9575, section 4.4.3, does not name the Link's hash among the input; its example
        (appendix B.2.1) includes it.
        """
        return message_hash(b"".join((self.previous, bytes(HASH_BYTES), self.link, *self.messages)))


def since_2019_s(unix_ns: int) -> float:
    """A moment of UTC in the seconds of F3411 and DRIP."""
    return unix_ns / 1e9 - EPOCH_2019_S


def link_hash(link: Link) -> bytes:
    """The hash of a Link in Manifests: of its 136 bytes after the SAM type.

    So it is in the example of RFC 9575 (appendix B.2.1). The text (sections 4.4 and 4.4.3.1) says: of its pages, which
    would change with the pages' time and parity, and so differ from one transport to the other.
    """
    return message_hash(encode_sam(link)[1:])


def encode_sam(message: SamMessage) -> bytes:
    """The authentication data; raises `ValueError` naming a part of a wrong size."""
    if isinstance(message, Link):
        _sized("child", message.child, TAG_BYTES)
        _sized("child_key", message.child_key, KEY_BYTES)
        _sized("parent", message.parent, TAG_BYTES)
        _sized("signature", message.signature, SIGNATURE_BYTES)
        return bytes([SamType.LINK]) + message.signed + message.signature
    _sized("tag", message.tag, TAG_BYTES)
    _sized("signature", message.signature, SIGNATURE_BYTES)
    if len(message.evidence) > MAX_EVIDENCE:
        raise ValueError(f"{len(message.evidence)} bytes of evidence, at most {MAX_EVIDENCE}")
    return bytes([message.sam_type]) + message.signed() + message.signature


def decode_sam(data: bytes) -> SamMessage:
    """The message in authentication data.

    Raises `UnsupportedMethodError` for another SAM type, and `DecodeError` for a structure that cannot be: the checks
    of sections 4.3.1 and 4.4.1 among them. No signature is checked.
    """
    if not data:
        raise DecodeError("no authentication data")
    if data[0] == SamType.LINK:
        if len(data) != LINK_BYTES:
            raise DecodeError(f"{len(data)} bytes, a Link has {LINK_BYTES}")
        vnb_s, vna_s = _TIMES.unpack_from(data, 1)
        at = 1 + _TIMES.size
        child, at = data[at : at + TAG_BYTES], at + TAG_BYTES
        key, at = data[at : at + KEY_BYTES], at + KEY_BYTES
        return Link(vnb_s, vna_s, child, key, data[at : at + TAG_BYTES], data[at + TAG_BYTES :])
    if data[0] not in (SamType.WRAPPER, SamType.MANIFEST, SamType.FRAME):
        raise UnsupportedMethodError(f"SAM type {data[0]} is not one of DRIP")
    if not EVIDENCE_BYTES <= len(data) <= EVIDENCE_BYTES + MAX_EVIDENCE:
        raise DecodeError(f"{len(data)} bytes, expected {EVIDENCE_BYTES}…{EVIDENCE_BYTES + MAX_EVIDENCE}")
    vnb_s, vna_s = _TIMES.unpack_from(data, 1)
    tag_at = len(data) - SIGNATURE_BYTES - TAG_BYTES
    evidence = data[1 + _TIMES.size : tag_at]
    message = Evidence(data[0], vnb_s, vna_s, evidence, data[tag_at : tag_at + TAG_BYTES], data[tag_at + TAG_BYTES :])
    if message.sam_type == SamType.WRAPPER:
        decode_wrapped(evidence)
    elif message.sam_type == SamType.MANIFEST:
        decode_manifest(evidence)
    elif not evidence:
        raise DecodeError("a Frame without its type")
    return message


def encode_wrapped(bodies: Sequence[bytes]) -> bytes:
    """The evidence of a Wrapper: up to four messages, put in the order of their types."""
    ordered: list[bytes] = sorted(bodies, key=_type_of)
    evidence = b"".join(ordered)
    try:
        decode_wrapped(evidence)
    except DecodeError as error:
        raise ValueError(str(error)) from None
    return evidence


def decode_wrapped(evidence: bytes) -> tuple[bytes, ...]:
    """The messages in a Wrapper, none for extended transports; raises `DecodeError` (sections 4.3 and 4.3.1)."""
    count, rest = divmod(len(evidence), SIZE)
    if rest or count > MAX_WRAPPED:
        raise DecodeError(f"{len(evidence)} bytes of evidence, a Wrapper has 0…{MAX_WRAPPED} messages of {SIZE}")
    bodies = tuple(evidence[at : at + SIZE] for at in range(0, len(evidence), SIZE))
    types = [body[0] >> 4 for body in bodies]
    if not WRAPPABLE.issuperset(types):
        raise DecodeError(f"messages of types {types}, a Wrapper holds {sorted(map(int, WRAPPABLE))}")
    if any(first > second for first, second in pairwise(types)):
        raise DecodeError(f"messages of types {types}, not in the order of types")
    return bodies


def encode_manifest(previous: bytes, link: bytes, messages: Sequence[bytes]) -> Manifest:
    """A Manifest with its own hash filled in; raises `ValueError` for more than eleven hashes or a wrong size."""
    if len(messages) > MAX_HASHES:
        raise ValueError(f"{len(messages)} hashes in a Manifest, at most {MAX_HASHES}")
    for hash_ in (previous, link, *messages):
        _sized("hash", hash_, HASH_BYTES)
    draft = Manifest(previous, bytes(HASH_BYTES), link, tuple(messages))
    return draft._replace(current=draft.own_hash)


def decode_manifest(evidence: bytes) -> Manifest:
    """The hashes in a Manifest; raises `DecodeError` (section 4.4.1). Whether they are right, the caller checks."""
    count, rest = divmod(len(evidence), HASH_BYTES)
    if rest or not 3 <= count <= 3 + MAX_HASHES:
        raise DecodeError(
            f"{len(evidence)} bytes of evidence, a Manifest has 3…{3 + MAX_HASHES} hashes of {HASH_BYTES}"
        )
    previous, current, link, *messages = (evidence[at : at + HASH_BYTES] for at in range(0, len(evidence), HASH_BYTES))
    return Manifest(previous, current, link, tuple(messages))


def manifest_evidence(manifest: Manifest) -> bytes:
    """The bytes of a Manifest's hashes."""
    return b"".join((manifest.previous, manifest.current, manifest.link, *manifest.messages))


def _type_of(body: bytes) -> int:
    return body[0] >> 4


def _times(vnb_s: int, vna_s: int) -> bytes:
    if not (0 <= vnb_s <= _MAX_TIME and 0 <= vna_s <= _MAX_TIME):
        raise ValueError(f"times {vnb_s} and {vna_s} s since 2019, both must be in 0…{_MAX_TIME}")
    return _TIMES.pack(vnb_s, vna_s)


def _sized(what: str, part: bytes, size: int) -> None:
    if len(part) != size:
        raise ValueError(f"{what}: {len(part)} bytes, expected {size}")


MAX_AUTH_DATA: Final = 201
"""DRIP's data fit into nine pages, all that a pack can hold (section 3.2.4.2)."""
MAX_PAGES: Final = 16
_HEAD: Final = struct.Struct("<BBI")
"""Last page, length and time on page 0."""


def page_count(length: int, *, parity: bool) -> int:
    """Pages for `length` bytes of data."""
    plain = 1 + max(0, -(-(length - PAGE_0_DATA) // PAGE_DATA))
    return _additional_page(length) + 2 if parity else plain


def split_with_parity(
    data: bytes, timestamp_s: int, *, parity: bool, auth_type: int = AuthType.SPECIFIC_METHOD
) -> tuple[Authentication, ...]:
    """The pages of `data` (1…201 bytes, else `ValueError`); `parity` for Bluetooth 4, never for packs (section 6.2)."""
    if not 1 <= len(data) <= MAX_AUTH_DATA:
        raise ValueError(f"{len(data)} bytes of authentication data, DRIP has 1…{MAX_AUTH_DATA}")
    count = page_count(len(data), parity=parity)
    stream = data
    if parity:
        padding = PAGE_0_DATA + PAGE_DATA * (count - 2) - len(data) - 1
        stream += bytes([padding + PAGE_DATA])
    stream = stream.ljust(PAGE_0_DATA + PAGE_DATA * (count - 1), b"\0")
    pages = [
        Authentication(auth_type, 0, stream[:PAGE_0_DATA], count - 1, len(data), timestamp_s),
        *(
            Authentication(auth_type, page, stream[PAGE_0_DATA + PAGE_DATA * (page - 1) :][:PAGE_DATA])
            for page in range(1, count)
        ),
    ]
    if parity:
        pages[-1] = pages[-1]._replace(data=_xor(_payload(page) for page in pages[:-1]))
    return tuple(pages)


def join_with_parity(held: Mapping[int, Authentication]) -> tuple[bytes, int | None]:
    """The data of the pages of one message by their number, and which page the parity replaced, if any.

    Raises `DecodeError` while pages are missing that the parity does not replace, and if the lengths contradict each
    other or a replaced page 0 is not credible (section 5.2).
    """
    first = held.get(0)
    replaced: int | None = None
    if first is None:
        first, held = _restored_first(held), dict(held)
        held[0], replaced = first, 0
    length, last = first.length or 0, first.last_page or 0
    if last >= MAX_PAGES or length > MAX_AUTH_DATA:
        raise DecodeError(f"last page {last} and {length} bytes, DRIP has at most {MAX_PAGES - 1} and {MAX_AUTH_DATA}")
    needed = page_count(length, parity=False)
    if last + 1 < needed:
        raise DecodeError(f"{length} bytes announced on {last + 1} pages, which cannot hold them")
    missing = [page for page in range(needed) if page not in held]
    if missing:
        everything = [page for page in range(last + 1) if page in held]
        if last + 1 != page_count(length, parity=True) or len(everything) != last:
            raise DecodeError(f"pages {missing} of 0…{last} are missing")
        held, replaced = dict(held), missing[0]
        restored = _xor(_payload(held[page]) for page in everything)
        held[replaced] = Authentication(first.auth_type, replaced, restored, version=first.version)
    data = b"".join(held[page].data for page in range(needed))
    return data[:length], replaced


def _additional_page(length: int) -> int:
    """The page on which the byte after the data stands."""
    return 0 if length < PAGE_0_DATA else 1 + (length - PAGE_0_DATA) // PAGE_DATA


def _payload(page: Authentication) -> bytes:
    """The 23 bytes after a page's header."""
    if page.page:
        return page.data
    return _HEAD.pack(page.last_page or 0, page.length or 0, page.timestamp_s or 0) + page.data


def _xor(payloads: Iterable[bytes]) -> bytes:
    total = 0
    for payload in payloads:
        total ^= int.from_bytes(payload, "big")
    return total.to_bytes(PAGE_DATA, "big")


def _restored_first(held: Mapping[int, Authentication]) -> Authentication:
    """Page 0 from all the others, if those held are all the others."""
    last = max(held, default=0)
    if last < 1 or len(held) != last:
        raise DecodeError("page 0 is missing")
    payload = _xor(_payload(page) for page in held.values())
    announced, length, timestamp_s = _HEAD.unpack_from(payload)
    additional = _additional_page(length)
    if announced != last or length > MAX_AUTH_DATA or last != additional + 1:
        raise DecodeError("page 0 is missing, and the parity does not replace it")
    stream = payload[_HEAD.size :] if additional == 0 else held[additional].data
    at = length - (PAGE_0_DATA + PAGE_DATA * (additional - 1)) if additional else length
    if stream[at] != len(stream) - at - 1 + PAGE_DATA or any(stream[at + 1 :]):
        raise DecodeError("page 0 is missing, and the additional data contradict the parity")
    page = next(iter(held.values()))
    return Authentication(page.auth_type, 0, payload[_HEAD.size :], announced, length, timestamp_s, page.version)
