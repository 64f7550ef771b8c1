"""`python -m tools.agreement`: how far skyrange agrees with ArduPilot, Gazebo and other radio engines."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skyrange.cli.options import AsJson, Changes, Load, Rates, ScenarioChoice, ScenarioName, Telemetry
from skyrange.cli.output.console import print_json, print_notice, print_text, terminal
from skyrange.cli.output.error_messages import describe_error
from skyrange.cli.parity import print_parity

if TYPE_CHECKING:
    from tools.agreement.gnss_reactions import ComparedReaction

app = typer.Typer(help="Compare skyrange with the programs that it stands for.", no_args_is_help=True)


class OtherRates(StrEnum):
    """Loop rates that differ from ArduPilot's own."""

    SINGLE = "single"
    REDUCED = "reduced"


@app.command("rates", epilog="Example: python -m tools.agreement rates squares --rates single")
def loop_rates(
    *,
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
    from skyrange.cli.output.progress import progress
    from skyrange.parity.flights import compare_rates
    from skyrange.runtime.run import free_folder

    chosen, other = ScenarioChoice(scenario, changes=changes or ()).load(), rates.value
    folder = out if out is not None else free_folder(f"{chosen.name}-rates")
    with progress(f"{chosen.name}, twice", quiet=as_json) as on_progress:
        parity = compare_rates(chosen, folder, other, on_progress=on_progress)
    print_parity(chosen.name, parity, {"full": "full rates", other: f"{other} rates"}, folder, as_json=as_json)


@app.command("fix-noise", epilog="Example: python -m tools.agreement fix-noise flight.tlog --seeds 5")
def fix_noise(
    *,
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Logs with times on the ground.")],
    seeds: Annotated[int, typer.Option(metavar="N", min=1, help="Park N simulated aircraft.")] = 10,
    page: Annotated[Path | None, typer.Option(metavar="FILE", help="Also renew the table in this page.")] = None,
) -> None:
    """Compare how the fixes of receivers at rest wander: those of logs and those of simulated receivers."""
    from skyrange.flightlog.reading import read_log
    from tools.agreement.fix_noise import TABLE, fly_parked, measure_fixes, write_lines

    if page is not None:
        TABLE.read(page)
    lines = write_lines([measure_fixes(each.stem, read_log(each)) for each in logs], fly_parked(seeds))
    if page is not None:
        TABLE.write(page, lines)
    for line in lines:
        print_text(line)


@app.command("ray-casters", epilog="Example: python -m tools.agreement ray-casters --buildings manhattan.geojson")
def ray_casters(
    *,
    buildings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File of buildings. Default: a generated downtown.")
    ] = None,
    reach_m: Annotated[float, typer.Option("--reach", metavar="M", min=1.0, help="How far rays reach.")] = 100.0,
    as_json: AsJson = False,
) -> None:
    """Compare skyrange's ray caster with Embree's: rays a second of processor time, and distances."""
    from skyrange.bench.planning import load_city
    from tools.agreement.ray_casters import compare

    rows, agreed = compare(load_city(buildings), reach_m)
    if as_json:
        print_json({"casters": [asdict(row) for row in rows], "agreement": asdict(agreed)})
        return
    for row in rows:
        repeats = "repeats to the bit" if row.repeats else "does not repeat"
        print_text(f"{row.name:<9} {row.rays_per_s / 1e6:6.1f} M rays/s, built in {row.build_ms:.0f} ms, {repeats}")
    print_text(
        f"{agreed.rays:,} rays met something: {agreed.met_by_one} in one of the two only; distances differ by "
        f"{agreed.median_m * 1e3:.3f} mm (median) and {agreed.worst_m * 1e3:.3f} mm (worst)"
    )


@app.command("gnss", epilog="Example: python -m tools.agreement gnss --out runs/gnss --json")
def gnss(
    *,
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
    from rich.table import Table

    from skyrange.cli.output.progress import progress
    from skyrange.runtime.run import free_folder
    from tools.agreement.gnss_reactions import TIME_S, agreement, compare, settings

    folder = out if out is not None else free_folder("gnss-reactions")
    with progress("100 false GNSS, twice", quiet=as_json) as on_progress:
        compared = compare(folder, settings(), rates.value, on_progress=on_progress)
    agreed = agreement(compared)
    if as_json:
        print_json(
            {
                "path": str(folder),
                **asdict(agreed),
                "settings_flown": [_describe_setting(reaction) for reaction in compared],
            }
        )
        return
    table = Table(title="False GNSS: builtin and ArduPilot", title_justify="left", title_style="bold")
    for column in ("setting", "builtin", "ArduPilot", "reset", "", "led", "", ""):
        table.add_column(column, justify="left" if column in ("setting", "builtin", "ArduPilot") else "right")
    for reaction in compared:
        table.add_row(
            reaction.setting.description,
            reaction.first.outcome,
            reaction.second.outcome,
            _seconds(reaction.first.reset_s),
            _seconds(reaction.second.reset_s),
            f"{reaction.first.led_m:.1f} m",
            f"{reaction.second.led_m:.1f} m",
            "" if reaction.alike else "differs",
        )
    console = terminal()
    console.print(table)
    console.print(f"same outcome in {agreed.alike} of {agreed.settings}")
    console.print(
        f"both reset in {agreed.resets}: {agreed.together} within {TIME_S:g} s, "
        f"at most {agreed.reset_apart_max_s:.2f} s"
    )
    console.print(f"run    {folder}", soft_wrap=True)


def _seconds(at: float | None) -> str:
    return "" if at is None else f"{at:.1f} s"


def _describe_setting(compared: ComparedReaction) -> dict[str, Any]:
    """A setting and the reactions to it, for `--json`."""
    reactions = {"builtin": compared.first, "ardupilot": compared.second}
    return {
        "setting": compared.setting.description,
        "kind": compared.setting.kind,
        "params": dict(compared.setting.params),
        "alike": compared.alike,
        **{name: {**asdict(reaction), "outcome": reaction.outcome} for name, reaction in reactions.items()},
    }


@app.command("gazebo-speed", epilog="Example: python -m tools.agreement gazebo-speed --vehicles 5 --vehicles 10")
def gazebo_bench(
    *,
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
    from skyrange.core.errors import InputError
    from skyrange.core.files import atomic_write
    from tools.agreement.gazebo_bench import collision as head_on
    from tools.agreement.gazebo_bench.fleets import PUBLISHED_VEHICLES, measure, measure_all, require_gazebo

    require_gazebo(window=window)
    if output is not None and (output.is_dir() or not output.parent.is_dir()):
        raise InputError.one("gazebo-speed", "--output", str(output), "a file in a folder that exists")

    def show(row: dict[str, Any]) -> None:
        there, here = row["gazebo"], row["range"]
        print_text(
            f"{row['vehicles']:>8} {there['real_time_factor']:>11.2f} {there['inverse']:>7.2f} "
            f"{there['gazebo_cpu_s']:>8.3f} {there['autopilots_cpu_s']:>10.3f} {there['ours_cpu_s']:>8.3f} "
            f"{here['real_time_factor']:>9.2f} {row['slower']:>12.2f}"
        )

    if not as_json:
        heads = f"{'aircraft':>8} {'× real time':>11} {'inverse':>7} {'Gazebo':>8} {'ArduPilots':>10} {'skyrange':>8}"
        print_text(f"{heads} {'in range':>9} {'range/Gazebo':>12}  (cores that real time needs)")
    fly = partial(measure, seconds=seconds, windows=repeat, load=load.value, rates=rates.value, window=window)
    collide = partial(head_on.measure, window=window) if collision else None
    data = measure_all(vehicles or [1, 2, 5, 10, 20, 40, 80], fly, collide, None if as_json else show)
    if output is not None:
        with atomic_write(output) as file:
            file.write(json.dumps(data, indent=1).encode())
    if as_json:
        print_json(data)
        return
    most = data["real_time"]["gazebo"]
    if most["measured"] is not None:
        more = "" if most["interpolated"] is None else f", interpolated {most['interpolated']}"
        print_text(f"in real time: {most['measured']} aircraft measured{more}; published: about {PUBLISHED_VEHICLES}")
    for hit in data["collisions"]:
        print_text(f"collision in {hit['physics']}: {hit['speed_mps']:.2f} m/s, {hit['energy_j']:.1f} J")
        for vehicle, fell in hit["aircraft"].items():
            heights = ", ".join(f"{height_m:.1f}" for height_m in fell["heights_after_m"])
            print_text(
                f"  {vehicle}: lost motors {fell['lost_motors']}, {fell['height_before_m']:.1f} m high before, "
                f"{heights} m after 0.5, 1, 2 s; on the ground after {fell['fell_s']} s"
            )
    if output is not None:
        print_text(f"results {output}")


@app.command("gazebo-physics", epilog="Example: python -m tools.agreement gazebo-physics squares")
def gazebo_physics(
    *,
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
        Path | None, typer.Option(metavar="FILE", help="Also renew the tables in this Markdown page.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Fly scenarios with ArduPilot in skyrange's own physics and in Gazebo's, and compare truth and collisions.

    The first one is flown twice more in Gazebo: again, and with finer steps of its physics.
    """
    from skyrange.cli.output.progress import step_progress
    from skyrange.runtime.run import free_folder
    from tools.agreement.physics import page as report
    from tools.agreement.physics.comparison import RESULTS, SCENARIOS, compare, results

    if page is not None:
        report.check_page(page)
    chosen = list(scenarios or SCENARIOS)
    folder = out if out is not None else free_folder("gazebo-parity")
    with step_progress(quiet=as_json) as on_step:
        compared = compare(folder, chosen, changes or (), again=chosen[0], on_step=on_step)
    if page is not None:
        report.renew_page(compared, page)
    if as_json:
        print_json({"path": str(folder), **results(compared)})
        return
    console = terminal()
    for line in report.tables(compared):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    if page is not None:
        print_notice(f"page {page}")
    console.print(f"results {folder}/{RESULTS}, and the runs", soft_wrap=True, markup=False)


@app.command("radio", epilog="Example: python -m tools.agreement radio --buildings city.geojson --engine ns3")
def radio_engines(
    *,
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
    from skyrange.city.building_files import load_buildings
    from skyrange.city.downtown import downtown_grid
    from skyrange.cli.output.progress import step_progress
    from skyrange.core.errors import InputError, nearest
    from skyrange.core.files import expand_user
    from skyrange.runtime.run import free_folder
    from tools.agreement.radio import page as report
    from tools.agreement.radio.agreement import compare
    from tools.agreement.radio.setups import installed_engines

    known = installed_engines()  # with what each lacks to run here
    for name in engines or ():
        if name not in known:
            expected = f"an engine to compare: {', '.join(sorted(known))}"
            raise InputError.one("radio", "--engine", name, expected, nearest(name, known))
        if known[name]:
            raise InputError.one("radio", "--engine", name, "an engine that runs here", known[name])
    chosen = [name for name in known if name in engines] if engines else [name for name in known if not known[name]]
    for name, why in known.items():
        if not engines and why:
            print_notice(f"without {name}: {why}")
    if page is not None:
        report.check_page(page)
    city = load_buildings(expand_user(buildings))[0] if buildings is not None else downtown_grid((12, 12))
    folder = out if out is not None else free_folder("radio-parity")
    with step_progress(quiet=as_json) as on_step:
        compared = compare(city, chosen, pairs=pairs, on_step=on_step)
    report.write_results(compared, folder)
    if page is not None:
        report.renew_page(compared, page)
    if as_json:
        print_json({"path": str(folder), **report.results(compared)})
        return
    console = terminal()
    for line in report.tables(compared):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    console.print(f"results {folder}/radio.json, radio.md and figures", soft_wrap=True, markup=False)


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
