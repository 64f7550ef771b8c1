"""Frames: one protocol unit on one link instance, from sending to its fate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import FrozenInstanceError
from enum import StrEnum
from typing import Any, NoReturn

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


_SLOTS = (
    "link", "direction", "sender", "serial", "src", "dst", "sent_ns", "payload", "parent", "causes", "arrived_ns",
    "fate",
)  # fmt: skip


class _Draft:
    """A frame while it is made; it becomes a `Frame`, whose layout it has."""

    __slots__ = _SLOTS


class Frame:
    """A frame on one link instance.

    `sender` is the endpoint that truly sent it (a tap's own for what the tap injects); `src` and `dst` are what the
    frame claims. `direction` is `"fwd"` from the link's first end to its second, else `"rev"`. `serial` counts the
    sender's frames on this link and direction, from 0. `parent` is the one frame that this one forwards, alters or
    duplicates. `arrived_ns` is set with the fate.

    Taps and agents are handed the frame itself: it cannot be altered. Only `end_journey`, of the kernel and of those
    that take its place, sets the fate.
    """

    __slots__ = _SLOTS

    arrived_ns: Time
    causes: tuple[FrameId, ...]
    direction: str
    dst: str
    fate: Fate
    link: str
    parent: FrameId | None
    payload: bytes
    sender: str
    sent_ns: Time
    serial: int
    src: str

    def __new__(
        cls,
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
    ) -> Frame:
        """A frame that was sent, and has not arrived."""
        draft: Any = _Draft()  # its slots can be set without a call of a descriptor for each
        draft.link = link
        draft.direction = direction
        draft.sender = sender
        draft.serial = serial
        draft.src = src
        draft.dst = dst
        draft.sent_ns = sent_ns
        draft.payload = payload
        draft.parent = parent
        draft.causes = causes
        draft.arrived_ns = NEVER
        draft.fate = Fate.IN_FLIGHT
        draft.__class__ = cls
        return draft  # type: ignore[no-any-return]

    def __setattr__(self, name: str, value: object) -> NoReturn:
        hint = "answer with a verdict, such as Replace(payload)"
        raise FrozenInstanceError(f"{name} of a frame cannot be altered: {hint}")

    def __delattr__(self, name: str) -> NoReturn:
        raise FrozenInstanceError(f"{name} of a frame cannot be deleted")

    def __reduce__(self) -> tuple[Callable[..., Frame], tuple[Any, ...]]:
        return _restore, tuple(getattr(self, name) for name in _SLOTS)

    def __deepcopy__(self, memo: dict[int, Any]) -> Frame:
        twin = memo[id(self)] = _restore(*(getattr(self, name) for name in _SLOTS))  # nothing in it can be altered
        return twin

    @property
    def id(self) -> FrameId:
        """(link, direction, true sender, that sender's serial)."""
        return _tuple(FrameId, (self.link, self.direction, self.sender, self.serial))

    def __repr__(self) -> str:
        return f"<Frame {self.id} {len(self.payload)} B sent {self.sent_ns} {self.fate}>"


_set_fate, _set_arrival = (Frame.__dict__[name].__set__ for name in ("fate", "arrived_ns"))


def end_journey(frame: Frame, fate: Fate, arrived_ns: Time = NEVER) -> None:
    """Set how the journey of a frame ended, and when it arrived if it did."""
    _set_fate(frame, fate)
    _set_arrival(frame, arrived_ns)


def _restore(*values: Any) -> Frame:
    frame = Frame(*values[:-2])
    end_journey(frame, values[-1], values[-2])
    return frame
