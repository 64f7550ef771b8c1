"""Bodies of HTTP messages, read to a limit."""

from __future__ import annotations

import aiohttp


async def read_bounded(content: aiohttp.StreamReader, announced: int | None, limit: int) -> bytes | None:
    """A complete body, or `None` if it is longer than `limit` bytes; not much more than that is read."""
    if announced is not None and announced > limit:
        return None
    body = bytearray()
    async for chunk in content.iter_any():
        body += chunk
        if len(body) > limit:
            return None
    return bytes(body)
