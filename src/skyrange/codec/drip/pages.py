"""Pages of DRIP's authentication data, with the parity page that replaces one lost page (RFC 9575, section 5).

A page is an Authentication message of F3411: page 0 has 17 bytes of data behind 6 of header, the others 23. Over
Bluetooth 4 every page is a broadcast of its own, and a last page holds the XOR of the 23 bytes of all others. It stands
in the message's additional data: one byte with their length, zeros up to the end of the page, then the parity.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from typing import Final

from skyrange.codec.f3411 import Authentication, AuthType
from skyrange.codec.f3411.encode import PAGE_0_DATA, PAGE_DATA
from skyrange.core.errors import DecodeError

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
