"""The autopilot `ardupilot`: its plugin, and the engine of the physics that its options name."""

from __future__ import annotations

from collections.abc import Sequence

from skyrange.vehicle.ardupilot.lockstep_fleet import LockstepFleet
from skyrange.vehicle.ardupilot.native_fleet import NativeFleet
from skyrange.vehicle.ardupilot.options import Options
from skyrange.vehicle.ardupilot.process_fleet import ProcessFleet
from skyrange.vehicle.contract import AutopilotContext, AutopilotPlugin


def _make(options: Options, context: AutopilotContext) -> ProcessFleet:
    kind = NativeFleet if options.physics == "native" else LockstepFleet
    return kind(context.name, context.specs, context.origin, context.epoch, options)


def _opened_ports(options: Options, count: int) -> Sequence[int]:
    return options.opened(count)


def _reads_sensors(options: Options) -> bool:
    return options.physics == "shared"


ARDUPILOT = AutopilotPlugin(
    Options,
    _make,
    "Runs ArduPilot's ArduCopter, one process per aircraft.",
    signs=True,
    reads_sensors=_reads_sensors,
    opened_ports=_opened_ports,
)
"""The autopilot `ardupilot`. Raises `InputError` as `ProcessFleet` does."""
