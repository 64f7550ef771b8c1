"""What is the air like? How far to look, whether chance plays, and the city's own load of the band."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Parameters of the builtin medium that belong to a place and not to a radio."""

    horizon_m: float = 1_000.0
    """Beyond it nobody hears anybody; what the air costs grows with its square. Open Drone ID has 200 to 400 m for
    Wi-Fi and legacy Bluetooth and four times that for Long Range (opendroneid.org)."""
    chance: bool = True
    """Shadowing and fading; without, signals are their medians."""
    city_busy: float = 0.0
    """Share of time, 0…1, in which frames of the city's own fill the Wi-Fi channels 1, 6 and 11."""
    city_dbm: float = -85.0
    """How strong they are at any antenna, on average over an exponential spread."""


OPEN_AIR: Final = Surroundings()
QUIET_CITY: Final = Surroundings(city_busy=0.2)
"""Most access points see 2.4 GHz utilisation of 20 % or more (Biswas et al., "Large-scale Measurements of Wireless
Network Behavior", SIGCOMM 2015: ten thousand access points); how strong it is in the air is an assumption."""
LOUD_CITY: Final = Surroundings(city_busy=0.5, city_dbm=-80.0)
"""The top tenth of them sees more than 50 %."""
