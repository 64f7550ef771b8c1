"""Frames: one protocol unit on one link instance, from sending to its fate."""

from __future__ import annotations

from enum import StrEnum

from skyrange.core.ids import FrameId
from skyrange.core.time import NEVER, Time

_tuple = tuple.__new__  # half the cost of FrameId's own constructor, and every hop asks for an id


class Fate(StrEnum):
    """How the journey of a frame over one link ended."""

    DELIVERED = "delivered"
    LOST = "lost"  # the channel's loss took it (datagram links only)
    OVERFLOW = "overflow"  # the bounded queue of the channel, or of the receiver, was full
    DROPPED = "dropped"  # a tap's verdict
    REPLACED = "replaced"  # a tap sent another frame, its child, in its place
    IN_FLIGHT = "in_flight"  # the run ended first


class Frame:
    """A frame on one link instance.

    `sender` is the endpoint that truly sent it (a tap's own for what the tap injects); `src` and `dst` are what the
    frame claims. `direction` is `"fwd"` from the link's first end to its second, else `"rev"`. `serial` counts the
    sender's frames on this link and direction, from 0. `parent` is the one frame that this one forwards, alters or
    duplicates. `arrived_ns` is set with the fate.
    """

    __slots__ = (
        "arrived_ns",
        "causes",
        "direction",
        "dst",
        "fate",
        "link",
        "parent",
        "payload",
        "sender",
        "sent_ns",
        "serial",
        "src",
    )

    def __init__(
        self,
        link: str,
        direction: str,
        sender: str,
        serial: int,
        src: str,
        dst: str,
        sent_ns: Time,
        payload: bytes,
        parent: FrameId | None = None,
        causes: tuple[FrameId, ...] = (),
    ) -> None:
        self.link = link
        self.direction = direction
        self.sender = sender
        self.serial = serial
        self.src = src
        self.dst = dst
        self.sent_ns = sent_ns
        self.payload = payload
        self.parent = parent
        self.causes = causes
        self.arrived_ns: Time = NEVER
        self.fate: Fate = Fate.IN_FLIGHT

    @property
    def id(self) -> FrameId:
        """(link, direction, true sender, that sender's serial)."""
        return _tuple(FrameId, (self.link, self.direction, self.sender, self.serial))

    def __repr__(self) -> str:
        return f"<Frame {self.id} {len(self.payload)} B sent {self.sent_ns} {self.fate}>"
