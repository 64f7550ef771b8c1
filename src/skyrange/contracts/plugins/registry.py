"""Registry of plugins: the shape that all have, found by group and kind, in the homes of their groups.

A kind is one word or dotted words: `approve-all`, `remote_id.spoof`. Kinds that act or listen are classes with a
decorator, in a module that is named as they are, in a home of theirs, a notebook or a file of
`--plugin FILE`. Engines are offered by entry points (`[project.entry-points."skyrange.media"]`) or by `register`.
Nothing is imported until a kind is asked for by its name; a list of all imports all.
"""

from __future__ import annotations

import importlib.util
import keyword
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from pkgutil import walk_packages
from types import ModuleType
from typing import Any, ClassVar, Final, Generic, Self, TypeVar

from skyrange.contracts.params import Params
from skyrange.core.errors import ComponentError, InputError, Problem, SkyrangeError, nearest
from skyrange.core.files import MAX_TEXT_BYTES, expand_user, read_input

HOMES: Final[Mapping[str, str]] = {
    "skyrange.attacks": "skyrange.attack",
    "skyrange.defences": "skyrange.defence",
    "skyrange.detectors": "skyrange.detect",
    "skyrange.faults": "skyrange.fault",
}
"""The package of each group: `mavlink.mode` of `skyrange.attacks` is in `skyrange.attack.mavlink.mode`."""
PACKAGES: Final = "skyrange.plugins"
"""The entry point group of packages with kinds: with `acme = "acme_sky"`, `acme.lag` is in `acme_sky.lag`."""


def name_of_module(module: str) -> str | None:
    """The name of the kinds in a module below a home; `None` for a module elsewhere, where names are free."""
    for home, prefix in [*((home, "") for home in HOMES.values()), *_offered().items()]:
        if module.startswith(f"{home}."):
            path = module.removeprefix(f"{home}.")
            return prefix + ".".join(part.removesuffix("_") for part in path.split("."))
    return None


def import_home(group: str, kind: str) -> None:
    """Import the module that has a kind of this name, if there is one."""
    for module in _modules_of(group, kind):
        if _exists(module):
            _import(module)
            return


def import_all(group: str) -> None:
    """Import every module of the group's home, and of all packages that offer kinds."""
    for home in [*([HOMES[group]] if group in HOMES else []), *_offered()]:
        _import_below(home)


def _modules_of(group: str, kind: str) -> Iterator[str]:
    """The modules in which a kind may be."""
    path = ".".join(f"{part}_" if keyword.iskeyword(part) else part for part in kind.split("."))
    if group in HOMES:
        yield f"{HOMES[group]}.{path}"
    for package, prefix in _offered().items():
        if kind.startswith(prefix):
            yield f"{package}.{path.removeprefix(prefix)}"


def _exists(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # a package on the way
        return False


@cache
def _import_below(package: str) -> None:
    home = _import(package)
    for module_info in walk_packages(getattr(home, "__path__", ()), f"{package}."):
        if not module_info.name.endswith(".__main__"):
            _import(module_info.name)


def _import(module: str) -> ModuleType:
    """Import a module. What it raises is the fault of its package; `InputError` says already what is wrong."""
    try:
        return import_module(module)
    except SkyrangeError:
        raise
    except Exception as error:
        package = module.partition(".")[0]
        hint = f"Mend {package}, or remove it" if package != "skyrange" else "Reinstall skyrange"
        raise ComponentError(f"package {package}", f"cannot import {module}: {error!r}", hint) from error


@cache
def _offered() -> dict[str, str]:
    """The packages that offer kinds, and what the names of theirs begin with."""
    return {point.value: f"{point.name}." for point in entry_points(group=PACKAGES)}


APPROVALS = "skyrange.approvals"
ATTACKS = "skyrange.attacks"
AUTOPILOTS = "skyrange.autopilots"
AVOIDANCE = "skyrange.avoidance"
DEFENCES = "skyrange.defences"
DETECTORS = "skyrange.detectors"
FAULTS = "skyrange.faults"
MEDIA = "skyrange.media"
GROUPS = (APPROVALS, ATTACKS, AUTOPILOTS, AVOIDANCE, DEFENCES, DETECTORS, FAULTS, MEDIA)

KIND_PATTERN = re.compile(r"[a-z][a-z0-9]*(?:[-_][a-z0-9]+)*(?:\.[a-z][a-z0-9]*(?:[-_][a-z0-9]+)*)*")
"""Lower-case words joined by `-` or `_`, in parts joined by dots."""

ContextT = TypeVar("ContextT")
MadeT = TypeVar("MadeT")


class NoParams(Params):
    """No parameters."""


@dataclass(frozen=True, slots=True)
class Plugin(Generic[ContextT, MadeT]):
    """A plugin of any group. Each group has a subclass of its own, which says what `make` is told and what it makes.

    `make(params, context)` is called once for each object that a scenario asks for. It may raise `InputError` for
    parameters that do not fit the scenario; the problems' `where` is the parameter's name.
    """

    group: ClassVar[str] = ""
    """The entry point group, one of `GROUPS`."""

    params: type[Params]
    """The model of its parameters; `NoParams` for none."""
    make: Callable[[Any, ContextT], MadeT]
    about: str
    """A sentence: what it is or does."""
    source: str = field(default="", kw_only=True)
    """Where its class is, for errors; "" if it is none."""

    def __call__(self, params: Params, context: ContextT) -> MadeT:
        """Make one object, as `make` does."""
        return self.make(params, context)

    @classmethod
    def find(cls, kind: str) -> Self:
        """The plugin of this group that is called `kind`. Raises as `plugins.find`."""
        plugin = find(cls.group, kind)
        assert isinstance(plugin, cls)  # find has seen to it
        return plugin


_registered: dict[tuple[str, str], Plugin[Any, Any]] = {}
_at_home: dict[tuple[str, str], Plugin[Any, Any]] = {}
"""Those of modules in homes, as far as they are imported."""


@dataclass(frozen=True, slots=True)
class _LoadedFile:
    source: bytes
    offers: tuple[tuple[str, str], ...]


_loaded_files: dict[Path, _LoadedFile] = {}


def register(group: str, kind: str, plugin: Plugin[Any, Any], *, at_home: bool = False) -> None:
    """Offer `plugin` under `kind` in `group`, in this process; `at_home` if its module is in a home of kinds.

    It takes precedence over an entry point of the same kind. Raises InputError for an unknown group, a kind that
    breaks `KIND_PATTERN` or that another plugin was registered under, and for what is no plugin of that group.
    """
    _check_group(group)
    if not KIND_PATTERN.fullmatch(kind):
        raise InputError.one(
            "plugin", "kind", kind, "lower-case words joined by '-', '_' or '.', such as 'remote_id.spoof'"
        )
    _check_shape(group, kind, plugin)
    if not at_home:
        import_home(group, kind)
    offered = _at_home if at_home else _registered
    known = _at_home.get((group, kind)) or offered.setdefault((group, kind), plugin)
    if known is plugin:
        return
    if known.source and known.source == plugin.source and known.source.endswith(" in __main__"):
        _registered[group, kind] = plugin  # a cell of a notebook that runs again
        return
    taken = f"{kind} of {plugin.source}" if plugin.source else kind
    hint = f"{known.source} has it. Choose another name." if known.source else "Choose another name."
    raise InputError.one("plugin", "kind", taken, f"a kind that is free in {group}", hint)


def kinds(group: str) -> tuple[str, ...]:
    """Every kind of `group`, sorted. Imports those that are classes. Raises InputError for an unknown group."""
    _check_group(group)
    import_all(group)
    offered = {kind for of, kind in (*_registered, *_at_home) if of == group}
    return tuple(sorted(offered | _entry_points(group).keys()))


def is_known(group: str, kind: str) -> bool:
    """Whether somebody offers a plugin of `kind`; imports its module alone."""
    _check_group(group)
    return _find_registered(group, kind) is not None or kind in _entry_points(group)


def find(group: str, kind: str) -> Plugin[Any, Any]:
    """The plugin of `kind`, imported now from its home or from what an entry point names.

    Raises InputError for a kind that nobody offers (with the nearest spelling) and for an entry point that names no
    plugin of the group; ComponentError when the package that offers it cannot be imported.
    """
    _check_group(group)
    plugin = _find_registered(group, kind)
    if plugin is not None:
        return plugin
    point = _entry_points(group).get(kind)
    if point is None:
        raise InputError.one("plugin", group, kind, "a kind that is installed", nearest(kind, kinds(group)))
    try:
        loaded: Plugin[Any, Any] = point.load()
    except (ImportError, AttributeError) as error:
        raise ComponentError(
            f"plugin {kind}", f"cannot import {point.value}: {error}", "Reinstall the package that provides it"
        ) from error
    _check_shape(group, kind, loaded)
    return loaded


def _find_registered(group: str, kind: str) -> Plugin[Any, Any] | None:
    """The plugin that is registered, or that its home registers when it is imported."""
    known = _registered.get((group, kind)) or _at_home.get((group, kind))
    if known is None and KIND_PATTERN.fullmatch(kind):
        import_home(group, kind)
        known = _at_home.get((group, kind))
    return known


def load_file(file: str | Path) -> tuple[tuple[str, str], ...]:
    """Run a Python file with kinds or calls of `register`; returns (group, kind) of each plugin that it offers.

    A file that was loaded or imported before is not run again. Raises InputError for a file that is missing, that
    raises an error, or that registers nothing.
    """
    path = expand_user(file).absolute()
    if path in _loaded_files and _registered.keys() >= set(_loaded_files[path].offers):
        return _loaded_files[path].offers
    if not os.path.exists(path):
        raise InputError.one("--plugin", "file", str(file), "a Python file that exists")
    known = _offered_by(path)
    if known:
        return known
    name = f"skyrange_plugin_{re.sub(r'[^A-Za-z0-9]', '_', path.stem)}_{len(_loaded_files)}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InputError.one("--plugin", "file", str(file), "a Python file, whose name ends in .py")
    source, before = read_input(path, "--plugin", max_bytes=MAX_TEXT_BYTES, expected="a Python file"), set(_registered)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where dataclasses and pickle look for it
    try:
        spec.loader.exec_module(module)
        added = tuple(sorted(set(_registered) - before))
        if not added:
            expected = "a class with a decorator such as @attack('acme.lag'), or a call of skyrange.register"
            raise InputError.one(str(file), "file", "registers no plugin", expected)
    except BaseException as error:
        del sys.modules[name]
        for key in set(_registered) - before:
            del _registered[key]
        if isinstance(error, InputError):
            raise InputError(str(file), _name_class(error)) from error
        if isinstance(error, Exception):
            raise InputError(str(file), [_import_fault(error, path)]) from error
        raise
    _loaded_files[path] = _LoadedFile(source, added)
    return added


def loaded_sources() -> list[tuple[str, bytes]]:
    """Name and content of each file that `load_file` ran in this process, in order."""
    return [(path.name, file.source) for path, file in _loaded_files.items()]


def loaded_paths() -> list[Path]:
    """Each file that `load_file` ran in this process, in order."""
    return list(_loaded_files)


def _offered_by(path: Path) -> tuple[tuple[str, str], ...]:
    """What a file offers that is imported already, under whatever name."""
    modules = [module for module in list(sys.modules.values()) if getattr(module, "__file__", None) == str(path)]
    values = [value for module in modules for value in vars(module).values()]
    plugin_ids = {id(value) for value in values} | {
        id(vars(value).get("plugin")) for value in values if isinstance(value, type)
    }
    return tuple(sorted(key for key, plugin in _registered.items() if id(plugin) in plugin_ids))


def load_files(files: Iterable[str | Path]) -> None:
    """`load_file` for each, in order."""
    for file in files:
        load_file(file)


def _name_class(error: InputError) -> list[Problem]:
    """The problems of a file, with the class that they are about."""
    about = f"{error.who.partition(' in ')[0]}, " if error.who.startswith("class ") else ""
    return [replace(problem, where=f"{about}{problem.where}") for problem in error.problems]


def _import_fault(error: Exception, path: Path) -> Problem:
    """What a plugin's file raised, and on which of its lines."""
    if isinstance(error, SyntaxError):
        line = error.lineno
    else:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename) == path]
        line = lines[-1] if lines else None
    where = f"line {line}" if line is not None else "file"
    return Problem(where, f"{type(error).__name__}: {error}", "a Python file that can be imported")


def _check_group(group: str) -> None:
    if group not in GROUPS:
        raise InputError.one("plugin", "group", group, "a group of plugins", nearest(group, GROUPS))


def _check_shape(group: str, kind: str, plugin: object) -> None:
    if not isinstance(plugin, Plugin) or plugin.group != group:
        shown = f"{type(plugin).__name__} {plugin!r}"
        hint = "See skyrange.plugin: attack, defence, ApprovalPlugin, AutopilotPlugin and so on."
        raise InputError.one(f"plugin {kind}", "object", shown[:120], f"a plugin of {group}", hint)


@cache
def _entry_points(group: str) -> dict[str, EntryPoint]:
    """Entry points by kind; a package that is installed later is seen by the next process."""
    return {point.name: point for point in entry_points(group=group)}
