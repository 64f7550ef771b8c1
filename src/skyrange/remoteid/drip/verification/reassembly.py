"""Reassembly of authentication pages that arrive one by one, some of them never, some of them forged."""

from __future__ import annotations

from typing import Final

from skyrange.codec.drip import join_with_parity
from skyrange.codec.f3411 import Authentication
from skyrange.core.errors import DecodeError

HOLD_S: Final = 30.0
"""Pages of a message that is not complete are dropped after this: the counter comes round after 256 messages, and a
message sent one page a second takes 11 s at most.
"""
MAX_OPEN: Final = 8
"""Messages of one sender that are held at once; the oldest makes room."""


class Reassembly:
    """The open messages of one sender, by their message counter (F3411; RFC 9575, section 5.2)."""

    __slots__ = ("_done", "_open", "conflicts", "dropped", "restored")

    def __init__(self) -> None:
        self._open: dict[int, tuple[float, dict[int, Authentication]]] = {}
        self._done: dict[int, tuple[float, Authentication]] = {}
        self.conflicts = 0
        """Pages that replaced a different page of the same number."""
        self.dropped = 0
        """Messages that were never complete."""
        self.restored = 0
        """Pages that the parity replaced."""

    @property
    def is_waiting(self) -> bool:
        """Whether a message has begun."""
        return bool(self._open)

    def add(self, counter: int, page: Authentication, now_s: float) -> bytes | None:
        """The data of a message that this page completes, each message once; `None` while pages are missing."""
        self._expire(now_s)
        done = self._done.get(counter)
        if done is not None and (page.page or page == done[1]):
            return None
        if done is not None:
            del self._done[counter]  # another message under a counter that came round
        begun = self._open.get(counter)
        if begun is None:
            if len(self._open) >= MAX_OPEN:
                del self._open[min(self._open, key=lambda key: self._open[key][0])]
                self.dropped += 1
            begun = self._open[counter] = (now_s, {})
        held = begun[1]
        if page.page in held and held[page.page] != page:
            self.conflicts += 1
        held[page.page] = page
        try:
            data, replaced = join_with_parity(held)
        except DecodeError:
            return None
        del self._open[counter]
        self.restored += replaced is not None
        self._done[counter] = (now_s, held.get(0, page))
        return data

    def _expire(self, now_s: float) -> None:
        for counter in [key for key, (begun_s, _) in self._open.items() if now_s - begun_s > HOLD_S]:
            del self._open[counter]
            self.dropped += 1
        for counter in [key for key, (done_s, _) in self._done.items() if now_s - done_s > HOLD_S]:
            del self._done[counter]
