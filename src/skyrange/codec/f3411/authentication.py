"""Authentication pages: data longer than one message, joined from its pages.

Page 0 holds 17 bytes and the numbers of pages and bytes; pages 1…15 hold 23 bytes each (F3411-22a, Authentication
message). The length has 8 bits, so the data have at most 255 bytes.
"""

from __future__ import annotations

from collections.abc import Iterable

from skyrange.codec.f3411.messages import Authentication
from skyrange.core.errors import DecodeError

MAX_PAGES = 16


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
