"""Result of reading a file of buildings: what was kept, what was dropped and why, and where heights are from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from skyrange.city.building_heights import BuildingHeight


@dataclass(slots=True)
class Reading:
    """What became of each feature of a file; the counts of `kept` and `dropped` add up to `features`."""

    format: str
    crs: str = "WGS 84 degrees"
    """The coordinate system of the file, before it was reprojected."""
    features: int = 0
    kept: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    """Features that became no building, by reason."""
    repaired: int = 0
    """Of those kept: shapes that crossed themselves and were made valid."""
    heights: Counter[str] = field(default_factory=Counter)
    """Heights that were measured, derived and defaulted."""
    height_keys: Counter[str] = field(default_factory=Counter)
    """The attributes that heights were read from."""
    unreadable_heights: int = 0
    """Of those kept: buildings with a height attribute that is no length."""
    notes: list[str] = field(default_factory=list)
    """Assumptions of the reader."""

    def count_height(self, height: BuildingHeight) -> None:
        """Count where the height of a kept building is from."""
        self.heights[height.source] += 1
        if height.key:
            self.height_keys[height.key] += 1
        self.unreadable_heights += height.unreadable

    def to_dict(self) -> dict[str, Any]:
        """The manifest's form."""
        return {
            "format": self.format,
            "crs": self.crs,
            "features": self.features,
            "kept": self.kept,
            "dropped": dict(sorted(self.dropped.items())),
            "repaired": self.repaired,
            "heights": {name: self.heights[name] for name in ("measured", "derived", "defaulted")},
            "height_keys": dict(sorted(self.height_keys.items())),
            "unreadable_heights": self.unreadable_heights,
            "notes": list(self.notes),
        }


def describe_reading(reading: Mapping[str, Any]) -> list[str]:
    """Sentences on a reading in the manifest's form (`Reading.to_dict`), for terminal and report."""
    dropped = reading.get("dropped") or {}
    heights = reading.get("heights") or {}
    keys = ", ".join(f"{name} {count:,}" for name, count in (reading.get("height_keys") or {}).items())
    lost = ", ".join(f"{count:,} {reason}" for reason, count in dropped.items())
    lines = [
        f"{reading.get('kept', 0):,} buildings of {reading.get('features', 0):,} features ({reading.get('format')}, "
        f"{reading.get('crs')}); {sum(dropped.values()):,} dropped" + (f": {lost}" if lost else ""),
        f"heights: {heights.get('measured', 0):,} measured, {heights.get('derived', 0):,} derived, "
        f"{heights.get('defaulted', 0):,} defaulted" + (f" (from {keys})" if keys else ""),
    ]
    if reading.get("unreadable_heights"):
        lines.append(f"{reading['unreadable_heights']:,} buildings have a height that cannot be read")
    if reading.get("repaired"):
        lines.append(f"{reading['repaired']:,} shapes were repaired")
    return [*lines, *map(str, reading.get("notes") or ())]
