"""Alteration of a flight plan: in the items of its mission, and in the volumes that it claims."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

from skyrange.attack.bases.mavlink.message_fields import move_place
from skyrange.attack.contract import Place
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.geodesy import Origin
from skyrange.core.volumes import Volume4D

Form = Literal["offset", "scale", "sea_level", "endless"]
_PLACES: Final = frozenset((
    mav.MAV_CMD_NAV_WAYPOINT, mav.MAV_CMD_NAV_SPLINE_WAYPOINT, mav.MAV_CMD_NAV_LOITER_UNLIM,
    mav.MAV_CMD_NAV_LOITER_TURNS, mav.MAV_CMD_NAV_LOITER_TIME,
))  # fmt: skip
"""Commands with a place in the air."""
_RELATIVE: Final = {
    int(mav.MAV_FRAME_GLOBAL_RELATIVE_ALT): int(mav.MAV_FRAME_GLOBAL),
    int(mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT): int(mav.MAV_FRAME_GLOBAL_INT),
}
"""Frames with heights above home, and those with the same number above mean sea level."""
ALTERED_FIELDS: Final = ("frame", "command", "param1", "param2", "param3", "param4", "x", "y", "z")
"""Fields of an item that the alteration writes."""
_FIRST_JUMP: Final = 2
"""Item that an endless plan goes back to: the first one after home and take-off."""
_FOR_EVER: Final = -1
"""Repetitions of that DO_JUMP (AP_MISSION_JUMP_REPEAT_FOREVER in ArduPilot's AP_Mission.h)."""


@dataclass(frozen=True, slots=True)
class PlanAlteration:
    """The alteration of one plan, as an item and as a claimed volume."""

    form: Form
    offset_m: Place
    factor: float
    origin: Origin

    def alter_item(self, fields: Any, count: int) -> bool:
        """Write into an item of a mission of `count` items; returns whether it is one that differs."""
        if self.form == "endless":
            return self._jump_back(fields) if fields["seq"] == count - 1 > _FIRST_JUMP else False
        if not fields["seq"] or int(fields["command"]) not in _PLACES:
            return False
        relative = int(fields["frame"]) in _RELATIVE
        if self.form == "offset":
            fields["z"] = max(fields["z"] + self.offset_m[2], 0.0 if relative else self.origin.alt_msl_m)
            if fields["x"] or fields["y"]:
                move_place(fields, "x", "y", self.offset_m, self.origin)
            return True
        if not relative:
            return False
        if self.form == "scale":
            fields["z"] *= self.factor
        else:
            fields["frame"] = _RELATIVE[int(fields["frame"])]
            fields["z"] = max(fields["z"], self.origin.alt_msl_m)
        return True

    def _jump_back(self, fields: Any) -> bool:
        for name in ("param3", "param4", "x", "y", "z"):
            fields[name] = 0
        fields["command"], fields["param1"], fields["param2"] = mav.MAV_CMD_DO_JUMP, _FIRST_JUMP, _FOR_EVER
        return True

    def alter_volume(self, volume: Volume4D) -> Volume4D:
        """The volume that the altered plan claims; that of an endless plan ends as before."""
        if self.form == "endless":
            return volume
        outline = volume.outline
        if self.form == "offset":
            places = [self.origin.enu_of(lat, lon) for lat, lon in outline]
            east, north, _ = self.offset_m
            outline = tuple(self.origin.geodetic_of(x + east, y + north) for x, y in places)
        lower, upper = self._height(volume.lower_m), self._height(volume.upper_m)
        return Volume4D(outline, lower, upper, volume.start_ns, volume.end_ns)

    def _height(self, ellipsoid_m: float) -> float:
        ground_m = self.origin.alt_msl_m + self.origin.geoid_m
        if self.form == "offset":
            return ellipsoid_m + self.offset_m[2]
        if self.form == "scale":
            return ground_m + (ellipsoid_m - ground_m) * self.factor
        return ellipsoid_m - self.origin.alt_msl_m
