"""The commands `skyrange bench` of single parts: radio, taps, flight approval, UTM services, planning, rays."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from skyrange.cli.options import AsJson
from skyrange.cli.output.console import print_json, print_text

commands = typer.Typer()


@commands.command(epilog="Example: skyrange bench radio --nodes 1000 --json")
def radio(
    *,
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
    from skyrange.bench.radio import measure

    rows = []
    if not as_json:
        heads = f"{'nodes':>8} {'× real time':>11} {'µs/node·s':>9} {'sent/s':>9} {'received/s':>10}"
        print_text(f"{heads} {'receivers':>9} {'line of sight':>13}")
    for count in nodes or [10, 100, 1000]:
        row = measure(count, seconds, horizon_m, engine)
        rows.append(row)
        if not as_json:
            share = row["line_of_sight_share"]
            print_text(
                f"{count:>8} {row['real_time_factor']:>11.2f} {row['us_per_node_s']:>9.1f} "
                f"{row['transmissions_per_s']:>9.0f} {row['receptions_per_s']:>10.0f} {row['heard_by']:>9.1f} "
                + (f"{share:>13.0%}" if share is not None else f"{'':>13}"),
            )
    if as_json:
        print_json(rows)


@commands.command("attacks", epilog="Example: skyrange bench attacks --vehicles 100 --json")
def attacks_bench(
    *,
    vehicles: Annotated[int, typer.Option(metavar="N", min=1, help="Number of aircraft.")] = 100,
    seconds: Annotated[
        float, typer.Option(metavar="S", min=1.0, help="Simulated seconds to measure, after 30 s of warm-up.")
    ] = 10.0,
    as_json: AsJson = False,
) -> None:
    """Measure what taps on all links between stations and aircraft cost, and what a flood of one link costs."""
    from skyrange.bench.attacks import measure

    rows = measure(vehicles, seconds)
    if as_json:
        print_json(rows)
        return
    print_text(f"{'case':<18} {'× real time':>11} {'speed':>6} {'frames/s':>9} {'µs/frame':>8} {'µs/extra frame':>14}")
    for row in rows:
        extra = row["extra_us_per_frame"]
        print_text(
            f"{row['case']:<18} {row['real_time_factor']:>11.2f} {row['speed']:>6.0%} {row['frames_per_s']:>9.0f} "
            f"{row['us_per_frame']:>8.2f} " + (f"{extra:>14.2f}" if extra is not None else "")
        )


@commands.command("batches", epilog="Example: skyrange bench batches --runs 64 --json")
def batches_bench(
    *,
    scenario: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="What acts: nominal, gnss, taps or radio. May be repeated. Default: all."),
    ] = None,
    runs: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=1, help="Runs of a batch. May be repeated. Default: 1, 4, 16, 64, 128 and 256."),
    ] = None,
    seconds: Annotated[float, typer.Option(metavar="S", min=1.0, help="Simulated seconds of a run.")] = 60.0,
    as_json: AsJson = False,
) -> None:
    """Measure runs of one aircraft that fly together in one kernel, against the same runs alone."""
    from skyrange.bench.batches import SCENARIOS, SIZES, measure
    from skyrange.core.errors import InputError, nearest

    for name in scenario or ():
        if name not in SCENARIOS:
            raise InputError.one("bench", "--scenario", name, ", ".join(SCENARIOS), nearest(name, SCENARIOS))
    rows = []
    if not as_json:
        print_text(f"{'scenario':<10} {'runs':>5} {'CPU-s/run':>10} {'set-up':>8} {'× alone':>8}")
    for name in scenario or SCENARIOS:
        for row in measure(name, runs or SIZES, seconds):
            rows.append(row)
            if not as_json:
                print_text(
                    f"{name:<10} {row['runs']:>5} {row['cpu_s_per_run']:>10.4f} {row['setup_s_per_run']:>8.4f} "
                    f"{row['factor']:>8.2f}"
                )
    if as_json:
        print_json(rows)


@commands.command("agents", epilog="Example: skyrange bench agents --worlds 64 --json")
def agents_bench(
    *,
    worlds: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=1, help="Worlds side by side. May be repeated. Default: 1, 16, 64 and 256."),
    ] = None,
    aircraft: Annotated[int, typer.Option(metavar="N", min=1, help="Aircraft of each world.")] = 3,
    as_json: AsJson = False,
) -> None:
    """Measure steps of the learning environment, played by random policies in worlds side by side."""
    from skyrange.bench.agents import SIZES, measure

    rows = []
    if not as_json:
        print_text(f"{'worlds':>6} {'steps/CPU-s':>11} {'flight':>8} {'building':>8} {'policies':>8} {'rest':>8}")
    for row in measure(worlds or SIZES, aircraft):
        rows.append(row)
        if not as_json:
            shares = "".join(f" {share:>8.1%}" for share in row.get("shares", {}).values())
            print_text(f"{row['worlds']:>6} {row['steps_per_s']:>11.1f}{shares}")
    if as_json:
        print_json(rows)


@commands.command("approval", epilog="Example: skyrange bench approval --active 10000 --json")
def approval_bench(
    *,
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
    from skyrange.bench.approval import measure

    rows = []
    if not as_json:
        print_text(f"{'active':>7} {'decisions/s':>11} {'mean ms':>8} {'p50 ms':>8} {'p99 ms':>8} {'rejected':>8}")
    for count in active or [100, 1000, 10_000]:
        row = measure(count, requests)
        rows.append(row)
        if not as_json:
            print_text(
                f"{row['active']:>7} {row['decisions_per_s']:>11.0f} {row['mean_ms']:>8.2f} {row['p50_ms']:>8.2f} "
                f"{row['p99_ms']:>8.2f} {row['rejected']:>8.0%}"
            )
    if as_json:
        print_json(rows)


@commands.command("utm", epilog="Example: skyrange bench utm --requests 1000 --json")
def utm_bench(
    *,
    requests: Annotated[int, typer.Option(metavar="N", min=1, help="Number of requests to measure.")] = 1000,
    as_json: AsJson = False,
) -> None:
    """Measure UTM services as processes: an approval authority, and a USS with a DSS, over HTTPS with databases."""
    from skyrange.bench.utm_services import measure_authority, measure_durable, measure_federation

    rows = []
    if not as_json:
        print_text(f"{'service':<26} {'clients':>7} {'decisions/s':>11} {'p50 ms':>8} {'p99 ms':>8}")
    measurements: list[Callable[[], dict[str, Any]]] = [
        partial(measure_durable, requests),
        *(partial(measure_authority, requests, clients) for clients in (1, 32)),
        *(partial(measure_federation, requests, clients) for clients in (1, 32)),
    ]
    for measure in measurements:
        row = measure()
        rows.append(row)
        if not as_json:
            print_text(
                f"{row['service']:<26} {row['clients']:>7} {row['decisions_per_s']:>11.0f} {row['p50_ms']:>8.2f} "
                f"{row['p99_ms']:>8.2f}"
            )
    if as_json:
        print_json(rows)


@commands.command("planning", epilog="Example: skyrange bench planning --buildings manhattan.geojson --alt-m 60")
def planning_bench(
    *,
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
    from skyrange.bench.planning import load_city, measure
    from skyrange.planning.sampling import load_ompl

    if ompl:
        load_ompl("bench planning")
    city = load_city(buildings)
    rows = []
    if not as_json:
        print_text(f"{'alt_m':>7} {'routes':>7} {'no way':>7} {'p50 ms':>8} {'p95 ms':>8} {'detour':>7} {'late':>7}")
    for height_m in alt_m or [30.0, 60.0, 90.0]:
        row = measure(city, routes, length_m, height_m, max(ceiling_m, height_m), ompl)
        rows.append(row)
        if not as_json and row["routes"]:
            print_text(
                f"{height_m:>7g} {row['routes']:>7} {row['no_way']:>7} {row['p50_ms']:>8} {row['p95_ms']:>8} "
                f"{row['detour']:>7} {row['late']:>7}"
            )
    if as_json:
        print_json(rows)


@commands.command("rays", epilog="Example: skyrange bench rays --buildings manhattan.geojson --aircraft 100")
def rays_bench(
    *,
    buildings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File of buildings. Default: a generated downtown.")
    ] = None,
    aircraft: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=10, help="Number of aircraft. May be repeated. Default: 10, 100 and 1000."),
    ] = None,
    scans: Annotated[int, typer.Option(metavar="N", min=1, help="Scans of ten sensors to measure, three times.")] = 10,
    as_json: AsJson = False,
) -> None:
    """Measure rays in a city with aircraft: of ten LiDARs (16 beams × 720 azimuths, 10 Hz) and of a depth camera."""
    from skyrange.bench.planning import load_city
    from skyrange.bench.rays import measure

    city = load_city(buildings)
    scene = buildings.stem if buildings is not None else "generated downtown"
    rows = []
    if not as_json:
        heads = f"{'scene':<24} {'buildings':>9} {'aircraft':>8} {'rays/s':>11} {'× LiDARs':>8} {'× depth':>7}"
        print_text(f"{heads} {'on buildings':>12} {'on aircraft':>11} {'digest':>16}")
    for count in aircraft or [10, 100, 1000]:
        row = measure(city, scene, count, scans)
        rows.append(row)
        if not as_json:
            print_text(
                f"{scene[:24]:<24} {row['buildings']:>9} {count:>8} {row['rays_per_s']:>11,} "
                f"{row['lidar_factor']:>8.1f} {row['depth_factor']:>7.1f} {row['met']['building']:>12.1%} "
                f"{row['met']['aircraft']:>11.3%} "
                f"{row['digest']:>16}"
            )
    if as_json:
        print_json(rows)
