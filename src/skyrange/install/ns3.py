"""Installation of the ns-3 engine: compiled against ns-3's libraries from PyPI's wheel, Debian, or a folder."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Final, NamedTuple

from skyrange.core.engine_sources import source_files
from skyrange.core.errors import InputError
from skyrange.install.compilation import CompiledEngine, compile_engine
from skyrange.radio.external.ns3 import HOW_TO_GET

WHO: Final = "ns-3"
MODULES: Final = ("core", "network", "mobility", "wifi", "spectrum", "propagation", "antenna", "stats")
"""The libraries of ns-3 that the engine uses."""
TESTED: Final = ("3.37", "3.44")
"""Releases with which the engine is tested."""
_LIBRARY: Final = re.compile(r"^libns(3(?:\.\d+)+|3)?-?(?P<module>[a-z-]+?)(?:-(?:default|optimized|release))?\.so")
_SYSTEM_INCLUDE: Final = Path("/usr/include")
_SYSTEM: Final = ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib", "/usr/local/lib")


class Ns3Libraries(NamedTuple):
    """An installation of ns-3."""

    include: Path
    """The folder that contains `ns3/`."""
    folder: Path
    libraries: tuple[Path, ...]
    """One for each of `MODULES`."""
    release: str
    origin: str


def install(prefix: Path | None = None) -> tuple[CompiledEngine, Ns3Libraries]:
    """Compile the engine against the ns-3 below `prefix`, or else the wheel's, or else the system's.

    Raises `InputError` if there is no ns-3 or no compiler, and `ComponentError` if it does not compile.
    """
    ns3 = find_libraries(prefix)
    include = [] if ns3.include == _SYSTEM_INCLUDE else ["-isystem", str(ns3.include)]
    release = f'-DSKYRANGE_NS3_RELEASE="{ns3.release}"'
    libraries = [*map(str, ns3.libraries), f"-Wl,-rpath,{ns3.folder}", "-Wl,--allow-shlib-undefined"]
    flags = ["-std=c++20", "-O2", "-w", release, *include, *libraries]
    return compile_engine("ns3", WHO, flags, source_files("ns3")), ns3


def find_libraries(prefix: Path | None = None) -> Ns3Libraries:
    """The ns-3 below `prefix`, or else the wheel's, or else the system's. Raises `InputError` if there is none."""
    if prefix is not None:
        for below in ("lib", "lib64", "lib/x86_64-linux-gnu"):
            libraries = _libraries(prefix / "include", prefix / below, str(prefix))
            if libraries is not None:
                return libraries
        expected = "a folder with include/ns3 and the libraries of ns-3 in lib or lib64"
        raise InputError.one(WHO, "--ns3", str(prefix), expected, "Build ns-3 and run its install step.")
    wheel = _wheel()
    if wheel is not None:
        return wheel
    for name in _SYSTEM:
        libraries = _libraries(_SYSTEM_INCLUDE, Path(name), "the system")
        if libraries is not None:
            return libraries
    raise InputError.one(WHO, "installation", "not found", "ns-3 with its headers, 3.37 or newer", HOW_TO_GET)


def _wheel() -> Ns3Libraries | None:
    try:
        package = distribution("ns3")
    except PackageNotFoundError:
        return None
    folder = Path(str(package.locate_file("ns3")))
    libraries = _libraries(folder / "include", folder / "lib64", f"the Python package ns3 {package.version}")
    return None if libraries is None else libraries._replace(release=package.version.partition(".post")[0])


def _libraries(include: Path, folder: Path, origin: str) -> Ns3Libraries | None:
    """The installation in two folders, None if a header or a library is missing."""
    if not (include / "ns3" / "spectrum-wifi-helper.h").is_file() or not folder.is_dir():
        return None
    files: dict[str, Path] = {}
    for file in sorted(folder.glob("libns3*.so")):
        name = _LIBRARY.match(file.name)
        if name is not None:
            files.setdefault(name["module"], file)
    if not all(module in files for module in MODULES):
        return None
    return Ns3Libraries(include, folder, tuple(files[module] for module in MODULES), _release(files["core"]), origin)


def _release(core: Path) -> str:
    """The release that the name of the core library tells: libns3.44-core.so, or libns3-core.so.37 behind a link."""
    for name in (core.name, core.resolve().name):
        version = re.search(r"libns(3\.\d+)", name) or re.search(r"\.so\.(\d+)", name)
        if version is not None:
            return version[1] if version[1].startswith("3.") else f"3.{version[1]}"
    return "unknown"
