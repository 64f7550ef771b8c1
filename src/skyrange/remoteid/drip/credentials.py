"""Credentials of an aircraft that authenticates its broadcasts."""

from __future__ import annotations

from typing import NamedTuple

from skyrange.remoteid.drip.registry import Registration
from skyrange.remoteid.drip.schedule import REQUIRED, Rates


class Credentials(NamedTuple):
    """What an aircraft signs with, and how often."""

    registration: Registration
    rates: Rates = REQUIRED
    seed: int = 0
    """Of the number in its first Manifest."""
    repeats: int = 1
    """How often a message is sent over Bluetooth 4, all of its pages in a row, under one counter."""
