"""Loading of a plugin by a Gazebo: what it says of one that it cannot load, and the wait until it has loaded one."""

from __future__ import annotations

import re
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from skyrange.core.errors import ComponentError
from skyrange.io.processes.program import Program

WORLD: Final = "world.sdf"
_LOOK_S: Final = 0.05
_LINES: Final = 100
_COLOURS: Final = re.compile(r"\x1b\[[0-9;]*m")
_NO_LIBRARY: Final = "error while loading shared libraries"
_FAILURE: Final = re.compile(
    r"^.*(?:Failed to load (?:system )?plugin|Error while loading the library|Error parsing XML"
    r"|Failed to find plugin \[|Unable to load the \[.*\] library|No physics plugins|Failed to load .*physics engine"
    r"|Unable to read .*file|Unable to start server).*$",
    re.MULTILINE,
)
"""What Gazebo says of a plugin, physics engine, world, or port that it cannot use; without the first two it goes on."""


def find_load_failure(text: str) -> str:
    """The first line of Gazebo's output which says that it cannot load a plugin or its world; "" if there is none."""
    found = _FAILURE.search(_COLOURS.sub("", text))
    return found[0].strip() if found else ""


def wait_for_plugin(
    who: str, title: str, command: Callable[[Path], tuple[str, ...]], world: str, loaded: str, deadline_s: float
) -> None:
    """Start a Gazebo named `title` with the SDF text `world`, wait until it prints `loaded`, and kill it.

    `command` returns its command line for a file of the world. Raises `ComponentError` in the name of `who` if it does
    not start, ends early, says that it cannot load something, or has not printed `loaded` after `deadline_s` of wall
    time.
    """
    with tempfile.TemporaryDirectory(prefix="skyrange-gazebo-") as name:
        folder = Path(name)
        file = folder / WORLD
        file.write_text(world)
        program = Program(who, ("env", f"HOME={folder}", *command(file)), folder, is_wrapper=True)  # its logs go there
        try:
            _wait(who, title, program, loaded, deadline_s)
        finally:
            program.kill()


def _wait(who: str, title: str, program: Program, loaded: str, deadline_s: float) -> None:
    until = time.monotonic() + deadline_s
    while True:
        ended = program.ended
        said = _COLOURS.sub("", program.last_words(_LINES))
        if loaded in said:
            return
        failure = find_load_failure(said)
        if failure:
            raise ComponentError(who, f"{title} does not load it: {failure}")
        last = " | ".join(said.splitlines()[-3:]) or "it printed nothing"
        if ended:
            hint = "Set LD_LIBRARY_PATH to the folder of its libraries" if _NO_LIBRARY in said else ""
            raise ComponentError(who, f"{title} ended ({ended}) before it had loaded it: {last}", hint)
        if time.monotonic() > until:
            raise ComponentError(who, f"{title} has not loaded it within {deadline_s:g} s of wall time: {last}")
        time.sleep(_LOOK_S)
