"""Compilation of an engine from skyrange's sources."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from skyrange.core.engine_sources import engine_folder, source_digest
from skyrange.core.errors import ComponentError, InputError
from skyrange.io.processes.single_run import run_once
from skyrange.radio.external.engine_trial import try_engine

COMPILE_S: Final = 1_800.0
"""Wall time in which a compiler must end, in seconds."""
DATA_SUFFIXES: Final = (".ned", ".ini")
"""Sources that an engine reads when it runs; they are kept beside it."""


class CompiledEngine(NamedTuple):
    """An engine that was compiled and tried."""

    path: Path
    name: str
    release: str
    compiled_now: bool
    """False if it was there already."""


def find_compiler(who: str) -> Path:
    """The C++ compiler: that of the variable CXX, else `g++`, else `c++`. Raises `InputError` if there is none."""
    for name in filter(None, (os.environ.get("CXX"), "g++", "c++")):
        found = shutil.which(name)
        if found is not None:
            return Path(found)
    raise InputError.one(who, "compiler", "no g++", "a C++ compiler", "On Debian: sudo apt-get install g++")


def compile_engine(name: str, who: str, flags: Sequence[str], sources: Sequence[Path]) -> CompiledEngine:
    """Compile and link an engine with `flags`, try it, and keep it in the user's folder under the digest of both.

    Raises `InputError` without a compiler, and `ComponentError` if it cannot be compiled or does not answer.
    """
    compiler = find_compiler(who)
    key = hashlib.sha256("\0".join([str(compiler), *flags]).encode()).hexdigest()[:8]
    folder = engine_folder(name) / f"{source_digest(name)[:16]}-{key}"
    program = folder / "engine"
    if os.access(program, os.X_OK):
        try:
            found = try_engine(who, [str(program)])
            program.touch()  # `find_engine` takes the one that was installed last
            return CompiledEngine(program, *found, False)
        except ComponentError:
            program.unlink()  # the libraries that it was linked with have changed
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".new-", dir=folder.parent) as scratch:
            fresh = Path(scratch) / "engine"
            arguments = [*(str(source) for source in sources if source.suffix == ".cc"), "-o", str(fresh), *flags]
            result = run_once(compiler, *arguments, deadline_s=COMPILE_S, who=who)
            if result.ended != "exit 0":
                output = result.text.splitlines()
                lines = [line for line in output if "error" in line or "undefined" in line] or output
                raise ComponentError(who, f"cannot be compiled ({result.ended}): {' | '.join(lines[:3])}")
            data = [source for source in sources if source.suffix in DATA_SUFFIXES]
            for source in data:
                shutil.copyfile(source, Path(scratch) / source.name)
            found = try_engine(who, [str(fresh)])
            folder.mkdir(exist_ok=True)
            for source in data:
                (Path(scratch) / source.name).replace(folder / source.name)
            fresh.replace(program)
    except OSError as error:
        problem = (error.strerror or str(error)).lower()
        hint = "Set XDG_DATA_HOME to use another folder."
        raise InputError.one("data folder", str(folder), problem, "a writable folder", hint) from None
    return CompiledEngine(program, *found, True)
