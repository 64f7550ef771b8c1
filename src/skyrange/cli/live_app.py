"""Declaration of the commands for live ranges."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli import live, runs
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
    ViewerHost,
    ViewerPort,
    parse_ip_address,
)
from skyrange.cli.output import viewer_notices as live_viewer_notices

commands = typer.Typer()


class Death(StrEnum):
    """Reactions of a live range to the death of a node."""

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
            help="Components that share a process. component: none; operator: those of one operator; host: those on "
            "one machine; one: all. Default: component with at most eight components per core, else operator.",
        ),
    ] = None,
    external: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COMPONENT",
            help="Start no process for this component, such as blue.gcs; your own program replaces it. May be "
            "repeated.",
        ),
    ] = None,
    port_offset: PortOffset = 0,
    on_death: Annotated[
        Death | None,
        typer.Option(
            metavar="HOW",
            help="Reaction to the death of a process: stop the range, continue without the process, or restart it (at "
            "most three times). Default: live.on_death of the scenario, else stop.",
        ),
    ] = None,
    qgc: Qgc = False,
    viewer_port: ViewerPort = None,
    viewer_host: ViewerHost = "127.0.0.1",
    keys: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Folder with the keys of the range, made by `skyrange keys`, for machines that join."
        ),
    ] = None,
    netns: Annotated[
        bool,
        typer.Option(
            "--netns",
            help="Put every ground station and every aircraft in its own network namespace, for tools that act on "
            "packets (tc, Scapy). Linux only; needs root.",
        ),
    ] = False,
    allow_motion: Motion = False,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Run a scenario in real time, with its components as separate processes on real sockets."""
    runs.load_plugins(plugin)
    options = {
        "group": group.value if group is not None else None,
        "on_death": on_death and on_death.value,
        "netns": netns,
        "motion": allow_motion,
        "viewer_port": live_viewer_notices.first_port(qgc, viewer_port, port_offset),
        "viewer_host": parse_ip_address("viewers", "--viewer-host", viewer_host),
    }
    live.live(scenario, out, seed, buildings, changes or [], external or [], port_offset, keys, options, as_json)


@commands.command(epilog="Example: skyrange node --join 10.0.0.1 --key lab2.key_secret")
def node(
    range_: Annotated[
        str,
        typer.Option(
            "--join",
            metavar="ADDRESS",
            help="IP address of the machine that starts the range, with :PORT if the port is not 14500.",
        ),
    ],
    key: Annotated[Path, typer.Option(metavar="FILE", help="Secret key of this machine, made by `skyrange keys`.")],
    address: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="IP address at which the other machines reach this one, as in `hosts` of the scenario. Default: the "
            "address from which this machine connects to the range.",
        ),
    ] = None,
    wait: Annotated[
        float,
        typer.Option(metavar="SECONDS", min=1, max=86_400, help="Longest time to wait for the start of the range."),
    ] = 60.0,
) -> None:
    """Join this machine to a live range, and run the components that `hosts` in the scenario assigns to it."""
    live.node(range_, key, address, wait)


@commands.command("relay", epilog="Example: skyrange relay --from 10.0.0.1 --vehicles 5 --listen 0.0.0.0")
def relay_(
    run: Annotated[
        str,
        typer.Option(
            "--from",
            metavar="ADDRESS",
            help="IP address of the run's --viewer-host, with :PORT of its first aircraft if that is not 5763.",
        ),
    ],
    vehicles: Annotated[int, typer.Option(metavar="N", min=1, max=500, help="Number of aircraft of the run.")],
    listen: Annotated[
        str,
        typer.Option(metavar="ADDRESS", help="IP address of this machine for viewers, with :PORT if not 5763."),
    ] = "127.0.0.1",
    wait: Annotated[
        float, typer.Option(metavar="SECONDS", min=1, max=86_400, help="Longest time to wait for the run.")
    ] = 60.0,
) -> None:
    """Relay the viewers' ports of a run to another network until the run ends. Nothing passes the other way."""
    live.relay(run, vehicles, listen, wait)


@commands.command(epilog="Example: skyrange keys lab-keys lab2 lab3")
def keys(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder for the keys of the range.")],
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="Name of a machine that may join. May be repeated."),
    ] = None,
) -> None:
    """Create the keys with which other machines join a live range."""
    live.keys(folder, names or [])


class Fail(StrEnum):
    """Fates of a frame for which the program of an external tap returns no verdict."""

    OPEN = "open"
    CLOSED = "closed"


@commands.command(epilog="Example: skyrange tap gcs:blue/b1 --listen 127.0.0.1:7000 --run runs/squares")
def tap(
    link: Annotated[str, typer.Argument(metavar="LINK", help="A link of a live range, such as gcs:blue/b1.")],
    listen: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="Loopback address to which your program connects; port 0 selects a free port."
        ),
    ],
    run: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Run folder of the live range. Default: the newest one under runs."),
    ] = None,
    hold_ms: Annotated[
        float,
        typer.Option(
            metavar="MS", min=1, max=60_000, help="Longest time that a frame waits for your program's verdict."
        ),
    ] = 200.0,
    fail: Annotated[
        Fail, typer.Option(metavar="HOW", help="open: a frame without a verdict passes; closed: it is dropped.")
    ] = Fail.OPEN,
    name: Annotated[str, typer.Option(metavar="NAME", help="Name of the tap in labels.")] = "tap-process",
    wait_s: Annotated[
        float, typer.Option("--wait", metavar="S", min=0, max=3600, help="Longest time to wait for the range.")
    ] = 60.0,
    as_json: AsJson = False,
) -> None:
    """Connect your own program to a link of a live range, to alter, drop, delay and inject frames."""
    live.tap(link, listen, run, hold_ms, fail.value, name, wait_s, as_json)


@commands.command(epilog="Example: skyrange merge runs/squares --out runs/squares-whole")
def merge(
    run: RunFolder,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Empty or new folder. Default: RUN-merged, beside RUN.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Merge the records that the processes of a killed live range left behind."""
    live.merge(run, out, as_json)
