"""What does `skyrange live` show while a range flies? A table of its nodes: address, state, rate, lag."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skyrange.cli.commands import print_json, print_summary, tell_if_cold
from skyrange.cli.live_viewing import first_port, invite, see_off
from skyrange.core.time import NS_PER_MS, to_seconds

if TYPE_CHECKING:
    from rich.table import Table

    from skyrange.runtime.live.supervisor import OnLook, Range

MOST_ROWS = 40


def live(
    name: str,
    out: Path | None,
    seed: int | None,
    buildings: Path | None,
    changes: Sequence[str],
    group: str | None,
    outside: Sequence[str],
    port_offset: int,
    on_death: str,
    qgc: bool,
    viewer_port: int | None,
    as_json: bool,
) -> None:
    """`skyrange live`."""
    from skyrange.core.errors import ComponentError, ShortfallError
    from skyrange.record import load as load_run
    from skyrange.runtime.live.supervisor import fly, prepare
    from skyrange.scenario.catalogue import load
    from skyrange.study.report import write_report
    from skyrange.study.summary import summary

    scenario = load(name, changes, seed=seed, buildings=buildings)
    tell_if_cold(quiet=as_json)
    options: Any = {"group": group, "on_death": on_death, "viewer_port": first_port(qgc, viewer_port, port_offset)}
    flown = prepare(scenario, out, outside=tuple(outside), port_offset=port_offset, **options)
    invite(flown)
    failure: ShortfallError | ComponentError | None = None
    with _shown(flown, quiet=as_json) as on_look:
        try:
            fly(flown, on_look)
        except (ShortfallError, ComponentError) as error:
            failure = error
    see_off(flown)
    record = load_run(flown.folder)
    write_report(record, flown.folder / "report.html")
    facts = {**summary(record), "live": record.manifest["live"]}
    if as_json:
        print_json(facts)
    else:
        print_summary(facts)
        behind = facts["live"]["fell_behind"]
        if behind:
            late = facts["live"]["late_max_s"]
            said = ", ".join(f"{node} by {late[node]:.1f} s" for node in behind)
            print(f"fell behind real time: {said}", file=sys.stderr)
    if failure is not None:
        raise failure


@contextmanager
def _shown(flown: Range, *, quiet: bool) -> Iterator[OnLook | None]:
    """On a terminal the table, elsewhere a line when all fly and every ten seconds."""
    if quiet:
        yield None
    elif sys.stderr.isatty():
        from rich.console import Console
        from rich.live import Live

        with Live(_table(flown), console=Console(stderr=True), refresh_per_second=4) as shown:
            yield lambda now: shown.update(_table(now))
    else:
        said = -2

        def tell(now: Range) -> None:
            nonlocal said
            tens = int(now.now_s // 10) if now.zero_ns else -1
            if tens > said:
                said = tens
                states = [member.state for member in now.members.values()]
                counted = ", ".join(f"{states.count(state)} {state}" for state in dict.fromkeys(states))
                at = f"{max(now.now_s, 0.0):.0f} of {now.rig.scenario.duration_s:.0f} s"
                print(f"{now.rig.scenario.name}: {at}; {counted}", file=sys.stderr, flush=True)

        yield tell


def _table(flown: Range) -> Table:
    """One row per node."""
    from rich.table import Table

    at = f"{max(flown.now_s, 0.0):.0f} of {flown.rig.scenario.duration_s:.0f} s"
    table = Table(title=f"{flown.rig.scenario.name}: {at}", title_justify="left", title_style="bold")
    for column in ("node", "listens at", "state"):
        table.add_column(column, no_wrap=column != "listens at")
    for column in ("sent/s", "heard/s", "lag", "core"):
        table.add_column(column, justify="right", no_wrap=True)
    seconds = max(flown.now_s, 1.0)
    homes = {node.name: node.endpoints for node in flown.plan.nodes}
    for name, member in list(flown.members.items())[:MOST_ROWS]:
        own = [one for one in flown.crossings if one.listener in homes[name]]
        places = ", ".join(f"{one.transport} {one.address[1]}" for one in own[:4]) + (" …" if len(own) > 4 else "")
        status = member.status
        table.add_row(
            name,
            places,
            member.state if not member.ended else f"[red]{member.state}[/]",
            f"{status.get('sent', 0) / seconds:.0f}",
            f"{status.get('received', 0) / seconds:.0f}",
            f"{status.get('lag_ns', 0) / NS_PER_MS:.0f} ms",
            f"{status.get('cpu_s', 0.0) / seconds:.0%}",
        )
    for name in sorted(flown.plan.outside):
        own = [one for one in flown.crossings if one.listener.startswith(name)]
        table.add_row(
            name, ", ".join(f"{one.transport} {one.address[1]}" for one in own[:4]), "outside", "", "", "", ""
        )
    late = max((to_seconds(int(member.status.get("late_ns", 0))) for member in flown.members.values()), default=0.0)
    table.caption = f"at most {late:.2f} s behind real time" if late > 0.1 else None
    return table
