"""Result of a pair on the terminal: the aircraft that departed from the twin, and means over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from skyrange.cli.output.console import terminal
from skyrange.cli.output.run_summary import MAX_AIRCRAFT, print_city, print_placing
from skyrange.cli.output.warnings import print_failed_missions
from skyrange.twins.lie_and_truth import REACTIONS, format_values, reacts, truth_name

if TYPE_CHECKING:
    from rich.console import Console

    from skyrange.twins.pair_folder import Pair


def print_pair(result: Pair) -> None:
    """Print the aircraft that departed from the twin, and means over seeds if there are several; first the missions
    that failed without an attack.
    """
    from rich.table import Table

    from skyrange.twins.attribution import unknown_subsets
    from skyrange.twins.verdict import describe_losses

    console = terminal()
    print_failed_missions(console, map(str, result.failed_missions))
    rows = [row for row in result.effects.to_pylist() if row["against"] == result.reference]
    departed = [row for row in rows if row["seed"] == result.seeds[0] and row["departed_s"] is not None]
    table = Table(
        title=f"{result.manifest['name']}: attacked against {result.reference}, seed {result.seeds[0]}",
        title_justify="left", title_style="bold",
    )  # fmt: skip
    for column in ("aircraft", "mission", "departs", "by", "delay", "distance", "energy"):
        left = column in ("aircraft", "mission")
        table.add_column(column, justify="left" if left else "right", no_wrap=True)
    for row in sorted(departed, key=lambda row: -row["departure_m"])[:MAX_AIRCRAFT]:
        table.add_row(
            row["vehicle"],
            row["outcome"],
            f"{row['departed_s']:.1f} s",
            f"{row['departure_m']:.1f} m",
            "–" if row["delay_s"] is None else f"{row['delay_s']:+.2f} s",
            f"{row['extra_distance_m']:+.1f} m",
            "–" if row["extra_energy_j"] is None else f"{row['extra_energy_j'] / 1000.0:+.2f} kJ",
        )
    first_seed = [row for row in rows if row["seed"] == result.seeds[0]]
    if losses := describe_losses(first_seed):
        console.print(losses, markup=False)
    if departed:
        console.print(table)
    else:
        threshold_m = result.manifest["threshold_m"]
        console.print(f"no aircraft was farther than {threshold_m:g} m from its position in the twin")
    for cause, vehicles in _causes(departed).items():
        shown = ", ".join(vehicles[:MAX_AIRCRAFT]) + (" …" if len(vehicles) > MAX_AIRCRAFT else "")
        console.print(f"{cause}: {shown}", markup=False)
    for row in first_seed:
        if row["outcome"] != row["outcome_twin"]:
            console.print(f"{row['vehicle']}: {row['outcome_twin']} in the twin, {row['outcome']} attacked")
        for mishap in ("near_misses", "collisions"):
            if row[mishap] != row[f"{mishap}_twin"]:
                text = mishap.replace("_", " ")
                console.print(f"{row['vehicle']}: {row[f'{mishap}_twin']} {text} in the twin, {row[mishap]} attacked")
    _print_lie_and_truth(console, result)
    if len(result.seeds) > 1:
        _print_intervals(console, result, {row["vehicle"] for row in rows if row["departed_s"] is not None})
    unknown = unknown_subsets(result.manifest["active"])
    if unknown:
        console.print(f"{unknown} combinations of attacks were not run; effects that need one are unknown (--arms)")
    _print_defences(console, result)
    manifest = result.run(result.reference, result.seeds[0]).manifest
    print_city(console, manifest.get("city"))
    print_placing(console, manifest.get("placing"))
    acts = [row for row in result.propagation.to_pylist() if row["phase"] in ("onset", "act")]
    of_faults = sum(bool(row["fault"]) for row in acts)
    where = f"labelled in {len(result.seeds)} attacked run{'s' * (len(result.seeds) > 1)}"
    if len(acts) > of_faults or not result.faults:
        console.print(f"{len(acts) - of_faults:,} hostile acts {where}")
    if result.faults:
        console.print(f"{of_faults:,} acts of faults {where}")
    console.print(f"pair   {result.path}", soft_wrap=True)
    console.print(f"report {result.report}", soft_wrap=True)


def _print_defences(console: Console, result: Pair) -> None:
    """Print what each defence did in the attacked run of the first seed, and its alarms in the twin."""
    from skyrange.metrics.defences import read_defences

    seed = result.seeds[0]
    false_alarms = {defence.id: defence.alarms for defence in read_defences(result.run(result.twin, seed))}
    for defence in read_defences(result.run("attacked", seed)):
        acts = ", ".join(f"{count} {action}" for action, count in sorted(defence.acts.items())) or "no act"
        first = "" if defence.first_alarm_s is None else f", the first at {defence.first_alarm_s:.2f} s"
        twin = f"{false_alarms.get(defence.id, 0)} in the {result.twin} run"
        console.print(f"defence {defence.id}: {acts}; {defence.alarms} alarms{first}; {twin}", markup=False)


def _print_lie_and_truth(console: Console, result: Pair) -> None:
    """Print what aircraft did about the lie and about the truth, of the first seed, if the honest arm was flown."""
    from rich.table import Table

    rows = [row for row in result.lie_and_truth.to_pylist() if row["seed"] == result.seeds[0]]
    shown = [row for row in rows if reacts(row)]
    if not rows:
        return
    if not shown:
        console.print("no aircraft reacted to the claimed aircraft, nor to a real one in its place")
        return
    table = Table(
        title=f"lie against truth: the claimed aircraft, and a real one in its place, seed {result.seeds[0]}",
        title_justify="left", title_style="bold",
    )  # fmt: skip
    for column in ("aircraft", "", "lie", "truth"):
        table.add_column(column, justify="right" if column in ("lie", "truth") else "left", no_wrap=True)
    for row in sorted(shown, key=lambda row: -max(row["departure_m"], row[truth_name("departure_m")]))[:MAX_AIRCRAFT]:
        for number, reaction in enumerate(REACTIONS):
            table.add_row("" if number else row["vehicle"], reaction.title, *format_values(row, reaction))
    console.print(table)


def _causes(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[str]]:
    """The aircraft of these rows by what caused their effect."""
    vehicles: dict[str, list[str]] = {}
    for row in rows:
        authors = [*row["attacks"], *(f"fault {fault}" for fault in row["faults"])]
        vehicles.setdefault(_describe_cause(row["attribution"], authors), []).append(row["vehicle"])
    return vehicles


def _describe_cause(attribution: str | None, authors: Sequence[str]) -> str:
    names = " and ".join(authors)
    if attribution in (None, "none"):
        return "no attack or fault is the cause"
    if attribution == "unknown":
        return "the cause is unknown, because the runs without the attacks were not made"
    if attribution == "not enough placebos":
        from skyrange.twins.effects import CLAIM_PLACEBOS, ENOUGH_PLACEBOS

        enough = f"{ENOUGH_PLACEBOS} placebos, and a claim {CLAIM_PLACEBOS}"
        return f"not shown to be an effect, which takes {enough} (more --seeds)"
    if attribution == "both":
        return f"caused by {names}, necessary and sufficient"
    return f"caused by {names}, {attribution}"


def _print_intervals(console: Console, result: Pair, affected: set[str]) -> None:
    """Print means over seeds with their 95 % confidence intervals."""
    for vehicle, intervals in result.intervals().items():
        if vehicle not in affected:
            continue
        text = [
            f"{key} {interval.mean:+.2f} "
            + (f"({interval.without})" if interval.low is None else f"[{interval.low:+.2f}, {interval.high:+.2f}]")
            for key, interval in intervals.items()
            if interval.mean or interval.low is not None
        ]
        console.print(f"{vehicle}, mean of {len(result.seeds)} seeds, 95 %: {'; '.join(text)}")
