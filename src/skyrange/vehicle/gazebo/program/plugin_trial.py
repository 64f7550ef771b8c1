"""Trial of the plugin: Gazebo loads it in an empty world."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Final

from skyrange.io.gazebo import take_port, wait_for_plugin
from skyrange.vehicle.gazebo.program.gazebo_commands import Gazebo
from skyrange.vehicle.gazebo.program.plugin_library import LOADED, PLUGIN_NAME

TRIAL_S: Final = 60.0
"""Wall time within which Gazebo must have loaded the plugin, in seconds; it takes one to five."""
_WORLD: Final = """<?xml version="1.0"?>
<sdf version="1.6"><world name="trial"><plugin name="{name}" filename="{library}"/></world></sdf>
"""


def try_plugin(who: str, gazebo: Gazebo, library: Path) -> None:
    """Let `gazebo` load the plugin `library` in an empty world; it has ended when this returns.

    Raises `ComponentError` in the name of `who` if it does not load it within `TRIAL_S`.
    """
    port = take_port(0, "port")
    world = _WORLD.format(name=PLUGIN_NAME, library=escape(str(library.absolute())))
    wait_for_plugin(who, gazebo.title, lambda file: gazebo.server_command(file, port=port), world, LOADED, TRIAL_S)
