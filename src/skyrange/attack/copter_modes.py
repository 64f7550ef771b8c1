"""Names of modes of ArduCopter, as a parameter."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator

from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.params import refuse
from skyrange.core.errors import Problem, nearest


def _known_mode(name: str) -> str:
    if name not in COPTER_MODE_NUMBERS:
        raise refuse(Problem("", name, "a mode of ArduCopter such as 'AUTO'", nearest(name, COPTER_MODE_NUMBERS)))
    return name


ModeName = Annotated[str, AfterValidator(_known_mode)]
"""Name of a mode of ArduCopter."""
