"""Base of kinds that alter MAVLink messages in transit."""

from __future__ import annotations

from typing import Any, ClassVar

from skyrange.attack.bases.mavlink.orders import rewrite
from skyrange.attack.bases.on_path import OnPath
from skyrange.codec.mavlink import Message, decode_anew
from skyrange.contracts.frames import Frame
from skyrange.contracts.plugins.form import state
from skyrange.contracts.verdicts import Replace, Verdicts
from skyrange.core.errors import DecodeError
from skyrange.core.time import Time


class OnMessages(OnPath):
    """Alters selected MAVLink messages: `alter` writes into each of them, and it replaces the original.

    Sender and sequence number stay, and the checksum fits; a signature is lost. What is no valid frame passes. The sham
    replaces the same frames by themselves.
    """

    needs: ClassVar[tuple[str, ...]] = ("alter",)

    held_fields: dict[tuple[str, int, int, str], Any] = state(dict)
    """By message, system and component of its sender, and field: the values that `hold_field` keeps."""

    def __init_subclass__(cls) -> None:
        """Take the `learn` that an `alter` such as that of `hold_field` brings."""
        super().__init_subclass__()
        if "learn" not in vars(cls) and hasattr(cls.alter, "learn"):
            cls.learn = cls.alter.learn  # type: ignore[method-assign]

    def on_frame(self, now: Time, frame: Frame) -> Verdicts:
        """Learn from it before the start, if the kind learns; then act on it."""
        if now >= self.schedule.start_ns:
            return super().on_frame(now, frame)
        if type(self).learn is not OnMessages.learn and self.selects(frame):
            message = _decode(frame)
            if message is not None:
                self.learn(now, message)
        return ()

    def act(self, now: Time, frame: Frame) -> Verdicts:
        """Replace it by the altered message."""
        message = _decode(frame)
        if message is None or not self.alter(now, message):
            return ()
        return (Replace(frame.payload if self.sham else rewrite(message, message)),)

    def learn(self, now: Time, message: Message) -> None:
        """Read a selected message that passes before the start; no kind has to."""

    def alter(self, now: Time, message: Message) -> bool:
        """Write into a message, which is its own; returns whether to replace the original."""
        raise NotImplementedError


def _decode(frame: Frame) -> Message | None:
    try:
        return decode_anew(frame.payload)
    except DecodeError:
        return None
