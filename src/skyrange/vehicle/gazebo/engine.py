"""The autopilot `gazebo`: its plugin."""

from __future__ import annotations

from collections.abc import Sequence

from skyrange.vehicle.ardupilot.engine import shared_battery
from skyrange.vehicle.contract import AutopilotContext, AutopilotPlugin
from skyrange.vehicle.gazebo.fleet import GazeboFleet
from skyrange.vehicle.gazebo.options import GazeboOptions


def _make(options: GazeboOptions, context: AutopilotContext) -> GazeboFleet:
    return GazeboFleet(context, options)


def _opened_ports(options: GazeboOptions, count: int) -> Sequence[int]:
    return options.opened(count)


GAZEBO = AutopilotPlugin(
    GazeboOptions,
    _make,
    "Runs ArduPilot's ArduCopter, one process per aircraft, in the physics of Gazebo.",
    signs=True,
    opened_ports=_opened_ports,
    other_battery=shared_battery,
)
"""The autopilot `gazebo`. Raises `InputError` as `GazeboFleet` does."""
