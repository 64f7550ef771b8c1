"""Which engine flies the ArduPilots of a scenario? That of the physics which its options name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.time import Epoch
from skyrange.vehicle.ardupilot.fleet import Fleet
from skyrange.vehicle.ardupilot.lockstep import LockstepFleet
from skyrange.vehicle.ardupilot.native import NativeFleet
from skyrange.vehicle.ardupilot.options import Options
from skyrange.vehicle.spec import VehicleSpec


class _Factory:
    options = Options
    signs = True
    """They obey `VehicleSpec.signing_key`."""

    def __call__(
        self,
        name: str,
        specs: Sequence[VehicleSpec],
        origin: Origin,
        epoch: Epoch,
        chance: Chance,
        options: Options | None = None,
    ) -> Fleet:
        options = options or Options()
        kind = NativeFleet if options.physics == "native" else LockstepFleet
        return kind(name, specs, origin, epoch, options)


ArduPilotFleet: Final = _Factory()
"""What is registered as the autopilot `ardupilot`. Raises `InputError` as `Fleet` does."""
