"""The autopilot `ardupilot`: its plugin, and the engine of the physics that its options name."""

from __future__ import annotations

from collections.abc import Sequence

from skyrange.vehicle.ardupilot.fleet import Fleet
from skyrange.vehicle.ardupilot.lockstep import LockstepFleet
from skyrange.vehicle.ardupilot.native import NativeFleet
from skyrange.vehicle.ardupilot.options import Options
from skyrange.vehicle.spec import AutopilotContext, AutopilotPlugin


def _make(options: Options, context: AutopilotContext) -> Fleet:
    kind = NativeFleet if options.physics == "native" else LockstepFleet
    return kind(context.name, context.specs, context.origin, context.epoch, options)


def _opened_ports(options: Options, count: int) -> Sequence[int]:
    return options.opened(count)


ARDUPILOT = AutopilotPlugin(
    Options,
    _make,
    "Flies ArduPilot's own ArduCopter, a program for each aircraft.",
    signs=True,
    opened_ports=_opened_ports,
)
"""The autopilot `ardupilot`. Raises `InputError` as `Fleet` does."""
