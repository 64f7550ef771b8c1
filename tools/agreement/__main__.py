"""`python -m tools.agreement`: how far skyrange agrees with ArduPilot, Gazebo and other radio engines."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli.measurement_app import Load, Rates, Telemetry
from skyrange.cli.options import AsJson, Changes, ScenarioName
from skyrange.cli.output.console import print_notice
from skyrange.cli.output.error_messages import describe_error
from tools.agreement import commands

app = typer.Typer(help="Compare skyrange with the programs that it stands for.", no_args_is_help=True)


class OtherRates(StrEnum):
    """Loop rates that differ from ArduPilot's own."""

    SINGLE = "single"
    REDUCED = "reduced"


@app.command("rates", epilog="Example: python -m tools.agreement rates squares --rates single")
def loop_rates(
    scenario: ScenarioName,
    rates: Annotated[
        OtherRates,
        typer.Option(metavar="RATES", help="reduced: 100 Hz; single: 400 Hz with one exchange per iteration."),
    ] = OtherRates.REDUCED,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for both runs. Default: runs/NAME-rates, then -2 …"),
    ] = None,
    changes: Changes = None,
    as_json: AsJson = False,
) -> None:
    """Run a scenario with ArduPilot at its own loop rate and at a cheaper one, and compare the flights."""
    commands.compare_loop_rates(scenario, rates.value, out, changes or [], as_json)


@app.command("gnss", epilog="Example: python -m tools.agreement gnss --out runs/gnss --json")
def gnss(
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the run. Default: runs/gnss-reactions, then -2 …"),
    ] = None,
    rates: Annotated[
        Rates,
        typer.Option(
            metavar="RATES", help="Loop rate of ArduPilot. reduced: 100 Hz; full or single: 400 Hz, which take longer."
        ),
    ] = Rates.REDUCED,
    as_json: AsJson = False,
) -> None:
    """Compare outcomes and reset times of both autopilots for a hundred GNSS jumps and drifts."""
    commands.compare_gnss_reactions(out, rates.value, as_json)


@app.command("gazebo-speed", epilog="Example: python -m tools.agreement gazebo-speed --vehicles 5 --vehicles 10")
def gazebo_bench(
    vehicles: Annotated[
        list[int] | None,
        typer.Option(
            metavar="N",
            min=1,
            help="Number of aircraft. May be repeated. Default: 1, 2, 5, 10, 20, 40 and 80. A number at which Gazebo "
            "is far slower than real time is the last.",
        ),
    ] = None,
    seconds: Annotated[
        float, typer.Option(metavar="S", min=1.0, help="Simulated seconds of each measurement, after 30 s of warm-up.")
    ] = 5.0,
    repeat: Annotated[
        int, typer.Option(metavar="K", min=1, help="Measure both K times in a flight, in turn, and take the medians.")
    ] = 3,
    load: Telemetry = Load.LIGHT,
    rates: Annotated[
        Rates, typer.Option(metavar="RATES", help="Loop rate of ArduPilot: full, single or reduced.")
    ] = Rates.FULL,
    window: Annotated[bool, typer.Option("--window", help="Open Gazebo's window.")] = False,
    collision: Annotated[
        bool, typer.Option("--collision/--no-collision", help="Also let two aircraft collide, in both.")
    ] = True,
    output: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the results to this file as JSON.")] = None,
    as_json: AsJson = False,
) -> None:
    """Measure N ArduPilots in Gazebo beside the range's own physics: real-time factor, CPU time, and a collision."""
    counts = vehicles or [1, 2, 5, 10, 20, 40, 80]
    commands.measure_gazebo_speed(counts, seconds, repeat, load.value, rates.value, window, collision, output, as_json)


@app.command("gazebo-physics", epilog="Example: python -m tools.agreement gazebo-physics squares")
def gazebo_physics(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(metavar="[SCENARIO]...", help="Scenarios or files. Default: squares, head-on and wind."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the runs. Default: runs/gazebo-parity, then -2 …"),
    ] = None,
    changes: Changes = None,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also write this Markdown page, whatever it was before.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Fly scenarios with ArduPilot in skyrange's own physics and in Gazebo's, and compare truth and collisions.

    The first one is flown twice more in Gazebo: again, and with finer steps of its physics.
    """
    commands.compare_gazebo_physics(scenarios or [], out, changes or [], page, as_json)


@app.command("radio", epilog="Example: python -m tools.agreement radio --buildings city.geojson --engine ns3")
def radio_engines(
    engines: Annotated[
        list[str] | None,
        typer.Option("--engine", metavar="NAME", help="Engine to compare. May be repeated. Default: all installed."),
    ] = None,
    buildings: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="City, in a file of buildings. Default: a generated downtown."),
    ] = None,
    pairs: Annotated[
        int, typer.Option(metavar="N", min=100, help="Pairs of places for the comparison of path losses.")
    ] = 10_000,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for tables and figures. Default: runs/radio-parity, then -2 …"),
    ] = None,
    page: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Also renew the tables in this Markdown page, and figures in ../images."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare radio engines with the builtin medium: reception, contention, hidden terminals, and path losses."""
    commands.compare_radio_engines(engines or [], buildings, pairs, out, page, as_json)


def main() -> None:
    """Run the command that the arguments name; an error is one line, or one line per problem."""
    try:
        code = app(prog_name="python -m tools.agreement", standalone_mode=False)
    except typer.Abort:
        raise
    except Exception as error:
        text, code = describe_error(error)
        print_notice(text)
    sys.exit(code if isinstance(code, int) else 0)


if __name__ == "__main__":
    main()
