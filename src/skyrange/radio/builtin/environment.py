"""Radio environment: range limit, randomness, and background traffic of the band."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class RadioEnvironment:
    """Parameters of the builtin medium that belong to a place and not to a radio."""

    horizon_m: float = 1_000.0
    """Nothing is received beyond this distance; the cost of simulation grows with its square. Open Drone ID gives 200
    to 400 m for Wi-Fi and legacy Bluetooth and four times that for Long Range (opendroneid.org)."""
    chance: bool = True
    """Whether there is shadowing and fading; without them, signals have their median power."""
    city_busy: float = 0.0
    """Share of time, 0…1, in which background traffic fills the Wi-Fi channels 1, 6 and 11: in a city 0.2, which most
    access points see or exceed, and 0.5, which the busiest tenth exceeds (Biswas et al., "Large-scale Measurements of
    Wireless Network Behavior", SIGCOMM 2015: ten thousand access points)."""
    city_dbm: float = -85.0
    """Mean power of the background traffic at any antenna; it is exponentially distributed."""
    carrier_sense_dbm: float | None = None
    """The weakest Wi-Fi frame that senders defer to; None for every frame whose preamble their receivers detect, as in
    IEEE 802.11-2020 17.3.12. The standard permits -82 dBm at most (17.3.10.6)."""


OPEN_GROUND: Final = RadioEnvironment()
