"""Declaration of the benchmark and parity commands."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli import benchmark_suite, benchmarks, live_benchmark, parity
from skyrange.cli.options import AsJson, Changes, Grouping, PortOffset, ScenarioName

bench_app = typer.Typer(
    help="Measure how fast skyrange runs on this machine.\n\nExample: skyrange bench fleet --vehicles 100 --seconds 30",
    no_args_is_help=True,
)
parity_app = typer.Typer(
    help="Compare the builtin autopilot with ArduPilot: flights, missions and reactions to attacks.\n\n"
    "Example: skyrange parity missions --count 60",
    no_args_is_help=True,
)


OnAir = Annotated[
    bool,
    typer.Option(
        "--remote-id", help="Fly among buildings, with Remote ID over the radio medium; all aircraft receive."
    ),
]


class Rates(StrEnum):
    """Loop rates of ArduPilot, the values of `options.ardupilot.rates`."""

    FULL = "full"
    SINGLE = "single"
    REDUCED = "reduced"


class Physics(StrEnum):
    """Kinds of physics of the ArduPilot benchmark."""

    SHARED = "shared"
    NATIVE = "native"


class Load(StrEnum):
    """Telemetry profiles of the benchmarks."""

    LIGHT = "light"
    OPERATOR = "operator"


Telemetry = Annotated[
    Load, typer.Option(metavar="LOAD", help="Telemetry profile: light, or operator (that of QGroundControl).")
]


Cores = Annotated[
    list[int] | None,
    typer.Option(metavar="N", min=1, help="Number of cores to compare with one. May be repeated. Default: 2."),
]
Repeat = Annotated[int, typer.Option(metavar="K", min=1, help="Measure all K times, in turn, and take the medians.")]


@bench_app.command(epilog="Example: skyrange bench fleet --vehicles 100 --seconds 30 --json")
def fleet(
    vehicles: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=1, help="Number of aircraft. May be repeated. Default: 1, 10, 100 and 1000."),
    ] = None,
    seconds: Annotated[float, typer.Option(metavar="S", min=1.0, help="Simulated seconds to measure.")] = 30.0,
    load: Telemetry = Load.LIGHT,
    remote_id: OnAir = False,
    detector: Annotated[
        bool, typer.Option("--detector", help="Run a heartbeat gap detector on all gcs links.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Measure runs of N aircraft with all recording: real-time factor on one core, memory, time per component."""
    benchmarks.bench_fleet(vehicles or [1, 10, 100, 1000], seconds, load.value, remote_id, detector, as_json)


@bench_app.command("ardupilot", epilog="Example: skyrange bench ardupilot --vehicles 5 --rates reduced --json")
def ardupilots(
    vehicles: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=1, help="Number of aircraft. May be repeated. Default: 1, 5 and 20."),
    ] = None,
    seconds: Annotated[float, typer.Option(metavar="S", min=1.0, help="Simulated seconds to measure.")] = 20.0,
    load: Telemetry = Load.LIGHT,
    rates: Annotated[
        Rates,
        typer.Option(
            metavar="RATES",
            help="full: ArduCopter's own loop at 400 Hz; single: 400 Hz, one exchange per iteration; reduced: 100 Hz.",
        ),
    ] = Rates.FULL,
    physics: Annotated[
        Physics,
        typer.Option(
            metavar="KIND", help="shared: skyrange's physics in lockstep; native: ArduPilot's own simulation."
        ),
    ] = Physics.SHARED,
    speedup: Annotated[
        float, typer.Option(metavar="X", min=0.1, max=100.0, help="Speed relative to real time, with native physics.")
    ] = 1.0,
    remote_id: OnAir = False,
    cores: Cores = None,
    repeat: Repeat = 1,
    as_json: AsJson = False,
) -> None:
    """Measure runs of N ArduPilots with all recording: real-time factor, CPU time of ArduPilot and of skyrange.

    With --cores, measure instead how many times as fast one run is on several cores as on one: the ArduPilots are
    divided among the cores, each with its share of the range.
    """
    if cores:
        options = {"rates": rates.value}
        for count in vehicles or [20]:
            benchmarks.bench_cores(
                count, seconds, max(cores), cores, load.value, remote_id, "ardupilot", options, repeat,
                as_json,
            )  # fmt: skip
        return
    benchmarks.bench_ardupilot(
        vehicles or [1, 5, 20], seconds, load.value, rates.value, physics.value, speedup, remote_id, as_json
    )


@bench_app.command("cores", epilog="Example: skyrange bench cores --vehicles 1000 --cores 2 --remote-id")
def cores_bench(
    vehicles: Annotated[int, typer.Option(metavar="N", min=1, help="Number of aircraft.")] = 1000,
    seconds: Annotated[float, typer.Option(metavar="S", min=1.0, help="Simulated seconds to measure.")] = 60.0,
    operators: Annotated[
        int, typer.Option(metavar="K", min=1, help="Operators, each with a ground station and MAVLink networks.")
    ] = 4,
    cores: Cores = None,
    load: Telemetry = Load.LIGHT,
    remote_id: OnAir = False,
    repeat: Repeat = 1,
    as_json: AsJson = False,
) -> None:
    """Measure one run on several cores: how many times as fast as on one, with the same fingerprint."""
    benchmarks.bench_cores(
        vehicles, seconds, operators, cores or [2], load.value, remote_id, "builtin", {}, repeat, as_json
    )


@bench_app.command("live", epilog="Example: skyrange bench live --vehicles 40 --group operator --json")
def live_bench(
    vehicles: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=1, help="Number of aircraft. May be repeated. Default: 5 and 20."),
    ] = None,
    seconds: Annotated[
        float, typer.Option(metavar="S", min=1.0, help="Seconds to measure, after 30 s in which all aircraft take off.")
    ] = 30.0,
    group: Annotated[
        Grouping | None, typer.Option(metavar="HOW", help="component, operator, host or one, as for skyrange live.")
    ] = None,
    port_offset: PortOffset = 0,
    as_json: AsJson = False,
) -> None:
    """Measure the frame rate and added latency of each transport, and whether N aircraft run in real time."""
    live_benchmark.live(vehicles or [5, 20], seconds, group.value if group is not None else None, port_offset, as_json)


@bench_app.command(epilog="Example: skyrange bench radio --nodes 1000 --json")
def radio(
    nodes: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=2, help="Number of radios. May be repeated. Default: 10, 100 and 1000."),
    ] = None,
    seconds: Annotated[float, typer.Option(metavar="S", min=1.0, help="Simulated seconds to measure.")] = 10.0,
    horizon_m: Annotated[
        float,
        typer.Option(
            "--horizon", metavar="M", min=1.0, help="Largest distance in metres at which radios receive each other."
        ),
    ] = 500.0,
    engine: Annotated[str, typer.Option(metavar="NAME", help="Radio engine, as in [radio] of a scenario.")] = "builtin",
    as_json: AsJson = False,
) -> None:
    """Measure the radio medium with N aircraft that broadcast once per second over a city of proportional size."""
    benchmarks.bench_radio(nodes or [10, 100, 1000], seconds, horizon_m, engine, as_json)


@bench_app.command("attacks", epilog="Example: skyrange bench attacks --vehicles 100 --json")
def attacks_bench(
    vehicles: Annotated[int, typer.Option(metavar="N", min=1, help="Number of aircraft.")] = 100,
    seconds: Annotated[
        float, typer.Option(metavar="S", min=1.0, help="Simulated seconds to measure, after 30 s of warm-up.")
    ] = 10.0,
    as_json: AsJson = False,
) -> None:
    """Measure what taps on all links between stations and aircraft cost, and what a flood of one link costs."""
    benchmarks.bench_attacks(vehicles, seconds, as_json)


@bench_app.command("approval", epilog="Example: skyrange bench approval --active 10000 --json")
def approval_bench(
    active: Annotated[
        list[int] | None,
        typer.Option(
            metavar="N", min=1, help="Number of accepted intents. May be repeated. Default: 100, 1000 and 10000."
        ),
    ] = None,
    requests: Annotated[int, typer.Option(metavar="N", min=1, help="Number of requests to measure.")] = 1000,
    as_json: AsJson = False,
) -> None:
    """Measure how fast the approval authority answers requests in memory while N intents are accepted."""
    benchmarks.bench_approval(active or [100, 1000, 10_000], requests, as_json)


@bench_app.command("utm", epilog="Example: skyrange bench utm --requests 1000 --json")
def utm_bench(
    requests: Annotated[int, typer.Option(metavar="N", min=1, help="Number of requests to measure.")] = 1000,
    as_json: AsJson = False,
) -> None:
    """Measure UTM services as processes: an approval authority, and a USS with a DSS, over HTTPS with databases."""
    benchmarks.bench_utm(requests, as_json)


@bench_app.command("planning", epilog="Example: skyrange bench planning --buildings manhattan.geojson --alt-m 60")
def planning_bench(
    buildings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File of buildings. Default: a generated downtown.")
    ] = None,
    routes: Annotated[int, typer.Option(metavar="N", min=1, help="Number of routes to plan at each height.")] = 100,
    length_m: Annotated[
        float, typer.Option(metavar="M", min=10.0, max=5_000.0, help="Their straight length.")
    ] = 1000.0,
    alt_m: Annotated[
        list[float] | None,
        typer.Option(metavar="M", min=1.0, max=1_000.0, help="Height. May be repeated. Default: 30, 60 and 90 m."),
    ] = None,
    ceiling_m: Annotated[float, typer.Option(metavar="M", min=1.0, max=1_000.0, help="Greatest height.")] = 120.0,
    ompl: Annotated[
        int, typer.Option(metavar="N", min=0, help="Plan by BIT* of OMPL with N iterations, not on the lattice.")
    ] = 0,
    as_json: AsJson = False,
) -> None:
    """Measure how fast routes around the buildings of a city are planned."""
    benchmarks.bench_planning(buildings, routes, length_m, alt_m or [30.0, 60.0, 90.0], ceiling_m, ompl, as_json)


@bench_app.command("all", epilog="Example: skyrange bench all --quick --output results.json --page results.html")
def all_benches(
    quick: Annotated[
        bool, typer.Option("--quick", help="Smaller sizes: about a minute instead of five, and less to rely on.")
    ] = False,
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Run this benchmark, such as fleet-light. May be repeated. Default: all."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the results to this file as JSON, for bench page.")
    ] = None,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a page of the results to this HTML file.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Run all benchmarks in turn, with ratios to a yardstick, load of the machine and memory over time."""
    benchmark_suite.run_all(only or [], quick, output, page, as_json)


@bench_app.command("page", epilog="Example: skyrange bench page new.json --against old.json --output comparison.html")
def results_page(
    results: Annotated[
        Path, typer.Argument(metavar="RESULTS", help="Results of bench all, a JSON file.", show_default=False)
    ],
    against: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Older results to compare with: old, new and their ratios.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="HTML file to write. Default: beside the results.")
    ] = None,
) -> None:
    """Write a page of the results of bench all, alone or compared with older ones."""
    benchmark_suite.make_page(results, against, output)


@parity_app.command(epilog="Example: skyrange parity flight squares --set wind.speed_mps=8")
def flight(
    scenario: ScenarioName,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for both runs. Default: runs/NAME-parity, then -2 …"),
    ] = None,
    changes: Changes = None,
    as_json: AsJson = False,
) -> None:
    """Run a scenario with each autopilot and compare modes, legs, heights, speeds, attitudes and deviations."""
    parity.flight(scenario, out, changes or [], as_json)


@parity_app.command("attacks", epilog="Example: skyrange parity attacks mavlink.command mavlink.guided")
def attack_reactions(
    kinds: Annotated[
        list[str] | None,
        typer.Argument(metavar="[KIND]...", help="Kinds of attack with an example. Default: all."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the runs. Default: runs/attack-parity, then -2 …"),
    ] = None,
    rates: Annotated[
        Rates,
        typer.Option(
            metavar="RATES", help="ArduPilot's loop rates: reduced, 100 Hz; full or single, 400 Hz, take longer."
        ),
    ] = Rates.REDUCED,
    seeds: Annotated[
        int,
        typer.Option(
            metavar="N", min=0, max=1000, help="Fly each example with the seeds 1 to N. Default: its own seed alone."
        ),
    ] = 0,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also renew the table in this Markdown page.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Fly the examples of attacks with both autopilots, attacked and muted, and compare reactions, times and places."""
    parity.attacks(kinds or [], out, rates.value, seeds, page, as_json)


@parity_app.command(epilog="Example: skyrange parity missions --count 60 --out runs/missions")
def missions(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILE]...", help="Mission files to fly, in calm air. Default: random missions."),
    ] = None,
    count: Annotated[
        int, typer.Option(metavar="N", min=1, help="How many random missions to fly, in fleets of twenty.")
    ] = 300,
    first: Annotated[
        int,
        typer.Option(metavar="N", min=0, help="Number of the first mission: a mission is a function of its number."),
    ] = 0,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for runs and results. Default: runs/mission-parity, then -2 …"),
    ] = None,
    rates: Annotated[
        Rates,
        typer.Option(
            metavar="RATES", help="ArduPilot's loop rates: reduced, 100 Hz; full or single, 400 Hz, take longer."
        ),
    ] = Rates.REDUCED,
    shrink: Annotated[
        bool, typer.Option("--shrink/--no-shrink", help="Make each random mission that differs as simple as possible.")
    ] = True,
    as_json: AsJson = False,
) -> None:
    """Fly missions with both autopilots and compare accepted items, order, times and paths."""
    parity.missions(files or [], count, first, out, rates.value, shrink, as_json)
