"""Notice that the interlock blocked motion of external vehicles, and what opens it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skyrange.cli.output.console import print_notice


def print_interlock_notice(manifest: Mapping[str, Any]) -> None:
    """Print which external vehicles could not be armed or moved, and what is required to allow it."""
    for engine in manifest.get("engines", ()):
        lock = engine.get("interlock", {})
        if lock.get("state") == "closed":
            missing = [] if lock["scenario"] else ["allow_motion in the scenario"]
            missing += [] if lock["command_line"] else ["--allow-motion"]
            vehicles = ", ".join(engine["vehicles"])
            print_notice(f"interlock closed: {vehicles} cannot be armed or moved without {' and '.join(missing)}")
