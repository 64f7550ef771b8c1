r"""Console output of all commands: text and JSON, in which no character of the data can control the terminal.

Everything that a command prints passes `print_text`, `print_notice`, `print_json` or a `terminal()`. Names, keys and
messages may come from files of anybody. Control characters, characters that reorder text, and halves of characters are
printed as escapes such as `\x1b`.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from skyrange.cli.output.escaping import escape, is_control

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console


def print_text(text: object = "") -> None:
    """Print one line, or several, on standard output."""
    print(escape(str(text)), flush=True)


def print_notice(text: object) -> None:
    """Print one line, or several, on standard error: progress, warnings and errors."""
    print(escape(str(text)), file=sys.stderr, flush=True)


def print_unverified(folder: Path, *, is_pair: bool = False) -> None:
    """Say that a command reads the record of a run, or those of a pair's runs, and does not compare it with its
    manifest.
    """
    which, whose = (f"{folder}/RUN", "of each run ") if is_pair else (folder, "")
    print_notice(f"not verified: `skyrange verify {which}` compares the record {whose}with its manifest")


def print_json(data: Any) -> None:
    """Print one JSON value on standard output, for scripts. A number that is infinite or NaN, which JSON has not, is
    null.
    """
    unicode = "utf" in (sys.stdout.encoding or "").lower()
    try:
        text = json.dumps(data, indent=2, ensure_ascii=not unicode, allow_nan=False)
    except ValueError:
        text = json.dumps(_nulled(data), indent=2, ensure_ascii=not unicode, allow_nan=False)
    if not text.replace("\n", "").isprintable():  # what is left of such characters stands inside strings
        text = "".join(
            json.dumps(character)[1:-1] if character != "\n" and is_control(character) else character
            for character in text
        )
    print(text, flush=True)


def _nulled(value: Any) -> Any:
    """Plain data with null for numbers that are infinite or NaN."""
    if isinstance(value, Mapping):
        return {key: _nulled(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_nulled(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def terminal(*, stderr: bool = False) -> Console:
    """The console for tables and progress. Text is printed as it is: markup and emoji codes are not interpreted."""
    from skyrange.cli.output.escaping_console import EscapingConsole

    return EscapingConsole(stderr=stderr, highlight=False, markup=False, emoji=False)
