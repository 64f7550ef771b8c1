"""What an attack alters as the only one: attacks that alter the same at the same time exclude each other.

What adds up is not exclusive: losses, delays, noise, errors of sensors, and more frames on a link. A statement that
replaces another is: of two, one would be without effect, and which one would be an accident of their order.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from skyrange.core.elementary_python import distance


@dataclass(frozen=True, slots=True)
class Exclusive:
    """Something that an attack alters, and no other attack may alter at the same time."""

    what: str
    """Such as "GNSS fixes of blue/b1". The same text means the same thing."""
    parts: frozenset[str] = frozenset()
    """Which parts of it are altered, such as names of MAVLink messages; empty for all."""
    area: tuple[tuple[float, float, float], float] | None = None
    """Outside of this ball nothing is altered: centre in metres from the origin, radius in metres; `None`: everywhere.
    """

    def common(self, other: Exclusive) -> str:
        """What both alter, in words; "" if there is nothing."""
        if self.what != other.what:
            return ""
        if self.area is not None and other.area is not None:
            (here, radius_m), (there, other_m) = self.area, other.area
            if distance(here, there) >= radius_m + other_m:
                return ""
        if not self.parts or not other.parts:
            parts = self.parts or other.parts
        else:
            parts = self.parts & other.parts
            if not parts:
                return ""
        return f"{', '.join(sorted(parts))} in {self.what}" if parts else self.what


def common(first: Iterable[Exclusive], second: Iterable[Exclusive]) -> str:
    """The first thing that both of two attacks alter, in words; "" if there is nothing."""
    others: dict[str, list[Exclusive]] = {}
    for exclusive in second:
        others.setdefault(exclusive.what, []).append(exclusive)
    return next((text for entry in first for other in others.get(entry.what, ()) if (text := entry.common(other))), "")
