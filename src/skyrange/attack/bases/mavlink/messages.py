"""Base of kinds that alter MAVLink messages in transit, and acts on their fields that need no method.

A kind with the base `OnMessages` that has such an act as its `alter` needs no method. The field is named as in MAVLink;
selected messages that do not have it pass. An integer is rounded and clipped to the range of its field.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, ClassVar, Final

import numpy as np

from skyrange.attack.bases.links import OnPath
from skyrange.attack.bases.mavlink.orders import rewrite
from skyrange.codec.mavlink import Message, decode_anew, dialect
from skyrange.contracts.frames import Frame
from skyrange.contracts.plugins.form import reads_fields, state
from skyrange.contracts.verdicts import Replace, Verdicts
from skyrange.core.errors import DecodeError, InputError, nearest
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


FIELDS: Final = frozenset(name for message in dialect.mavlink_map.values() for name in message.fieldnames)
"""Names of the fields of all messages."""
_LIMITS: Final = {f"{sign}int{bits}_t": np.iinfo(f"{sign}int{bits}") for sign in ("", "u") for bits in (8, 16, 32, 64)}
"""Limits by type of a field."""


def alter_field(field: str, change: str | Callable[[Any, Any], Any]) -> Any:
    """Alter a field: `change` is a function of the kind and the true value, or the name of a parameter that is added.

    The sham replaces the same messages by themselves. Raises `InputError` for a field that no message has.
    """
    _check(field)

    def alter(self: Any, now: Time, message: Message) -> bool:
        if field not in message.fieldnames:
            return False
        true = getattr(message, field)
        _write(message, field, true + getattr(self, change) if isinstance(change, str) else change(self, true))
        return True

    return reads_fields(alter, change)


def hold_field(field: str) -> Any:
    """Keep a field at the value that it had in the last message before the start, for each message and sender.

    Where none passed before, it is the value of the first one since. The sham replaces the same messages by themselves.
    Raises `InputError` for a field that no message has.
    """
    _check(field)

    def alter(self: Any, now: Time, message: Message) -> bool:
        if field not in message.fieldnames:
            return False
        _write(message, field, self.held_fields.setdefault(_key(message, field), _read(message, field)))
        return True

    def learn(self: Any, now: Time, message: Message) -> None:
        if field in message.fieldnames:
            self.held_fields[_key(message, field)] = _read(message, field)

    made: Any = alter
    made.learn = learn
    return made


def _check(field: str) -> None:
    if field not in FIELDS:
        expected = "a field of a MAVLink message such as 'relative_alt'"
        raise InputError.one("alter", "field", field, expected, nearest(field, FIELDS))


def _key(message: Message, field: str) -> tuple[str, int, int, str]:
    return type(message).msgname, message.get_srcSystem(), message.get_srcComponent(), field


def _read(message: Message, field: str) -> Any:
    """The value of a field; that of a text in bytes."""
    return getattr(message, f"_{field}_raw", getattr(message, field))


def _write(message: Message, field: str, value: Any) -> None:
    """Set a field. A text is given as such, or in bytes."""
    limits = _LIMITS.get(message.fieldtypes[message.fieldnames.index(field)])
    if limits is not None:
        several = isinstance(value, Iterable)
        whole = [_clip(item, limits) for item in (value if several else (value,))]
        value = whole if several else whole[0]
    elif hasattr(message, f"_{field}_raw"):
        raw = value.encode() if isinstance(value, str) else value
        setattr(message, f"_{field}_raw", raw)
        value = raw.partition(b"\0")[0].decode("ascii", errors="replace")
    setattr(message, field, value)


def _clip(value: float, limits: Any) -> int:
    """The nearest integer within limits. Raises `ValueError` for NaN, and `OverflowError` for infinity."""
    return min(max(round(value), int(limits.min)), int(limits.max))
