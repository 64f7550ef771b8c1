"""The 4-D volume that a plan claims: Volume4D of ASTM F3548-21.

Heights are above the WGS 84 ellipsoid, as F3548 (Altitude, reference W84, units M) asks.
"""

from __future__ import annotations

from dataclasses import dataclass

from skyrange.core.time import Time


@dataclass(frozen=True, slots=True)
class Volume4D:
    """A prism with a time window.

    `outline` is a closed ring without the repeated last vertex, (latitude, longitude) in degrees, at
    least three vertices; `lower_m` and `upper_m` are ellipsoid heights in metres; `start_ns` and
    `end_ns` are simulated times.
    """

    outline: tuple[tuple[float, float], ...]
    lower_m: float
    upper_m: float
    start_ns: Time
    end_ns: Time

    def __post_init__(self) -> None:
        if len(self.outline) < 3:
            raise ValueError(f"a volume's outline needs 3 vertices, got {len(self.outline)}")
        if not self.lower_m < self.upper_m:
            raise ValueError(f"a volume's lower_m must be below upper_m, got {self.lower_m} and {self.upper_m}")
        if not self.start_ns < self.end_ns:
            raise ValueError(f"a volume must start before it ends, got {self.start_ns} and {self.end_ns}")
