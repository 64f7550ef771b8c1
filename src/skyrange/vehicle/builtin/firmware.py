"""What the firmware calls itself."""

from __future__ import annotations

from typing import Final

BANNER: Final = ("ArduCopter V4.6.0-dev (skyrange)", "Frame: QUAD/X")
"""The texts that precede a list of parameters and begin a log, as in ArduCopter (`send_banner`)."""
