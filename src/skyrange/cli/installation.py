"""The commands `skyrange doctor` and `skyrange install`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli.options import AsJson
from skyrange.cli.output.console import print_json, print_notice, print_text
from skyrange.core.errors import InputError
from skyrange.core.files import expand_user

commands = typer.Typer()
install_app = typer.Typer(
    help="Install autopilots, radio engines and Gazebo's plugin in your data folder, and compile kernels.\n\n"
    "Example: skyrange install ardupilot",
    no_args_is_help=True,
)


@commands.command(epilog="Example: skyrange doctor --json")
def doctor(
    *,
    compiling: Annotated[
        bool,
        typer.Option(
            "--compile/--no-compile",
            help="Compile missing kernels and fly for one second, or with --no-compile only look.",
        ),
    ] = True,
    as_json: AsJson = False,
) -> None:
    """Check this installation, report what is missing, and compile the numeric kernels."""
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


@install_app.callback()
def _install() -> None:
    """Install autopilots, radio engines and Gazebo's plugin in your data folder, and compile kernels."""


@install_app.command(epilog="Example: skyrange install ardupilot --version 4.6.3")
def ardupilot(
    *,
    version: Annotated[
        str | None,
        typer.Option(
            metavar="V",
            help="Release to download, or required version of FILE. Default: 4.7.0, or any version with --from.",
        ),
    ] = None,
    source: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="Install this arducopter SITL binary instead; needs no network."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Install ArduPilot's official SITL binary of ArduCopter in your data folder, and check that it runs."""
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


@install_app.command(epilog="Example: skyrange install gazebo --prefix /opt/gazebo")
def gazebo(
    *,
    prefix: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder in which Gazebo is installed, with bin/gz or bin/gzserver. Default: that of the variable "
            "SKYRANGE_GAZEBO, else that on PATH.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compile the plugin for Gazebo in your data folder, and check that Gazebo loads it."""
    from skyrange.install.gazebo import TESTED, find_installed, install
    from skyrange.vehicle.gazebo.gazebo_program import find_gazebo
    from skyrange.vehicle.gazebo.plugin_library import find_plugin

    folder = expand_user(prefix) if prefix is not None else None
    if not as_json:
        simulator = find_installed(folder)
        print_text(f"compiling the plugin for {simulator.title}, {simulator.path}")
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


@install_app.command(epilog="Example: skyrange install kernels")
def kernels(
    *,
    jobs: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Processes at once. Default: the number of cores.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compile the numeric kernels that flights use, so that no flight has to."""
    from skyrange.cli.output.progress import compile_kernels
    from skyrange.core.compiled import cache_folder
    from skyrange.runtime.compilation import count_kernels

    made = compile_kernels(jobs=jobs, quiet=as_json)
    cached, listed = count_kernels()
    if as_json:
        print_json({"compiled": made, "cached": cached, "kernels": listed, "path": cache_folder()})
    else:
        print_text(f"{cached} of {listed} kernels are compiled, {made} of them now: {cache_folder()}")


@install_app.command(epilog="Example: skyrange install ns3")
def ns3(
    *,
    prefix: Annotated[
        Path | None,
        typer.Option(
            "--ns3",
            metavar="DIR",
            help="Folder in which ns-3 is installed. Default: the Python package ns3, else the system's ns-3.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compile the radio engine of ns-3 in your data folder, and check that it runs."""
    from skyrange.install.ns3 import TESTED, find_libraries, install

    if not as_json:
        libraries = find_libraries(expand_user(prefix) if prefix is not None else None)
        print_text(f"compiling the engine against ns-3 {libraries.release} from {libraries.origin}")
    made, libraries = install(expand_user(prefix) if prefix is not None else None)
    facts = {"release": libraries.release, "from": libraries.origin, "path": str(made.path)}
    if as_json:
        print_json(facts)
    else:
        print_text(f"{'compiled' if made.compiled_now else 'was compiled already'}: {made.path}")
        print_text('use it in a scenario with [radio] engine = "ns3"')
    if libraries.release not in TESTED:
        print_notice(f"ns-3 {libraries.release} is not a tested release; tested: {', '.join(TESTED)}")


@install_app.command(epilog="Example: skyrange install omnetpp --omnetpp ~/omnetpp-6.1 --inet ~/inet4.5")
def omnetpp(
    *,
    omnetpp: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder in which OMNeT++ was built. Default: that whose setenv was sourced."),
    ] = None,
    inet: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder in which INET was built. Default: that whose setenv was sourced."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compile the radio engine of OMNeT++ and INET in your data folder, and check that it runs."""
    from skyrange.install.omnetpp import LICENCE, find_installation, install

    folders = [expand_user(folder) if folder is not None else None for folder in (omnetpp, inet)]
    if not as_json:
        print_text(f"compiling the engine against {find_installation(*folders).release}")
    made, installation = install(*folders)
    facts = {
        "omnetpp": installation.omnetpp_release,
        "omnetpp_path": str(installation.omnetpp),
        "inet": installation.inet_release,
        "inet_path": str(installation.inet),
        "path": str(made.path),
    }
    if as_json:
        print_json(facts)
    else:
        print_text(f"{'compiled' if made.compiled_now else 'was compiled already'}: {made.path}")
        print_text(f"OMNeT++ {installation.omnetpp_release}: {installation.omnetpp}")
        print_text(f"INET {installation.inet_release}: {installation.inet}")
        print_text('use it in a scenario with [radio] engine = "omnetpp"')
    print_notice(LICENCE)
    for line in installation.untested:
        print_notice(line)
