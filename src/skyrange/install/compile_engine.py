"""Compilation of a radio engine from skyrange's sources."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from skyrange.install.compilation import compile_sources
from skyrange.radio.external.engine import try_engine


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
