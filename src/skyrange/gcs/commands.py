"""Was a command carried out? The MAVLink command protocol, as one exchange at a time.

https://mavlink.io/en/services/command.html: a COMMAND_LONG without a COMMAND_ACK is sent again with
`confirmation` one higher; an ack IN_PROGRESS starts the waiting anew. Beyond it: FAILED and
TEMPORARILY_REJECTED are asked again for a while, because ArduCopter answers so until its estimator and
pre-arm checks are content.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, Time

ACK_TIMEOUT_NS = 1_500 * NS_PER_MS
"""As the mission protocol's default; the command protocol names none."""
MAX_RETRIES = 5
ASK_AGAIN_NS = NS_PER_S
"""Pause before asking again what was refused for now."""

_FOR_NOW = frozenset({mav.MAV_RESULT_TEMPORARILY_REJECTED, mav.MAV_RESULT_FAILED})


class Command(NamedTuple):
    """A command to give: MAV_CMD, its parameters, how it is called in reasons, and how much it matters.

    `persist_s` is how long a refusal for now is answered by asking again; an `optional` command may be
    refused without harm.
    """

    command: int
    params: tuple[float, ...]
    name: str
    persist_s: float = 0.0
    optional: bool = False


@dataclass(slots=True)
class Exchange:
    """One command under way. `due` is when `on_time` wants to be called."""

    command: Command
    due: Time = 0
    persist_until: Time = NEVER
    confirmation: int = 0
    retries: int = 0

    def begin(self, now: Time) -> None:
        """Ready to be sent at once."""
        self.due = now
        self.persist_until = now + round(self.command.persist_s * NS_PER_S)

    def on_time(self, now: Time) -> str:
        """`"send"` the frame now, `"wait"`, or why it is given up."""
        if now < self.due:
            return "wait"
        if self.retries > MAX_RETRIES:
            return f"{self.command.name}: no acknowledgement after {self.retries} attempts"
        self.retries += 1
        self.due = now + ACK_TIMEOUT_NS
        return "send"

    def message(self, system: int, component: int) -> Message:
        """The COMMAND_LONG; each call raises `confirmation` for the next (which stops at 255)."""
        confirmation = self.confirmation
        self.confirmation = min(confirmation + 1, 255)
        params = (*self.command.params, *([0.0] * (7 - len(self.command.params))))
        return mav.MAVLink_command_long_message(system, component, self.command.command, confirmation, *params)

    def on_ack(self, now: Time, result: int) -> str:
        """`"accepted"`, `"wait"`, or why it is refused for good."""
        if result == mav.MAV_RESULT_ACCEPTED:
            return "accepted"
        if result == mav.MAV_RESULT_IN_PROGRESS:
            self.retries, self.due = 1, now + ACK_TIMEOUT_NS
            return "wait"
        if result in _FOR_NOW and now + ASK_AGAIN_NS <= self.persist_until:
            self.retries, self.confirmation, self.due = 0, 0, now + ASK_AGAIN_NS
            return "wait"
        return f"{self.command.name}: {result_name('MAV_RESULT', 'MAV_RESULT_', result)}"


def result_name(enum: str, prefix: str, value: int) -> str:
    """The short name of a MAVLink enum's value (`DENIED`), or the value itself where the enum has none."""
    entry = mav.enums[enum].get(value)
    return entry.name.removeprefix(prefix) if entry is not None else str(value)


def set_mode(mode: int, name: str, persist_s: float = 10.0) -> Command:
    """Switch to an ArduCopter mode by its number."""
    return Command(
        mav.MAV_CMD_DO_SET_MODE,
        (float(mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(mode)),
        f"mode {name}",
        persist_s,
    )
