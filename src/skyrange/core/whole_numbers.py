"""Whole numbers in text that users or peers wrote."""

from __future__ import annotations

_MAX_DIGITS = 18
"""Digits that always fit into 64 bits; Python refuses texts of more than 4,300."""


def parse_whole(text: str) -> int | None:
    """The number that the ASCII digits of `text` write; `None` for any other text, and for more than 18 digits.

    Unlike `str.isdigit`, which accepts superscripts that `int` cannot read.
    """
    return int(text) if text.isascii() and text.isdigit() and len(text) <= _MAX_DIGITS else None
