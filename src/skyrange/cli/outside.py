"""What does one have to be told whose aircraft are real? That they were held back, and what it would take."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any


def tell_if_held_back(manifest: Mapping[str, Any]) -> None:
    """Say that external vehicles were not let move, if there were any."""
    for engine in manifest.get("engines", ()):
        lock = engine.get("interlock", {})
        if lock.get("state") == "closed":
            wanting = [] if lock["scenario"] else ["allow_motion in the scenario"]
            wanting += [] if lock["command_line"] else ["--allow-motion"]
            told = ", ".join(engine["vehicles"])
            print(f"interlock closed: {told} cannot be armed or moved without {' and '.join(wanting)}", file=sys.stderr)
