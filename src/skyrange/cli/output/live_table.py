"""Progress of a live range on the terminal: a table of its nodes, or a line every ten seconds."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from skyrange.cli.output.console import print_notice, terminal
from skyrange.core.time import NS_PER_MS, to_seconds

if TYPE_CHECKING:
    from rich.table import Table

    from skyrange.runtime.live.range import LiveRange, OnUpdate
    from skyrange.runtime.live.transport.addresses import Crossing

MAX_ROWS = 40


@contextmanager
def live_progress(flown: LiveRange, *, quiet: bool) -> Iterator[OnUpdate | None]:
    """Show the table on a terminal; elsewhere print a line at the start and every ten seconds."""
    if quiet:
        yield None
    elif sys.stderr.isatty():
        from rich.console import Group
        from rich.live import Live

        from skyrange.cli.output.flight_lines import FlightLines

        flown.reports_events = True
        lines = FlightLines(sum(1 for _ in flown.built.scenario.fleet))

        def show(now: LiveRange) -> None:
            reports, now.reports = now.reports, []
            for report in reports:
                lines.add(report)
            # the table last: what does not fit on the terminal is cut at its end
            shown.update(Group(*(lines.render() if now.zero_ns else ()), make_table(now)))

        with Live(make_table(flown), console=terminal(stderr=True), refresh_per_second=4) as shown:
            yield show
            show(flown)
    else:
        printed, waited = -2, False

        def tell(now: LiveRange) -> None:
            nonlocal printed, waited
            if now.waits_for and not waited:
                waited = True
                print_notice(_format_waiting(now))
            tens = int(now.now_s // 10) if now.zero_ns else -1
            if tens > printed and now.members:
                printed = tens
                states = [member.state for member in now.members.values()]
                counted = ", ".join(f"{states.count(state)} {state}" for state in dict.fromkeys(states))
                at = _format_time(now)
                print_notice(f"{now.built.scenario.name}: {at}; {counted}")

        yield tell


def _format_address(crossing: Crossing) -> str:
    from skyrange.io.addresses import is_loopback

    host, port = crossing.address
    return f"{crossing.transport} {port}" if is_loopback(host) else f"{crossing.transport} {host}:{port}"


def _format_time(flown: LiveRange) -> str:
    """The time reached; processes end a moment after the scenario's end, and that is no more time of it."""
    end_s = flown.built.scenario.duration_s
    return f"{min(max(flown.now_s, 0.0), end_s):.0f} of {end_s:.0f} s"


def _format_waiting(flown: LiveRange) -> str:
    where = f"{flown.deployment.base}:{flown.control_port}"
    return f"waiting for {', '.join(flown.waits_for)}: run `skyrange node --join {where} --key FILE` on each"


def make_table(flown: LiveRange) -> Table:
    """A table with one row per node."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=f"{flown.built.scenario.name}: {_format_time(flown)}", title_justify="left", title_style="bold")
    for column in ("node", "listens at", "state"):
        table.add_column(column, no_wrap=column != "listens at")
    for column in ("sent/s", "received/s", "lag", "core"):
        table.add_column(column, justify="right", no_wrap=True)
    seconds = max(flown.now_s, 1.0)
    endpoints = {node.name: node.endpoints for node in flown.deployment.nodes}
    for name, member in list(flown.members.items())[:MAX_ROWS]:
        crossings = [crossing for crossing in flown.crossings if crossing.listener in endpoints[name]]
        places = ", ".join(_format_address(crossing) for crossing in crossings[:4]) + (
            " …" if len(crossings) > 4 else ""
        )
        status = member.status
        table.add_row(
            name,
            places,
            Text(member.state, "red" if member.ended else ""),
            f"{status.get('sent', 0) / seconds:.0f}",
            f"{status.get('received', 0) / seconds:.0f}",
            f"{status.get('lag_ns', 0) / NS_PER_MS:.0f} ms",
            f"{status.get('cpu_s', 0.0) / seconds:.0%}",
        )
        for program in status.get("programs", ()):
            state = program["state"] + (f", {len(program['ended'])} ended" if program["ended"] else "")
            row = (f"  {program['name']}", f"pid {program['pid']}", Text(state, "red" if program["ended"] else ""))
            table.add_row(*row, "", "", "", "")
    for address in flown.waits_for:
        table.add_row(f"at {address}", "", "awaited", "", "", "", "")
    for name in sorted(flown.deployment.outside):
        crossings = [crossing for crossing in flown.crossings if crossing.listener.startswith(name)]
        table.add_row(
            name, ", ".join(_format_address(crossing) for crossing in crossings[:4]), "outside", "", "", "", ""
        )
    late = max((to_seconds(int(member.status.get("late_ns", 0))) for member in flown.members.values()), default=0.0)
    if flown.waits_for:
        table.caption = _format_waiting(flown)
        return table
    table.caption = f"at most {late:.2f} s behind real time" if late > 0.1 else None
    return table
