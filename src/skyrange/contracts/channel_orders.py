"""Orders by which an end of a Wi-Fi control link changes the channel of its radio."""

from __future__ import annotations

from typing import Literal, NamedTuple

from skyrange.core.time import Time

End = Literal["station", "aircraft"]
"""The end of the access point, or that of the aircraft."""


class ChannelOrder(NamedTuple):
    """An order of one end to its radio."""

    link: str
    end: End
    channel: int
    announcements: int = 0
    """Of an access point: in how many beacons it announces the change before it changes; 0: at once and silently."""
    retune_ns: Time = 0
    """How long the radio neither sends nor receives while it changes."""
    action: str = "channel"
    """Name of the act in the record."""
