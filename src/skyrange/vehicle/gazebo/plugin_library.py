"""Compiled plugin of skyrange for Gazebo: found by variable or among those that were compiled, and tried.

In its trial, Gazebo loads it in an empty world.
"""

from __future__ import annotations

import os
import re
from html import escape
from pathlib import Path
from typing import Final

from skyrange.core.engine_sources import engine_folder, source_digest, source_files
from skyrange.core.errors import InputError
from skyrange.core.files import MIB, expand_user, read_input
from skyrange.io.gazebo import take_port, wait_for_plugin
from skyrange.vehicle.gazebo.gazebo_program import Flavour, Gazebo

VARIABLE: Final = "SKYRANGE_GAZEBO_PLUGIN"
"""Environment variable with the path of the compiled plugin; it precedes those in the user's data folder."""
NAME: Final = "gazebo"
"""Name of the folder of sources, and of that of compiled plugins."""
LIBRARY: Final = "libskyrange_gazebo.so"
PLUGIN_NAME: Final = "skyrange"
"""The plugin's name in a world; Gazebo Sim requires that the library declares it (GZ_ADD_PLUGIN_ALIAS)."""
LOADED: Final = "skyrange: it has not started this Gazebo"
"""What the plugin says as soon as a Gazebo without skyrange has made it."""
INSTALL: Final = "skyrange install gazebo"
MAX_BYTES: Final = 256 * MIB
"""A larger file is no plugin; that of a release build has some 500 kB."""
_EXPECTED: Final = "a compiled plugin, a shared library"
_NEEDED: Final = re.compile(rb"\0lib(?:gazebo(?:_[a-z]+)?|(?P<sim>gz-sim)\d*)\.so\.(?P<major>\d{1,3})(?=\0)")
"""Names of Gazebo's libraries, as the dynamic section of a program that needs them spells them."""


def plugin_sources(flavour: Flavour) -> list[Path]:
    """The sources of the plugin for a flavour: all but those whose names begin with that of the other flavour."""
    others = tuple(f"{other}_" for other in Flavour if other != flavour)
    return [file for file in source_files(NAME) if not file.name.startswith(others) and file.parent.name == NAME]


def find_plugin(gazebo: Gazebo) -> Path:
    """The plugin for `gazebo`: that of SKYRANGE_GAZEBO_PLUGIN, else the one compiled last from these sources.

    Raises `InputError`, with the command that compiles it, if there is none.
    """
    hint = f"Compile it: {INSTALL}"
    named = os.environ.get(VARIABLE)
    if named:
        path = expand_user(named).absolute()
        builds = _linked_builds(path, hint)
        if builds and gazebo.build not in builds:
            value = f"{named}, linked with {', '.join(sorted(builds))}"
            raise InputError.one(VARIABLE, "path", value, f"a plugin for {gazebo.title} ({gazebo.build})", hint)
        return path
    folder = engine_folder(NAME)
    digest = source_digest(NAME)[:16]
    libraries = list(folder.glob(f"{digest}-{gazebo.build}-*/{LIBRARY}"))
    if libraries:
        return max(libraries, key=lambda path: path.stat().st_mtime_ns)
    others = sorted({path.parent.name.split("-")[1] for path in folder.glob(f"{digest}-*/{LIBRARY}")})
    if any(folder.glob(f"*-{gazebo.build}-*/{LIBRARY}")):
        value = "compiled from sources of another version of skyrange"
    elif others:
        value = f"compiled for another Gazebo ({', '.join(others)})"
    else:
        value = "not compiled yet"
    raise InputError.one("Gazebo", "plugin", value, f"skyrange's plugin for {gazebo.title} ({gazebo.build})", hint)


def _linked_builds(path: Path, hint: str) -> set[str]:
    """The builds of Gazebo (`Gazebo.build`) that a shared library is linked with."""
    data = read_input(path, VARIABLE, str(path), max_bytes=MAX_BYTES, expected=_EXPECTED)
    if not data.startswith(b"\x7fELF"):
        raise InputError.one(VARIABLE, "path", str(path), _EXPECTED, hint)
    return {
        f"{Flavour.SIM if match['sim'] else Flavour.CLASSIC}{int(match['major'])}" for match in _NEEDED.finditer(data)
    }


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
