"""Authentication pages: data longer than one message, split into pages and joined again.

Page 0 holds 17 bytes and the numbers of pages and bytes; pages 1…15 hold 23 bytes each (F3411-22a, Authentication
message). The length has 8 bits, so the data have at most 255 bytes.
"""

from __future__ import annotations

from collections.abc import Iterable

from skyrange.codec.f3411.encode import PAGE_0_DATA, PAGE_DATA
from skyrange.codec.f3411.messages import Authentication
from skyrange.core.errors import DecodeError

MAX_DATA = 255
MAX_PAGES = 16


def split_pages(auth_type: int, data: bytes, timestamp_s: int) -> tuple[Authentication, ...]:
    """The messages that carry `data` (0…255 bytes, else `ValueError`); `timestamp_s` since `EPOCH_2019_S`."""
    if len(data) > MAX_DATA:
        raise ValueError(f"{len(data)} bytes of authentication data, at most {MAX_DATA}")
    rest = range(PAGE_0_DATA, len(data), PAGE_DATA)
    first = Authentication(
        auth_type, 0, data[:PAGE_0_DATA].ljust(PAGE_0_DATA, b"\0"), len(rest), len(data), timestamp_s
    )
    return first, *(
        Authentication(auth_type, page, data[at : at + PAGE_DATA].ljust(PAGE_DATA, b"\0"))
        for page, at in enumerate(rest, start=1)
    )


def join_pages(messages: Iterable[Authentication]) -> bytes:
    """The data of all pages, given in any order and possibly repeated; of two versions of a page the last one counts.

    Raises `DecodeError` if a page is missing or if the pages cannot hold the length they announce.
    """
    held = {message.page: message for message in messages}
    first = held.get(0)
    if first is None:
        raise DecodeError("page 0 is missing")
    last, length = first.last_page or 0, first.length or 0
    if last >= MAX_PAGES:
        raise DecodeError(f"last page {last}, at most {MAX_PAGES - 1}")
    missing = [page for page in range(last + 1) if page not in held]
    if missing:
        raise DecodeError(f"pages {missing} of 0…{last} are missing")
    data = b"".join(held[page].data for page in range(last + 1))
    if length > len(data):
        raise DecodeError(f"{length} bytes announced on {last + 1} pages, which hold {len(data)}")
    return data[:length]
