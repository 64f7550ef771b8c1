"""What does each command do? Call the library, then print a table for people or JSON for scripts."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skyrange.core.errors import InputError, ShortfallError

if TYPE_CHECKING:
    from rich.console import Console

    from skyrange.study.pairing import Pair


def print_json(data: Any) -> None:
    """For scripts: one JSON value on standard output."""
    unicode = "utf" in (sys.stdout.encoding or "").lower()
    print(json.dumps(data, indent=2, ensure_ascii=not unicode, allow_nan=False))


def terminal() -> Console:
    """For people: where tables go."""
    from rich.console import Console

    return Console(highlight=False)


def tell_if_cold(*, quiet: bool) -> None:
    """Say why the first run takes longer than the others."""
    from skyrange.core.compiled import compiled_before

    if not quiet and not compiled_before():
        print("compiling the numeric kernels, once (a minute or two)", file=sys.stderr, flush=True)


def run(
    name: str,
    out: Path | None,
    seed: int | None,
    speed: float | None,
    buildings: Path | None,
    changes: Sequence[str],
    qgc: bool,
    viewer_port: int | None,
    motion: bool,
    as_json: bool,
) -> None:
    """`skyrange run`."""
    from skyrange.cli.outside import tell_if_held_back
    from skyrange.cli.progress import progress
    from skyrange.cli.viewing import watchable
    from skyrange.scenario.catalogue import load
    from skyrange.study.session import fly
    from skyrange.study.summary import summary

    scenario = load(name, changes, seed=seed, buildings=buildings)
    shortfall: ShortfallError | None = None
    tell_if_cold(quiet=as_json)
    watched = qgc or viewer_port is not None
    with watchable(scenario, watched, viewer_port) as viewers, progress(scenario.name, quiet=as_json) as on_progress:
        try:
            record = fly(scenario, out, speed=speed, viewers=viewers, on_progress=on_progress, motion=motion)
        except ShortfallError as error:
            from skyrange.record import load as load_run

            shortfall, record = error, load_run(error.path)
    facts = summary(record)
    if as_json:
        print_json(facts)
    else:
        print_summary(facts)
        tell_if_held_back(record.manifest)
    if shortfall is not None:
        raise shortfall


def pair(
    name: str,
    out: Path | None,
    sham: bool,
    seeds: int,
    jobs: int,
    seed: int | None,
    buildings: Path | None,
    changes: Sequence[str],
    as_json: bool,
) -> None:
    """`skyrange pair`."""
    from skyrange.cli.progress import together
    from skyrange.scenario.catalogue import load
    from skyrange.study.pairing import ARMS
    from skyrange.study.pairing import pair as fly_pair

    scenario = load(name, changes, seed=seed, buildings=buildings)
    tell_if_cold(quiet=as_json)
    flights = seeds * (len(ARMS) if sham else len(ARMS) - 1)
    with together(scenario.name, flights, quiet=as_json) as on_progress:
        made = fly_pair(scenario, out, sham=sham, seeds=seeds, jobs=jobs, on_progress=on_progress)
    if as_json:
        effects = made.effects.to_pylist()
        found = {vehicle: {key: one._asdict() for key, one in own.items()} for vehicle, own in made.intervals().items()}
        folder = {"path": str(made.path), "report": str(made.report)}
        print_json({**made.manifest, **folder, "effects": effects, "intervals": found})
    else:
        _print_pair(made)


def _print_pair(made: Pair) -> None:
    """The aircraft that departed from the twin, or that none did."""
    from rich.table import Table

    console = terminal()
    rows = [row for row in made.effects.to_pylist() if row["against"] == made.reference]
    own = [row for row in rows if row["seed"] == made.seeds[0] and row["departed_s"] is not None]
    table = Table(
        title=f"{made.manifest['name']}: attacked against {made.reference}, seed {made.seeds[0]}",
        title_justify="left", title_style="bold",
    )  # fmt: skip
    for column in ("aircraft", "mission", "departs", "by", "delay", "distance", "energy"):
        left = column in ("aircraft", "mission")
        table.add_column(column, justify="left" if left else "right", no_wrap=True)
    for row in sorted(own, key=lambda row: -row["departure_m"])[:MOST_AIRCRAFT]:
        table.add_row(
            row["vehicle"],
            row["outcome"],
            f"{row['departed_s']:.1f} s",
            f"{row['departure_m']:.1f} m",
            "–" if row["delay_s"] is None else f"{row['delay_s']:+.1f} s",
            f"{row['extra_distance_m']:+.1f} m",
            "–" if row["extra_energy_j"] is None else f"{row['extra_energy_j'] / 1000.0:+.2f} kJ",
        )
    if own:
        console.print(table)
    else:
        console.print(f"no aircraft came farther than {made.manifest['threshold_m']:g} m from where it is in the twin")
    for row in own:
        if row["outcome"] != row["outcome_twin"]:
            console.print(
                f"{row['vehicle']}: {row['outcome_twin']} in the twin, {row['outcome']} attacked", markup=False
            )
        for what in ("near_misses", "collisions"):
            if row[what] != row[f"{what}_twin"]:
                said = what.replace("_", " ")
                console.print(f"{row['vehicle']}: {row[f'{what}_twin']} {said} in the twin, {row[what]} attacked")
    if len(made.seeds) > 1:
        _print_intervals(console, made, {row["vehicle"] for row in rows if row["departed_s"] is not None})
    acts = sum(row["phase"] in ("onset", "act") for row in made.labels.to_pylist())
    console.print(f"{acts:,} hostile acts labelled in {len(made.seeds)} attacked run{'s' * (len(made.seeds) > 1)}")
    console.print(f"pair   {made.path}", soft_wrap=True, markup=False)
    console.print(f"report {made.report}", soft_wrap=True, markup=False)


def _print_intervals(console: Console, made: Pair, affected: set[str]) -> None:
    """Means over seeds with their 95 % intervals."""
    for vehicle, own in made.intervals().items():
        if vehicle not in affected:
            continue
        said = [
            f"{key} {one.mean:+.2f} [{one.low:+.2f}, {one.high:+.2f}]"
            for key, one in own.items()
            if one.low is not None and one.high is not None
        ]
        console.print(f"{vehicle}, mean of {len(made.seeds)} seeds, 95 %: {'; '.join(said)}", markup=False)


def show(folder: Path, as_json: bool) -> None:
    """`skyrange show`."""
    from skyrange.record import load
    from skyrange.study.summary import summary

    facts = summary(load(folder))
    if as_json:
        print_json(facts)
    else:
        print_summary(facts)


def print_summary(facts: dict[str, Any]) -> None:
    """What a run was and how it went, as `skyrange show` says it."""
    from rich.markup import escape
    from rich.table import Table

    console = terminal()
    title = f"{escape(facts['name'])} · {facts['status']}"
    rows = facts["vehicles"]
    if len(rows) > MOST_AIRCRAFT:
        _print_operators(console, title, rows)
        rows = [row for row in rows if row["outcome"] != "complete"]
        title = f"not complete: {len(rows)}" + (f", the first {MOST_AIRCRAFT}" if len(rows) > MOST_AIRCRAFT else "")
    if rows:
        aircraft = Table(title=title, title_justify="left", title_style="bold")
        for column in ("aircraft", "outcome", "finished", "flown", "highest", "frames to its ground station"):
            aircraft.add_column(column, justify="left" if column in ("aircraft", "outcome") else "right")
        for row in rows[:MOST_AIRCRAFT]:
            good = row["outcome"] == "complete"
            why = row["mishap"] or row["reason"]
            reason = f" ({escape(why)})" if why and not good else ""
            aircraft.add_row(
                row["id"],
                f"[{'green' if good else 'yellow'}]{row['outcome']}[/]{reason}",
                "–" if row["finished_s"] is None else f"{row['finished_s']:.1f} s",
                f"{row['distance_m']:.0f} m",
                f"{row['highest_m']:.1f} m",
                f"{row['frames_received']:,} of {row['frames_sent']:,}",
            )
        console.print(aircraft)
    _print_mishaps(console, facts["mishaps"])
    timings = facts["timings"]
    factor = timings.get("real_time_factor")
    wall_s = timings.get("wall_s")
    pace = f" in {wall_s:.1f} s, {factor:.0f}× real time" if wall_s and factor else ""
    console.print(f"{facts['simulated_s']:.1f} s simulated{pace}; {facts['frames']:,} frames; seed {facts['seed']}")
    if facts["fingerprint"]:
        console.print(f"fingerprint {facts['fingerprint']}")
    console.print(f"run    {facts['path']}", soft_wrap=True, markup=False)
    if facts["report"]:
        console.print(f"report {facts['report']}", soft_wrap=True, markup=False)


MOST_AIRCRAFT = 60
"""Rows of a summary's table; of a larger fleet it has a row per operator, and those that did not complete."""


def _print_operators(console: Console, title: str, rows: Sequence[dict[str, Any]]) -> None:
    """A fleet too large for a row each: how many of each operator's missions are complete, and how far they flew."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold")
    for column in ("operator", "aircraft", "complete", "last finished", "flown, mean", "highest"):
        table.add_column(column, justify="left" if column == "operator" else "right")
    for name in dict.fromkeys(row["operator"] for row in rows):
        own = [row for row in rows if row["operator"] == name]
        finished = [row["finished_s"] for row in own if row["finished_s"] is not None]
        table.add_row(
            name,
            f"{len(own):,}",
            f"{sum(row['outcome'] == 'complete' for row in own):,}",
            f"{max(finished):.1f} s" if finished else "–",
            f"{sum(row['distance_m'] for row in own) / len(own):.0f} m",
            f"{max(row['highest_m'] for row in own):.1f} m",
        )
    console.print(table)


MOST_MISHAPS = 12
"""Lines of mishaps in a summary; the record and its report hold all."""


def _print_mishaps(console: Console, mishaps: Sequence[dict[str, Any]]) -> None:
    """Collisions, crashes, breaches and failsafes, one a line."""
    for mishap in mishaps[:MOST_MISHAPS]:
        console.print(f"[red]![/] {mishap['words']}", markup=True)
    if len(mishaps) > MOST_MISHAPS:
        console.print(f"[red]![/] and {len(mishaps) - MOST_MISHAPS} more of these; the report shows them")


def report(folder: Path, out: Path | None, as_json: bool) -> None:
    """`skyrange report`."""
    from skyrange.record import load
    from skyrange.study.report import write_report

    record = load(folder)
    path = out.expanduser() if out is not None else record.path / "report.html"
    try:
        write_report(record, path)
    except OSError as error:
        raise InputError.one("--out", "file", str(path), f"a file that can be written ({error.strerror})") from None
    if as_json:
        print_json({"report": str(path), "bytes": path.stat().st_size})
    else:
        print(path)


def export(folder: Path, only: str | None, receivers: Sequence[str], out: Path | None, as_json: bool) -> None:
    """`skyrange export`."""
    from skyrange.record import load
    from skyrange.study import export as captures
    from skyrange.study.overheard import has_radio

    record = load(folder)
    target = out.expanduser() if out is not None else record.path
    if not target.is_dir():
        raise InputError.one("--out", "folder", str(target), "a folder that exists")
    if receivers and only == "mavlink":
        raise InputError.one("--receiver", "with --only mavlink", receivers[0], "Remote ID to be exported")
    made = {}
    if only == "remote_id" or receivers or (only is None and has_radio(record)):
        made["remote_id"] = captures.remote_id(record, target / captures.REMOTE_ID, receivers)
    if only != "remote_id":
        made["mavlink"] = captures.mavlink(record, target / captures.MAVLINK)
    if as_json:
        print_json({name: {**one._asdict(), "path": str(one.path)} for name, one in made.items()})
        return
    for one in made.values():
        print(f"{one.packets:>9,} packets  {one.path}")
    if "remote_id" not in made and only is None:
        print("no Remote ID: the run has no radio medium", file=sys.stderr)


def diff(a: Path, b: Path, tolerance_s: float | None, as_json: bool) -> None:
    """`skyrange diff`."""
    from skyrange.record import load
    from skyrange.study.agreement import Agreement, agreement
    from skyrange.study.diff import Difference
    from skyrange.study.diff import diff as compare

    runs = load(a), load(b)
    difference: Agreement | Difference = compare(*runs) if tolerance_s is None else agreement(*runs, tolerance_s)
    if as_json:
        print_json(difference.to_dict())
    else:
        print(difference)


def scenarios(as_json: bool) -> None:
    """`skyrange scenarios`."""
    from skyrange.scenario.catalogue import SHIPPED

    if as_json:
        print_json([{"name": name, "about": about} for name, about in SHIPPED.items()])
        return
    width = max(map(len, SHIPPED))
    for name, about in SHIPPED.items():
        print(f"{name:<{width}}  {about}")


def load_plugins(files: Sequence[Path] | None) -> None:
    """`--plugin` of several commands."""
    if files:
        from skyrange.agent.plugins import load_files

        load_files(files)


def attacks(as_json: bool) -> None:
    """`skyrange attacks`."""
    from skyrange.agent.plugins import ATTACKS, kinds
    from skyrange.attack.contract import AttackKind

    found = {name: AttackKind.find(name) for name in kinds(ATTACKS)}
    if as_json:
        rows = [{"kind": name, "about": one.about, "technique": one.technique} for name, one in found.items()]
        print_json(rows)
        return
    width = max(map(len, found), default=0)
    for name, one in found.items():
        print(f"{name:<{width}}  {one.about}")


def schema() -> None:
    """`skyrange schema`."""
    from skyrange.scenario.schema import json_schema

    print_json(json_schema())


def doctor(as_json: bool) -> None:
    """`skyrange doctor`."""
    from skyrange.doctor import examine

    findings = examine()
    if as_json:
        print_json([finding.to_dict() for finding in findings])
    else:
        for finding in findings:
            print(f"{'ok ' if finding.ok else '-- ' if finding.optional else '!! '} {finding.subject}: {finding.found}")
            if finding.hint:
                print(f"    {finding.hint}")
    if not all(finding.ok or finding.optional for finding in findings):
        sys.exit(3)


def install_ardupilot(version: str | None, source: Path | None, as_json: bool) -> None:
    """`skyrange install ardupilot`."""
    from skyrange.cli.progress import transfer
    from skyrange.install.ardupilot import install
    from skyrange.vehicle.ardupilot.binary import find

    with transfer("arducopter", quiet=as_json) as on_progress:
        made = install(version, source.expanduser() if source is not None else None, on_progress)
    binary = made.binary
    facts = {"version": binary.version, "path": str(binary.path), "sha256": binary.sha256, "from": made.origin}
    if as_json:
        print_json(facts)
    else:
        print(f"installed ArduCopter {binary.version}")
        for key in ("path", "sha256", "from"):
            print(f"{key:<6} {facts[key]}")
    try:
        first = find()
    except InputError as error:
        print(f"what would fly is another, and will not do: {error}", file=sys.stderr)
    else:
        if first.path != binary.path:
            where = "newer" if first.source == "installed" else f"of {first.source}"
            print(f"what flies is another, {where}: ArduCopter {first.version}, {first.path}", file=sys.stderr)


def bench_fleet(
    vehicles: Sequence[int], seconds: float, load: str, remote_id: bool, detector: bool, as_json: bool
) -> None:
    """`skyrange bench fleet`."""
    from skyrange.bench.fleet import PARTS, measure

    rows = []
    if not as_json:
        print(f"{'aircraft':>8} {'× real time':>11} {'cpu s':>7} {'memory MB':>9}  share of time")
    for count in vehicles:
        row = measure(count, seconds, load, remote_id, detector)
        rows.append(row)
        if not as_json:
            shares = " · ".join(f"{part} {row['share'][part]:.0%}" for part in PARTS)
            print(
                f"{count:>8} {row['real_time_factor']:>11.2f} {row['cpu_s']:>7.2f} {row['memory_mb']:>9.0f}  {shares}",
                flush=True,
            )
    if as_json:
        print_json(rows)


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
        heads = f"{'aircraft':>8} {'loop Hz':>7} {'× real time':>11} {'ArduPilots cpu s':>16} {'ours cpu s':>10}"
        print(f"{heads} {'bare cpu s':>10} {'ours/bare':>9} {'per core':>8}")
    for count in vehicles:
        row = measure(count, seconds, load, rates, physics, speedup, remote_id)
        rows.append(row)
        if not as_json:
            print(
                f"{count:>8} {row['loop_hz']:>7.0f} {row['real_time_factor']:>11.2f} {row['autopilots_cpu_s']:>16.2f} "
                f"{row['ours_cpu_s']:>10.2f} {row['bare_cpu_s']:>10.2f} {row['ours_over_bare']:>9.2f} "
                f"{row['per_core']:>8.1f}",
                flush=True,
            )
    if as_json:
        print_json(rows)


def bench_radio(nodes: Sequence[int], seconds: float, horizon_m: float, as_json: bool) -> None:
    """`skyrange bench radio`."""
    from skyrange.bench.radio import measure

    rows = []
    if not as_json:
        heads = f"{'nodes':>8} {'× real time':>11} {'µs/node·s':>9} {'sent/s':>9} {'heard/s':>9}"
        print(f"{heads} {'heard by':>8} {'sight lines':>11}")
    for count in nodes:
        row = measure(count, seconds, horizon_m)
        rows.append(row)
        if not as_json:
            print(
                f"{count:>8} {row['real_time_factor']:>11.2f} {row['us_per_node_s']:>9.1f} "
                f"{row['transmissions_per_s']:>9.0f} {row['receptions_per_s']:>9.0f} {row['heard_by']:>8.1f} "
                f"{row['line_of_sight_share']:>11.0%}",
                flush=True,
            )
    if as_json:
        print_json(rows)
