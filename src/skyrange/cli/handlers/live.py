"""The commands for live ranges, and the table of nodes that `skyrange live` shows during a run."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skyrange.cli.addresses import parse_address, parse_ip_address
from skyrange.cli.output.console import print_json, print_notice, print_text, terminal
from skyrange.cli.output.interlock_notice import print_interlock_notice
from skyrange.cli.output.live_viewer_notices import print_open_ports, print_viewer_counts, tell_when_up
from skyrange.cli.output.run_summary import print_summary
from skyrange.core.time import NS_PER_MS, to_seconds

if TYPE_CHECKING:
    from rich.table import Table

    from skyrange.runtime.live.range import LiveRange, OnUpdate
    from skyrange.runtime.live.transport.addresses import Crossing

MAX_ROWS = 40


def live(
    name: str,
    out: Path | None,
    seed: int | None,
    buildings: Path | None,
    changes: Sequence[str],
    outside: Sequence[str],
    port_offset: int,
    keys: Path | None,
    options: Mapping[str, Any],
    as_json: bool,
) -> None:
    """`skyrange live`; `options` go to `prepare_range` as they are."""
    from skyrange.cli.output.progress import compile_if_cold
    from skyrange.core.errors import ComponentError, ShortfallError, SkyrangeError
    from skyrange.io.zeromq.curve_keys import load_range
    from skyrange.metrics.summary import summary
    from skyrange.record import load as load_run
    from skyrange.report import write_report
    from skyrange.runtime.live.range import prepare_range
    from skyrange.runtime.live.supervisor.supervisor import run_range
    from skyrange.scenario.shipped import load
    from skyrange.twins.failed_missions import require_missions

    scenario = load(name, changes, seed=seed, buildings=buildings)
    compile_if_cold(quiet=as_json)
    own = load_range(keys) if keys is not None else None
    flown = prepare_range(scenario, out, outside=tuple(outside), port_offset=port_offset, keys=own, **options)
    print_open_ports(flown)
    failure: ShortfallError | ComponentError | None = None
    with _show_progress(flown, quiet=as_json) as on_update:
        try:
            run_range(flown, tell_when_up(flown, on_update))
        except (ShortfallError, ComponentError) as error:
            failure = error
    print_viewer_counts(flown)
    try:
        record = load_run(flown.folder)
        write_report(record, flown.folder / "report.html")
    except (SkyrangeError, OSError):
        if failure is not None:  # the cause
            raise failure from None
        raise
    facts = {**summary(record), "live": record.manifest["live"]}
    if as_json:
        print_json(facts)
    else:
        print_summary(facts)
        print_interlock_notice(record.manifest)
        behind = facts["live"]["fell_behind"]
        if behind:
            late = facts["live"]["late_max_s"]
            nodes = ", ".join(f"{node} by {late[node]:.1f} s" for node in behind)
            print_notice(f"fell behind real time: {nodes}")
        for address, clock in facts["live"]["clocks"].items():
            for jump in clock["jumps"]:
                jumped = f"the clock of {address} jumped by {jump['by_s']:+.1f} s at {jump['at_s']:.1f} s"
                print_notice(f"{jumped}; it was set, or the machine was suspended")
    if failure is not None:
        raise failure
    require_missions(record)


def node(remote: str, key: Path, address: str | None, wait_s: float) -> None:
    """`skyrange node`."""
    from skyrange.io.zeromq.curve_keys import load_member
    from skyrange.runtime.live.node.host_agent import join_range
    from skyrange.runtime.live.range import CONTROL_PORT

    own = None if address is None else parse_ip_address("node", "--address", address)
    at = parse_address("node", "--join", remote, CONTROL_PORT)
    join_range(at, load_member(key), own, wait_s=wait_s, on_word=print_notice)


def keys(folder: Path, names: Sequence[str]) -> None:
    """`skyrange keys`."""
    from skyrange.io.zeromq.curve_keys import RANGE, make_range_keys

    made = make_range_keys(folder, names)
    if not made:
        print_notice(f"{folder} already has the keys of a range; give the names of machines that may join")
    for path in made:
        use = "stays on this machine" if path.stem == RANGE else "copy it to that machine only"
        print_text(f"{path}  {use}")


def merge(folder: Path, out: Path | None, as_json: bool) -> None:
    """`skyrange merge`."""
    from skyrange.metrics.summary import summary
    from skyrange.record import load as load_run
    from skyrange.record.live_merge.merge import recover_run
    from skyrange.report import write_report

    folder = folder.resolve()  # so that "." has a name
    into = out if out is not None else folder.with_name(f"{folder.name}-merged")
    recover_run(folder, into)
    record = load_run(into)
    write_report(record, into / "report.html")
    facts = summary(record)
    if as_json:
        print_json(facts)
    else:
        print_summary(facts)


@contextmanager
def _show_progress(flown: LiveRange, *, quiet: bool) -> Iterator[OnUpdate | None]:
    """Show the table on a terminal; elsewhere print a line at the start and every ten seconds."""
    if quiet:
        yield None
    elif sys.stderr.isatty():
        from rich.live import Live

        with Live(_table(flown), console=terminal(stderr=True), refresh_per_second=4) as shown:
            yield lambda now: shown.update(_table(now))
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


def _table(flown: LiveRange) -> Table:
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
        own = [one for one in flown.crossings if one.listener in endpoints[name]]
        places = ", ".join(_format_address(one) for one in own[:4]) + (" …" if len(own) > 4 else "")
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
        own = [one for one in flown.crossings if one.listener.startswith(name)]
        table.add_row(name, ", ".join(_format_address(one) for one in own[:4]), "outside", "", "", "", "")
    late = max((to_seconds(int(member.status.get("late_ns", 0))) for member in flown.members.values()), default=0.0)
    if flown.waits_for:
        table.caption = _format_waiting(flown)
        return table
    table.caption = f"at most {late:.2f} s behind real time" if late > 0.1 else None
    return table
