"""Compiled program of a radio engine: found by variable, or among those that were compiled."""

from __future__ import annotations

import os
from pathlib import Path

from skyrange.core.engine_sources import engine_folder, source_digest
from skyrange.core.errors import InputError
from skyrange.core.files import expand_user


def find_engine(name: str, title: str, variable: str, install: str) -> Path:
    """The compiled program of an engine: the file that `variable` names, else the one compiled last from these sources.

    Raises `InputError` in the name of `title`, with the command `install`, if there is none.
    """
    hint = f"Compile it: {install}"
    named = os.environ.get(variable)
    if named:
        path = expand_user(named)
        if not os.access(path, os.X_OK) or path.is_dir():
            raise InputError.one(variable, "path", named, "an executable file", hint)
        return path
    folder = engine_folder(name)
    digest = source_digest(name)[:16]
    programs = [path for path in folder.glob(f"{digest}-*/engine") if os.access(path, os.X_OK)]
    if programs:
        return max(programs, key=lambda path: path.stat().st_mtime_ns)
    older = any(folder.glob("*/engine"))
    value = "compiled from sources of another version of skyrange" if older else "not compiled yet"
    raise InputError.one(title, "radio.engine", value, "its engine program", hint)
