"""MAVLink sequence check: frames of a second sender under one id, by their sequence numbers.

Each component numbers its frames 0 to 255 and again from 0 (https://mavlink.io/en/guide/serialization.html,
"seq: Used to detect packet loss"). Frames that get lost leave gaps, and a network may repeat a frame or deliver it a
little late; but one number with two contents, or a number that was passed long ago, is that of another sender or of a
recording. So the check needs no rate of losses and no threshold on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Final, Literal, NamedTuple

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.orders import read
from skyrange.defence.placement import inspects_forward

NUMBERS: Final = 256
BEHIND: Final = NUMBERS // 2
"""A number that is at most this far behind the last is behind it; every other is ahead."""
_MOST_SENDERS: Final = 64
"""Senders that are followed; a flood of invented ones fills no memory."""
Finding = Literal["", "conflict", "old"]


class Seen(NamedTuple):
    """What is known of one number: when its frame came, or the gap was made, and the hash of its frame."""

    at_ns: sky.Time
    content: int | None
    """`None` for a frame that has not come."""


@dataclass(slots=True)
class Follower:
    """The sequence numbers of one sender."""

    late_ns: sky.Time
    silence_ns: sky.Time
    last: int = -1
    last_ns: sky.Time = 0
    seen: dict[int, Seen] = field(default_factory=dict)

    def take(self, now: sky.Time, number: int, content: int) -> Finding:
        """Follow a frame: "" for one in order, late or repeated, else what is wrong with it."""
        behind = (self.last - number) % NUMBERS
        if self.last < 0 or now - self.last_ns > self.silence_ns:
            self.seen = {}
        elif behind <= BEHIND:
            known = self.seen.get(number)
            if known is None:
                return ""  # older than all that is known
            late = now - known.at_ns > self.late_ns
            if known.content is None and not late:
                self.seen[number] = Seen(now, content)
                return ""
            if known.content == content and not late:
                return ""
            return "old" if known.content in (None, content) else "conflict"
        else:
            ahead = (number - self.last) % NUMBERS
            for step in range(1, ahead):
                self.seen[(self.last + step) % NUMBERS] = Seen(now, None)
        self.seen[number] = Seen(now, content)
        self.last, self.last_ns = number, now
        return ""


@sky.defence(
    "mavlink.sequence",
    surface=("gcs",),
    place="the companion's end of the gcs link; knows the frames that arrive",
    effect="raises an alarm; with `drop`, drops each frame whose number another frame has had, or that is old",
    alerts=("sequence.conflict", "sequence.old"),
    against=("mavlink.*", "link.replay", "identity.keep_alive"),
    evasion="renumbers the frames of the true sender on the path, alters frames in place, or waits for silence",
    cost="reads each frame once; no frame and no delay is added",
    realism={"sequence numbers": "cited: https://mavlink.io/en/guide/serialization.html"},
)
class SequenceCheck(sky.EndTap):
    """Notices a second sender under one MAVLink id, and recordings, by sequence numbers."""

    decides: ClassVar = "sequence check"
    inspects = staticmethod(inspects_forward)

    late_s: sky.Number = sky.param(
        "How late a network may deliver a frame or a copy of it, in seconds; a frame that is later is old. The default "
        "is several times the round trip of a cellular link.",
        default=1.0, gt=0, le=60,
    )  # fmt: skip
    silence_s: sky.Number = sky.param(
        "Silence of a sender, in seconds, after which any number is taken, because it may have restarted; the default "
        "is four or five missed heartbeats, as in the heartbeat protocol's timeout. Not longer than the sender needs "
        "for 128 frames.",
        default=5.0, gt=0, le=120,
    )  # fmt: skip
    drop: bool = sky.param(
        "Whether to drop what is found. The first of two frames with one number has passed then, and it may be the "
        "attacker's.",
        default=False, strict=True,
    )  # fmt: skip
    senders: dict[tuple[int, int], Follower] = sky.state(dict)

    def find_rules(self, end: sky.PathEnd) -> Sequence[sky.PathRule]:
        """A frame that was overtaken is old."""
        return [sky.ExpectsOrder(end, "fwd")]

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> Sequence[sky.Verdict]:
        if frame.direction == "rev":
            return ()
        message = read(frame.payload)
        if message is None:
            return ()
        sender = message.get_srcSystem(), message.get_srcComponent()
        follower = self.senders.get(sender)
        if follower is None:
            if len(self.senders) >= _MOST_SENDERS:
                return ()
            follower = self.senders[sender] = Follower(sky.from_seconds(self.late_s), sky.from_seconds(self.silence_s))
        finding = follower.take(now, message.get_seq(), sky.hash64(frame.payload.hex()))
        if not finding:
            return ()
        name = f"{sender[0]}/{sender[1]}"
        alarm = self.alarm.raise_at(
            now, f"sequence.{finding}", 1.0, sender=name, number=message.get_seq(), message=str(message.get_type())
        )
        return [sky.Drop(), *alarm] if self.drop else alarm
