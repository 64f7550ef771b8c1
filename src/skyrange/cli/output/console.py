"""Output to the terminal and as JSON, shared by all commands."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console


def print_json(data: Any) -> None:
    """Print one JSON value on standard output, for scripts."""
    unicode = "utf" in (sys.stdout.encoding or "").lower()
    print(json.dumps(data, indent=2, ensure_ascii=not unicode, allow_nan=False))


def terminal() -> Console:
    """The console for tables."""
    from rich.console import Console

    return Console(highlight=False)


def tell_if_cold(*, quiet: bool) -> None:
    """Print a notice if the numeric functions must be compiled before this run."""
    from skyrange.core.compiled import compiled_before

    if not quiet and not compiled_before():
        print("compiling the numeric functions; this takes a minute or two, once", file=sys.stderr, flush=True)
