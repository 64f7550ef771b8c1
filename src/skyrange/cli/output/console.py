r"""Console output of all commands: text and JSON, in which no character of the data can control the terminal.

Everything that a command prints passes `print_text`, `print_notice`, `print_json` or a `terminal()`. Names, keys and
messages may come from files of anybody. Control characters, characters that reorder text, and halves of characters are
printed as escapes such as `\x1b`.
"""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any
from unicodedata import category

if TYPE_CHECKING:
    from rich.console import Console

_HARMLESS = "\n\t\u200c\u200d"
"""Characters of the categories below that are printed: breaks, and the joiners that some scripts need."""
_CATEGORIES = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Control, format (such as a change of the writing direction), half characters, line and paragraph separators."""


def escape(text: str) -> str:
    r"""`text` without characters that control a terminal; each is shown as `\xNN`, `\uNNNN` or `\UNNNNNNNN`."""
    if text.isprintable():
        return text
    return "".join(_escape_character(one) if _is_control(one) else one for one in text)


def print_text(text: object = "") -> None:
    """Print one line, or several, on standard output."""
    print(escape(str(text)), flush=True)


def print_notice(text: object) -> None:
    """Print one line, or several, on standard error: progress, warnings and errors."""
    print(escape(str(text)), file=sys.stderr, flush=True)


def print_json(data: Any) -> None:
    """Print one JSON value on standard output, for scripts."""
    unicode = "utf" in (sys.stdout.encoding or "").lower()
    text = json.dumps(data, indent=2, ensure_ascii=not unicode, allow_nan=False)
    if not text.replace("\n", "").isprintable():  # what is left of such characters stands inside strings
        text = "".join(json.dumps(one)[1:-1] if one != "\n" and _is_control(one) else one for one in text)
    print(text, flush=True)


def terminal(*, stderr: bool = False) -> Console:
    """The console for tables and progress. Text is printed as it is: markup and emoji codes are not interpreted."""
    from skyrange.cli.output.escaping_console import EscapingConsole

    return EscapingConsole(stderr=stderr, highlight=False, markup=False, emoji=False)


def tell_if_cold(*, quiet: bool) -> None:
    """Print a notice if the numeric functions must be compiled before this run."""
    from skyrange.core.compiled import compiled_before

    if not quiet and not compiled_before():
        print_notice("compiling the numeric functions; this takes a minute or two, once")


def _is_control(character: str) -> bool:
    return category(character) in _CATEGORIES and character not in _HARMLESS


def _escape_character(character: str) -> str:
    code = ord(character)
    if 0xDC80 <= code <= 0xDCFF:  # a byte of a file's name that is not UTF-8 (PEP 383)
        code -= 0xDC00
    return f"\\x{code:02x}" if code <= 0xFF else f"\\u{code:04x}" if code <= 0xFFFF else f"\\U{code:08x}"
