"""The commands `skyrange parity flight`, `rates`, `gnss`, `attacks`, `missions` and `radio`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skyrange.cli.output.console import print_json, print_notice, terminal

if TYPE_CHECKING:
    from skyrange.study.compare.autopilot_parity import FlightMeasures, Parity
    from skyrange.study.compare.gnss_reactions import ComparedReaction, Reaction


def flight(name: str, out: Path | None, changes: Sequence[str], as_json: bool) -> None:
    """`skyrange parity flight`."""
    from skyrange.cli.output.progress import progress
    from skyrange.runtime.run import free_folder
    from skyrange.scenario.shipped import load
    from skyrange.study.compare.autopilot_parity import compare

    scenario = load(name, changes)
    folder = out if out is not None else free_folder(f"{scenario.name}-parity")
    with progress(f"{scenario.name}, twice", quiet=as_json) as on_progress:
        parity = compare(scenario, folder, on_progress=on_progress)
    _print_parity(scenario.name, parity, {"builtin": "the builtin", "ArduPilot": "ArduPilot"}, folder, as_json)


def rates(name: str, other: str, out: Path | None, changes: Sequence[str], as_json: bool) -> None:
    """`skyrange parity rates`."""
    from skyrange.cli.output.progress import progress
    from skyrange.runtime.run import free_folder
    from skyrange.scenario.shipped import load
    from skyrange.study.compare.autopilot_parity import compare_rates

    scenario = load(name, changes)
    folder = out if out is not None else free_folder(f"{scenario.name}-rates")
    with progress(f"{scenario.name}, twice", quiet=as_json) as on_progress:
        parity = compare_rates(scenario, folder, other, on_progress=on_progress)
    _print_parity(scenario.name, parity, {"full": "full rates", other: f"{other} rates"}, folder, as_json)


def _print_parity(scenario: str, parity: Parity, names: Mapping[str, str], folder: Path, as_json: bool) -> None:
    """Print how two flights compare; `names` are the column headings with the names for sentences."""
    from rich.table import Table

    first, second = names.values()
    if as_json:
        flights = [
            {"under": name, **_flight(one)}
            for name, side in zip(names, (parity.first, parity.second), strict=True)
            for one in side.values()
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
    for vehicle, one in parity.first.items():
        other = parity.second[vehicle]
        for what in ("outcome", "modes", "items"):
            mine, others = (_names(getattr(each, what)) for each in (one, other))
            if mine != others:
                console.print(f"{vehicle}: {what} {mine} with {first}, {others} with {second}")
        console.print(f"{vehicle}: at most {parity.apart_m(vehicle):.1f} m apart, from lift-off on")
    console.print(f"runs   {folder}", soft_wrap=True)


def _names(happened: str | Sequence[tuple[float, Any]]) -> str:
    return happened if isinstance(happened, str) else ", ".join(str(what) for _, what in happened)


def _flight(one: FlightMeasures) -> dict[str, Any]:
    facts = asdict(one)
    del facts["path"]
    return facts | {"measures": {name: _finite(value) for name, value in one.measures.items()}}


def _finite(value: float) -> float | None:
    return None if isnan(value) else value


def gnss(out: Path | None, rates: str, as_json: bool) -> None:
    """`skyrange parity gnss`."""
    from rich.table import Table

    from skyrange.cli.output.progress import progress
    from skyrange.runtime.run import free_folder
    from skyrange.study.compare.gnss_reactions import TIME_S, agreement, compare, settings

    folder = out if out is not None else free_folder("gnss-reactions")
    with progress("100 false GNSS, twice", quiet=as_json) as on_progress:
        compared = compare(folder, settings(), rates, on_progress=on_progress)
    found = agreement(compared)
    if as_json:
        print_json({"path": str(folder), **asdict(found), "settings_flown": [_setting(one) for one in compared]})
        return
    table = Table(title="False GNSS: builtin and ArduPilot", title_justify="left", title_style="bold")
    for column in ("setting", "builtin", "ArduPilot", "reset", "", "led", "", ""):
        table.add_column(column, justify="left" if column in ("setting", "builtin", "ArduPilot") else "right")
    for one in compared:
        table.add_row(
            one.setting.description,
            one.first.outcome,
            one.second.outcome,
            _seconds(one.first.reset_s),
            _seconds(one.second.reset_s),
            f"{one.first.led_m:.1f} m",
            f"{one.second.led_m:.1f} m",
            "" if one.alike else "differs",
        )
    console = terminal()
    console.print(table)
    console.print(f"same outcome in {found.alike} of {found.settings}")
    console.print(
        f"both reset in {found.resets}: {found.together} within {TIME_S:g} s, at most {found.reset_apart_max_s:.2f} s"
    )
    console.print(f"run    {folder}", soft_wrap=True)


def _seconds(at: float | None) -> str:
    return "" if at is None else f"{at:.1f} s"


def _setting(one: ComparedReaction) -> dict[str, Any]:
    return {
        "setting": one.setting.description,
        "kind": one.setting.kind,
        "params": dict(one.setting.params),
        "alike": one.alike,
        "builtin": _reaction(one.first),
        "ardupilot": _reaction(one.second),
    }


def _reaction(one: Reaction) -> dict[str, Any]:
    return {**asdict(one), "outcome": one.outcome}


def attacks(kinds: Sequence[str], out: Path | None, rates: str, seeds: int, page: Path | None, as_json: bool) -> None:
    """`skyrange parity attacks`; `seeds` 0 is the seed of each example."""
    from rich.table import Table

    from skyrange.cli.output.progress import step_progress
    from skyrange.runtime.run import free_folder
    from skyrange.study.compare.attacks import page as report
    from skyrange.study.compare.attacks.flights import chosen_kinds, compare

    chosen = chosen_kinds(kinds)
    if page is not None:
        report.check_page(page, seeds=seeds > 0)
    folder = out if out is not None else free_folder("attack-parity")
    if seeds:
        _attacks_over_seeds(chosen, folder, rates, seeds, page, as_json)
        return
    with step_progress(quiet=as_json) as on_flight:
        compared = compare(folder, chosen, rates, on_flight=on_flight)
    if page is not None:
        report.renew_page(compared, page)
    if as_json:
        print_json({"path": str(folder), **report.results(compared)})
        return
    table = Table(title="Attacks: builtin and ArduPilot", title_justify="left", title_style="bold")
    for column in ("attack", "builtin", "ArduPilot", "what shows it, ArduPilot", "agree"):
        table.add_column(column)
    for one in compared:
        table.add_row(
            one.kind, report.words(one.first), report.words(one.second), report.signs(one.second), report.verdict(one)
        )
    console = terminal()
    console.print(table)
    console.print(report.summary(compared), soft_wrap=True)
    console.print(f"runs   {folder}", soft_wrap=True)


def _attacks_over_seeds(
    chosen: Sequence[str], folder: Path, rates: str, seeds: int, page: Path | None, as_json: bool
) -> None:
    from rich.table import Table

    from skyrange.cli.output.progress import step_progress
    from skyrange.study.compare.attacks import page as report
    from skyrange.study.compare.attacks.flights import compare_seeds

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
    for one in compared:
        table.add_row(one.kind, "builtin", *report.seeds_words(one.first))
        table.add_row("", "ArduPilot", *report.seeds_words(one.second))
    console = terminal()
    console.print(table)
    console.print(f"runs   {folder}", soft_wrap=True)


def missions(
    files: Sequence[Path], count: int, first: int, out: Path | None, rates: str, shrink: bool, as_json: bool
) -> None:
    """`skyrange parity missions`."""
    from skyrange.runtime.run import free_folder
    from skyrange.study.compare.mission_parity import compare, count_files, given_missions, page, results

    given, refused = given_missions(files)
    if files and not as_json:
        print_notice(count_files(len(given), refused))
        for one in refused:
            print_notice(f"not flown: {one.file}: {one.reason}")
    folder = out if out is not None else free_folder("mission-parity")

    def on_fleet(run: int, flown: int) -> None:
        if not as_json:
            print_notice(f"run {run}: {flown} missions")

    agreement = compare(
        folder, count, first=first, given=given, refused=refused, rates=rates, shrink=shrink, on_fleet=on_fleet
    )
    if as_json:
        print_json({"path": str(folder), **results(agreement)})
        return
    console = terminal()
    for line in page(agreement):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    console.print(f"results {folder}/missions.json, missions.md", soft_wrap=True, markup=False)


def radio(
    engines: Sequence[str], buildings: Path | None, pairs: int, out: Path | None, page: Path | None, as_json: bool
) -> None:
    """`skyrange parity radio`."""
    from skyrange.city.building_files import load_buildings
    from skyrange.city.downtown import downtown_grid
    from skyrange.cli.output.progress import step_progress
    from skyrange.core.errors import InputError, nearest
    from skyrange.core.input_files import expand_user
    from skyrange.runtime.run import free_folder
    from skyrange.study.compare.radio import page as report
    from skyrange.study.compare.radio.agreement import compare
    from skyrange.study.compare.radio.setups import installed_engines

    found = installed_engines()
    for name in engines:
        if name not in found:
            expected = f"an engine to compare: {', '.join(sorted(found))}"
            raise InputError.one("skyrange parity radio", "--engine", name, expected, nearest(name, found))
        if found[name]:
            raise InputError.one("skyrange parity radio", "--engine", name, "an engine that runs here", found[name])
    chosen = [name for name in found if name in engines] if engines else [name for name in found if not found[name]]
    for name, why in found.items():
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
