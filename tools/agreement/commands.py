"""Commands that compare skyrange with other programs: false GNSS and loop rates of ArduPilot, Gazebo, radio engines."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skyrange.cli.handlers.measurement.parity import print_parity
from skyrange.cli.output.console import print_json, print_notice, print_text, terminal

if TYPE_CHECKING:
    from tools.agreement.gnss_reactions import ComparedReaction, Reaction


def compare_loop_rates(name: str, other: str, out: Path | None, changes: Sequence[str], as_json: bool) -> None:
    """`rates`."""
    from skyrange.cli.output.progress import progress
    from skyrange.parity.flights import compare_rates
    from skyrange.runtime.run import free_folder
    from skyrange.scenario.shipped import load

    scenario = load(name, changes)
    folder = out if out is not None else free_folder(f"{scenario.name}-rates")
    with progress(f"{scenario.name}, twice", quiet=as_json) as on_progress:
        parity = compare_rates(scenario, folder, other, on_progress=on_progress)
    print_parity(scenario.name, parity, {"full": "full rates", other: f"{other} rates"}, folder, as_json)


def compare_gnss_reactions(out: Path | None, rates: str, as_json: bool) -> None:
    """`gnss`."""
    from rich.table import Table

    from skyrange.cli.output.progress import progress
    from skyrange.runtime.run import free_folder
    from tools.agreement.gnss_reactions import TIME_S, agreement, compare, settings

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


def compare_radio_engines(
    engines: Sequence[str], buildings: Path | None, pairs: int, out: Path | None, page: Path | None, as_json: bool
) -> None:
    """`radio`."""
    from skyrange.city.building_files import load_buildings
    from skyrange.city.downtown import downtown_grid
    from skyrange.cli.output.progress import step_progress
    from skyrange.core.errors import InputError, nearest
    from skyrange.core.files import expand_user
    from skyrange.runtime.run import free_folder
    from tools.agreement.radio import page as report
    from tools.agreement.radio.agreement import compare
    from tools.agreement.radio.setups import installed_engines

    found = installed_engines()
    for name in engines:
        if name not in found:
            expected = f"an engine to compare: {', '.join(sorted(found))}"
            raise InputError.one("radio", "--engine", name, expected, nearest(name, found))
        if found[name]:
            raise InputError.one("radio", "--engine", name, "an engine that runs here", found[name])
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


def measure_gazebo_speed(
    vehicles: Sequence[int], seconds: float, repeat: int, load: str, rates: str, window: bool, collision: bool,
    output: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """`gazebo-speed`."""
    from skyrange.core.errors import InputError
    from skyrange.core.files import atomic_write
    from tools.agreement.gazebo_bench import collision as head_on
    from tools.agreement.gazebo_bench.fleets import PUBLISHED_VEHICLES, measure, measure_all, require_gazebo

    require_gazebo(window)
    if output is not None and (output.is_dir() or not output.parent.is_dir()):
        raise InputError.one("gazebo-speed", "--output", str(output), "a file in a folder that exists")

    def show(row: dict[str, Any]) -> None:
        one, other = row["gazebo"], row["range"]
        print_text(
            f"{row['vehicles']:>8} {one['real_time_factor']:>11.2f} {one['inverse']:>7.2f} {one['gazebo_cpu_s']:>8.3f} "
            f"{one['autopilots_cpu_s']:>10.3f} {one['ours_cpu_s']:>8.3f} {other['real_time_factor']:>9.2f} "
            f"{row['slower']:>12.2f}"
        )

    if not as_json:
        heads = f"{'aircraft':>8} {'× real time':>11} {'inverse':>7} {'Gazebo':>8} {'ArduPilots':>10} {'skyrange':>8}"
        print_text(f"{heads} {'in range':>9} {'range/Gazebo':>12}  (cores that real time needs)")
    one = partial(measure, seconds=seconds, windows=repeat, load=load, rates=rates, window=window)
    collide = partial(head_on.measure, window=window) if collision else None
    data = measure_all(vehicles, one, collide, None if as_json else show)
    if output is not None:
        with atomic_write(output) as file:
            file.write(json.dumps(data, indent=1).encode())
    if as_json:
        print_json(data)
        return
    found = data["real_time"]["gazebo"]
    if found["measured"] is not None:
        more = "" if found["interpolated"] is None else f", interpolated {found['interpolated']}"
        print_text(f"in real time: {found['measured']} aircraft measured{more}; published: about {PUBLISHED_VEHICLES}")
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


def compare_gazebo_physics(
    names: Sequence[str], out: Path | None, changes: Sequence[str], page: Path | None, as_json: bool
) -> None:
    """`gazebo-physics`."""
    from skyrange.cli.output.progress import step_progress
    from skyrange.runtime.run import free_folder
    from tools.agreement.physics import page as report
    from tools.agreement.physics.comparison import RESULTS, SCENARIOS, compare, results

    if page is not None:
        report.check_page(page)
    chosen = list(names or SCENARIOS)
    folder = out if out is not None else free_folder("gazebo-parity")
    with step_progress(quiet=as_json) as on_step:
        compared = compare(folder, chosen, changes, again=chosen[0], on_step=on_step)
    if page is not None:
        report.write_page(compared, page)
    if as_json:
        print_json({"path": str(folder), **results(compared)})
        return
    console = terminal()
    for line in report.tables(compared):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    if page is not None:
        print_notice(f"page {page}")
    console.print(f"results {folder}/{RESULTS}, and the runs", soft_wrap=True, markup=False)
