"""Compilation of an engine from skyrange's sources, and a trial of the result."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from skyrange.codec.medium_protocol import (
    NOISE,
    PATH,
    TRANSMISSION,
    Advance,
    EngineRadio,
    Hello,
    MessageType,
    decode_done,
    decode_ready,
    encode_advance,
    encode_hello,
)
from skyrange.contracts.medium import ReceptionOutcome, Waveform
from skyrange.core.errors import ComponentError, DecodeError, InputError
from skyrange.core.time import NS_PER_MS
from skyrange.io.processes.engine_socket import EngineSocket
from skyrange.io.processes.single_run import run_once
from skyrange.radio.external.engine_sources import engine_folder, source_digest

COMPILE_S: Final = 1_800.0
"""Wall time in which a compiler must end, in seconds."""
TRIAL_S: Final = 60.0
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
            return CompiledEngine(program, *try_engine(who, [str(program)]), False)
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


def try_engine(who: str, command: Sequence[str]) -> tuple[str, str]:
    """Let an engine send one frame from one radio to another; its name and release.

    Raises `ComponentError` if it does not greet, or if the frame is not received.
    """
    engine = EngineSocket(who, command, TRIAL_S)
    try:
        radios = [EngineRadio("one", 1, 7.0), EngineRadio("two", 2, 7.0)]
        kind, body = engine.request(MessageType.HELLO, encode_hello(Hello(1, 1000.0, False, radios)))
        if kind != MessageType.READY:
            raise ComponentError(who, f"answered {kind.name} instead of READY")
        ready = decode_ready(body)
        frames, paths = np.zeros(1, dtype=TRANSMISSION), np.zeros(1, dtype=PATH)
        frames[0] = (7, NS_PER_MS, 15.0, 0, 200, Waveform.OFDM_6M, 6, 0, 1, 0)
        paths[0] = (-60.0, 1, 0)
        places = np.array([(0.0, 0.0, 10.0), (10.0, 0.0, 10.0)])
        advance = Advance(20 * NS_PER_MS, 0, places, frames, np.zeros(0, dtype=NOISE), paths)
        kind, body = engine.request(MessageType.ADVANCE, encode_advance(advance))
        if kind != MessageType.DONE:
            raise ComponentError(who, f"answered {kind.name} instead of DONE")
        heard = decode_done(body).heard
        if heard["key"].tolist() != [7] or heard["outcome"][0] != ReceptionOutcome.DECODED:
            raise ComponentError(who, "does not receive a frame over 10 m")
        return ready.name, ready.release
    except DecodeError as error:
        raise ComponentError(who, f"sent {error}") from None
    finally:
        engine.close()
