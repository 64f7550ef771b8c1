"""The commands `skyrange bench gazebo` and `skyrange parity gazebo`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from skyrange.cli.output.console import print_json, print_notice, print_text, terminal


def bench_gazebo(
    vehicles: Sequence[int], seconds: float, repeat: int, load: str, rates: str, window: bool, collision: bool,
    output: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """`skyrange bench gazebo`."""
    from skyrange.bench.gazebo import collision as head_on
    from skyrange.bench.gazebo.fleets import PUBLISHED_VEHICLES, measure, measure_all, require_gazebo
    from skyrange.core.errors import InputError
    from skyrange.core.files import atomic_write

    require_gazebo(window)
    if output is not None and (output.is_dir() or not output.parent.is_dir()):
        raise InputError.one("bench gazebo", "--output", str(output), "a file in a folder that exists")

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


def parity_gazebo(
    names: Sequence[str], out: Path | None, changes: Sequence[str], page: Path | None, as_json: bool
) -> None:
    """`skyrange parity gazebo`."""
    from skyrange.cli.output.progress import step_progress
    from skyrange.runtime.run import free_folder
    from skyrange.study.compare.physics import page as report
    from skyrange.study.compare.physics.comparison import RESULTS, SCENARIOS, compare, results

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
