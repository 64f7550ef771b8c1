"""The commands `skyrange dataset`."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli.options import AsJson
from skyrange.cli.output.console import print_json, print_notice, print_text, terminal

dataset_app = typer.Typer(
    help="Build a labelled data set from the runs of a study, and look for leaks in it.\n\n"
    "Example: skyrange dataset build studies/detect detect-data",
    no_args_is_help=True,
)

Dataset = Annotated[Path, typer.Argument(metavar="DATASET", help="The folder of a data set.", show_default=False)]


@dataset_app.command("build", epilog="Example: skyrange dataset build studies/detect detect-data")
def build(
    *,
    source: Annotated[
        Path,
        typer.Argument(
            metavar="STUDY|FILE",
            help='The folder of a study with keep = "everything", or a TOML or JSON list of run folders.',
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="A new folder, or that of the same build, which goes on.", show_default=False
        ),
    ],
    name: Annotated[
        str | None, typer.Option(metavar="NAME", help="Name of the data set. Default: that of DIR.", show_default=False)
    ] = None,
    hold_out_family: Annotated[
        list[str] | None,
        typer.Option(metavar="FAMILY", help="Family of attacks to hold out in a split of its own. May be repeated."),
    ] = None,
    hold_out_city: Annotated[
        list[str] | None,
        typer.Option(metavar="CITY", help="City to hold out in a split of its own. May be repeated."),
    ] = None,
    hold_out_fleet: Annotated[
        list[int] | None,
        typer.Option(metavar="N", help="Size of fleets to hold out in a split of its own. May be repeated."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Build a data set: views of all runs with labels, splits by block, metadata and checksums.

    Without an option --hold-out-…, what the study's file holds out is.
    """
    from skyrange.core.files import expand_user
    from skyrange.dataset.build import build_dataset
    from skyrange.dataset.members import SHARES, HeldOut, assign_splits, cluster_members, read_members
    from skyrange.study.dataset_members import list_dataset_members
    from skyrange.study.folder import open_folder
    from skyrange.study.score_tables import check_held_traits, held_out_of

    path, target = expand_user(source), expand_user(out)
    held_out = HeldOut(
        frozenset(hold_out_family or ()), frozenset(hold_out_city or ()), frozenset(hold_out_fleet or ())
    )
    if path.is_dir():
        members, opened = list_dataset_members(path), open_folder(path)
        study = opened.study
        seed = study.first_seed
        check_held_traits(opened, held_out)
        held_out = held_out_of(study) if held_out == HeldOut() else held_out
    else:
        members, seed = read_members(path), 0
    given = [member for member in members if member.split]
    members = [*given, *assign_splits([member for member in members if not member.split], seed, held_out=held_out)]
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


@dataset_app.command("audit", epilog="Example: skyrange dataset audit detect-data")
def audit(*, folder: Dataset, as_json: AsJson = False) -> None:
    """Look for leaks: what tells arms apart by metadata, before the onset, or from a sham. Fails if anything does."""
    from rich.table import Table

    from skyrange.dataset.audit.classifier import require_no_leak
    from skyrange.dataset.audit.comparisons import audit_dataset

    findings = audit_dataset(folder)
    rows = [{"name": finding.name, "status": finding.status, **asdict(finding)} for finding in findings]
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
