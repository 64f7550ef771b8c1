"""Compilation of numeric functions with numba: cached by the code itself, IEEE-exact, single-threaded.

There is no fastmath and no parallel reduction, because the bytes of a run must be the same whatever the load.

numba's cache notices a change in a function's own file, but not in compiled functions of other files that it calls, and
would go on with their old code. One change in a file makes it compile all functions of the file. Here the files of a
function are named after its key instead, which covers what is compiled and nothing else. Several
versions of skyrange can therefore share a folder.

numba's cache is not made for several processes that fill it at once, as those of a live range do; `_Cache` is.

A key covers the bytecode of the function with the constants that it loads, its defaults, its closure, its options, the
values of its global names, and all this of every compiled function that it calls, directly or not. It does not cover
comments, docstrings, line numbers, or the place and the time of a file.

Keys are computed from the loaded functions and not from their files, because a file may be edited after it was loaded.
"""

from __future__ import annotations

import builtins
import dis
import fcntl
import inspect
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache, cached_property
from hashlib import blake2b
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, Final, NamedTuple, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, _CacheLocator
from numba.core.dispatcher import Dispatcher
from numba.core.sigutils import normalize_signature
from numba.core.types import ExternalFunction

_PACKAGE: Final = __name__.partition(".")[0]
_EXTENDED: Final = dis.EXTENDED_ARG
_LOAD_GLOBAL: Final = dis.opmap["LOAD_GLOBAL"]
_LOADS_CONSTANT: Final = frozenset(dis.hasconst)
_VERSIONS: Final = f"python {sys.version_info[:2]}, numba {numba.__version__}, numpy {np.__version__}"


class _Description(NamedTuple):
    """Digest of a function without its callees, and these in the order in which the digest names them."""

    digest: bytes
    callees: tuple[Dispatcher, ...]


def compute_key(function: Dispatcher, *, anew: bool = False) -> str:
    """The key of a compiled function. `anew` reads all values again; otherwise each function is read once.

    Raises `TypeError` for a global name with a value that has no digest.
    """
    describe = _describe if anew else _describe_once
    numbers = {function: 0}
    reached = [function]
    digest = blake2b(_VERSIONS.encode(), digest_size=12)
    for dispatcher in reached:  # grows: a cycle of calls ends because each function is reached once
        description = describe(dispatcher)
        digest.update(description.digest)
        for callee in description.callees:
            if callee not in numbers:
                numbers[callee] = len(reached)
                reached.append(callee)
            digest.update(numbers[callee].to_bytes(4, "little"))
    return digest.hexdigest()


def find_callees(function: Dispatcher) -> tuple[Dispatcher, ...]:
    """The compiled functions that a compiled function names, each as often as it does."""
    return _describe_once(function).callees


def _describe(dispatcher: Dispatcher) -> _Description:
    function = dispatcher.py_func
    callees: list[Dispatcher] = []
    known = function.__globals__
    try:
        parts = (
            _name(function),
            sorted((name, str(value)) for name, value in dispatcher.targetoptions.items()),
            _describe_code(function.__code__, known, callees),
            _describe_value(function.__defaults__, known, callees),
            _describe_value(tuple((function.__kwdefaults__ or {}).items()), known, callees),
            _describe_value(tuple(cell.cell_contents for cell in function.__closure__ or ()), known, callees),
        )
    except TypeError as error:
        raise TypeError(
            f"compiled function {_name(function)}: {error}; expected compiled functions, numbers, strings, arrays, "
            "tuples of these, NamedTuple classes, modules, and functions and types of other packages; pass the value "
            "as an argument"
        ) from None
    return _Description(blake2b(repr(parts).encode(), digest_size=16).digest(), tuple(callees))


_describe_once = cache(_describe)


def _describe_code(code: CodeType, known: dict[str, Any], callees: list[Dispatcher]) -> tuple[Any, ...]:
    """The code, and the constants and global values that it loads. It does not load its docstring."""
    loaded: list[Any] = []
    for operation, argument in _operations(code.co_code):
        if operation in _LOADS_CONSTANT:
            loaded.append(_describe_value(code.co_consts[argument], known, callees))
        elif operation == _LOAD_GLOBAL:
            name = code.co_names[argument >> 1]  # the lowest bit is a flag
            try:
                loaded.append(_describe_global(name, code, known, callees))
            except TypeError as error:
                raise TypeError(f"global {name}: {error}") from None
    shape = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags)
    names = (code.co_names, code.co_varnames, code.co_cellvars, code.co_freevars)
    return code.co_code, code.co_exceptiontable, shape, names, loaded


def _operations(code: bytes) -> Iterator[tuple[int, int]]:
    high = 0
    for operation, low in zip(code[::2], code[1::2], strict=True):
        argument = high | low
        high = argument << 8 if operation == _EXTENDED else 0
        yield operation, argument


def _describe_global(name: str, code: CodeType, known: dict[str, Any], callees: list[Dispatcher]) -> Any:
    if name not in known:
        return _describe_value(getattr(builtins, name, None), known, callees)
    value = known[name]
    if isinstance(value, ModuleType) and _is_own(value.__name__):
        return _describe_module(value, code, known, callees, frozenset())
    return _describe_value(value, known, callees)


def _describe_module(
    module: ModuleType, code: CodeType, known: dict[str, Any], callees: list[Dispatcher], within: frozenset[str]
) -> Any:
    """What a code may read of a module of this package: the names of the module that the code has too."""
    attributes: list[Any] = []
    for name in code.co_names:
        value = vars(module).get(name)
        if isinstance(value, ModuleType) and _is_own(value.__name__):
            if value.__name__ not in within:
                inner = _describe_module(value, code, known, callees, within | {module.__name__})
                attributes.append((name, inner))
        elif name in vars(module):
            attributes.append((name, _describe_value(value, known, callees)))
    return module.__name__, attributes


def _describe_value(value: Any, known: dict[str, Any], callees: list[Dispatcher]) -> Any:
    """Text, bytes, and tuples and lists of these, which differ whenever numba would compile something else."""
    kind = type(value)
    if value is None or value is Ellipsis or kind in (bool, int, float, complex, str, bytes):
        return kind.__name__, repr(value)
    if isinstance(value, Dispatcher):
        callees.append(value)
        return "compiled", _name(value.py_func)
    if kind is CodeType:
        return _describe_code(value, known, callees)
    if isinstance(value, tuple):
        return "tuple", _name(kind), [_describe_value(item, known, callees) for item in value]
    if kind is slice:  # a constant from Python 3.14 on
        parts = value.start, value.stop, value.step
        return "slice", [_describe_value(part, known, callees) for part in parts]
    if kind is frozenset:  # that of `x in {1, 2}`
        return "set", sorted(repr(_describe_value(item, known, callees)) for item in value)
    if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
        layout = value.flags.c_contiguous, value.flags.f_contiguous, value.flags.aligned
        return "array", _name(kind), repr(value.dtype), value.shape, layout, blake2b(value.tobytes()).digest()
    if isinstance(value, ExternalFunction):
        return "external", value.symbol, repr(value.sig)
    if kind is ModuleType and not _is_own(value.__name__):
        return "module", value.__name__
    if isinstance(value, type) and issubclass(value, tuple) and (fields := getattr(value, "_fields", None)):
        defaults = tuple(getattr(value, "_field_defaults", {}).items())
        return "named tuple", _name(value), fields, _describe_value(defaults, known, callees)
    other = isinstance(value, type | FunctionType | BuiltinFunctionType | np.ufunc)
    if other and not _is_own(getattr(value, "__module__", None) or ""):
        return kind.__name__, _name(value)
    raise TypeError(f"{value!r} of type {kind.__name__} has no digest")


def _is_own(module: str) -> bool:
    return module.partition(".")[0] == _PACKAGE


def _name(value: Any) -> str:
    return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', value.__name__)}"


P = ParamSpec("P")
R = TypeVar("R")

_UNUSED_S: Final = 5 * 86_400
"""How long code of another version of a function is kept after its last use."""


class _Locator(_CacheLocator):
    """The folder of all functions. numba's other means against old code have no part: the key is in the file's name."""

    def __init__(self, file: str) -> None:
        self._py_file = file  # numba warns with it about a function that cannot be cached

    def get_cache_path(self) -> str:
        return cache_folder()

    def get_source_stamp(self) -> str:
        return ""

    def get_disambiguator(self) -> str:
        return ""


class _Files(CompileResultCacheImpl):
    """The names of a function's files, computed when one is first wanted."""

    def __init__(self, dispatcher: Any) -> None:
        function = dispatcher.py_func
        self._lineno = function.__code__.co_firstlineno
        self._locator = _Locator(inspect.getfile(function))
        self.key = compute_key(dispatcher)
        self.stem = f"{function.__module__}.{function.__qualname__}-".replace("<", "").replace(">", "")
        self._filename_base = f"{self.stem}{self.key}.py{sys.version_info[0]}{sys.version_info[1]}"


class _IndexFile(IndexDataCacheFile):
    """A function's index. One that names a class which has been moved or removed since counts as empty."""

    def _load_index(self) -> Any:
        try:
            return super()._load_index()  # type: ignore[no-untyped-call]
        except (AttributeError, ImportError):  # the class of a named tuple among the arguments
            return {}


class _Cache(FunctionCache):
    """numba's cache of one function, for any number of processes and versions of the function at once.

    numba numbers the files of a function's signatures in an index that it reads, extends and writes back. Two processes
    that do so together give one number to two signatures, and the index then leads from one signature to the code of
    the other. When called, that code computes on its arguments as if they were of other types; and since it is never
    the code that was asked for, it is loaded again at every call, 10 ms and 60 kB each time.
    """

    def __init__(self, dispatcher: Any) -> None:
        self._dispatcher = dispatcher
        self._py_func = getattr(dispatcher, "py_func", dispatcher)  # NUMBA_DISABLE_JIT leaves the function as it is
        self._name = repr(self._py_func)
        self.enable()  # type: ignore[no-untyped-call]

    @cached_property
    def _impl(self) -> _Files:
        return _Files(self._dispatcher)

    @cached_property
    def _cache_file(self) -> IndexDataCacheFile:  # type: ignore[override]  # nobody sets it
        return _IndexFile(self.cache_path, self._impl.filename_base, "")  # type: ignore[no-untyped-call]

    @property
    def cache_path(self) -> str:
        """The folder of the function's files; "" if there is none."""
        return cache_folder()

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code `data` of the signature `sig`, one process after the other.

        Code is not kept if a value that it was compiled with has changed since the key was computed.
        """
        if not self.cache_path or compute_key(self._dispatcher, anew=True) != self._impl.key:
            return
        self._impl.locator.ensure_cache_path()
        with (Path(self.cache_path) / ".lock").open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # released when the file is closed or its process has died
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
            self._touch()
            _remove_unused(self.index, self._impl.stem)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The cached code of `sig`; None if there is none or it is another signature's, so that it is compiled anew."""
        if not self.cache_path:
            return None
        overload: Any = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        if overload is None:
            return None
        self._touch()
        requested, _ = normalize_signature(sig)  # type: ignore[no-untyped-call]
        return overload if tuple(overload.signature.args) == tuple(requested) else None

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, Any, Any]:
        """Numba's key of a signature, and the fields of its named tuples: a class of another order is another type."""
        arguments, processor, code = super()._index_key(sig, codegen)  # type: ignore[no-untyped-call]
        return arguments, processor, (code, _list_fields(arguments))

    def find_signatures(self, processor: Any) -> frozenset[tuple[Any, ...]]:
        """The types of arguments for which there is code for a processor, which numba describes."""
        entries: Any = self._cache_file._load_index()  # type: ignore[no-untyped-call]
        return frozenset(
            arguments
            for arguments, made_for, (_, fields) in entries
            if made_for == processor and fields == _list_fields(arguments)
        )

    @property
    def index(self) -> Path:
        """The file that names those of the signatures."""
        return Path(self.cache_path) / f"{self._impl.filename_base}.nbi"

    def _touch(self) -> None:
        """Set the time of the index, which tells that the function's files are used."""
        with suppress(OSError):
            os.utime(self.index)


def _list_fields(arguments: Sequence[Any]) -> tuple[tuple[str, ...], ...]:
    """The fields of all named tuples among types of arguments, which numba knows by their class alone."""
    field_names: list[tuple[str, ...]] = []
    for kind in arguments:
        if isinstance(kind, numba.types.NamedTuple | numba.types.NamedUniTuple):
            field_names.append(tuple(kind.fields))
        if isinstance(kind, numba.types.BaseTuple):
            field_names += _list_fields(kind.types)  # type: ignore[attr-defined]
    return tuple(field_names)


def _remove_unused(index: Path, stem: str) -> None:
    """Remove files of other versions of a function, and folders of earlier caches, that nobody has used for days."""
    with suppress(OSError):
        last = index.stat().st_mtime - _UNUSED_S
        for other in [path for path in index.parent.iterdir() if path.name.startswith(stem) and path.suffix == ".nbi"]:
            if other.stat().st_mtime < last:
                for file in index.parent.glob(f"{other.stem}.*"):
                    file.unlink(missing_ok=True)
        for folder in index.parent.parent.glob("kernels-*"):
            if folder.stat().st_mtime < last:
                shutil.rmtree(folder, ignore_errors=True)


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` with numba when first called; keeps its Python type for checkers. It runs without the GIL."""
    return _compile(function, inline=False)


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` as `compiled` does, and insert its code into every compiled function that calls it.

    A loop with a call in it is not turned into vector instructions.
    """
    return _compile(function, inline=True)


def _compile(function: Callable[P, R], *, inline: bool) -> Callable[P, R]:
    njit: Any = numba.njit  # whose stubs lack some options
    dispatcher = njit(
        fastmath=False,
        error_model="numpy",
        nogil=True,
        forceinline=inline,
        no_cfunc_wrapper=True,  # nothing is called from C: compilation takes a tenth less
    )(function)
    dispatcher._cache = _Cache(dispatcher)  # as cache=True does with numba's own
    return cast("Callable[P, R]", dispatcher)


def find_cached(function: Any) -> frozenset[tuple[Any, ...]]:
    """The types of arguments for which the cache has this version of a compiled function, for this processor."""
    if not cache_folder():
        return frozenset()
    signatures: frozenset[tuple[Any, ...]] = function._cache.find_signatures(function.targetctx.codegen().magic_tuple())
    return signatures


def list_compiled() -> frozenset[str]:
    """The names of the files of compiled functions in the cache, one for each signature."""
    folder = cache_folder()
    return frozenset(file.name for file in Path(folder).glob("*.nbc")) if folder else frozenset()


@cache
def cache_folder() -> str:
    """The folder of compiled functions: beside the package, else with the user; "" if neither is writable."""
    user = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "skyrange"
    for home in (Path(__file__).parent.parent / "__pycache__", user):
        if not home.is_absolute():
            continue  # the system does not know the user, so there is no home directory
        folder = home / "kernels"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return str(folder)
    return ""
