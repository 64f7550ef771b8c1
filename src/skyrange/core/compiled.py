"""How is a numeric kernel compiled? One way for all: cached, IEEE-exact, single-threaded.

No fastmath and no parallel reductions, because a run's bytes must not depend on the machine's mood.

numba's cache notices a change in a kernel's own file, but not in the kernels it calls from other files,
and would go on with what those once were. So the cache's folder is named after the text of all kernel
modules together: change one, and all are compiled anew.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
from numba.core import config as numba_config

P = ParamSpec("P")
R = TypeVar("R")

config: Any = numba_config

_MARK = b"skyrange.core.compiled import kernel"


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` with numba when first called; keeps its Python type for checkers."""
    before = config.CACHE_DIR
    config.CACHE_DIR = _cache_folder() or before  # read while decorating, so it need not stay
    try:
        return cast("Callable[P, R]", numba.njit(cache=True, fastmath=False, error_model="numpy")(function))
    finally:
        config.CACHE_DIR = before


def compiled_before() -> bool:
    """Whether this version's kernels were compiled here before; if not, the first run takes some seconds longer."""
    folder = _cache_folder()
    return bool(folder) and any(Path(folder).rglob("*.nbi"))


@cache
def _cache_folder() -> str:
    """Where compiled kernels are kept: beside the package, else with the user; "" leaves it to numba."""
    package = Path(__file__).parent.parent
    digest = blake2b(digest_size=8)
    for path in sorted(package.rglob("*.py")):
        text = path.read_bytes()
        if _MARK in text:
            digest.update(text)
    user = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "skyrange"
    for home in (package / "__pycache__", user):
        if not home.is_absolute():
            continue  # nobody's home: a user that the system does not know
        folder = home / f"kernels-{digest.hexdigest()}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return str(folder)
    return ""
