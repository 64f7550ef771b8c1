"""Summary of a run on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from skyrange.cli.output.console import terminal
from skyrange.cli.output.warnings import shorten_warnings

if TYPE_CHECKING:
    from rich.console import Console
MAX_AIRCRAFT = 60
"""Rows of the table; for a larger fleet there is one row per operator, and one per aircraft that did not complete."""

SHOWN_SHARE = 0.01
"""What takes less of the disk is not named."""
_LEFT_OUT = {
    "study": "frames, receptions, scans and telemetry; the table features counts frames",
    "summary": "truth, sensors, frames, receptions, scans, telemetry, labels and observations",
}
"""By level of the record."""
MAX_FILES = 8
"""Mission files that are printed."""
MAX_MOVES = 12
"""Number of moved places that are printed; the manifest and the report contain all."""
MAX_MISHAPS = 12
"""Number of mishaps that are printed; the record and its report contain all."""


def print_summary(facts: dict[str, Any]) -> None:
    """Print the summary of a run."""
    from rich.table import Table
    from rich.text import Text

    console = terminal()
    title = f"{facts['name']} · run {facts['status']}"
    rows = facts["vehicles"]
    if len(rows) > MAX_AIRCRAFT:
        _print_operators(console, title, rows)
        rows = [row for row in rows if row["outcome"] != "complete"]
        title = f"not complete: {len(rows)}" + (f", the first {MAX_AIRCRAFT}" if len(rows) > MAX_AIRCRAFT else "")
    if rows:
        aircraft = Table(title=title, title_justify="left", title_style="bold")
        for column in ("aircraft", "outcome", "landed", "flown", "highest", "frames to ground station"):
            aircraft.add_column(column, justify="left" if column in ("aircraft", "outcome") else "right")
        for row in rows[:MAX_AIRCRAFT]:
            good = row["outcome"] == "complete"
            why = row["mishap"] or row["reason"]
            reason = f" ({why})" if why and not good else ""
            aircraft.add_row(
                row["id"],
                Text.assemble((row["outcome"], "green" if good else "yellow"), reason),
                "–" if row["landed_s"] is None else f"{row['landed_s']:.2f} s",
                _metres(row["distance_m"], 0),
                _metres(row["highest_m"], 1),
                _frames_text(row),
            )
        console.print(aircraft)
    _print_mishaps(console, facts["mishaps"])
    for line in shorten_warnings(facts.get("warnings", [])):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    print_city(console, facts.get("city"))
    _print_mission_files(console, facts.get("mission_files") or ())
    print_placing(console, facts.get("placing"))
    if facts.get("radio"):
        console.print(f"radio  {facts['radio']}", soft_wrap=True, markup=False, highlight=False)
    _print_trust(console, facts.get("trust"))
    _print_equivocators(console, facts.get("equivocators"))
    pace = _pace(facts["timings"])
    console.print(f"{facts['simulated_s']:.1f} s simulated{pace}{_frames_of_run(facts)}; seed {facts['seed']}")
    _print_cores(console, facts.get("cores"))
    _print_level(console, facts.get("level"))
    if facts["fingerprint"]:
        console.print(f"fingerprint {facts['fingerprint']}")
    console.print(f"run    {facts['path']}", soft_wrap=True)
    if facts["report"]:
        console.print(f"report {facts['report']}", soft_wrap=True)


def print_disk(facts: Mapping[str, Any]) -> None:
    """Print how much disk a run takes, and what takes most of it."""
    disk: Mapping[str, int] = facts["disk"]
    total = sum(disk.values())
    largest = [f"{name} {size / 1e6:.1f}" for name, size in disk.items() if size >= SHOWN_SHARE * total]
    per_frame = f", {total / facts['frames']:.0f} bytes for each frame" if facts["frames"] else ""
    text = f"disk   {total / 1e6:.1f} MB{per_frame}: {', '.join(largest)}"
    terminal().print(text, soft_wrap=True, markup=False, highlight=False)


def _pace(timings: Mapping[str, Any]) -> str:
    """How long a run took, and its speed: of all, and of the flight without set-up and finishing."""
    factor, wall_s, total = (timings.get(name) for name in ("real_time_factor", "wall_s", "total_factor"))
    if not wall_s or not factor:
        return ""
    if not total:
        return f" in {wall_s:.1f} s, {factor:.0f}× real time"
    whole_s = sum(timings.get(name) or 0.0 for name in ("setup_s", "wall_s", "finish_s"))
    return f" in {whole_s:.1f} s, {total:.3g}× real time (the flight in {wall_s:.1f} s, {factor:.3g}×)"


def _print_cores(console: Console, cores: Mapping[str, Any] | None) -> None:
    """Print on how many cores a run was, and what each did."""
    if not cores:
        return
    parts = [f"{part['vehicles']} aircraft, waited {part['waited_s']:.1f} s" for part in cores.get("parts") or ()]
    why = f": {cores['reason']}" if cores["reason"] else ""
    text = f"cores  {cores['used']} of {cores['asked']}{why}" + "".join(f"\n       {part}" for part in parts)
    console.print(text, soft_wrap=True, markup=False, highlight=False)


def _print_equivocators(console: Console, operators: Sequence[str] | None) -> None:
    """Print whose stake counts nothing in the next run."""
    if not operators:
        return
    stakes = ", ".join(f"{operator} = 0" for operator in operators)
    console.print(
        f"fork   {', '.join(operators)} signed two events with one self-parent, and should have no stake in the next "
        f"run, beside its other stakes: --set 'approvals.hashgraph.stakes={{ {stakes} }}'",
        soft_wrap=True,
        markup=False,
        highlight=False,
    )


def _print_trust(console: Console, trust: Mapping[str, Any] | None) -> None:
    """Print how many aircraft sign their Remote ID, and how long receivers took until they trusted them."""
    if not trust:
        return
    times = "" if trust["median_s"] is None else f", after {trust['median_s']:.1f} s (median)"
    console.print(
        f"trust  {trust['adopters']} of {trust['aircraft']} aircraft sign; receivers that verify trusted "
        f"{trust['trusted']} of {trust['signed']} signing senders{times}, {trust['within_look_ahead']} within "
        f"{trust['look_ahead_s']:g} s",
        soft_wrap=True,
        highlight=False,
    )


def _print_level(console: Console, level: str | None) -> None:
    """Print what a run does not keep."""
    if level in _LEFT_OUT:
        console.print(f"level  {level}: without {_LEFT_OUT[level]}", soft_wrap=True, markup=False, highlight=False)


def _frames_of_run(facts: Mapping[str, Any]) -> str:
    return "" if facts["frames"] is None else f"; {facts['frames']:,} frames"


def _metres(value: float | None, decimals: int) -> str:
    return "–" if value is None else f"{value:.{decimals}f} m"


def _frames_text(row: Mapping[str, Any]) -> str:
    """The frames between an aircraft and its ground station."""
    if row["frames_sent"] is None:
        return "–"
    if row.get("station_outside"):
        return f"{row['frames_received']:,} handed over, {row['frames_from_station']:,} from it"
    return f"{row['frames_received']:,} of {row['frames_sent']:,}"


def print_city(console: Console, city: Mapping[str, Any] | None) -> None:
    """Print what was kept and dropped of a file of buildings; nothing for a generated city."""
    from skyrange.city.reading import describe_reading

    if city and city.get("reading"):
        console.print(f"city   {city['source']}", soft_wrap=True, markup=False)
        for line in describe_reading(city["reading"]):
            console.print(f"       {line}", soft_wrap=True, markup=False)


def _print_mission_files(console: Console, files: Sequence[Mapping[str, Any]]) -> None:
    """Print which mission files say something that no flight uses, or had another ground, up to `MAX_FILES`."""
    from skyrange.codec.mission.ignored_keys import describe_mission_file

    incomplete = [
        file
        for file in files
        if "planned_home_above_ground_m" in file or not all(key["harmless"] for key in file["ignored"])
    ]
    for file in incomplete[:MAX_FILES]:
        console.print(f"plan   {describe_mission_file(file)}", soft_wrap=True, markup=False, highlight=False)
    if len(incomplete) > MAX_FILES:
        console.print(f"plan   {len(incomplete) - MAX_FILES} more files; they are in manifest.json")


def print_placing(console: Console, moves: Sequence[Mapping[str, Any]] | None) -> None:
    """Print what `placing = "clear"` moved, the nearest to other aircraft first; nothing if it moved nothing."""
    from skyrange.assembly.placement.moved_places import describe_placing

    lines = describe_placing(moves or ())
    if not lines:
        return
    console.print(f'placed placing = "clear" moved {len(lines)}', soft_wrap=True, markup=False, highlight=False)
    more = [f"{len(lines) - MAX_MOVES} more are in manifest.json, under placing"] if len(lines) > MAX_MOVES else []
    for line in (*lines[:MAX_MOVES], *more):
        console.print(f"       {line}", soft_wrap=True, markup=False, highlight=False)


def _print_operators(console: Console, title: str, rows: Sequence[dict[str, Any]]) -> None:
    """Print one row per operator: number of complete missions, and distances flown."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold")
    for column in ("operator", "aircraft", "complete", "last landed", "flown, mean", "highest"):
        table.add_column(column, justify="left" if column == "operator" else "right")
    for name in dict.fromkeys(row["operator"] for row in rows):
        fleet = [row for row in rows if row["operator"] == name]
        landed = [row["landed_s"] for row in fleet if row["landed_s"] is not None]
        table.add_row(
            name,
            f"{len(fleet):,}",
            f"{sum(row['outcome'] == 'complete' for row in fleet):,}",
            f"{max(landed):.2f} s" if landed else "–",
            _metres(_mean([row["distance_m"] for row in fleet]), 0),
            _metres(max((row["highest_m"] for row in fleet if row["highest_m"] is not None), default=None), 1),
        )
    console.print(table)


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _print_mishaps(console: Console, mishaps: Sequence[dict[str, Any]]) -> None:
    """Print collisions, crashes, fence breaches and failsafes, one per line."""
    from rich.text import Text

    for mishap in mishaps[:MAX_MISHAPS]:
        console.print(Text.assemble(("!", "red"), f" {mishap['words']}"))
    if len(mishaps) > MAX_MISHAPS:
        console.print(Text.assemble(("!", "red"), f" and {len(mishaps) - MAX_MISHAPS} more; the report shows all"))
