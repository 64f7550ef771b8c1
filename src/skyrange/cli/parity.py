"""The commands `skyrange parity flight`, `log`, `attacks` and `missions`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skyrange.cli.options import AsJson, Changes, Jobs, Rates, ScenarioChoice, ScenarioName, Workers
from skyrange.cli.output.console import print_json, print_notice, terminal

if TYPE_CHECKING:
    from skyrange.parity.flights import FlightMeasures, Parity


parity_app = typer.Typer(
    help="Compare the builtin autopilot with ArduPilot and with logs: flights, missions, reactions to attacks.\n\n"
    "Example: skyrange parity missions --count 60",
    no_args_is_help=True,
)


@parity_app.command(epilog="Example: skyrange parity flight squares --set wind.speed_mps=8")
def flight(
    *,
    scenario: ScenarioName,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for both runs. Default: runs/NAME-parity, then -2 …"),
    ] = None,
    changes: Changes = None,
    as_json: AsJson = False,
) -> None:
    """Run a scenario with each autopilot and compare modes, legs, heights, speeds, attitudes and deviations."""
    from skyrange.cli.output.progress import progress
    from skyrange.parity.flights import compare
    from skyrange.runtime.run import free_folder

    chosen = ScenarioChoice(scenario, changes=changes or ()).load()
    folder = out if out is not None else free_folder(f"{chosen.name}-parity")
    with progress(f"{chosen.name}, twice", quiet=as_json) as on_progress:
        parity = compare(chosen, folder, on_progress=on_progress)
    names = {"builtin": "the builtin", "ArduPilot": "ArduPilot"}
    print_parity(chosen.name, parity, names, folder, as_json=as_json)


def print_parity(scenario: str, parity: Parity, names: Mapping[str, str], folder: Path, *, as_json: bool) -> None:
    """Print how two flights compare; `names` are the column headings with the names for sentences."""
    from rich.table import Table

    first, second = names.values()
    if as_json:
        flights = [
            {"under": name, **_flight(measures)}
            for name, side in zip(names, (parity.first, parity.second), strict=True)
            for measures in side.values()
        ]
        apart = {vehicle: _finite(parity.apart_m(vehicle)) for vehicle in parity.first}
        print_json({"path": str(folder), "flights": flights, "apart_m": apart})
        return
    table = Table(title=f"{scenario}: {first} and {second}", title_justify="left", title_style="bold")
    for column in ("aircraft", "measure", *names, "difference", ""):
        table.add_column(column, justify="left" if column in ("aircraft", "measure") else "right", no_wrap=True)
    for row in parity.rows():
        share = "" if isnan(row.relative) else f"{row.relative:+.1%}"
        table.add_row(
            row.vehicle, row.measure, f"{row.first:.2f}", f"{row.second:.2f}", f"{row.difference:+.2f}", share
        )
    console = terminal()
    console.print(table)
    for vehicle, first_flight in parity.first.items():
        second_flight = parity.second[vehicle]
        for measure in ("outcome", "modes", "items"):
            value, other_value = (_names(getattr(compared, measure)) for compared in (first_flight, second_flight))
            if value != other_value:
                console.print(f"{vehicle}: {measure} {value} with {first}, {other_value} with {second}")
        console.print(f"{vehicle}: at most {parity.apart_m(vehicle):.1f} m apart, from lift-off on")
    console.print(f"runs   {folder}", soft_wrap=True)


def _names(happened: str | Sequence[tuple[float, Any]]) -> str:
    return happened if isinstance(happened, str) else ", ".join(str(value) for _, value in happened)


def _flight(measures: FlightMeasures) -> dict[str, Any]:
    facts = asdict(measures)
    del facts["path"]
    return facts | {"measures": {name: _finite(value) for name, value in measures.measures.items()}}


def _finite(value: float) -> float | None:
    return None if isnan(value) else value


@parity_app.command("log", epilog="Example: skyrange parity log flight.tlog --autopilot builtin --out runs/my-flight")
def log(
    *,
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="Logs of flights (.tlog, .BIN, .ulg) or folders of runs.")
    ],
    autopilot: Annotated[
        list[str] | None,
        typer.Option(metavar="KIND", help="Fly with builtin, ardupilot, or both if repeated. Default: both."),
    ] = None,
    seeds: Annotated[int, typer.Option(metavar="N", min=2, max=1000, help="Fly each flight with N seeds.")] = 20,
    ardupilot_seeds: Annotated[
        int | None,
        typer.Option(metavar="N", min=2, max=1000, help="With ArduPilot, which takes longer. Default: --seeds."),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="Do not judge this flight, such as flight-2; its wind counts. May be repeated."
        ),
    ] = None,
    system: Annotated[
        int | None, typer.Option(metavar="ID", min=1, max=255, help="MAVLink system of a .tlog. Default: the busiest.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for runs and page. Default: runs/log-parity, then -2 …")
    ] = None,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also renew the tables in this Markdown page.")
    ] = None,
    jobs: Jobs = None,
    as_json: AsJson = False,
) -> None:
    """Fly the flights of logs in simulation, and compare legs, lean and tracks with the logs."""
    from skyrange.cli.output.log_parity import show_log_parity
    from skyrange.cli.output.progress import compile_if_cold, run_progress
    from skyrange.flightlog.reading import read_log
    from skyrange.parity.flights import KINDS
    from skyrange.parity.logs.comparison import compare_logs, plan_logs
    from skyrange.parity.logs.page import TABLES, renew_page

    if page is not None:
        TABLES.read(page)
    read = [read_log(each, system if each.is_file() else None) for each in logs]
    number = {"ardupilot": seeds if ardupilot_seeds is None else ardupilot_seeds}
    plan = plan_logs(read, {kind: number.get(kind, seeds) for kind in autopilot or KINDS}, without or ())
    compile_if_cold(quiet=as_json)
    with run_progress(plan.name, quiet=as_json) as on_progress:
        result = compare_logs(plan, out, Workers(jobs).executor(in_process=True), on_progress)
    if page is not None:
        renew_page(result, page)
    show_log_parity(result, as_json=as_json)


@parity_app.command("attacks", epilog="Example: skyrange parity attacks mavlink.command mavlink.guided")
def attacks(
    *,
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
    from rich.table import Table

    from skyrange.cli.output.progress import step_progress
    from skyrange.parity.attacks import page as report
    from skyrange.parity.attacks.flights import chosen_kinds, compare
    from skyrange.runtime.run import free_folder

    chosen = chosen_kinds(kinds or [])
    if page is not None:
        report.check_page(page, seeds=seeds > 0)
    folder = out if out is not None else free_folder("attack-parity")
    if seeds:
        _compare_over_seeds(chosen, folder, rates.value, seeds, page, as_json=as_json)
        return
    with step_progress(quiet=as_json) as on_flight:
        compared = compare(folder, chosen, rates.value, on_flight=on_flight)
    if page is not None:
        report.renew_page(compared, page)
    if as_json:
        print_json({"path": str(folder), **report.results(compared)})
        return
    table = Table(title="Attacks: builtin and ArduPilot", title_justify="left", title_style="bold")
    for column in ("attack", "builtin", "ArduPilot", "what shows it, ArduPilot", "agree"):
        table.add_column(column)
    for reaction in compared:
        table.add_row(
            reaction.kind,
            report.words(reaction.first),
            report.words(reaction.second),
            report.signs(reaction.second),
            report.verdict(reaction),
        )
    console = terminal()
    console.print(table)
    console.print(report.summary(compared), soft_wrap=True)
    console.print(f"runs   {folder}", soft_wrap=True)


def _compare_over_seeds(
    chosen: Sequence[str], folder: Path, rates: str, seeds: int, page: Path | None, *, as_json: bool
) -> None:
    from rich.table import Table

    from skyrange.cli.output.progress import step_progress
    from skyrange.parity.attacks import page as report
    from skyrange.parity.attacks.flights import compare_seeds

    with step_progress(quiet=as_json) as on_flight:
        compared = compare_seeds(folder, chosen, seeds, rates, on_flight=on_flight)
    if page is not None:
        report.renew_seeds(compared, page)
    if as_json:
        print_json({"path": str(folder), "seeds": seeds, **report.seeds_results(compared)})
        return
    table = Table(
        title=f"Attacks over {seeds} seeds: median (least to greatest)", title_justify="left", title_style="bold"
    )
    for column in ("attack", "autopilot", "reactions", "first sign after the start", "farthest from its twin"):
        table.add_column(column)
    for reaction in compared:
        table.add_row(reaction.kind, "builtin", *report.seeds_words(reaction.first))
        table.add_row("", "ArduPilot", *report.seeds_words(reaction.second))
    console = terminal()
    console.print(table)
    console.print(f"runs   {folder}", soft_wrap=True)


@parity_app.command(epilog="Example: skyrange parity missions --count 60 --out runs/missions")
def missions(
    *,
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
    from skyrange.parity.missions.comparison import compare, count_files, given_missions, page, results
    from skyrange.runtime.run import free_folder

    given, refused = given_missions(files or [])
    if files and not as_json:
        print_notice(count_files(len(given), refused))
        for mission in refused:
            print_notice(f"not flown: {mission.file}: {mission.reason}")
    folder = out if out is not None else free_folder("mission-parity")

    def on_fleet(run: int, flown: int) -> None:
        if not as_json:
            print_notice(f"run {run}: {flown} missions")

    agreement = compare(
        folder, count, first=first, given=given, refused=refused, rates=rates.value, shrink=shrink, on_fleet=on_fleet
    )
    if as_json:
        print_json({"path": str(folder), **results(agreement)})
        return
    console = terminal()
    for line in page(agreement):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    console.print(f"results {folder}/missions.json, missions.md", soft_wrap=True, markup=False)
