"""Handlers of the commands `skyrange dataset`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from skyrange.cli.output.console import print_json, print_notice, print_text, terminal


def build(
    source: Path,
    out: Path,
    name: str | None,
    families: Sequence[str],
    cities: Sequence[str],
    fleets: Sequence[int],
    as_json: bool,
) -> None:
    """`skyrange dataset build`."""
    from skyrange.core.files import expand_user
    from skyrange.dataset.build import build_dataset
    from skyrange.dataset.members import read_members
    from skyrange.dataset.splits import SHARES, HeldOut, assign_splits, cluster_members
    from skyrange.study.sweep.dataset_members import list_dataset_members
    from skyrange.study.sweep.folder import open_folder
    from skyrange.study.sweep.scores.score_tables import check_held_traits, held_out_of

    path, target = expand_user(source), expand_user(out)
    held = HeldOut(frozenset(families), frozenset(cities), frozenset(fleets))
    if path.is_dir():
        members, opened = list_dataset_members(path), open_folder(path)
        study = opened.study
        seed = study.first_seed
        check_held_traits(opened, held)
        held = held_out_of(study) if held == HeldOut() else held
    else:
        members, seed = read_members(path), 0
    given = [member for member in members if member.split]
    members = [*given, *assign_splits([member for member in members if not member.split], seed, held_out=held)]
    clusters = len(set(cluster_members(members).values()))
    if empty := [split for split in SHARES if split not in {member.split for member in members}]:
        hint = "fly more seeds, or each block with a seed of its own (shared_seeds = false)"
        why = f"blocks that share a seed go together, and make {clusters} clusters"
        print_notice(f"no run is in {', '.join(empty)}, because {why}: {hint}")
    folder = build_dataset(members, target, name or target.name)
    splits = Counter(member.split for member in members)
    if as_json:
        print_json({"dataset": str(folder), "runs": len(members), "splits": dict(splits)})
        return
    counts = ", ".join(f"{split} {count}" for split, count in sorted(splits.items()))
    print_text(f"dataset {folder}: {len(members)} runs ({counts})")
    print_text(f"to look for leaks: skyrange dataset audit {folder}")


def audit(folder: Path, as_json: bool) -> None:
    """`skyrange dataset audit`."""
    from rich.table import Table

    from skyrange.dataset.audit.classifier import require_no_leak
    from skyrange.dataset.audit.comparisons import audit_dataset

    findings = audit_dataset(folder)
    rows = [{"name": one.name, "status": one.status, **asdict(one)} for one in findings]
    if as_json:
        print_json(rows)
    else:
        table = Table(title=folder.name, title_justify="left", title_style="bold")
        for head in rows[0]:
            table.add_column(head)
        for row in rows:
            table.add_row(*(_text(value) for value in row.values()))
        terminal().print(table)
    require_no_leak(findings)


def _text(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.3g}"
    return ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
