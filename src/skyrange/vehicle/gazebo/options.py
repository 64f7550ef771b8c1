"""Scenario options of aircraft in Gazebo: the table `[autopilots.options.gazebo]`."""

from __future__ import annotations

from pydantic import Field

from skyrange.vehicle.ardupilot.options import ProcessOptions


class GazeboOptions(ProcessOptions):
    """Options of Gazebo, and of the ArduPilot processes whose aircraft it moves."""

    window: bool = Field(default=False, description="Whether to open Gazebo's window beside it.")
    steps_per_tick: int = Field(
        default=1,
        ge=1,
        le=20,
        description="Steps of Gazebo's physics in each of the range's ticks of 2.5 ms: 1 is 400 Hz, 5 is 2000 Hz.",
    )
    master_port: int = Field(
        default=0,
        ge=0,
        le=65_535,
        description="TCP port on 127.0.0.1 at which the master of Gazebo 11 listens, for gzclient and other clients of "
        "it; 0 chooses a free one. Gazebo Sim has no master.",
    )
