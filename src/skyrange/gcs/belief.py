"""What does a ground station believe about its aircraft? The last thing each message told it, and which frame."""

from __future__ import annotations

from dataclasses import dataclass

from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.ids import FrameId
from skyrange.core.time import NEVER, Time


@dataclass(slots=True)
class Belief:
    """One aircraft as told by its telemetry; units are MAVLink's, `-NEVER` and `None` mean "never told"."""

    heard_ns: Time = -NEVER
    """When its last heartbeat was read."""
    armed: bool | None = None
    disarmed_beats: int = 0
    """Heartbeats in a row that said it is disarmed; copies of one count once."""
    beat_seq: int = -1
    """Sequence number of the last heartbeat read."""
    mode: int | None = None
    """ArduCopter's mode number."""
    mode_ref: FrameId | None = None
    """The heartbeat that last changed `mode` or `armed`."""
    position_ns: Time = -NEVER
    lat_e7: int = 0
    lon_e7: int = 0
    alt_msl_mm: int = 0
    above_home_mm: int = 0
    position_ref: FrameId | None = None
    item: int | None = None
    """Mission item it says it flies to (0 is home)."""
    item_ns: Time = -NEVER
    farthest_item: int = 0
    """Largest `item` since the mission was started."""
    item_ref: FrameId | None = None

    def on_heartbeat(self, now: Time, message: Message, ref: FrameId) -> bool:
        """Take in a HEARTBEAT; whether the mode is another than before."""
        self.heard_ns = now
        armed = bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
        if armed:
            self.disarmed_beats = 0
        elif message.get_seq() != self.beat_seq:
            self.disarmed_beats += 1
        self.beat_seq = message.get_seq()
        changed: bool = message.custom_mode != self.mode
        if changed or armed != self.armed:
            self.mode, self.armed, self.mode_ref = message.custom_mode, armed, ref
        return changed

    def on_position(self, now: Time, message: Message, ref: FrameId) -> None:
        """Take in a GLOBAL_POSITION_INT."""
        self.position_ns, self.position_ref = now, ref
        self.lat_e7, self.lon_e7 = message.lat, message.lon
        self.alt_msl_mm, self.above_home_mm = message.alt, message.relative_alt

    def on_current(self, now: Time, message: Message, ref: FrameId) -> bool:
        """Take in a MISSION_CURRENT; whether the item is another than before."""
        self.item_ns = now
        changed: bool = message.seq != self.item
        if changed:
            self.item, self.item_ref = message.seq, ref
        self.farthest_item = max(self.farthest_item, message.seq)
        return changed


@dataclass(slots=True)
class Counts:
    """What came in, per aircraft."""

    frames: int = 0
    bad: int = 0
    """Bytes that are no valid MAVLink frame."""
    foreign: int = 0
    """Frames of another system or component than the aircraft's autopilot."""
