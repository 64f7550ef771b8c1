"""Declaration of the commands with their arguments; the library is imported only when a command runs."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli import comparisons as matrices
from skyrange.cli import comparisons as variants
from skyrange.cli import exports, installation, live_app, runs
from skyrange.cli.dataset_app import dataset_app
from skyrange.cli.measurement_app import bench_app, parity_app
from skyrange.cli.options import (
    Arms,
    AsJson,
    Buildings,
    Changes,
    Motion,
    Plugins,
    Qgc,
    RunFolder,
    RunOrPairFolder,
    RunOut,
    ScenarioName,
    Seed,
    ViewerHost,
    ViewerPort,
    complete_scenario,
)
from skyrange.cli.radio_app import radio_app
from skyrange.cli.study_app import study_app
from skyrange.cli.utm_app import utm_app
from skyrange.core.errors import InputError

app = typer.Typer(
    name="skyrange",
    help="A cyber range for unmanned aircraft: run fleets over a city, attack them, and measure the effects.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
install_app = typer.Typer(
    help="Install autopilots, radio engines and Gazebo's plugin in your data folder, and compile kernels.\n\n"
    "Example: skyrange install ardupilot",
    no_args_is_help=True,
)
app.add_typer(live_app.commands)
app.add_typer(bench_app, name="bench")
app.add_typer(dataset_app, name="dataset")
app.add_typer(install_app, name="install")
app.add_typer(parity_app, name="parity")
app.add_typer(radio_app, name="radio")
app.add_typer(study_app, name="study")
app.add_typer(utm_app, name="utm")


def _version(wanted: bool) -> None:
    if wanted:
        from skyrange import __version__
        from skyrange.cli.output.console import print_text

        print_text(f"skyrange {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Run fleets of unmanned aircraft over a city, attack them, and measure the effects."""


@app.command(epilog="Example: skyrange run squares --seed 7 --set 'operators.*.vehicles.*.plan.square.alt_m=8'")
def run(
    scenario: ScenarioName,
    out: RunOut = None,
    seed: Seed = None,
    speed: Annotated[
        float | None,
        typer.Option(
            metavar="X",
            min=0.0,
            help="Simulated seconds per second of wall time; 0 is as fast as possible. Default: 0, or 1 with --qgc.",
        ),
    ] = None,
    buildings: Buildings = None,
    changes: Changes = None,
    qgc: Qgc = False,
    viewer_port: ViewerPort = None,
    viewer_host: ViewerHost = "127.0.0.1",
    allow_motion: Motion = False,
    cores: Annotated[
        int,
        typer.Option(
            metavar="N",
            min=1,
            help="Processor cores for the run: its operators are divided among them, with the same result.",
        ),
    ] = 1,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Run a scenario and write a run folder with a report."""
    runs.load_plugins(plugin)
    given = changes or []
    runs.run(scenario, out, seed, speed, buildings, given, qgc, viewer_port, viewer_host, allow_motion, cores, as_json)


@app.command(epilog="Example: skyrange pair attacked.toml --seeds 5 --out runs/study")
def pair(
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="NAME|FILE",
            help="Name of a shipped scenario or a TOML file, with at least one attack or fault that is not muted.",
            autocompletion=complete_scenario,
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the pair, empty or new. Default: runs/NAME-pair, then -2 …"),
    ] = None,
    arms: Annotated[
        Arms | None,
        typer.Option(
            metavar="WHICH",
            help="The runs to compare: nominal, with all attacks and with all muted; baseline, with all and with their "
            "shams, or muted where they have none; sham, all three; each, also each attack alone and each left out; "
            "subsets, every subset of the attacks. Default: subsets with up to four attacks, else each.",
        ),
    ] = None,
    seeds: Annotated[
        int,
        typer.Option(
            metavar="K",
            min=1,
            help="Repeat with K seeds, and compute means and 95 % confidence intervals of the effects.",
        ),
    ] = 1,
    honest: Annotated[
        bool,
        typer.Option(
            "--honest",
            help="Add a run in which a real aircraft flies where an attack claims that one is, and sends the same "
            "bytes at the same times; compare what the others do about the lie and about the truth.",
        ),
    ] = False,
    jobs: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Number of parallel runs, one process each. Default: one per core."),
    ] = None,
    seed: Annotated[int | None, typer.Option(metavar="N", help="The first seed; overrides the scenario's.")] = None,
    buildings: Buildings = None,
    changes: Changes = None,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Run a scenario with and without its attacks and faults, compare the runs, and name what caused each effect."""
    runs.load_plugins(plugin)
    runs.pair(
        scenario,
        out,
        arms.value if arms is not None else None,
        honest,
        seeds,
        jobs,
        seed,
        buildings,
        changes or [],
        as_json,
    )


@app.command(
    epilog='Example: skyrange compare corridor-rush --variant "federated:operators.*.approval=federated" --seeds 5'
)
def compare(
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="NAME|FILE",
            help="Name of a shipped scenario or a TOML file.",
            autocompletion=complete_scenario,
            show_default=False,
        ),
    ],
    variant: Annotated[
        list[str],
        typer.Option(
            metavar="NAME:PATH=VALUE",
            help="A variant, and a value of the scenario that it changes; * in the path matches all elements. May be "
            "repeated; a name that is repeated changes another value.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the runs, empty or new. Default: runs/NAME-comparison, then -2 …"),
    ] = None,
    seeds: Annotated[
        int,
        typer.Option(metavar="K", min=1, help="Repeat with K seeds, and compute means and 95 % confidence intervals."),
    ] = 1,
    jobs: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Number of parallel runs, one process each. Default: one per core."),
    ] = None,
    seed: Annotated[int | None, typer.Option(metavar="N", help="The first seed; overrides the scenario's.")] = None,
    buildings: Buildings = None,
    changes: Changes = None,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Run a scenario and variants of it with the same seeds, and compare missions, separation, approvals and delays."""
    runs.load_plugins(plugin)
    variants.compare(scenario, variant, out, seeds, jobs, seed, buildings, changes or [], as_json)


@app.command(epilog="Example: skyrange show runs/squares")
def show(run: RunOrPairFolder, as_json: AsJson = False) -> None:
    """Summarise a run or a pair. Killed and unfinished runs are accepted too."""
    runs.show(run, as_json)


@app.command(epilog="Example: skyrange report runs/squares --out squares.html")
def report(
    run: RunOrPairFolder,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The file to write. Default: report.html in the folder.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write the HTML report of a run or a pair, one file that can be read offline."""
    runs.report(run, out, as_json)


class Kind(StrEnum):
    """Kinds of capture that can be exported from a run."""

    REMOTE_ID = "remote_id"
    MAVLINK = "mavlink"


@app.command(epilog="Example: skyrange export runs/rid-spoofing --only remote_id --receiver green/g1")
def export(
    run: RunFolder,
    only: Annotated[
        Kind | None,
        typer.Option(metavar="KIND", help="remote_id or mavlink. Default: both, or mavlink if the run has no radio."),
    ] = None,
    receiver: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Export only the Remote ID that this receiver decoded: a vehicle, a ground receiver or an attack. "
            "May be repeated. Default: all receivers.",
        ),
    ] = None,
    csv: Annotated[
        bool, typer.Option("--csv", help="Write a CSV file of what each operator's ground station received instead.")
    ] = False,
    tlog: Annotated[
        bool, typer.Option("--tlog", help="Write tlogs of what each ground station received and sent instead.")
    ] = False,
    mcap: Annotated[
        bool,
        typer.Option(
            "--mcap", help="Write run.mcap for Foxglove or Lichtblick instead: poses, scene, logs, positions."
        ),
    ] = False,
    kml: Annotated[
        bool, typer.Option("--kml", help="Write tracks.kml for globes instead: the true track of each aircraft.")
    ] = False,
    tables: Annotated[
        bool, typer.Option("--tables", help="Write a CSV file of each recorded table to the folder tables instead.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="An existing folder to write to. Default: the run's folder.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write captures for Wireshark: remote_id.pcapng with received broadcasts, mavlink.pcapng with the gcs links. Or
    write files for other tools: CSV files, tlogs, MCAP and KML.
    """
    options = {"--csv": csv, "--tlog": tlog, "--mcap": mcap, "--kml": kml, "--tables": tables}
    chosen = [option for option, wanted in options.items() if wanted]
    if chosen:
        if only is not None or receiver:
            hint = "Captures and other files are written by two commands."
            raise InputError.one("export", ", ".join(chosen), "with --only or --receiver", "one of both", hint)
        exports.export_files(run, [option.removeprefix("--") for option in chosen], out, as_json)
        return
    exports.export_captures(run, only.value if only is not None else None, receiver or [], out, as_json)


@app.command(epilog="Example: skyrange diff runs/squares runs/squares-2")
def diff(
    a: Annotated[Path, typer.Argument(metavar="A", help="A run's folder.", show_default=False)],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another run's folder.", show_default=False)],
    tolerance: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Compare decisions, events, outcomes and paths, with this tolerance for times. For live runs, which "
            "do not repeat to the byte. Default: every row must be the same.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare two runs: first frame and first row of truth that differ, then a summary. The exit code is always 0."""
    runs.diff(a, b, tolerance, as_json)


@app.command(epilog="Example: skyrange matrix --column firewall --seeds 2 --out runs/firewall")
def matrix(
    file: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE]", help="Matrix file. Default: the shipped matrix.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the matrix, empty or new. Default: runs/NAME, then -2 …"),
    ] = None,
    row: Annotated[
        list[str] | None, typer.Option(metavar="ID", help="Fly this row alone. May be repeated.", show_default=False)
    ] = None,
    column: Annotated[
        list[str] | None, typer.Option(metavar="ID", help="Fly this column alone. May be repeated.", show_default=False)
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(metavar="K", min=1, help="Number of seeds of each cell; overrides the file's.")
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Number of cells flown at once. Default: one per core."),
    ] = None,
    page: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the page in Markdown here too, and its figure beside it."),
    ] = None,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Fly every attack against every defence: effects, times to alarm, false alarms, costs. Each cell is a pair."""
    runs.load_plugins(plugin)
    matrices.matrix(file, out, row or [], column or [], seeds, jobs, page, as_json)


@app.command(epilog="Example: skyrange verify runs/squares")
def verify(run: RunFolder, as_json: AsJson = False) -> None:
    """Compare a run's files and tables with its manifest: hashes, counts, digests. The exit code is 3 if any differ."""
    runs.verify(run, as_json)


@app.command(epilog="Example: skyrange scenarios --json")
def scenarios(as_json: AsJson = False) -> None:
    """List the shipped scenarios."""
    runs.scenarios(as_json)


@app.command(epilog="Example: skyrange attacks --plugin lag.py")
def attacks(plugin: Plugins = None, as_json: AsJson = False) -> None:
    """List the installed kinds of attacks with a description of each."""
    runs.load_plugins(plugin)
    runs.attacks(as_json)


@app.command(epilog="Example: skyrange faults --json")
def faults(plugin: Plugins = None, as_json: AsJson = False) -> None:
    """List the installed kinds of benign faults with a description of each."""
    runs.load_plugins(plugin)
    runs.faults(as_json)


@app.command(epilog="Example: skyrange defences --json")
def defences(plugin: Plugins = None, as_json: AsJson = False) -> None:
    """List the installed kinds of defences with a description of each."""
    runs.load_plugins(plugin)
    runs.defences(as_json)


@app.command(epilog="Example: skyrange schema > scenario.schema.json")
def schema(plugin: Plugins = None) -> None:
    """Print the JSON Schema of a scenario, with the meaning, unit and range of every key."""
    runs.load_plugins(plugin)
    runs.schema()


@app.command(epilog="Example: skyrange doctor --json")
def doctor(
    compiling: Annotated[
        bool,
        typer.Option(
            "--compile/--no-compile",
            help="Compile missing kernels and fly for one second, or with --no-compile only look.",
        ),
    ] = True,
    as_json: AsJson = False,
) -> None:
    """Check this installation, report what is missing, and compile the numeric kernels."""
    installation.doctor(compiling, as_json)


@install_app.callback()
def _install() -> None:
    """Install autopilots, radio engines and Gazebo's plugin in your data folder, and compile kernels."""


@install_app.command(epilog="Example: skyrange install ardupilot --version 4.6.3")
def ardupilot(
    version: Annotated[
        str | None,
        typer.Option(
            metavar="V",
            help="Release to download, or required version of FILE. Default: 4.7.0, or any version with --from.",
        ),
    ] = None,
    source: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="Install this arducopter SITL binary instead; needs no network."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Install ArduPilot's official SITL binary of ArduCopter in your data folder, and check that it runs."""
    installation.install_ardupilot(version, source, as_json)


@install_app.command(epilog="Example: skyrange install gazebo --prefix /opt/gazebo")
def gazebo(
    prefix: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder in which Gazebo is installed, with bin/gz or bin/gzserver. Default: that of the variable "
            "SKYRANGE_GAZEBO, else that on PATH.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compile the plugin for Gazebo in your data folder, and check that Gazebo loads it."""
    installation.install_gazebo(prefix, as_json)


@install_app.command(epilog="Example: skyrange install kernels")
def kernels(
    jobs: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Processes at once. Default: the number of cores.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compile the numeric kernels that flights use, so that no flight has to."""
    installation.install_kernels(jobs, as_json)


@install_app.command(epilog="Example: skyrange install ns3")
def ns3(
    prefix: Annotated[
        Path | None,
        typer.Option(
            "--ns3",
            metavar="DIR",
            help="Folder in which ns-3 is installed. Default: the Python package ns3, else the system's ns-3.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compile the radio engine of ns-3 in your data folder, and check that it runs."""
    installation.install_ns3(prefix, as_json)


@install_app.command(epilog="Example: skyrange install omnetpp --omnetpp ~/omnetpp-6.1 --inet ~/inet4.5")
def omnetpp(
    omnetpp: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder in which OMNeT++ was built. Default: that whose setenv was sourced."),
    ] = None,
    inet: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder in which INET was built. Default: that whose setenv was sourced."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compile the radio engine of OMNeT++ and INET in your data folder, and check that it runs."""
    installation.install_omnetpp(omnetpp, inet, as_json)
