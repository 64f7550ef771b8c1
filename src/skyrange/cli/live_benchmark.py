"""The command `skyrange bench live`: a table of the transports, then one table per live range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from skyrange.cli.output.console import print_json, print_notice, terminal
from skyrange.cli.output.progress import progress
from skyrange.core.time import NS_PER_S

if TYPE_CHECKING:
    from rich.table import Table

    from skyrange.runtime.live.deployment import Group
    from skyrange.runtime.live.range import LiveRange, OnUpdate


def live(vehicles: Sequence[int], seconds: float, group: Group | None, port_offset: int, as_json: bool) -> None:
    """`skyrange bench live`."""
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
    for count in vehicles:
        with progress(f"{count} aircraft", quiet=as_json) as tell:

            def look(flown: LiveRange, tell: Any = tell) -> None:
                end = round(flown.built.duration_ns)
                tell(min(max(round(flown.now_s * NS_PER_S), 0), end), end)

            on_update: OnUpdate | None = None if tell is None else look
            ranges.append(measure(count, seconds, group, port_offset, on_update))
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
    held = "kept real time" if row["held"] else f"fell behind ({', '.join(row['fell_behind'])})"
    table = _table(
        f"{row['vehicles']} aircraft in {row['processes']} processes: {held}", ("measure", "value"), ("measure",)
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
    for kind, own in row["added_ms"].items():
        measures[f"added on {kind}"] = f"{own['median']:.1f} ms, 99 % within {own['p99']:.1f} ms"
    for name, value in measures.items():
        table.add_row(name, value)
    return table
