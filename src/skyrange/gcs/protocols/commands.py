"""The MAVLink command protocol, ground station side: one exchange at a time, and the texts that explain a rejection.

By https://mavlink.io/en/services/command.html, a COMMAND_LONG without a COMMAND_ACK is sent again with
`confirmation` one higher, and an acknowledgement IN_PROGRESS restarts the timeout. In addition, a command that
is answered with FAILED or TEMPORARILY_REJECTED is repeated for a limited time, because ArduCopter answers so
until its estimator has settled and its pre-arm checks pass.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, Time

ACK_TIMEOUT_NS = 1_500 * NS_PER_MS
"""The default of the mission protocol; the command protocol names none."""
MAX_RETRIES = 5
ASK_AGAIN_NS = NS_PER_S
"""Pause before a temporarily rejected command is sent again."""

_TEMPORARY = frozenset({mav.MAV_RESULT_TEMPORARILY_REJECTED, mav.MAV_RESULT_FAILED})


class Command(NamedTuple):
    """A command to send: MAV_CMD, its parameters, and the name by which failure reasons call it.

    A temporary rejection is retried for `persist_s` seconds. The flight goes on if an `optional` command is
    rejected.
    """

    command: int
    params: tuple[float, ...]
    name: str
    persist_s: float = 0.0
    optional: bool = False


@dataclass(slots=True)
class CommandExchange:
    """The exchange of one command and its acknowledgement. `due` is when `on_time` must be called next."""

    command: Command
    due: Time = 0
    persist_until: Time = NEVER
    confirmation: int = 0
    retries: int = 0

    def begin(self, now: Time) -> None:
        """Make the command due at once."""
        self.due = now
        self.persist_until = now + round(self.command.persist_s * NS_PER_S)

    def on_time(self, now: Time) -> str:
        """`"send"` to send the message now, `"wait"`, or else the reason for which the exchange is given up."""
        if now < self.due:
            return "wait"
        if self.retries > MAX_RETRIES:
            return f"{self.command.name}: no acknowledgement after {self.retries} attempts"
        self.retries += 1
        self.due = now + ACK_TIMEOUT_NS
        return "send"

    def message(self, system: int, component: int) -> Message:
        """The COMMAND_LONG to send; each call raises `confirmation` for the next one, up to 255."""
        confirmation = self.confirmation
        self.confirmation = min(confirmation + 1, 255)
        params = (*self.command.params, *([0.0] * (7 - len(self.command.params))))
        return mav.MAVLink_command_long_message(system, component, self.command.command, confirmation, *params)

    def on_ack(self, now: Time, result: int) -> str:
        """`"accepted"`, `"wait"`, or else the reason for which the command is finally rejected."""
        if result == mav.MAV_RESULT_ACCEPTED:
            return "accepted"
        if result == mav.MAV_RESULT_IN_PROGRESS:
            self.retries, self.due = 1, now + ACK_TIMEOUT_NS
            return "wait"
        if result in _TEMPORARY and now + ASK_AGAIN_NS <= self.persist_until:
            self.retries, self.confirmation, self.due = 0, 0, now + ASK_AGAIN_NS
            return "wait"
        return f"{self.command.name}: {enum_name('MAV_RESULT', 'MAV_RESULT_', result)}"


def enum_name(enum: str, prefix: str, value: int) -> str:
    """The short name of a MAVLink enum value (`DENIED`), or the number itself if the enum does not define it."""
    entry = mav.enums[enum].get(value)
    return entry.name.removeprefix(prefix) if entry is not None else str(value)


def set_mode(mode: int, name: str, persist_s: float = 10.0) -> Command:
    """The command that switches to an ArduCopter mode, given by its number."""
    return Command(
        mav.MAV_CMD_DO_SET_MODE,
        (float(mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(mode)),
        f"mode {name}",
        persist_s,
    )


MAX_TEXTS = 4
"""Number of different texts that are kept, the newest; ArduCopter sends one per failing pre-arm check."""
MAX_CHARS = 200
"""Length at which a text is cut."""


@dataclass(slots=True)
class AutopilotTexts:
    """The latest warnings and errors of one autopilot, without repetitions, oldest first.

    A text of more than 50 characters arrives in chunks of the same id (https://mavlink.io/en/messages/common.html,
    STATUSTEXT); a chunk that does not follow the one before it begins a new text.
    """

    texts: list[str] = field(default_factory=list)
    _chunk: tuple[int, int] = (0, 0)
    """Id and sequence number that the next chunk of the newest text has; id 0 if it is complete."""

    def clear(self) -> None:
        """Forget all texts, before a new attempt."""
        self.texts.clear()
        self._chunk = (0, 0)

    def read(self, message: Message) -> None:
        """Keep the text of a STATUSTEXT of severity WARNING or worse."""
        if message.severity > mav.MAV_SEVERITY_WARNING:
            return
        text = "".join(letter if letter.isprintable() else " " for letter in str(message.text)).strip("\0 ")
        continued = message.id != 0 and (message.id, message.chunk_seq) == self._chunk and self.texts
        if continued:
            text = self.texts.pop() + text
        self._chunk = (message.id, message.chunk_seq + 1)
        text = text[:MAX_CHARS]
        if text:
            if text in self.texts:
                self.texts.remove(text)
            self.texts.append(text)
            del self.texts[:-MAX_TEXTS]

    def quote(self) -> str:
        """The texts as part of a sentence; empty without any."""
        return "the autopilot said " + ", ".join(f'"{text}"' for text in self.texts) if self.texts else ""
