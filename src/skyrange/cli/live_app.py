"""Declaration of the commands for live ranges."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli.handlers import live, runs
from skyrange.cli.handlers import tap as tapping
from skyrange.cli.options import (
    AsJson,
    Buildings,
    Changes,
    Grouping,
    Motion,
    Plugins,
    PortOffset,
    Qgc,
    RunFolder,
    RunOut,
    ScenarioName,
    Seed,
    ViewerPort,
)
from skyrange.cli.output import live_viewer_notices

commands = typer.Typer()


class Death(StrEnum):
    """What a live range does when a node dies."""

    STOP = "stop"
    CONTINUE = "continue"
    RESTART = "restart"


@commands.command("live", epilog="Example: skyrange live squares --external blue.gcs")
def live_(
    scenario: ScenarioName,
    out: RunOut = None,
    seed: Seed = None,
    buildings: Buildings = None,
    changes: Changes = None,
    group: Annotated[
        Grouping | None,
        typer.Option(
            metavar="HOW",
            help="Which components share a process: component, none; operator, those of one operator; host, those on "
            "one machine; one, all. Default: component with at most eight components per core, else operator.",
        ),
    ] = None,
    external: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COMPONENT",
            help="Start no process for this component, such as blue.gcs, because a program of yours replaces it. "
            "May be repeated.",
        ),
    ] = None,
    port_offset: PortOffset = 0,
    on_death: Annotated[
        Death | None,
        typer.Option(
            metavar="HOW",
            help="What to do when a process dies: stop the range, continue without it, or restart it (at most three "
            "times). Default: the scenario's choice, else stop.",
        ),
    ] = None,
    qgc: Qgc = False,
    viewer_port: ViewerPort = None,
    keys: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Folder of the range's keys, made by `skyrange keys`, for hosts that join."
        ),
    ] = None,
    netns: Annotated[
        bool,
        typer.Option(
            "--netns",
            help="Give every ground station and every aircraft its own network namespace, for tools that work on "
            "packets (tc, Scapy). Linux only; needs root.",
        ),
    ] = False,
    allow_motion: Motion = False,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Run a scenario in real time, with components as separate processes on real sockets."""
    runs.load_plugins(plugin)
    options = {
        "group": group.value if group is not None else None,
        "on_death": on_death and on_death.value,
        "netns": netns,
        "motion": allow_motion,
        "viewer_port": live_viewer_notices.first_port(qgc, viewer_port, port_offset),
    }
    live.live(scenario, out, seed, buildings, changes or [], external or [], port_offset, keys, options, as_json)


@commands.command(epilog="Example: skyrange node --join 10.0.0.1 --key lab2.key_secret")
def node(
    range_: Annotated[
        str,
        typer.Option(
            "--join",
            metavar="ADDRESS",
            help="IP address of the machine that starts the range, with :PORT if it is not 14500.",
        ),
    ],
    key: Annotated[Path, typer.Option(metavar="FILE", help="This machine's secret key, made by `skyrange keys`.")],
    address: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="IP address at which the other machines reach this one, as in the scenario's hosts. Default: the "
            "address from which this machine reaches the range.",
        ),
    ] = None,
    wait: Annotated[
        float, typer.Option(metavar="SECONDS", min=1, max=86_400, help="How long to wait for the range to start.")
    ] = 60.0,
) -> None:
    """Let this machine join a live range and run the components that the scenario's hosts assign to it."""
    live.node(range_, key, address, wait)


@commands.command(epilog="Example: skyrange keys lab-keys lab2 lab3")
def keys(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="The folder for the range's keys.")],
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="A machine that may join. May be repeated."),
    ] = None,
) -> None:
    """Create the keys with which other machines join a live range."""
    live.keys(folder, names or [])


class Fail(StrEnum):
    """What happens to a frame for which an external tap's program returns no verdict."""

    OPEN = "open"
    CLOSED = "closed"


@commands.command(epilog="Example: skyrange tap gcs:blue/b1 --listen 127.0.0.1:7000 --run runs/squares")
def tap(
    link: Annotated[str, typer.Argument(metavar="LINK", help="A link of a live range, such as gcs:blue/b1.")],
    listen: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="Loopback address at which your program connects; port 0 takes any free port."
        ),
    ],
    run: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="The live range's run folder. Default: the newest one under runs."),
    ] = None,
    hold_ms: Annotated[
        float, typer.Option(metavar="MS", min=1, max=60_000, help="How long a frame waits for your program's verdict.")
    ] = 200.0,
    fail: Annotated[
        Fail, typer.Option(metavar="HOW", help="A frame without a verdict passes (open) or is dropped (closed).")
    ] = Fail.OPEN,
    name: Annotated[str, typer.Option(metavar="NAME", help="The tap's name in labels.")] = "tap-process",
    wait_s: Annotated[
        float, typer.Option("--wait", metavar="S", min=0, max=3600, help="How long to wait for the range.")
    ] = 60.0,
    as_json: AsJson = False,
) -> None:
    """Put your own program, in any language, on a link of a live range: it can alter, drop, delay and inject frames."""
    tapping.tap(link, listen, run, hold_ms, fail.value, name, wait_s, as_json)


@commands.command(epilog="Example: skyrange merge runs/squares --out runs/squares-whole")
def merge(
    run: RunFolder,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="An empty or new folder. Default: RUN-merged, beside RUN.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Merge what the processes of a killed live range left behind into one record."""
    live.merge(run, out, as_json)
