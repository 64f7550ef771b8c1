"""The autopilot `ardupilot`: its plugin, and the engine of the physics that its options name."""

from __future__ import annotations

from collections.abc import Sequence

from skyrange.vehicle.ardupilot.arducopter_binary import BATTERY, find_binary
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


def shared_battery(_options: object) -> str:
    """Which battery an ArduPilot in lockstep measures instead of the world's: SITL's, if the build takes no other.

    Raises `InputError` as `find_binary` does.
    """
    binary = find_binary()
    if BATTERY in binary.capabilities:
        return ""
    return (
        f"ArduCopter {binary.version} measures SIM_BATT_VOLTAGE (12.6 V) and 0 A, because its JSON backend takes no "
        "battery. No battery failsafe acts before the world's battery is empty and stops the motors"
    )


def _other_battery(options: Options) -> str:
    if options.physics == "native":
        return "ArduPilot's own simulation (native physics) has a battery of its own"
    return shared_battery(options)


ARDUPILOT = AutopilotPlugin(
    Options,
    _make,
    "Runs ArduPilot's ArduCopter, one process per aircraft.",
    signs=True,
    reads_sensors=_reads_sensors,
    opened_ports=_opened_ports,
    other_battery=_other_battery,
)
"""The autopilot `ardupilot`. Raises `InputError` as `ProcessFleet` does."""
