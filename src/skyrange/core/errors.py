"""Errors: who is at fault, the value, what was expected, and what to do.

Exit codes (also of the command line): 2 bad input, 3 a component failed, 4 the run fell short.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

from skyrange.core.time import Time, to_seconds

MAX_LINES: Final = 60
"""Problems that the message of an error lists; more are counted."""
MAX_QUOTED: Final = 500
"""Characters of a value, or of its place, that a message quotes."""


class SkyrangeError(Exception):
    """Base of every error this library raises on purpose."""

    exit_code = 3

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled with its attributes, since the message is no argument of its constructor."""
        return _remade, (type(self), self.args, self.__dict__)


def _remade(kind: type[SkyrangeError], args: tuple[Any, ...], state: dict[str, Any]) -> SkyrangeError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(state)
    return error


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong with an input.

    `where` names the file, line or key; `value` is what was found there, as text; `expected` says what was expected;
    `hint` says what to do and may be empty.
    """

    where: str
    value: str
    expected: str
    hint: str = ""

    def __str__(self) -> str:
        line = f"{_shorten(self.where)}: {_shorten(self.value)} — expected {self.expected}"
        return f"{line}. {self.hint}" if self.hint else line


Problems: TypeAlias = Iterable[Problem]
"""What is wrong with an input: none if it is right."""


def _shorten(text: str) -> str:
    """A quoted text on one line, of bounded length."""
    text = text if len(text) <= MAX_QUOTED else f"{text[:MAX_QUOTED]}…"
    return text.replace("\n", "\\n").replace("\r", "\\r")


class InputError(SkyrangeError):
    """A scenario, a file or an argument is wrong; has all its problems at once, and its message the first ones."""

    exit_code = 2

    def __init__(self, who: str, problems: Sequence[Problem]) -> None:
        """`who` is at fault (a file's name, "scenario", an option); `problems` is not empty."""
        self.who = who
        self.problems = tuple(problems)
        who = _shorten(who)
        lines = [f"  {problem}" for problem in self.problems[:MAX_LINES]]
        if len(self.problems) > MAX_LINES:
            lines.append(f"  … and {len(self.problems) - MAX_LINES:,} more")
        text = "\n".join([f"{who}:", *lines]) if len(self.problems) > 1 else f"{who}: {self.problems[0]}"
        super().__init__(text)

    @classmethod
    def one(cls, who: str, where: str, value: object, expected: str, hint: str = "") -> InputError:
        """An error with a single problem."""
        return cls(who, [Problem(where, value if isinstance(value, str) else repr(value), expected, hint)])


class ComponentError(SkyrangeError):
    """An agent, tap, engine or peer broke its contract or stopped answering."""

    exit_code = 3

    def __init__(self, who: str, problem: str, hint: str = "") -> None:
        self.who = who
        super().__init__(f"{who}: {problem}" + (f". {hint}" if hint else ""))


class ShortfallError(SkyrangeError):
    """The run ended before it did what was asked; its record up to there is whole, in the folder `path`."""

    exit_code = 4

    def __init__(self, problem: str, path: Path) -> None:
        self.path = path
        super().__init__(problem)


class DecodeError(SkyrangeError):
    """Bytes that are not what was expected; the only error that a decoder raises."""

    exit_code = 3


def attribute_error(who: str, now: Time, error: Exception) -> Exception:
    """`error` as the failure of the component `who` at `now`; a `SkyrangeError` says already who is at fault."""
    if isinstance(error, SkyrangeError):
        return error
    return ComponentError(who, f"raised {error!r} at {to_seconds(now):.6f} s")


def nearest(word: str, known: Iterable[str]) -> str:
    """A hint that names the known spelling closest to `word`, or lists the known ones if they are few; or "".

    A spelling that differs by upper and lower case is close if no other one is.
    """
    options = sorted(set(known))
    close = difflib.get_close_matches(word, options, n=1, cutoff=0.6)
    if not close:
        folded = {option.casefold(): option for option in options}
        close = [folded[match] for match in difflib.get_close_matches(word.casefold(), folded, n=1, cutoff=0.6)]
    if close:
        return f"Did you mean {close[0]!r}?"
    return f"Known: {', '.join(options)}." if 0 < len(options) <= 12 else ""
