"""Diagnosis of the installation: what is present, what is missing, and how to add it."""

from __future__ import annotations

import platform
import re
import sys
import tempfile
import time
from dataclasses import KW_ONLY, asdict, dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any

from skyrange.contracts.plugins.registry import GROUPS, kinds
from skyrange.core.errors import ComponentError, InputError, SkyrangeError


@dataclass(frozen=True, slots=True)
class Finding:
    """One item of the diagnosis: what was found, whether it is sufficient, and what to do if it is not.

    skyrange works without an `optional` item.
    """

    subject: str
    found: str
    _: KW_ONLY
    ok: bool = True
    hint: str = ""
    optional: bool = False

    def to_dict(self) -> dict[str, Any]:
        """The finding as plain data, for `--json`."""
        return asdict(self)


def examine(*, flying: bool = True) -> list[Finding]:
    """Examine the installation. With `flying` also run a small scenario for one second, which compiles what it uses."""
    findings = [_python(), *_packages(), *_plugins(), _ardupilot(), _ns3(), *_gazebo(), _writable(), _kernels()]
    return [*findings, _flight()] if flying else findings


def _python() -> Finding:
    return Finding("python", f"{platform.python_version()} on {platform.platform()}", ok=sys.version_info >= (3, 11))


def _packages() -> list[Finding]:
    """Packages that skyrange needs, and those of its optional parts (extras), but of development."""
    findings = []
    for requirement in requires("skyrange") or []:
        extra = _extra_of(requirement)
        if extra == "dev":
            continue
        name = _name_of(requirement)
        installed = _installed_version(name)
        if installed is not None:
            findings.append(Finding(name, installed, optional=bool(extra)))
        elif extra:
            findings.append(
                Finding(name, "missing", ok=False, hint=f"Optional. pip install 'skyrange[{extra}]'", optional=True)
            )
        else:
            findings.append(Finding(name, "missing", ok=False, hint=f"pip install '{requirement}'"))
    return findings


def _plugins() -> list[Finding]:
    """The kinds of each group; one that has an extra of its name is available if the extra's packages are."""
    lacking: dict[str, list[str]] = {}
    for requirement in requires("skyrange") or []:
        if _installed_version(_name_of(requirement)) is None:
            lacking.setdefault(_extra_of(requirement), []).append(_name_of(requirement))
    if _ns3().ok:  # compiled, perhaps against the system's libraries
        lacking.pop("ns3", None)
    findings = []
    for group in GROUPS:
        lacked = {kind: ", ".join(lacking[kind]) for kind in kinds(group) if kind in lacking}
        names = [f"{kind} (needs {lacked[kind]})" if kind in lacked else kind for kind in kinds(group)]
        hint = "; ".join(f"Optional. pip install 'skyrange[{kind}]'" for kind in lacked)
        findings.append(Finding(group, ", ".join(names) or "none", ok=not lacked, hint=hint, optional=bool(lacked)))
    return findings


def _name_of(requirement: str) -> str:
    return re.split(r"[^A-Za-z0-9._-]", requirement, maxsplit=1)[0]


def _extra_of(requirement: str) -> str:
    """The extra that a requirement belongs to, "" for none."""
    match = re.search(r"""extra\s*==\s*["']([^"']+)["']""", requirement)
    return match[1] if match else ""


def _installed_version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _ardupilot() -> Finding:
    """The ArduCopter binary that a run would use: path, version, capabilities, and whether it runs."""
    from skyrange.io.processes.program import run_once
    from skyrange.vehicle.ardupilot.arducopter_binary import (
        ANSWER_S,
        SUPPORTED_VERSION,
        check_help,
        find_binary,
        version_key,
    )

    try:
        binary = find_binary()
    except InputError as error:
        fault = error.problems[0]
        hint = f"Optional. {fault.hint or f'Expected {fault.expected}.'}"
        return Finding("ardupilot", f"{fault.value} ({error.who}: {fault.where})", ok=False, hint=hint, optional=True)
    what = f"ArduCopter {binary.version} ({binary.source}: {binary.path}), SHA-256 {binary.sha256[:16]}…"
    can = ", ".join(binary.capabilities) or "none of the capabilities that skyrange uses"
    try:
        answer = run_once(binary.path, "--help", deadline_s=ANSWER_S)
        check_help(str(binary.path), answer.ended, answer.text)
    except ComponentError as error:
        hint = f"Optional. {error}"
        return Finding("ardupilot", f"{what}; does not run correctly", ok=False, hint=hint, optional=True)
    least = ".".join(map(str, SUPPORTED_VERSION))
    hint = (
        ""
        if version_key(binary.version)[0][:2] >= SUPPORTED_VERSION
        else f"skyrange is expected to work with version {least} or newer."
    )
    return Finding("ardupilot", f"{what}; runs; has {can}", hint=hint, optional=True)


def _ns3() -> Finding:
    """The ns-3 engine that a run would use: path, release, and whether it transmits a frame."""
    from skyrange.radio.external.engine import try_engine
    from skyrange.radio.external.ns3 import HOW_TO_GET, INSTALL, find_program

    try:
        program = find_program()
    except InputError as error:
        fault = error.problems[0]
        hint = f"Optional. {fault.hint}. It needs g++ and ns-3: {HOW_TO_GET}"
        return Finding("radio engine ns3", f"{fault.value}", ok=False, hint=hint, optional=True)
    try:
        name, release = try_engine("radio engine ns3", [str(program)])
    except ComponentError as error:
        hint = f"Optional. {error}. Compile it again: {INSTALL}"
        return Finding("radio engine ns3", f"{program}; does not run correctly", ok=False, hint=hint, optional=True)
    return Finding("radio engine ns3", f"{name} {release}, {program}; runs", optional=True)


def _gazebo() -> list[Finding]:
    """The Gazebo that a run would use, whether it loads the plugin, and its window."""
    from skyrange.vehicle.gazebo.gazebo_program import find_gazebo, find_window
    from skyrange.vehicle.gazebo.plugin_library import INSTALL, find_plugin, try_plugin

    try:
        gazebo = find_gazebo()
    except InputError as error:
        reasons = "; ".join(f"{fault.value} ({fault.where})" for fault in error.problems)
        return [Finding("gazebo", reasons, ok=False, hint=f"Optional. {error.problems[0].hint}", optional=True)]
    what = f"{gazebo.title} ({gazebo.source}: {gazebo.path})"
    try:
        library = find_plugin(gazebo)
        try_plugin("plugin", gazebo, library)
        findings = [Finding("gazebo", f"{what}; loads the plugin {library}", optional=True)]
    except InputError as error:
        fault = error.problems[0]
        hint = f"Optional. {fault.hint}"
        findings = [Finding("gazebo", f"{what}; plugin: {fault.value}", ok=False, hint=hint, optional=True)]
    except ComponentError as error:
        hint = f"Optional. {error}. Compile it again: {INSTALL}"
        findings = [
            Finding("gazebo", f"{what}; does not load the plugin {library}", ok=False, hint=hint, optional=True)
        ]
    try:
        findings.append(Finding("gazebo window", find_window(gazebo), optional=True))
    except InputError as error:
        fault = error.problems[0]
        findings.append(Finding("gazebo window", fault.value, ok=False, hint=f"Optional. {fault.hint}", optional=True))
    return findings


def _writable() -> Finding:
    """Whether runs can be recorded where they land without `--out`: in the folder `runs`, made if it is not there."""
    runs = Path.cwd() / "runs"
    folder = runs if runs.is_dir() else runs.parent
    try:
        with tempfile.TemporaryDirectory(dir=folder):
            return Finding("folder of runs", f"{folder} is writable")
    except OSError as error:
        hint = "Change to a writable folder, or set a writable folder with --out DIR of `skyrange run`."
        return Finding("folder of runs", f"{folder}: {error.strerror}", ok=False, hint=hint)


def _kernels() -> Finding:
    """How many of the kernels that flights use are compiled."""
    from skyrange.core.compiled import cache_folder
    from skyrange.runtime.compilation import count_kernels

    folder = cache_folder()
    if not folder:
        hint = "Make a folder that XDG_CACHE_HOME names writable; until then each process compiles what it uses."
        return Finding("kernels", "no writable folder for compiled kernels", ok=False, hint=hint, optional=True)
    cached, listed = count_kernels()
    hint = (
        ""
        if cached == listed
        else "Optional. `skyrange install kernels` compiles the rest; flights compile what they use."
    )
    return Finding(
        "kernels", f"{cached} of {listed} compiled, in {folder}", ok=cached == listed, hint=hint, optional=True
    )


def _flight() -> Finding:
    from skyrange.scenario.shipped import load
    from skyrange.study.runs import fly

    began = time.perf_counter()
    try:
        with tempfile.TemporaryDirectory() as folder:
            fly(load("squares", ["duration_s=1"]), Path(folder) / "run")
    except SkyrangeError as error:
        return Finding(
            "flight", str(error), ok=False, hint="Please report this with the output of `skyrange doctor --json`."
        )
    return Finding(
        "flight",
        f"one second of squares, including loading of kernels, in {time.perf_counter() - began:.1f} s",
    )
