"""Installation of the OMNeT++ engine: compiled against the user's own OMNeT++ and INET."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Final, NamedTuple

from skyrange.core.engine_sources import source_files
from skyrange.core.errors import InputError
from skyrange.core.files import MIB, read_input
from skyrange.install.compilation import CompiledEngine, compile_engine

WHO: Final = "OMNeT++"
TESTED_OMNETPP: Final = ("6.1",)
"""Releases of OMNeT++ with which the engine is tested."""
TESTED_INET: Final = ("4.5.4",)
"""Releases of INET with which the engine is tested."""
OLDEST_OMNETPP: Final = (6, 0)
OLDEST_INET: Final = (4, 5)
LICENCE: Final = (
    "OMNeT++'s Academic Public License allows non-commercial use only; for commercial use there is OMNEST. "
    "INET is under the LGPL."
)
LIBRARIES: Final = ("oppcmdenv", "oppenvir", "oppsim")
FEATURES: Final = ("Ieee80211", "Mobility", "PhysicalEnvironment", "WirelessNoiseSource")
"""INET's features that the engine uses."""
_INET_ENVIRONMENT: Final = ("INET_ROOT",)
_OMNETPP_ENVIRONMENT: Final = ("__omnetpp_root_dir", "OMNETPP_ROOT")
_CONFIGURE: Final = "./configure WITH_QTENV=no WITH_OSG=no WITH_SCAVE_PYTHON_BINDINGS=no"


class OmnetppInstallation(NamedTuple):
    """An OMNeT++ and an INET that were built."""

    omnetpp: Path
    omnetpp_release: str
    inet: Path
    inet_release: str

    @property
    def release(self) -> str:
        """Both versions, for the record."""
        return f"OMNeT++ {self.omnetpp_release}, INET {self.inet_release}"

    @property
    def untested(self) -> list[str]:
        """What of it the engine is not tested with."""
        lines = []
        if self.omnetpp_release not in TESTED_OMNETPP:
            lines.append(f"OMNeT++ {self.omnetpp_release} is not tested; tested: {', '.join(TESTED_OMNETPP)}")
        if self.inet_release not in TESTED_INET:
            lines.append(f"INET {self.inet_release} is not tested; tested: {', '.join(TESTED_INET)}")
        return lines


def install(omnetpp: Path | None = None, inet: Path | None = None) -> tuple[CompiledEngine, OmnetppInstallation]:
    """Compile the engine against the OMNeT++ and INET in two folders; None: those whose `setenv` was sourced.

    Raises `InputError` if one of them is not there or not built, or there is no compiler, and `ComponentError` if the
    engine does not compile or does not run.
    """
    installation = find_installation(omnetpp, inet)
    flags = [
        "-std=c++17", "-O2", "-w", "-DNDEBUG=1", "-DINET_IMPORT",
        f'-DSKYRANGE_OMNETPP_RELEASE="{installation.release}"', f'-DSKYRANGE_INET_NED="{installation.inet / "src"}"',
        "-isystem", str(installation.omnetpp / "include"), "-isystem", str(installation.inet / "src"),
        "-Wl,--export-dynamic", "-Wl,--no-as-needed",
        f"-L{installation.inet / 'src'}", "-lINET", f"-L{installation.omnetpp / 'lib'}", "-Wl,-u,_cmdenv_lib",
        *(f"-l{name}" for name in LIBRARIES),
        f"-Wl,-rpath,{installation.inet / 'src'}", f"-Wl,-rpath,{installation.omnetpp / 'lib'}",
    ]  # fmt: skip
    return compile_engine("omnetpp", WHO, flags, source_files("omnetpp")), installation


def find_installation(omnetpp: Path | None = None, inet: Path | None = None) -> OmnetppInstallation:
    """The OMNeT++ and INET in two folders; None: those whose `setenv` was sourced.

    Raises `InputError`, which names the command that mends what is missing.
    """
    first = _folder("--omnetpp", omnetpp, _OMNETPP_ENVIRONMENT, "OMNeT++")
    release = _omnetpp_release(first)
    second = _folder("--inet", inet, _INET_ENVIRONMENT, "INET")
    return OmnetppInstallation(first, release, second, _inet_release(second))


def _folder(option: str, given: Path | None, variables: tuple[str, ...], title: str) -> Path:
    for name in variables:
        if given is None and os.environ.get(name):
            given = Path(os.environ[name])
    if given is None:
        hint = f"Add {option} DIR, or source its file setenv before."
        raise InputError.one(WHO, option, "not given", f"the folder in which {title} was built", hint)
    if not given.is_dir():
        raise InputError.one(WHO, option, str(given), f"the folder in which {title} was built")
    return given.resolve()


def _omnetpp_release(folder: Path) -> str:
    """The version of the OMNeT++ in a folder. Raises `InputError` unless it is built, in the release mode."""
    where = str(folder)
    version = _read(folder / "Version")
    release = re.fullmatch(r"omnet(?:pp|est)-(\d+(?:\.\d+)+\w*)", version.strip())
    if release is None or not (folder / "include" / "omnetpp.h").is_file():
        expected = "a folder of OMNeT++ with the files Version and include/omnetpp.h"
        raise InputError.one(WHO, "--omnetpp", where, expected, "Get OMNeT++ 6.1 from https://omnetpp.org/download.")
    _check_release("--omnetpp", where, "OMNeT++", release[1], OLDEST_OMNETPP)
    if not (folder / "Makefile.inc").is_file():
        hint = f"cd {where} && . ./setenv && {_CONFIGURE} && make MODE=release"
        raise InputError.one(WHO, "--omnetpp", where, "an OMNeT++ that is configured and built", hint)
    for name in LIBRARIES:
        if not (folder / "lib" / f"lib{name}.so").is_file():
            hint = f"cd {where} && . ./setenv && make MODE=release base"
            expected = f"a built OMNeT++, with lib/lib{name}.so (shared libraries, release mode, Cmdenv)"
            raise InputError.one(WHO, "--omnetpp", where, expected, hint)
    return release[1]


def _inet_release(folder: Path) -> str:
    """The version of the INET in a folder. Raises `InputError` unless it is built with the needed features."""
    where = str(folder)
    text = _read(folder / "src" / "inet" / "common" / "INETDefs.h")
    version = re.search(r"#define\s+INET_VERSION\s+0x([0-9a-fA-F]{4})\b", text)
    patch = re.search(r"#define\s+INET_PATCH_LEVEL\s+0x([0-9a-fA-F]+)\b", text)
    if version is None or patch is None:
        expected = "a folder of INET with the file src/inet/common/INETDefs.h"
        raise InputError.one(WHO, "--inet", where, expected, "Get INET 4.5.4 from https://inet.omnetpp.org/Download.")
    major, minor = divmod(int(version[1], 16), 256)
    release = f"{major}.{minor}.{int(patch[1], 16)}"
    _check_release("--inet", where, "INET", release, OLDEST_INET)
    states = dict(re.findall(r'<feature id="(\w+)" enabled="(\w+)"', _read(folder / ".oppfeaturestate")))
    missing = [name for name in FEATURES if states.get(name, "true") != "true"]
    build = "make makefiles && make MODE=release"
    if missing:
        hint = f"cd {where} && . ./setenv && opp_featuretool enable -f {' '.join(missing)} && {build}"
        raise InputError.one(WHO, "--inet", f"{where} without {', '.join(missing)}", "INET with these features", hint)
    if not (folder / "src" / "libINET.so").is_file():
        hint = f"cd {where} && . ./setenv && {build}"
        raise InputError.one(WHO, "--inet", where, "a built INET, with src/libINET.so (release mode)", hint)
    return release


def _check_release(option: str, where: str, title: str, release: str, oldest: tuple[int, int]) -> None:
    if tuple(int(part) for part in re.findall(r"\d+", release)[:2]) < oldest:
        expected = f"{title} {'.'.join(map(str, oldest))} or newer"
        raise InputError.one(WHO, option, f"{where} ({title} {release})", expected)


def _read(path: Path) -> str:
    """The text of a file, "" if it cannot be read."""
    try:
        return read_input(path, WHO, str(path), max_bytes=MIB).decode("utf-8", "replace")
    except InputError:
        return ""
