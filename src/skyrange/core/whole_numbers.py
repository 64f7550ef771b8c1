"""Whole numbers: their reading from text that users or peers wrote, and the counts at which an event is noted."""

from __future__ import annotations

_MAX_DIGITS = 18
"""Digits that always fit into 64 bits; Python refuses texts of more than 4,300."""


def parse_whole(text: str) -> int | None:
    """The number that the ASCII digits of `text` write; `None` for any other text, and for more than 18 digits.

    Unlike `str.isdigit`, which accepts superscripts that `int` cannot read.
    """
    return int(text) if text.isascii() and text.isdigit() and len(text) <= _MAX_DIGITS else None


def worth_noting(count: int) -> bool:
    """Whether the `count`-th event of a kind is noted: the 1st, 2nd, 4th, 8th …, so that no flood fills the record."""
    return count & (count - 1) == 0


def has_one_worth_noting(before: int, count: int) -> bool:
    """Whether an event worth noting is among those after the `before`-th, up to the `count`-th."""
    return count.bit_length() > before.bit_length()
