"""Compilation of an engine's sources: found compiler, shortened errors, and a result that is kept once it was tried."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, Generic, NamedTuple, TypeVar

from skyrange.core.engine_sources import engine_folder, source_digest
from skyrange.core.errors import ComponentError, InputError
from skyrange.io.processes.program import run_once
from skyrange.radio.external.engine import try_engine

COMPILE_S: Final = 1_800.0
"""Wall time in which a compiler must end, in seconds."""
DATA_SUFFIXES: Final = (".ned", ".ini")
"""Sources that an engine reads when it runs; they are kept beside it."""
_MAX_LINES: Final = 3

Tried = TypeVar("Tried")


class Compiled(NamedTuple, Generic[Tried]):
    """A file that was compiled, what its trial returned, and False if it was there already."""

    path: Path
    tried: Tried
    compiled_now: bool


def find_compiler(who: str) -> Path:
    """The C++ compiler: that of the variable CXX, else `g++`, else `c++`. Raises `InputError` if there is none."""
    for name in filter(None, (os.environ.get("CXX"), "g++", "c++")):
        path = shutil.which(name)
        if path is not None:
            return Path(path)
    raise InputError.one(who, "compiler", "no g++", "a C++ compiler", "On Debian: sudo apt-get install g++")


def compile_sources(
    name: str,
    who: str,
    file: str,
    flags: Sequence[str],
    sources: Sequence[Path],
    try_it: Callable[[Path], Tried],
    *,
    build: str = "",
) -> Compiled[Tried]:
    """Compile and link `sources` with `flags` into a file named `file`, try it, and keep it in the user's folder.

    It is kept in a folder named after the digest of all sources of the engine `name`, after `build` (what it is for),
    and after the compiler and its flags. `try_it` gets the path and raises `ComponentError` if it is unusable.

    Raises `InputError` without a compiler, and `ComponentError` if it cannot be compiled or its trial fails.
    """
    compiler = find_compiler(who)
    key = hashlib.sha256("\0".join([str(compiler), *flags]).encode()).hexdigest()[:8]
    parts = (source_digest(name)[:16], build, key)
    folder = engine_folder(name) / "-".join(filter(None, parts))
    kept = folder / file
    if os.access(kept, os.X_OK):
        try:
            tried = try_it(kept)
            kept.touch()  # the one that was installed last is taken
            return Compiled(kept, tried, compiled_now=False)
        except ComponentError:
            kept.unlink()  # the libraries that it was linked with have changed
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".new-", dir=folder.parent) as scratch:
            fresh = Path(scratch) / file
            arguments = [*(str(source) for source in sources if source.suffix == ".cc"), "-o", str(fresh), *flags]
            _run_compiler(compiler, arguments, who)
            data = [source for source in sources if source.suffix in DATA_SUFFIXES]
            for source in data:
                shutil.copyfile(source, Path(scratch) / source.name)
            tried = try_it(fresh)
            folder.mkdir(exist_ok=True)
            for source in data:
                (Path(scratch) / source.name).replace(folder / source.name)
            fresh.replace(kept)
    except OSError as error:
        problem = (error.strerror or str(error)).lower()
        hint = "Set XDG_DATA_HOME to use another folder."
        raise InputError.one("data folder", str(folder), problem, "a writable folder", hint) from None
    return Compiled(kept, tried, compiled_now=True)


def _run_compiler(compiler: Path, arguments: Sequence[str], who: str) -> None:
    result = run_once(compiler, *arguments, deadline_s=COMPILE_S, who=who)
    if result.ended != "exit 0":
        output = result.text.splitlines()
        lines = [line for line in output if "error" in line or "undefined" in line] or output
        raise ComponentError(who, f"cannot be compiled ({result.ended}): {' | '.join(lines[:_MAX_LINES])}")


class CompiledEngine(NamedTuple):
    """An engine that was compiled and tried."""

    path: Path
    name: str
    release: str
    compiled_now: bool
    """False if it was there already."""


def compile_engine(name: str, who: str, flags: Sequence[str], sources: Sequence[Path]) -> CompiledEngine:
    """Compile and link an engine with `flags`, try it, and keep it in the user's folder under the digest of both.

    Raises `InputError` without a compiler, and `ComponentError` if it cannot be compiled or does not answer.
    """
    made = compile_sources(name, who, "engine", flags, sources, lambda program: try_engine(who, [str(program)]))
    return CompiledEngine(made.path, *made.tried, made.compiled_now)
