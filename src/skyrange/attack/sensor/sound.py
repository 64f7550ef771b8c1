"""Base of kinds that act by sound on inertial sensors, and what these sensors measure at most."""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

from skyrange.attack.bases.sensors import AddsSignal, within
from skyrange.attack.declaration import Facts
from skyrange.contracts.params import Enu

SOUND_AT_AIRCRAFT: Final = {
    "amplitude at the aircraft": "assumed: a parameter, because it depends on sensor, distance and housing"
}
"""Realism of readings that sound alters."""
Accelerations = Annotated[Enu, within(-160.0, 160.0, "m/s²")]
"""Forward, left and up, up to 16 g: full scale of usual accelerometers."""
Rates = Annotated[Enu, within(-2_000.0, 2_000.0, "deg/s")]
"""About forward, left and up, up to the full scale of usual gyroscopes."""


class AddsSound(AddsSignal):
    """Adds the error that sound at the resonance of a MEMS sensor makes of its readings."""

    attack_facts: ClassVar[Facts] = {"equipment": "a loudspeaker and amplifier for the resonance"}
