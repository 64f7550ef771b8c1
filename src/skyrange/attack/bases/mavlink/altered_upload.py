"""Altered plans: an alteration of items and volumes, and uploads altered on the way up, and back when they are read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final, Literal, Protocol

from skyrange.attack.bases.mavlink.compromised_sender import SenderStream, without_signature
from skyrange.attack.bases.mavlink.message_fields import move_place, read_fields, write_alteration
from skyrange.attack.contract import Place
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import message_id
from skyrange.contracts.frames import Frame
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


_COUNT: Final = int(mav.MAVLINK_MSG_ID_MISSION_COUNT)
_ITEM: Final = int(mav.MAVLINK_MSG_ID_MISSION_ITEM_INT)


class ItemAlteration(Protocol):
    """An alteration of the items of one upload."""

    def alter_item(self, fields: Any, count: int) -> bool:
        """Write into an item of an upload of `count` items; returns whether it is one that is altered."""
        ...


@dataclass(slots=True)
class AlteredUpload:
    """The uploads of one station to one aircraft: of missions, or of another `mission_type`.

    The station's program itself keeps the plan of the operator, with the same number of items.
    """

    alteration: ItemAlteration
    up: SenderStream
    down: SenderStream
    count: int = 0
    originals: dict[int, Any] = field(default_factory=dict)
    """The operator's altered items by number."""
    mission_type: int = int(mav.MAV_MISSION_TYPE_MISSION)

    def alter(self, frame: Frame, *, sham: bool) -> bytes | None:
        """The altered frame, that of a sham with the same content; `None` for one that stays as it is."""
        number = message_id(frame.payload)
        plain = without_signature(frame.payload) if number in (_COUNT, _ITEM) else None
        fields = None if plain is None or number is None else read_fields(plain, number)
        if plain is None or number is None or fields is None or fields["mission_type"] != self.mission_type:
            return None
        upwards = frame.direction == "fwd"
        if number == _COUNT:
            if upwards:
                self.count, self.originals = int(fields["count"]), {}
            return None
        true = fields.copy()
        if not (self._alter_up(fields) if upwards else self._restore(fields)):
            return None
        content = write_alteration(plain, number, true, fields, sham=sham)
        return (self.up if upwards else self.down).forward(frame.payload, content)

    def _alter_up(self, fields: Any) -> bool:
        original = fields.copy()
        if not self.alteration.alter_item(fields, self.count):
            return False
        self.originals[int(original["seq"])] = original
        return True

    def _restore(self, fields: Any) -> bool:
        original = self.originals.get(int(fields["seq"]))
        if original is None:
            return False
        for name in ALTERED_FIELDS:
            fields[name] = original[name]
        return True
