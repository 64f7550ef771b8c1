"""Declaration of the commands `skyrange study`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli import studies
from skyrange.cli.options import AsJson, Plugins

study_app = typer.Typer(
    help="Fly many runs of a scenario, by factors, arms and seeds, and measure them.\n\n"
    "Example: skyrange study run study.toml",
    no_args_is_help=True,
)

StudyFile = Annotated[
    Path,
    typer.Argument(
        metavar="NAME|FILE", help="Name of a shipped study (detectors), or a TOML file.", show_default=False
    ),
]
Folder = Annotated[Path, typer.Argument(metavar="STUDY", help="The folder of a study.", show_default=False)]
Jobs = Annotated[
    int | None, typer.Option(metavar="N", min=1, help="Runs at a time. Default: one for each CPU.", show_default=False)
]
Changes = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="PATH=VALUE",
        help="Change a value of the study's file, such as seeds=2 or factors.size.values=[1,2]; * in the path matches "
        "all elements. May be repeated.",
    ),
]
On = Annotated[
    str | None,
    typer.Option(
        "--on",
        metavar="ADDRESS",
        help="Fly on a Ray cluster: auto, local or ray://HOST:PORT. Its nodes must see the folder of the study, or "
        "--storage.",
        show_default=False,
    ),
]
Storage = Annotated[
    str | None,
    typer.Option(
        "--storage",
        metavar="URL",
        help="Storage through which the nodes of a cluster return what they flew, if they do not see the folder of the "
        "study: a URL that fsspec knows, such as s3://bucket/drift.",
        show_default=False,
    ),
]


@study_app.command("run", epilog="Example: skyrange study run study.toml --dry-run")
def run_study(
    file: StudyFile,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the study. Default: studies/NAME.", show_default=False)
    ] = None,
    changes: Changes = None,
    jobs: Jobs = None,
    on: On = None,
    storage: Storage = None,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Check all scenarios, fly one block as a trial, and estimate time and disk."),
    ] = False,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Fly a study: every point of its design with every seed in every arm. A study that was begun is continued."""
    studies.run(file, out, changes or [], jobs, on, storage, dry_run, as_json)


@study_app.command("register", epilog="Example: skyrange study register study.toml")
def register_study(
    file: StudyFile,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the study. Default: studies/NAME.", show_default=False)
    ] = None,
    changes: Changes = None,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Register a study before its flights: its question, measures and rule, with a hash to publish.

    The report of the study says what was registered; all else is exploratory.
    """
    studies.register(file, out, changes or [], as_json)


@study_app.command("resume", epilog="Example: skyrange study resume studies/drift")
def resume_study(
    folder: Folder,
    jobs: Jobs = None,
    on: On = None,
    storage: Storage = None,
    other_version: Annotated[
        bool,
        typer.Option("--other-version", help="Go on with another version of skyrange than the one that began it."),
    ] = False,
    retry: Annotated[bool, typer.Option("--retry", help="Also fly the blocks with failed runs again.")] = False,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Fly the blocks of a study that are not finished."""
    studies.resume(folder, jobs, on, storage, other_version, retry, as_json)


@study_app.command("status", epilog="Example: skyrange study status studies/drift")
def show_status(folder: Folder, as_json: AsJson = False) -> None:
    """Print how many blocks of a study are finished, and which runs failed."""
    studies.status(folder, as_json)


@study_app.command("show", epilog="Example: skyrange study show studies/drift")
def show_study(folder: Folder, as_json: AsJson = False) -> None:
    """Print what each arm measured at each point: means over the seeds, with 95 % confidence intervals."""
    studies.show(folder, as_json)


@study_app.command("report", epilog="Example: skyrange study report studies/drift")
def report_study(
    folder: Folder,
    pdf: Annotated[bool, typer.Option("--pdf", help="Write the figures as PDF as well, for papers.")] = False,
) -> None:
    """Write report.html: effects with intervals, dose-response curves, interactions, failures; and figures as SVG."""
    studies.report(folder, pdf)


@study_app.command("score", epilog="Example: skyrange study score studies/detect --hold-out-family gnss_denial")
def score_study(
    folder: Folder,
    rate: Annotated[
        float,
        typer.Option(metavar="N", min=1e-6, help="False alarms per aircraft-hour to choose thresholds for."),
    ] = 1.0,
    hold_out_family: Annotated[
        list[str] | None,
        typer.Option(metavar="FAMILY", help="Family of attacks that only the test split has. May be repeated."),
    ] = None,
    hold_out_city: Annotated[
        list[str] | None, typer.Option(metavar="CITY", help="City that only the test split has. May be repeated.")
    ] = None,
    hold_out_fleet: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=1, help="Number of aircraft that only the test split has. May be repeated."),
    ] = None,
    beside: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Result file of others to put beside these. May be repeated."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Result file. Default: scores.json in the folder of the study.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Score the detectors of a study, print a leaderboard, and write the result file.

    Options --hold-out-… replace all that the study's file holds out.
    """
    held = hold_out_family or [], hold_out_city or [], hold_out_fleet or []
    studies.score(folder, rate, *held, beside or [], out, as_json)
