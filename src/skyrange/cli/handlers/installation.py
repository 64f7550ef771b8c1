"""The commands `skyrange doctor` and `skyrange install`."""

from __future__ import annotations

import sys
from pathlib import Path

from skyrange.cli.output.console import print_json, print_notice, print_text
from skyrange.core.errors import InputError
from skyrange.core.input_files import expand_user


def doctor(compiling: bool, as_json: bool) -> None:
    """`skyrange doctor`."""
    from skyrange.cli.output.progress import compile_kernels
    from skyrange.doctor import examine

    if compiling:
        compile_kernels(quiet=as_json)
    findings = examine(flying=compiling)
    if as_json:
        print_json([finding.to_dict() for finding in findings])
    else:
        for finding in findings:
            mark = "ok" if finding.ok else "--" if finding.optional else "!!"
            print_text(f"{mark}  {finding.subject}: {finding.found}")
            if finding.hint:
                print_text(f"    {finding.hint}")
    if not all(finding.ok or finding.optional for finding in findings):
        sys.exit(3)


def install_ardupilot(version: str | None, source: Path | None, as_json: bool) -> None:
    """`skyrange install ardupilot`."""
    from skyrange.cli.output.progress import download_progress
    from skyrange.install.ardupilot import install
    from skyrange.vehicle.ardupilot.arducopter_binary import find_binary

    with download_progress("arducopter", quiet=as_json) as on_progress:
        made = install(version, expand_user(source) if source is not None else None, on_progress)
    binary = made.binary
    facts = {"version": binary.version, "path": str(binary.path), "sha256": binary.sha256, "from": made.origin}
    if as_json:
        print_json(facts)
    else:
        print_text(f"installed ArduCopter {binary.version}")
        for key in ("path", "sha256", "from"):
            print_text(f"{key:<6} {facts[key]}")
    try:
        first = find_binary()
    except InputError as error:
        print_notice(f"skyrange runs a different binary, which is unusable: {error}")
    else:
        if first.path != binary.path:
            where = "which is newer" if first.source == "installed" else f"from {first.source}"
            print_notice(f"skyrange runs a different binary, {where}: ArduCopter {first.version}, {first.path}")


def install_kernels(jobs: int | None, as_json: bool) -> None:
    """`skyrange install kernels`."""
    from skyrange.cli.output.progress import compile_kernels
    from skyrange.core.compiled import cache_folder
    from skyrange.runtime.compilation.cache_filling import count_kernels

    made = compile_kernels(jobs=jobs, quiet=as_json)
    cached, listed = count_kernels()
    if as_json:
        print_json({"compiled": made, "cached": cached, "kernels": listed, "path": cache_folder()})
    else:
        print_text(f"{cached} of {listed} kernels are compiled, {made} of them now: {cache_folder()}")


def install_ns3(prefix: Path | None, as_json: bool) -> None:
    """`skyrange install ns3`."""
    from skyrange.install.ns3 import TESTED, find_libraries, install

    if not as_json:
        found = find_libraries(expand_user(prefix) if prefix is not None else None)
        print_text(f"compiling the engine against ns-3 {found.release} from {found.origin}")
    made, found = install(expand_user(prefix) if prefix is not None else None)
    facts = {"release": found.release, "from": found.origin, "path": str(made.path)}
    if as_json:
        print_json(facts)
    else:
        print_text(f"{'compiled' if made.compiled_now else 'was compiled already'}: {made.path}")
        print_text('use it in a scenario with [radio] engine = "ns3"')
    if found.release not in TESTED:
        print_notice(f"ns-3 {found.release} is not a tested release; tested: {', '.join(TESTED)}")


def install_omnetpp(omnetpp: Path | None, inet: Path | None, as_json: bool) -> None:
    """`skyrange install omnetpp`."""
    from skyrange.install.omnetpp import LICENCE, find_installation, install

    folders = [expand_user(folder) if folder is not None else None for folder in (omnetpp, inet)]
    if not as_json:
        print_text(f"compiling the engine against {find_installation(*folders).release}")
    made, found = install(*folders)
    facts = {
        "omnetpp": found.omnetpp_release,
        "omnetpp_path": str(found.omnetpp),
        "inet": found.inet_release,
        "inet_path": str(found.inet),
        "path": str(made.path),
    }
    if as_json:
        print_json(facts)
    else:
        print_text(f"{'compiled' if made.compiled_now else 'was compiled already'}: {made.path}")
        print_text(f"OMNeT++ {found.omnetpp_release}: {found.omnetpp}")
        print_text(f"INET {found.inet_release}: {found.inet}")
        print_text('use it in a scenario with [radio] engine = "omnetpp"')
    print_notice(LICENCE)
    for line in found.untested:
        print_notice(line)


def install_gazebo(prefix: Path | None, as_json: bool) -> None:
    """`skyrange install gazebo`."""
    from skyrange.install.gazebo import TESTED, find_installed, install
    from skyrange.vehicle.gazebo.gazebo_program import find_gazebo
    from skyrange.vehicle.gazebo.plugin_library import find_plugin

    folder = expand_user(prefix) if prefix is not None else None
    if not as_json:
        found = find_installed(folder)
        print_text(f"compiling the plugin for {found.title}, {found.path}")
    made, gazebo = install(folder)
    facts = {"flavour": gazebo.flavour, "version": gazebo.version, "gazebo": str(gazebo.path), "path": str(made.path)}
    if as_json:
        print_json(facts)
    else:
        print_text(f"{'compiled' if made.compiled_now else 'was compiled already'}: {made.path}")
        print_text('use it in a scenario with autopilot = "gazebo"')
    if not gazebo.version.startswith(tuple(f"{release}." for release in TESTED)):
        print_notice(f"{gazebo.title} is not a tested release; tested: {', '.join(TESTED)}")
    try:
        first = find_gazebo()
    except InputError:
        print_notice(f"for runs in it set SKYRANGE_GAZEBO={gazebo.path}")
        return
    if first.path != gazebo.path:
        print_notice(f"skyrange runs a different Gazebo: {first.title}, {first.path} ({first.source})")
    elif (plugin := find_plugin(first)) != made.path:
        print_notice(f"skyrange loads a different plugin: {plugin}")
