"""Base of kinds that alter MAVLink messages in transit."""

from __future__ import annotations

from typing import ClassVar

from skyrange.attack.bases.mavlink.orders import rewrite
from skyrange.attack.bases.on_path import OnPath
from skyrange.codec.mavlink import Message, decode_anew
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.verdicts import Replace, Verdicts
from skyrange.core.errors import DecodeError
from skyrange.core.time import Time


class OnMessages(OnPath):
    """Alters selected MAVLink messages: `alter` writes into each of them, and it replaces the original.

    Sender and sequence number stay, and the checksum fits; a signature is lost. What is no valid frame passes. The sham
    replaces the same frames by themselves.
    """

    needs: ClassVar[tuple[str, ...]] = ("alter",)

    def act(self, now: Time, frame: Frame) -> Verdicts:
        """Replace it by the altered message."""
        try:
            message = decode_anew(frame.payload)
        except DecodeError:
            return ()
        if not self.alter(now, message):
            return ()
        return (Replace(frame.payload if self.sham else rewrite(message, message)),)

    def alter(self, now: Time, message: Message) -> bool:
        """Write into a message, which is its own; returns whether to replace the original."""
        raise NotImplementedError
