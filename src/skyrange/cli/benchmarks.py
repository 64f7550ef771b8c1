"""The commands `skyrange bench`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from skyrange.cli.output.console import print_json, print_text


def bench_fleet(
    vehicles: Sequence[int], seconds: float, load: str, remote_id: bool, detector: bool, as_json: bool
) -> None:
    """`skyrange bench fleet`."""
    from skyrange.bench.fleet import PARTS, measure

    rows = []
    if not as_json:
        heads = f"{'aircraft':>8} {'× real time':>11} {'of flight':>9} {'set-up s':>8} {'flight s':>8} {'finish s':>8}"
        print_text(f"{heads} {'disk MB':>7} {'B/frame':>7} {'memory MB':>9}  share of time in flight")
    for count in vehicles:
        row = measure(count, seconds, load, remote_id, detector)
        rows.append(row)
        if not as_json:
            shares = " · ".join(f"{part} {row['share'][part]:.0%}" for part in PARTS)
            print_text(
                f"{count:>8} {row['total_factor']:>11.2f} {row['real_time_factor']:>9.2f} {row['setup_s']:>8.1f} "
                f"{row['wall_s']:>8.1f} {row['finalise_s']:>8.1f} {row['disk_mb']:>7.1f} "
                f"{row['bytes_per_frame']:>7.1f} {row['memory_mb']:>9.0f}  {shares}"
            )
    if as_json:
        print_json(rows)


def bench_cores(
    vehicles: int,
    seconds: float,
    operators: int,
    cores: Sequence[int],
    load: str,
    remote_id: bool,
    autopilot: str,
    options: Mapping[str, Any],
    repeat: int,
    as_json: bool,
) -> None:
    """`skyrange bench cores`, and `skyrange bench ardupilot --cores`."""
    from skyrange.bench.cores import check_cores, compare, measure

    cores = sorted({1, *cores})  # what the others are compared with
    check_cores(cores)
    rows = []
    if not as_json:
        heads = f"{'cores':>5} {'× real time':>11} {'of flight':>9} {'set-up s':>8} {'flight s':>8} {'finish s':>8}"
        print_text(f"{heads} {'flying':>6}  waited s, of each core")
    for turn, count in product(range(repeat), cores):
        row = measure(vehicles, seconds, operators, count, load, remote_id, autopilot, options, turn)
        rows.append(row)
        if not as_json:
            waited = " ".join(f"{one:.1f}" for one in row["waited_s"])
            print_text(
                f"{row['used']:>5} {row['total_factor']:>11.2f} {row['real_time_factor']:>9.2f} {row['setup_s']:>8.1f} "
                f"{row['wall_s']:>8.1f} {row['finish_s']:>8.1f} {row['flying']:>6}  {waited}{row['reason']}"
            )
    found = compare(rows)
    if as_json:
        print_json({"rows": rows, "compared": found})
        return
    for one in found:
        if one["speed_up"] is not None and one["cores"] > 1:
            same = "the same fingerprint" if one["same_fingerprint"] else "ANOTHER fingerprint"
            print_text(
                f"{one['cores']} cores: {one['speed_up']:.2f} times as fast as one, the flight "
                f"{one['flight_speed_up']:.2f} times; {same}"
            )


def bench_ardupilot(
    vehicles: Sequence[int],
    seconds: float,
    load: str,
    rates: str,
    physics: str,
    speedup: float,
    remote_id: bool,
    as_json: bool,
) -> None:
    """`skyrange bench ardupilot`."""
    from skyrange.bench.ardupilot import measure

    rows = []
    if not as_json:
        heads = f"{'aircraft':>8} {'loop Hz':>7} {'× real time':>11} {'ArduPilots cpu s':>16} {'skyrange cpu s':>14}"
        print_text(f"{heads} {'bare cpu s':>10} {'skyrange/bare':>13} {'per core':>8}")
    for count in vehicles:
        row = measure(count, seconds, load, rates, physics, speedup, remote_id)
        rows.append(row)
        if not as_json:
            print_text(
                f"{count:>8} {row['loop_hz']:>7.0f} {row['real_time_factor']:>11.2f} {row['autopilots_cpu_s']:>16.2f} "
                f"{row['ours_cpu_s']:>14.2f} {row['bare_cpu_s']:>10.2f} {row['ours_over_bare']:>13.2f} "
                f"{row['per_core']:>8.1f}",
            )
    if as_json:
        print_json(rows)


def bench_radio(nodes: Sequence[int], seconds: float, horizon_m: float, engine: str, as_json: bool) -> None:
    """`skyrange bench radio`."""
    from skyrange.bench.radio import measure

    rows = []
    if not as_json:
        heads = f"{'nodes':>8} {'× real time':>11} {'µs/node·s':>9} {'sent/s':>9} {'received/s':>10}"
        print_text(f"{heads} {'receivers':>9} {'line of sight':>13}")
    for count in nodes:
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


def bench_attacks(vehicles: int, seconds: float, as_json: bool) -> None:
    """`skyrange bench attacks`."""
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


def bench_planning(
    buildings: Path | None,
    routes: int,
    length_m: float,
    heights_m: Sequence[float],
    ceiling_m: float,
    iterations: int,
    as_json: bool,
) -> None:
    """`skyrange bench planning`."""
    from skyrange.bench.planning import load_city, measure
    from skyrange.planning.sampling import load_ompl

    if iterations:
        load_ompl("bench planning")
    city = load_city(buildings)
    rows = []
    if not as_json:
        print_text(f"{'alt_m':>7} {'routes':>7} {'no way':>7} {'p50 ms':>8} {'p95 ms':>8} {'detour':>7} {'late':>7}")
    for alt_m in heights_m:
        row = measure(city, routes, length_m, alt_m, max(ceiling_m, alt_m), iterations)
        rows.append(row)
        if not as_json and row["routes"]:
            print_text(
                f"{alt_m:>7g} {row['routes']:>7} {row['no_way']:>7} {row['p50_ms']:>8} {row['p95_ms']:>8} "
                f"{row['detour']:>7} {row['late']:>7}"
            )
    if as_json:
        print_json(rows)


def bench_utm(requests: int, as_json: bool) -> None:
    """`skyrange bench utm`."""
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


def bench_approval(active: Sequence[int], requests: int, as_json: bool) -> None:
    """`skyrange bench approval`."""
    from skyrange.bench.approval import measure

    rows = []
    if not as_json:
        print_text(f"{'active':>7} {'decisions/s':>11} {'mean ms':>8} {'p50 ms':>8} {'p99 ms':>8} {'rejected':>8}")
    for count in active:
        row = measure(count, requests)
        rows.append(row)
        if not as_json:
            print_text(
                f"{row['active']:>7} {row['decisions_per_s']:>11.0f} {row['mean_ms']:>8.2f} {row['p50_ms']:>8.2f} "
                f"{row['p99_ms']:>8.2f} {row['rejected']:>8.0%}"
            )
    if as_json:
        print_json(rows)
