"""Texts of an autopilot (STATUSTEXT) that explain why it rejects a command."""

from __future__ import annotations

from dataclasses import dataclass, field

from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav

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
