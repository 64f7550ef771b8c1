"""Which commands are there, and what do they take? Imports of the library wait until a command needs them."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli import bench_live, commands, live, live_viewing, parity
from skyrange.cli import tap as tapping

app = typer.Typer(
    name="skyrange",
    help="A cyber range for the sky: fly fleets of small unmanned aircraft over a city, attack them, measure it.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
bench_app = typer.Typer(
    help="Measure how fast this machine runs the range.\n\nExample: skyrange bench fleet --vehicles 100 --seconds 30",
    no_args_is_help=True,
)
app.add_typer(bench_app, name="bench")
install_app = typer.Typer(
    help="Fetch real engines into your data folder.\n\nExample: skyrange install ardupilot",
    no_args_is_help=True,
)
app.add_typer(install_app, name="install")
parity_app = typer.Typer(
    help="Compare the builtin autopilot with ArduPilot.\n\nExample: skyrange parity gnss --out runs/gnss",
    no_args_is_help=True,
)
app.add_typer(parity_app, name="parity")

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for scripts.")]
RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder.", show_default=False)]


def _complete_scenario(incomplete: str) -> list[str]:
    from skyrange.scenario.catalogue import SHIPPED

    return [name for name in SHIPPED if name.startswith(incomplete)]


ScenarioName = Annotated[
    str,
    typer.Argument(
        metavar="NAME|FILE",
        help="A shipped scenario's name (see `skyrange scenarios`) or a TOML file.",
        autocompletion=_complete_scenario,
        show_default=False,
    ),
]
RunOut = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="The run's folder, empty or new. Default: runs/NAME, then runs/NAME-2 …"),
]
Seed = Annotated[int | None, typer.Option(metavar="N", help="Chance of the run, over the scenario's.")]
Buildings = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Fly over this GeoJSON city; the origin moves to its centre."),
]
Changes = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="PATH=VALUE", help="Change the scenario; * in the path means all. May be repeated."),
]
Qgc = Annotated[
    bool,
    typer.Option("--qgc", help="Let QGroundControl, MAVProxy and others watch, read-only, at a TCP port per aircraft."),
]
ViewerPort = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=0,
        max=65_535,
        help="The first of those ports, each next aircraft's is 10 higher; 0 takes any. Implies --qgc. "
        "Default: 5763, and a --port-offset.",
    ),
]
Motion = Annotated[
    bool,
    typer.Option(
        "--allow-motion",
        help="Let arming and motion commands through to external vehicles, where the scenario says allow_motion too. "
        "Such a vehicle can hurt somebody.",
    ),
]


def _version(wanted: bool) -> None:
    if wanted:
        from skyrange import __version__

        typer.echo(f"skyrange {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Fly fleets over a city, attack them, measure it."""


class Rates(StrEnum):
    """Loop rates of ArduPilot that the benchmark measures."""

    FULL = "full"
    REDUCED = "reduced"


class Physics(StrEnum):
    """Whose forces move the ArduPilots of the benchmark."""

    SHARED = "shared"
    NATIVE = "native"


class Load(StrEnum):
    """Telemetry profiles that the benchmark measures."""

    LIGHT = "light"
    OPERATOR = "operator"


@app.command(epilog="Example: skyrange run squares --seed 7 --set 'operators.*.vehicles.*.plan.square.alt_m=8'")
def run(
    scenario: ScenarioName,
    out: RunOut = None,
    seed: Seed = None,
    speed: Annotated[
        float | None,
        typer.Option(
            metavar="X",
            min=0.0,
            help="Simulated seconds per wall second; 0 is as fast as it goes. Default: 0, and 1 with --qgc.",
        ),
    ] = None,
    buildings: Buildings = None,
    changes: Changes = None,
    qgc: Qgc = False,
    viewer_port: ViewerPort = None,
    allow_motion: Motion = False,
    as_json: AsJson = False,
) -> None:
    """Fly a scenario and leave a run folder with a report."""
    commands.run(scenario, out, seed, speed, buildings, changes or [], qgc, viewer_port, allow_motion, as_json)


class Grouping(StrEnum):
    """How a live range's components share processes."""

    COMPONENT = "component"
    OPERATOR = "operator"
    HOST = "host"
    ONE = "one"


class Death(StrEnum):
    """What becomes of a live range in which a node dies."""

    STOP = "stop"
    CONTINUE = "continue"
    RESTART = "restart"


@app.command("live", epilog="Example: skyrange live squares --external blue.gcs")
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
    port_offset: Annotated[int, typer.Option(metavar="N", min=-5000, max=35_000, help="Added to every port.")] = 0,
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


@app.command(epilog="Example: skyrange node --join 10.0.0.1 --key lab2.key_secret")
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


@app.command(epilog="Example: skyrange keys lab-keys lab2 lab3")
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


@app.command(epilog="Example: skyrange tap gcs:blue/b1 --listen 127.0.0.1:7000 --run runs/squares")
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


@app.command(epilog="Example: skyrange pair attacked.toml --sham --seeds 5 --out runs/study")
def pair(
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="NAME|FILE",
            help="A shipped scenario's name or a TOML file, with at least one attack that acts.",
            autocompletion=_complete_scenario,
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="The pair's folder, empty or new. Default: runs/NAME-pair, then -2 …"),
    ] = None,
    sham: Annotated[
        bool, typer.Option("--sham", help="A third arm: the attacks send as much, and it is all benign.")
    ] = False,
    seeds: Annotated[
        int, typer.Option(metavar="K", min=1, help="Repeat with K seeds; effects get means and 95 % intervals.")
    ] = 1,
    jobs: Annotated[int, typer.Option(metavar="N", min=1, help="Runs that fly at once, a process each.")] = 2,
    seed: Annotated[int | None, typer.Option(metavar="N", help="The first seed, over the scenario's.")] = None,
    buildings: Buildings = None,
    changes: Changes = None,
    as_json: AsJson = False,
) -> None:
    """Fly a scenario with its attacks and with all of them muted, and compare: what did the attack do?"""
    commands.pair(scenario, out, sham, seeds, jobs, seed, buildings, changes or [], as_json)


@app.command(epilog="Example: skyrange show runs/squares")
def show(run: RunFolder, as_json: AsJson = False) -> None:
    """Say what a run was and how it went; works on killed and unfinished runs too."""
    commands.show(run, as_json)


@app.command(epilog="Example: skyrange report runs/squares --out squares.html")
def report(
    run: RunFolder,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Where to write it. Default: report.html in the run.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write a run's HTML report: one file, no network needed to read it."""
    commands.report(run, out, as_json)


class Kind(StrEnum):
    """Captures that can be made of a run."""

    REMOTE_ID = "remote_id"
    MAVLINK = "mavlink"


@app.command(epilog="Example: skyrange export runs/rid-spoofing --only remote_id --receiver green/g1")
def export(
    run: RunFolder,
    only: Annotated[
        Kind | None,
        typer.Option(metavar="KIND", help="remote_id or mavlink. Default: all that the run has."),
    ] = None,
    receiver: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Of Remote ID only what this one received: a vehicle, a ground receiver or an attack that listens. "
            "May be repeated. Default: all of them.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="An existing folder to write to. Default: the run's.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write captures for Wireshark: remote_id.pcapng as received over the air, mavlink.pcapng of the gcs links."""
    commands.export(run, only.value if only is not None else None, receiver or [], out, as_json)


@app.command(epilog="Example: skyrange diff runs/squares runs/squares-2")
def diff(
    a: Annotated[Path, typer.Argument(metavar="A", help="A run's folder.", show_default=False)],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another run's folder.", show_default=False)],
    tolerance: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Compare what was decided, what happened and how it ended, and let times differ by so much: for live "
            "runs, which do not repeat to the byte. Default: every row has to be the same.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare two runs: first differing frame, first differing truth, then the summary. Exits 0 either way."""
    commands.diff(a, b, tolerance, as_json)


@app.command(epilog="Example: skyrange scenarios --json")
def scenarios(as_json: AsJson = False) -> None:
    """List the shipped scenarios."""
    commands.scenarios(as_json)


@app.command(epilog="Example: skyrange schema > scenario.schema.json")
def schema() -> None:
    """Print the JSON Schema of a scenario: every key with its meaning, unit and range."""
    commands.schema()


@app.command(epilog="Example: skyrange doctor --json")
def doctor(as_json: AsJson = False) -> None:
    """Say what this installation has, and what is missing; compile the numeric kernels once."""
    commands.doctor(as_json)


@install_app.callback()
def _install() -> None:
    """Fetch real engines into your data folder."""


@install_app.command(epilog="Example: skyrange install ardupilot --version 4.6.3")
def ardupilot(
    version: Annotated[
        str | None,
        typer.Option(
            metavar="V", help="The release to fetch, or what FILE must be. Default: 4.7.0, or whatever FILE is."
        ),
    ] = None,
    source: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="Take this arducopter for SITL; no network is needed."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Put ArduPilot's official SITL binary of ArduCopter into your data folder, after checking that it runs."""
    commands.install_ardupilot(version, source, as_json)


@bench_app.command(epilog="Example: skyrange bench fleet --vehicles 100 --seconds 30 --json")
def fleet(
    vehicles: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=1, help="Aircraft; may be repeated. Default: 1, 10, 100 and 1000."),
    ] = None,
    seconds: Annotated[float, typer.Option(metavar="S", min=1.0, help="Simulated seconds to measure.")] = 30.0,
    load: Annotated[
        Load, typer.Option(metavar="LOAD", help="Telemetry asked for: light, or operator, what QGroundControl asks.")
    ] = Load.LIGHT,
    remote_id: Annotated[
        bool, typer.Option("--remote-id", help="Among buildings, with Remote ID over the radio medium, all listening.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Fly N aircraft on missions with everything recorded: real-time factor on one core, memory, share per part."""
    commands.bench_fleet(vehicles or [1, 10, 100, 1000], seconds, load.value, remote_id, as_json)


@bench_app.command("ardupilot", epilog="Example: skyrange bench ardupilot --vehicles 5 --rates reduced --json")
def ardupilots(
    vehicles: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=1, help="Aircraft; may be repeated. Default: 1, 5 and 20."),
    ] = None,
    seconds: Annotated[float, typer.Option(metavar="S", min=1.0, help="Simulated seconds to measure.")] = 20.0,
    load: Annotated[
        Load, typer.Option(metavar="LOAD", help="Telemetry asked for: light, or operator, what QGroundControl asks.")
    ] = Load.LIGHT,
    rates: Annotated[
        Rates, typer.Option(metavar="RATES", help="Loop rates: full, ArduCopter's own 400 Hz, or reduced, 100 Hz.")
    ] = Rates.FULL,
    physics: Annotated[
        Physics, typer.Option(metavar="KIND", help="shared, our world in lockstep, or native, ArduPilot's simulation.")
    ] = Physics.SHARED,
    speedup: Annotated[
        float, typer.Option(metavar="X", min=0.1, max=100.0, help="With native physics: times real time.")
    ] = 1.0,
    as_json: AsJson = False,
) -> None:
    """Fly N ArduPilots on missions with everything recorded: real-time factor, processor time, theirs and ours."""
    commands.bench_ardupilot(vehicles or [1, 5, 20], seconds, load.value, rates.value, physics.value, speedup, as_json)


@bench_app.command("live", epilog="Example: skyrange bench live --vehicles 40 --group operator --json")
def live_bench(
    vehicles: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=1, help="Aircraft; may be repeated. Default: 5 and 20."),
    ] = None,
    seconds: Annotated[
        float, typer.Option(metavar="S", min=1.0, help="Seconds to fly, after 30 in which all take off.")
    ] = 30.0,
    group: Annotated[
        Grouping | None, typer.Option(metavar="HOW", help="As of skyrange live: component, operator, host or one.")
    ] = None,
    port_offset: Annotated[int, typer.Option(metavar="N", min=-5000, max=35_000, help="Added to every port.")] = 0,
    as_json: AsJson = False,
) -> None:
    """What a live range carries: each transport's frames per second and added latency; do N aircraft hold real time."""
    bench_live.live(vehicles or [5, 20], seconds, group.value if group is not None else None, port_offset, as_json)


@bench_app.command(epilog="Example: skyrange bench radio --nodes 1000 --json")
def radio(
    nodes: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=2, help="Radios; may be repeated. Default: 10, 100 and 1000."),
    ] = None,
    seconds: Annotated[float, typer.Option(metavar="S", min=1.0, help="Simulated seconds to measure.")] = 10.0,
    horizon_m: Annotated[
        float, typer.Option("--horizon", metavar="M", min=1.0, help="Metres beyond which nobody hears anybody.")
    ] = 500.0,
    as_json: AsJson = False,
) -> None:
    """Broadcast once a second from N aircraft over a city of their own size: what the air costs, and what of it."""
    commands.bench_radio(nodes or [10, 100, 1000], seconds, horizon_m, as_json)


@parity_app.command(epilog="Example: skyrange parity flight squares --set wind.speed_mps=8")
def flight(
    scenario: ScenarioName,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="A folder for both runs. Default: runs/NAME-parity, then -2 …"),
    ] = None,
    changes: Changes = None,
    as_json: AsJson = False,
) -> None:
    """Fly a scenario with all aircraft under each of the two: modes, legs, heights, speeds, attitudes, deviations."""
    parity.flight(scenario, out, changes or [], as_json)


@parity_app.command(epilog="Example: skyrange parity gnss --out runs/gnss --json")
def gnss(
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="A folder for the run. Default: runs/gnss-reactions, then -2 …"),
    ] = None,
    rates: Annotated[
        Rates,
        typer.Option(metavar="RATES", help="Loop rates of ArduPilot: reduced, 100 Hz, or full, 400 Hz; takes longer."),
    ] = Rates.REDUCED,
    as_json: AsJson = False,
) -> None:
    """Deceive both in a hundred ways, by jumps and drifts of GNSS: same outcome? reset at the same time?"""
    parity.gnss(out, rates.value, as_json)
