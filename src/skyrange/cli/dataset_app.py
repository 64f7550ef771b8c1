"""Declaration of the commands `skyrange dataset`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli import datasets
from skyrange.cli.options import AsJson

dataset_app = typer.Typer(
    help="Build a labelled data set from the runs of a study, and look for leaks in it.\n\n"
    "Example: skyrange dataset build studies/detect detect-data",
    no_args_is_help=True,
)

Dataset = Annotated[Path, typer.Argument(metavar="DATASET", help="The folder of a data set.", show_default=False)]


@dataset_app.command("build", epilog="Example: skyrange dataset build studies/detect detect-data")
def build(
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
    datasets.build(source, out, name, hold_out_family or [], hold_out_city or [], hold_out_fleet or [], as_json)


@dataset_app.command("audit", epilog="Example: skyrange dataset audit detect-data")
def audit(folder: Dataset, as_json: AsJson = False) -> None:
    """Look for leaks: what tells arms apart by metadata, before the onset, or from a sham. Fails if anything does."""
    datasets.audit(folder, as_json)
