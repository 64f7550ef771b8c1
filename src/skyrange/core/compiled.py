"""Compilation of numeric functions with numba: cached, IEEE-exact, single-threaded.

There is no fastmath and no parallel reduction, because the bytes of a run must be the same whatever the load.

numba's cache notices a change in a function's own file, but not in compiled functions of other files that it calls, and
would go on with their old code. So the cache's folder is named after the text of all modules with compiled functions
together: when one changes, all are compiled anew.

numba's cache is not made for several processes that fill it at once, as those of a live range do; `_Shared` is.
"""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Callable
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
from numba.core import config as numba_config
from numba.core.caching import FunctionCache
from numba.core.sigutils import normalize_signature

P = ParamSpec("P")
R = TypeVar("R")

config: Any = numba_config

_MARK = re.compile(rb"skyrange\.core\.compiled import (compiled|inlined)\b")


class _Shared(FunctionCache):
    """numba's cache of one function, for any number of processes at once.

    numba numbers the files of a function's signatures in an index that it reads, extends and writes back. Two processes
    that do so together give one number to two signatures, and the index then leads from one signature to the code of
    the other. When called, that code computes on its arguments as if they were of other types; and since it is never
    the code that was asked for, it is loaded again at every call, 10 ms and 60 kB each time.
    """

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code `data` of the signature `sig`, one process after the other."""
        self._impl.locator.ensure_cache_path()
        with (Path(self.cache_path) / ".lock").open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # released when the file is closed or its process has died
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The cached code of `sig`; None if there is none or it is another signature's, so that it is compiled anew."""
        found: Any = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        asked, _ = normalize_signature(sig)  # type: ignore[no-untyped-call]
        return found if found is not None and tuple(found.signature.args) == tuple(asked) else None


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` with numba when first called; keeps its Python type for checkers. It runs without the GIL."""
    return _compile(function, inline=False)


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` as `compiled` does, and insert its code into every compiled function that calls it.

    A loop with a call in it is not turned into vector instructions.
    """
    return _compile(function, inline=True)


def _compile(function: Callable[P, R], inline: bool) -> Callable[P, R]:
    before = config.CACHE_DIR
    config.CACHE_DIR = _cache_folder() or before  # read while decorating, so it need not stay
    try:
        dispatcher: Any = numba.njit(fastmath=False, error_model="numpy", nogil=True, forceinline=inline)(function)
        dispatcher._cache = _Shared(function)  # type: ignore[no-untyped-call]  # as cache=True does with numba's own
        return cast("Callable[P, R]", dispatcher)
    finally:
        config.CACHE_DIR = before


def compiled_before() -> bool:
    """Whether this version's functions were compiled here before; if not, the first run takes some seconds longer."""
    folder = _cache_folder()
    return bool(folder) and any(Path(folder).rglob("*.nbi"))


def count_compiled() -> int:
    """The number of compiled functions in the cache, each signature for itself; 0 if numba chooses its folder."""
    folder = _cache_folder()
    return sum(1 for _ in Path(folder).rglob("*.nbc")) if folder else 0


@cache
def _cache_folder() -> str:
    """The folder of compiled functions: beside the package, else with the user; "" leaves it to numba."""
    package = Path(__file__).parent.parent
    digest = blake2b(digest_size=8)
    for path in sorted(package.rglob("*.py")):
        text = path.read_bytes()
        if _MARK.search(text) or path == Path(__file__):
            digest.update(text)
    user = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "skyrange"
    for home in (package / "__pycache__", user):
        if not home.is_absolute():
            continue  # the system does not know the user, so there is no home directory
        folder = home / f"kernels-{digest.hexdigest()}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return str(folder)
    return ""
