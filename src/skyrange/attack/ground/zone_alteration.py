"""Alteration of the zones that a ground station uploads: each one is moved, or made smaller or larger."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final, Literal

from skyrange.attack.bases.mavlink.message_fields import move_place, put
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.geodesy import Origin

Form = Literal["scale", "move"]
_CIRCLES: Final = frozenset((mav.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, mav.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION))
_CORNERS: Final = frozenset((
    mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
))  # fmt: skip
_EXCLUSIONS: Final = frozenset((
    mav.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION, mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
))  # fmt: skip
_LEAST_RADIUS_M: Final = 0.1
"""An autopilot refuses a circle without a radius (AC_PolyFence_loader.cpp `validate_fence`)."""


@dataclass(slots=True)
class ZoneAlteration:
    """The alteration of the zones of one upload, item by item, in the order of their numbers."""

    form: Form
    factor: float
    offset_m: tuple[float, float]
    origin: Origin
    all_zones: bool
    """Whether zones that the aircraft has to stay in are altered too."""
    firsts: dict[int, tuple[int, float, float]] = field(default_factory=dict)
    """By the number of a corner: those of its polygon's first one, east and north in metres, and how many it has."""

    def alter_item(self, fields: Any, count: int) -> bool:
        """Write into an item of a fence; returns whether it is one that is altered."""
        command = int(fields["command"])
        if not fields["seq"]:
            self.firsts.clear()  # another upload begins
        if not (command in _EXCLUSIONS or (self.all_zones and command in _CIRCLES | _CORNERS)):
            return False
        if self.form == "move":
            move_place(fields, "x", "y", (*self.offset_m, 0.0), self.origin)
        elif command in _CIRCLES:
            put(fields, "param1", max(float(fields["param1"]) * self.factor, _LEAST_RADIUS_M))
        else:
            self._scale_corner(fields)
        return True

    def _scale_corner(self, fields: Any) -> None:
        """Move a corner towards the first one of its polygon, or away from it."""
        east_m, north_m = self.origin.enu_of(fields["x"] * 1e-7, fields["y"] * 1e-7)
        number, corners = int(fields["seq"]), int(fields["param1"])
        if number not in self.firsts:
            self.firsts |= dict.fromkeys(range(number, number + max(corners, 1)), (number, east_m, north_m))
        _, first_east_m, first_north_m = self.firsts[number]
        by_m = ((east_m - first_east_m) * (self.factor - 1.0), (north_m - first_north_m) * (self.factor - 1.0), 0.0)
        move_place(fields, "x", "y", by_m, self.origin)
