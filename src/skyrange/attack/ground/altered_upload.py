"""Upload of an altered plan: items altered on the way up, and back when they are read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from skyrange.attack.bases.mavlink.compromised_sender import SenderStream, without_signature
from skyrange.attack.bases.mavlink.message_fields import read_fields, write_alteration
from skyrange.attack.ground.plan_alteration import ALTERED_FIELDS
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import message_id
from skyrange.contracts.frames import Frame

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

    def alter(self, frame: Frame, sham: bool) -> bytes | None:
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
        content = write_alteration(plain, number, true, fields, sham)
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
