"""Which commands measure the range, and what do they take?"""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli import bench_live, commands, parity
from skyrange.cli.options import AsJson, Changes, Grouping, PortOffset, ScenarioName

bench_app = typer.Typer(
    help="Measure how fast this machine runs the range.\n\nExample: skyrange bench fleet --vehicles 100 --seconds 30",
    no_args_is_help=True,
)
parity_app = typer.Typer(
    help="Compare the builtin autopilot with ArduPilot, and ArduPilot with itself at other rates.\n\n"
    "Example: skyrange parity gnss --out runs/gnss",
    no_args_is_help=True,
)


OnAir = Annotated[
    bool, typer.Option("--remote-id", help="Among buildings, with Remote ID over the radio medium, all listening.")
]


class Rates(StrEnum):
    """Loop rates of ArduPilot, as in `options.ardupilot.rates`."""

    FULL = "full"
    SINGLE = "single"
    REDUCED = "reduced"


class OtherRates(StrEnum):
    """Those that are not its own."""

    SINGLE = "single"
    REDUCED = "reduced"


class Physics(StrEnum):
    """Whose forces move the ArduPilots of the benchmark."""

    SHARED = "shared"
    NATIVE = "native"


class Load(StrEnum):
    """Telemetry profiles that the benchmark measures."""

    LIGHT = "light"
    OPERATOR = "operator"


Telemetry = Annotated[
    Load, typer.Option(metavar="LOAD", help="Telemetry asked for: light, or operator, what QGroundControl asks.")
]


@bench_app.command(epilog="Example: skyrange bench fleet --vehicles 100 --seconds 30 --json")
def fleet(
    vehicles: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=1, help="Aircraft; may be repeated. Default: 1, 10, 100 and 1000."),
    ] = None,
    seconds: Annotated[float, typer.Option(metavar="S", min=1.0, help="Simulated seconds to measure.")] = 30.0,
    load: Telemetry = Load.LIGHT,
    remote_id: OnAir = False,
    detector: Annotated[
        bool, typer.Option("--detector", help="Have a heartbeat gap detector listen to all gcs links.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Fly N aircraft on missions with everything recorded: real-time factor on one core, memory, share per part."""
    commands.bench_fleet(vehicles or [1, 10, 100, 1000], seconds, load.value, remote_id, detector, as_json)


@bench_app.command("ardupilot", epilog="Example: skyrange bench ardupilot --vehicles 5 --rates reduced --json")
def ardupilots(
    vehicles: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=1, help="Aircraft; may be repeated. Default: 1, 5 and 20."),
    ] = None,
    seconds: Annotated[float, typer.Option(metavar="S", min=1.0, help="Simulated seconds to measure.")] = 20.0,
    load: Telemetry = Load.LIGHT,
    rates: Annotated[
        Rates,
        typer.Option(
            metavar="RATES",
            help="full, ArduCopter's own loop at 400 Hz, single, one exchange in its turn, or reduced, 100 Hz.",
        ),
    ] = Rates.FULL,
    physics: Annotated[
        Physics, typer.Option(metavar="KIND", help="shared, our world in lockstep, or native, ArduPilot's simulation.")
    ] = Physics.SHARED,
    speedup: Annotated[
        float, typer.Option(metavar="X", min=0.1, max=100.0, help="With native physics: times real time.")
    ] = 1.0,
    remote_id: OnAir = False,
    as_json: AsJson = False,
) -> None:
    """Fly N ArduPilots on missions with everything recorded: real-time factor, processor time, theirs and ours."""
    commands.bench_ardupilot(
        vehicles or [1, 5, 20], seconds, load.value, rates.value, physics.value, speedup, remote_id, as_json
    )


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
    port_offset: PortOffset = 0,
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


@parity_app.command("rates", epilog="Example: skyrange parity rates squares --rates single")
def loop_rates(
    scenario: ScenarioName,
    rates: Annotated[
        OtherRates,
        typer.Option(metavar="RATES", help="reduced, 100 Hz, or single, 400 Hz with one exchange in a turn."),
    ] = OtherRates.REDUCED,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="A folder for both runs. Default: runs/NAME-rates, then -2 …"),
    ] = None,
    changes: Changes = None,
    as_json: AsJson = False,
) -> None:
    """Fly a scenario with all aircraft under ArduPilot, at its own rates and at cheaper ones: what does that change?"""
    parity.rates(scenario, rates.value, out, changes or [], as_json)


@parity_app.command(epilog="Example: skyrange parity gnss --out runs/gnss --json")
def gnss(
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="A folder for the run. Default: runs/gnss-reactions, then -2 …"),
    ] = None,
    rates: Annotated[
        Rates,
        typer.Option(metavar="RATES", help="ArduPilot's: reduced, 100 Hz, or full or single, 400 Hz; takes longer."),
    ] = Rates.REDUCED,
    as_json: AsJson = False,
) -> None:
    """Deceive both in a hundred ways, by jumps and drifts of GNSS: same outcome? reset at the same time?"""
    parity.gnss(out, rates.value, as_json)
