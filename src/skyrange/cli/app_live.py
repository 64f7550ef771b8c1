"""Which commands are there for live ranges, and what do they take?"""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli import live, live_viewing
from skyrange.cli import tap as tapping
from skyrange.cli.options import (
    AsJson,
    Buildings,
    Changes,
    Grouping,
    Motion,
    PortOffset,
    Qgc,
    RunFolder,
    RunOut,
    ScenarioName,
    Seed,
    ViewerPort,
)

commands = typer.Typer()


class Death(StrEnum):
    """What becomes of a live range in which a node dies."""

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
            help="Which components share a process: component, none do; operator, those of an operator; host, those "
            "on a machine; one, all do. "
            "Default: component while there are at most eight for each core, then operator.",
        ),
    ] = None,
    external: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COMPONENT",
            help="Start no process for this one, such as blue.gcs: a program of yours is it. May be repeated.",
        ),
    ] = None,
    port_offset: PortOffset = 0,
    on_death: Annotated[
        Death | None,
        typer.Option(
            metavar="HOW",
            help="When a process dies: stop the range, continue without it, or restart it, at most three times. "
            "Default: what the scenario says, else stop.",
        ),
    ] = None,
    qgc: Qgc = False,
    viewer_port: ViewerPort = None,
    keys: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="The range's keys, as `skyrange keys` makes them, for hosts that join. No default."
        ),
    ] = None,
    netns: Annotated[
        bool,
        typer.Option(
            "--netns",
            help="Give every ground station and every aircraft a network namespace of its own, for tools that work on "
            "packets (tc, Scapy). Linux, and needs root.",
        ),
    ] = False,
    allow_motion: Motion = False,
    as_json: AsJson = False,
) -> None:
    """Fly a scenario in real time, every component a process of its own on real sockets."""
    options = {
        "group": group.value if group is not None else None,
        "on_death": on_death and on_death.value,
        "netns": netns,
        "motion": allow_motion,
        "viewer_port": live_viewing.first_port(qgc, viewer_port, port_offset),
    }
    live.live(scenario, out, seed, buildings, changes or [], external or [], port_offset, keys, options, as_json)


@commands.command(epilog="Example: skyrange node --join 10.0.0.1 --key lab2.key_secret")
def node(
    range_: Annotated[
        str,
        typer.Option(
            "--join",
            metavar="ADDRESS",
            help="Where the range is started: its IP address, with :PORT if ports were moved (else 14500).",
        ),
    ],
    key: Annotated[Path, typer.Option(metavar="FILE", help="This machine's secret key, which `skyrange keys` made.")],
    address: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="At which IP address the others reach this machine, as hosts in the scenario has it. Default: the one "
            "from which it reaches the range.",
        ),
    ] = None,
    wait: Annotated[
        float, typer.Option(metavar="SECONDS", min=1, max=86_400, help="How long to wait for the range to be started.")
    ] = 60.0,
) -> None:
    """Offer this machine to a live range: it runs there what the scenario's hosts say, until the range ends."""
    live.node(range_, key, address, wait)


@commands.command(epilog="Example: skyrange keys lab-keys lab2 lab3")
def keys(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="The folder for the range's keys.")],
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="A machine that shall be able to join. May be repeated."),
    ] = None,
) -> None:
    """Make the keys with which other machines join a live range."""
    live.keys(folder, names or [])


class Fail(StrEnum):
    """What becomes of a frame that an external tap's program does not judge."""

    OPEN = "open"
    CLOSED = "closed"


@commands.command(epilog="Example: skyrange tap gcs:blue/b1 --listen 127.0.0.1:7000 --run runs/squares")
def tap(
    link: Annotated[str, typer.Argument(metavar="LINK", help="A link of a live range, such as gcs:blue/b1.")],
    listen: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Where a program of yours calls, on the loopback; port 0 takes any.")
    ],
    run: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="The range's run folder. Default: the newest live one under runs."),
    ] = None,
    hold_ms: Annotated[
        float, typer.Option(metavar="MS", min=1, max=60_000, help="How long a frame waits for its answer.")
    ] = 200.0,
    fail: Annotated[
        Fail, typer.Option(metavar="HOW", help="A frame without an answer passes (open) or is dropped (closed).")
    ] = Fail.OPEN,
    name: Annotated[str, typer.Option(metavar="NAME", help="What labels call it.")] = "tap-process",
    wait_s: Annotated[
        float, typer.Option("--wait", metavar="S", min=0, max=3600, help="How long to wait for the range to be there.")
    ] = 60.0,
    as_json: AsJson = False,
) -> None:
    """Put a program of yours, in any language, on a link of a live range: it sees, alters, drops, delays, injects."""
    tapping.tap(link, listen, run, hold_ms, fail.value, name, wait_s, as_json)


@commands.command(epilog="Example: skyrange merge runs/squares --out runs/squares-whole")
def merge(
    run: RunFolder,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="A folder, empty or new. Default: RUN-merged, beside it.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Make one record of what the processes of a live range left behind that was killed."""
    live.merge(run, out, as_json)
