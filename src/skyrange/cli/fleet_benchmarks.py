"""The commands `skyrange bench fleet`, `ardupilot`, `cores` and `live`: aircraft in virtual time and in real time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skyrange.cli.options import AsJson, Grouping, Load, PortOffset, Rates, Telemetry
from skyrange.cli.output.console import print_json, print_notice, print_text, terminal
from skyrange.cli.output.progress import progress
from skyrange.core.extras import require_extra
from skyrange.core.time import NS_PER_S

if TYPE_CHECKING:
    from rich.table import Table

    from skyrange.bench.fleet import FleetOptions
    from skyrange.runtime.live.range import LiveRange, OnUpdate

commands = typer.Typer()

OnAir = Annotated[
    bool,
    typer.Option(
        "--remote-id", help="Fly among buildings, with Remote ID over the radio medium; all aircraft receive."
    ),
]


class Physics(StrEnum):
    """Kinds of physics of the ArduPilot benchmark."""

    SHARED = "shared"
    NATIVE = "native"


Cores = Annotated[
    list[int] | None,
    typer.Option(metavar="N", min=1, help="Number of cores to compare with one. May be repeated. Default: 2."),
]


Repeat = Annotated[int, typer.Option(metavar="K", min=1, help="Measure all K times, in turn, and take the medians.")]


@commands.command(epilog="Example: skyrange bench fleet --vehicles 100 --seconds 30 --json")
def fleet(
    *,
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
    from skyrange.bench.fleet import PARTS, FleetOptions, measure

    rows = []
    if not as_json:
        heads = f"{'aircraft':>8} {'× real time':>11} {'of flight':>9} {'set-up s':>8} {'flight s':>8} {'finish s':>8}"
        print_text(f"{heads} {'disk MB':>7} {'B/frame':>7} {'memory MB':>9}  share of time in flight")
    for count in vehicles or [1, 10, 100, 1000]:
        row = measure(count, seconds, FleetOptions(load=load.value, remote_id=remote_id), detector=detector)
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


@commands.command("ardupilot", epilog="Example: skyrange bench ardupilot --vehicles 5 --rates reduced --json")
def ardupilots(
    *,
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
        from skyrange.bench.fleet import FleetOptions

        fleet = FleetOptions(
            load=load.value,
            remote_id=remote_id,
            autopilot="ardupilot",
            options={"rates": rates.value},
            operators=max(cores),
        )
        for count in vehicles or [20]:
            _compare_cores(count, seconds, fleet, cores, repeat=repeat, as_json=as_json)
        return
    from skyrange.bench.ardupilot import measure

    rows = []
    if not as_json:
        heads = f"{'aircraft':>8} {'loop Hz':>7} {'× real time':>11} {'ArduPilots cpu s':>16} {'skyrange cpu s':>14}"
        print_text(f"{heads} {'bare cpu s':>10} {'skyrange/bare':>13} {'per core':>8}")
    for count in vehicles or [1, 5, 20]:
        row = measure(
            count,
            seconds,
            load=load.value,
            rates=rates.value,
            physics=physics.value,
            speedup=speedup,
            remote_id=remote_id,
        )
        rows.append(row)
        if not as_json:
            print_text(
                f"{count:>8} {row['loop_hz']:>7.0f} {row['real_time_factor']:>11.2f} {row['autopilots_cpu_s']:>16.2f} "
                f"{row['ours_cpu_s']:>14.2f} {row['bare_cpu_s']:>10.2f} {row['ours_over_bare']:>13.2f} "
                f"{row['per_core']:>8.1f}",
            )
    if as_json:
        print_json(rows)


@commands.command("cores", epilog="Example: skyrange bench cores --vehicles 1000 --cores 2 --remote-id")
def cores_bench(
    *,
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
    from skyrange.bench.fleet import FleetOptions

    fleet = FleetOptions(load=load.value, remote_id=remote_id, operators=operators)
    _compare_cores(vehicles, seconds, fleet, cores or [2], repeat=repeat, as_json=as_json)


def _compare_cores(
    vehicles: int, seconds: float, fleet: FleetOptions, cores: Sequence[int], *, repeat: int, as_json: bool
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
        row = measure(vehicles, seconds, count, fleet, turn=turn)
        rows.append(row)
        if not as_json:
            waited = " ".join(f"{wait_s:.1f}" for wait_s in row["waited_s"])
            print_text(
                f"{row['used']:>5} {row['total_factor']:>11.2f} {row['real_time_factor']:>9.2f} {row['setup_s']:>8.1f} "
                f"{row['wall_s']:>8.1f} {row['finish_s']:>8.1f} {row['flying']:>6}  {waited}{row['reason']}"
            )
    compared = compare(rows)
    if as_json:
        print_json({"rows": rows, "compared": compared})
        return
    for medians in compared:
        if medians["speed_up"] is not None and medians["cores"] > 1:
            same = "the same fingerprint" if medians["same_fingerprint"] else "ANOTHER fingerprint"
            print_text(
                f"{medians['cores']} cores: {medians['speed_up']:.2f} times as fast as one, the flight "
                f"{medians['flight_speed_up']:.2f} times; {same}"
            )


@commands.command("live", epilog="Example: skyrange bench live --vehicles 40 --group operator --json")
def live_bench(
    *,
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
    require_extra("live", "bench live")
    from skyrange.bench.live import measure
    from skyrange.bench.transports import TRANSPORTS
    from skyrange.bench.transports import measure as measure_transport

    transports = []
    for number, transport in enumerate(TRANSPORTS):
        if not as_json:
            print_notice(f"transport {number + 1} of {len(TRANSPORTS)}: {transport}")
        transports.append(measure_transport(transport, 5_000 if transport == "http" else 50_000))
    if not as_json:
        terminal().print(_transports(transports))
    ranges = []
    for count in vehicles or [5, 20]:
        with progress(f"{count} aircraft", quiet=as_json) as tell:

            def look(flown: LiveRange, tell: Any = tell) -> None:
                end = round(flown.built.duration_ns)
                tell(min(max(round(flown.now_s * NS_PER_S), 0), end), end)

            on_update: OnUpdate | None = None if tell is None else look
            ranges.append(measure(count, seconds, group.value if group is not None else None, port_offset, on_update))
        if not as_json:
            terminal().print(_range(ranges[-1]))
    if as_json:
        print_json({"transports": transports, "ranges": ranges})


def _table(title: str, columns: Sequence[str], textual: Sequence[str]) -> Table:
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold")
    for column in columns:
        table.add_column(column, justify="left" if column in textual else "right", no_wrap=column not in textual)
    return table


def _transports(rows: Sequence[Mapping[str, Any]]) -> Table:
    columns = ("transport", "links", "frames/s", "per core", "added", "99 % within")
    table = _table("between two processes", columns, ("transport", "links"))
    for row in rows:
        table.add_row(
            row["transport"],
            ", ".join(row["links"]),
            f"{row['frames_per_s']:,}",
            f"{row['frames_per_core_s']:,}",
            f"{row['added_ms']:.2f} ms",
            f"{row['added_p99_ms']:.2f} ms",
        )
    return table


def _range(row: Mapping[str, Any]) -> Table:
    """The measures of one range, one per row."""
    pace = "kept real time" if row["held"] else f"fell behind ({', '.join(row['fell_behind'])})"
    table = _table(
        f"{row['vehicles']} aircraft in {row['processes']} processes: {pace}", ("measure", "value"), ("measure",)
    )
    other_cores = row["elsewhere_cores"]
    busiest = ", ".join(f"{name} {share:.2f}" for name, share in row["cores_by_process"].items())
    measures = {
        "largest delay behind real time": f"{row['max_lag_s']:.3f} s",
        "cores": f"{row['cores']:.2f}",
        "busiest processes, in cores": busiest,
        "cores used by other programs": "unknown" if other_cores is None else f"{other_cores:.2f}",
        "aircraft per core": f"{row['aircraft_per_core']}",
        "flying": f"{row['flying']}",
        "frames per second": f"{row['frames_per_s']:,.0f}, over sockets {row['crossings_per_s']:,.0f}",
        "time to start, time to end": f"{row['start_s']:.1f} s, {row['end_s']:.1f} s",
    }
    for kind, added in row["added_ms"].items():
        measures[f"added on {kind}"] = f"{added['median']:.1f} ms, 99 % within {added['p99']:.1f} ms"
    for name, value in measures.items():
        table.add_row(name, value)
    return table
