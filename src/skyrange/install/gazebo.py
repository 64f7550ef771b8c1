"""Installation of the Gazebo plugin: compiled against the user's own Gazebo, with the flags that pkg-config gives."""

from __future__ import annotations

import os
import shlex
import shutil
from pathlib import Path
from typing import Final, NamedTuple

from skyrange.core.errors import ComponentError, InputError
from skyrange.install.compilation import Compiled, compile_sources
from skyrange.io.processes.program import ProgramOutput, run_once
from skyrange.vehicle.gazebo.gazebo_program import HOW_TO_GET, Flavour, Gazebo, examine_gazebo, find_gazebo
from skyrange.vehicle.gazebo.plugin_library import LIBRARY, NAME, plugin_sources, try_plugin

WHO: Final = "Gazebo plugin"
TESTED: Final = ("11.1", "10.4")
"""Releases (major and minor) with which the plugin is tested."""
ANSWER_S: Final = 30.0
"""Wall time within which pkg-config must answer."""
_BESIDE: Final = "spdlog"
"""What the headers of Gazebo Sim 9 and newer use besides, without that its package in pkg-config says so."""
_FOLDERS: Final = ("lib/pkgconfig", "lib64/pkgconfig", "lib/*-linux-gnu*/pkgconfig", "share/pkgconfig")


class GazeboHeaders(NamedTuple):
    """The headers and libraries of a Gazebo, as pkg-config describes them."""

    package: str
    """Name of the package in pkg-config."""
    version: str
    flags: tuple[str, ...]
    """Flags of the compiler and of the linker."""


def install(prefix: Path | None = None) -> tuple[Compiled[None], Gazebo]:
    """Compile the plugin against the Gazebo below `prefix`, or else against the one that a run would use.

    Raises `InputError` if there is no Gazebo, no header of it, no pkg-config or no compiler, and `ComponentError` if
    the plugin does not compile, or if Gazebo does not load it.
    """
    gazebo = find_installed(prefix)
    headers = find_headers(gazebo, prefix)
    flags = [
        *headers.flags, "-std=c++17", "-O2", "-w", "-fPIC", "-shared", "-Wl,--no-undefined",
        f'-DSKYRANGE_GAZEBO_RELEASE="{headers.version}"',
    ]  # fmt: skip
    sources = plugin_sources(gazebo.flavour)
    if not any(source.suffix == ".cc" for source in sources):
        raise ComponentError("skyrange", f"has no sources of a plugin for {gazebo.title}", "Reinstall skyrange")
    made = compile_sources(
        NAME, WHO, LIBRARY, flags, sources, lambda library: try_plugin(WHO, gazebo, library), build=gazebo.build
    )
    return made, gazebo


def find_installed(prefix: Path | None = None) -> Gazebo:
    """The Gazebo below `prefix`, or else the one that a run would use. Raises `InputError` if there is none."""
    if prefix is None:
        return find_gazebo()
    for name in ("gz", "gzserver"):
        path = prefix / "bin" / name
        if path.is_file():
            return examine_gazebo(path, "--prefix")
    raise InputError.one(WHO, "--prefix", str(prefix), "a folder with bin/gz or bin/gzserver", HOW_TO_GET)


def find_headers(gazebo: Gazebo, prefix: Path | None = None) -> GazeboHeaders:
    """The headers and libraries of `gazebo`: below `prefix`, in the folder that it is installed in, or the system's.

    The variable PKG_CONFIG names another pkg-config, PKG_CONFIG_PATH further folders of its files. Raises `InputError`
    if there is no pkg-config, or if it knows no package of the same major version.
    """
    program = _pkg_config()
    roots = [prefix] if prefix is not None else [gazebo.path.parent.parent, gazebo.path.resolve().parent.parent]
    folders = [str(folder) for root in roots for pattern in _FOLDERS for folder in sorted(root.glob(pattern))]
    search = ":".join(dict.fromkeys([*folders, *filter(None, [os.environ.get("PKG_CONFIG_PATH")])]))
    packages = ("gazebo",) if gazebo.flavour == Flavour.CLASSIC else (f"gz-sim{gazebo.major}", "gz-sim")
    others = []
    for package in packages:
        answer = _ask(program, search, "--modversion", package)
        version = answer.text.strip()
        if answer.ended != "exit 0":
            continue
        if version.partition(".")[0] != str(gazebo.major):
            others.append(f"headers of {version}")
            continue
        names = [package]
        if gazebo.flavour == Flavour.SIM and _ask(program, search, "--exists", _BESIDE).ended == "exit 0":
            names.append(_BESIDE)
        return GazeboHeaders(package, version, _flags(program, search, *names))
    value = ", ".join(others) or f"pkg-config does not know {' or '.join(packages)}"
    expected = f"headers and libraries for {gazebo.title} ({gazebo.path})"
    raise InputError.one(WHO, "headers", value, expected, _how_to_get_headers(gazebo))


def _pkg_config() -> Path:
    for name in filter(None, (os.environ.get("PKG_CONFIG"), "pkg-config", "pkgconf")):
        path = shutil.which(name)
        if path is not None:
            return Path(path)
    raise InputError.one(WHO, "pkg-config", "not found", "pkg-config", "On Debian: sudo apt-get install pkg-config")


def _ask(program: Path, search: str, *arguments: str) -> ProgramOutput:
    variable = [f"PKG_CONFIG_PATH={search}"] if search else []
    try:
        return run_once(Path("env"), *variable, str(program), *arguments, deadline_s=ANSWER_S, who=str(program))
    except ComponentError as error:
        problem = str(error).removeprefix(f"{program}: ")
        raise InputError.one(WHO, "pkg-config", problem, "an answer", "The variable PKG_CONFIG names it") from None


def _flags(program: Path, search: str, *packages: str) -> tuple[str, ...]:
    """The flags of packages; libraries outside of the system's folders are found at run time too."""
    answer = _ask(program, search, "--cflags", "--libs", *packages)
    if answer.ended != "exit 0":
        problem = " | ".join(line for line in answer.text.splitlines() if line.strip())
        hint = "Install the missing package; on Debian, those named -dev"
        raise InputError.one(WHO, "headers", problem, f"{packages[0]} with all that it requires", hint)
    flags = shlex.split(answer.text)
    return (*flags, *dict.fromkeys(f"-Wl,-rpath,{flag[2:]}" for flag in flags if flag.startswith("-L/")))


def _how_to_get_headers(gazebo: Gazebo) -> str:
    name = "libgazebo-dev" if gazebo.flavour == Flavour.CLASSIC else f"libgz-sim{gazebo.major}-dev"
    return f"On Debian or Ubuntu: sudo apt-get install {name}. For a Gazebo that was built elsewhere: --prefix DIR"
