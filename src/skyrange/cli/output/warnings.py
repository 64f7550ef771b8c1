"""Warnings on the terminal: what a scenario does unexpectedly, missions that failed without an attack, and motion
that the interlock blocked.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from skyrange.cli.output.console import print_notice
from skyrange.core.errors import MAX_LINES

if TYPE_CHECKING:
    from rich.console import Console

    from skyrange.scenario.model.scenario import Scenario


def print_warnings(scenario: Scenario) -> None:
    """Print what a scenario does otherwise than its author may expect, before the run; `warnings` of the manifest
    has it too.
    """
    from skyrange.assembly.warnings import list_warnings

    for line in shorten_warnings(list_warnings(scenario)):
        print_notice(line)


def shorten_warnings(lines: Sequence[str]) -> list[str]:
    """The first warnings, and how many more there are."""
    more = [f"WARNING: {len(lines) - MAX_LINES} more are in manifest.json, under warnings"] * (len(lines) > MAX_LINES)
    return [*(f"WARNING: {line}" for line in lines[:MAX_LINES]), *more]


def print_failed_missions(console: Console, lines: Iterable[str]) -> None:
    """Print a line for each run; commands do so first, because effects are differences from these runs."""
    for line in lines:
        text = f"failed without an attack: {line}"
        console.print(text, style="yellow", soft_wrap=True, markup=False, highlight=False)


def print_interlock_notice(manifest: Mapping[str, Any]) -> None:
    """Print which external vehicles could not be armed or moved, and what is required to allow it."""
    for engine in manifest.get("engines", ()):
        lock = engine.get("interlock", {})
        if lock.get("state") == "closed":
            missing = [] if lock["scenario"] else ["allow_motion in the scenario"]
            missing += [] if lock["command_line"] else ["--allow-motion"]
            vehicles = ", ".join(engine["vehicles"])
            print_notice(f"interlock closed: {vehicles} cannot be armed or moved without {' and '.join(missing)}")
