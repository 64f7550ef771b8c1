"""All commands: declarations of those that fly, compare and read runs, and the groups of the others."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli import (
    benchmark_suite,
    catalogue,
    comparisons,
    exports,
    fleet_benchmarks,
    flightlogs,
    installation,
    live,
    log_detection,
    part_benchmarks,
    runs,
    watching,
)
from skyrange.cli.datasets import dataset_app
from skyrange.cli.installation import install_app
from skyrange.cli.options import (
    Arms,
    AsJson,
    Buildings,
    Certificate,
    CertificateKey,
    Changes,
    Control,
    Jobs,
    MaxRuns,
    Motion,
    On,
    OtherVersion,
    Plugins,
    Qgc,
    RunFolder,
    RunOrPairFolder,
    RunOut,
    ScenarioChoice,
    ScenarioName,
    Seed,
    View,
    ViewerHost,
    ViewerOptions,
    ViewerPort,
    ViewHost,
    ViewPort,
    Workers,
    complete_scenario,
    load_plugins,
)
from skyrange.cli.parity import parity_app
from skyrange.cli.radio import radio_app
from skyrange.cli.studies import study_app
from skyrange.cli.utm import utm_app
from skyrange.core.errors import InputError

app = typer.Typer(
    name="skyrange",
    help="A cyber range for unmanned aircraft: run fleets over a city, attack them, and measure the effects.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(*, wanted: bool) -> None:
    if wanted:
        from skyrange import __version__
        from skyrange.cli.output.console import print_text

        print_text(f"skyrange {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    *,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Run fleets of unmanned aircraft over a city, attack them, and measure the effects."""


@app.command(epilog="Example: skyrange run squares --seed 7 --set 'operators.*.vehicles.*.plan.square.alt_m=8'")
def run(
    *,
    scenario: ScenarioName,
    out: RunOut = None,
    seed: Seed = None,
    speed: Annotated[
        float | None,
        typer.Option(
            metavar="X",
            min=0.0,
            help="Simulated seconds per second of wall time; 0 is as fast as possible. Default: 0, or 1 with --qgc or "
            "--control.",
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
    view: View = False,
    view_host: ViewHost = "127.0.0.1",
    view_port: ViewPort = 0,
    certificate: Certificate = None,
    key: CertificateKey = None,
    control: Control = False,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Run a scenario and write a run folder with a report."""
    load_plugins(plugin)
    options = runs.RunOptions(
        scenario=ScenarioChoice(scenario, seed=seed, buildings=buildings, changes=changes or ()),
        out=out,
        speed=speed,
        viewers=ViewerOptions(wanted=qgc or viewer_port is not None, first_port=viewer_port, host=viewer_host),
        allow_motion=allow_motion,
        cores=cores,
        view=view,
        view_at=watching.ViewAddress(view_host, view_port, certificate, key),
        control=control,
    )
    runs.run(options, as_json=as_json)


@app.command(epilog="Example: skyrange pair attacked.toml --seeds 5 --out runs/study")
def pair(
    *,
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
        typer.Option(
            metavar="DIR",
            help="Folder of the pair: empty, new, or one to go on with. Default: runs/NAME-pair, then -2 …",
        ),
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
    max_runs: MaxRuns = 1_000_000,
    jobs: Jobs = None,
    on: On = None,
    seed: Annotated[int | None, typer.Option(metavar="N", help="The first seed; overrides the scenario's.")] = None,
    buildings: Buildings = None,
    changes: Changes = None,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Run a scenario with and without its attacks and faults, compare the runs, and name what caused each effect."""
    load_plugins(plugin)
    options = comparisons.PairOptions(
        scenario=ScenarioChoice(scenario, seed=seed, buildings=buildings, changes=changes or ()),
        out=out,
        arms=arms.value if arms is not None else None,
        honest=honest,
        seeds=seeds,
        workers=Workers(jobs, on),
        max_runs=max_runs,
    )
    comparisons.pair(options, as_json=as_json)


@app.command(
    epilog='Example: skyrange compare corridor-rush --variant "federated:operators.*.approval=federated" --seeds 5'
)
def compare(
    *,
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
        typer.Option(
            metavar="DIR",
            help="Folder of the runs: empty, new, or one to go on with. Default: runs/NAME-comparison, then -2 …",
        ),
    ] = None,
    seeds: Annotated[
        int,
        typer.Option(metavar="K", min=1, help="Repeat with K seeds, and compute means and 95 % confidence intervals."),
    ] = 1,
    max_runs: MaxRuns = 1_000_000,
    jobs: Jobs = None,
    on: On = None,
    seed: Annotated[int | None, typer.Option(metavar="N", help="The first seed; overrides the scenario's.")] = None,
    buildings: Buildings = None,
    changes: Changes = None,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Run a scenario and variants of it with the same seeds, and compare missions, separation, approvals and delays."""
    load_plugins(plugin)
    options = comparisons.VariantOptions(
        scenario=ScenarioChoice(scenario, seed=seed, buildings=buildings, changes=changes or ()),
        variants=variant,
        out=out,
        seeds=seeds,
        workers=Workers(jobs, on),
        max_runs=max_runs,
    )
    comparisons.compare(options, as_json=as_json)


@app.command(epilog="Example: skyrange resume runs/defences")
def resume(
    *,
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="The folder of a pair, a comparison, a matrix, a study, or of parity log."
        ),
    ],
    jobs: Jobs = None,
    on: On = None,
    other_version: OtherVersion = False,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Go on with a pair, a comparison, a matrix or a study that was interrupted: fly the runs that are not finished."""
    load_plugins(plugin)
    comparisons.resume(folder, Workers(jobs, on), other_version=other_version, as_json=as_json)


@app.command(epilog="Example: skyrange show runs/squares")
def show(*, run: RunOrPairFolder, as_json: AsJson = False) -> None:
    """Summarise a run or a pair. Killed and unfinished runs are accepted too."""
    runs.show(run, as_json=as_json)


@app.command(epilog="Example: skyrange report runs/squares --out squares.html")
def report(
    *,
    run: RunOrPairFolder,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The file to write. Default: report.html in the folder.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write the HTML report of a run or a pair, one file that can be read offline."""
    runs.report(run, out, as_json=as_json)


@app.command(epilog="Example: skyrange watch runs/rid-spoofing")
def watch(
    *,
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="The folder of a run, a pair, a comparison, a matrix or a study.", show_default=False
        ),
    ],
    run: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Of a study, the runs of this point or block (p0003, p0003-s7); of a matrix, of this cell "
            "(ROW/COLUMN); of a comparison, of this variant. Default: the first.",
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option(metavar="N", help="The runs of this seed. Default: the first.")] = None,
    time: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            min=0.0,
            help="Open at this time of the flight. Default: before the first departure from a twin, or the start.",
        ),
    ] = None,
    host: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS",
            help="IP address at which the page is served. One of a network needs --certificate and --key.",
        ),
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(metavar="PORT", min=0, max=65_535, help="TCP port of this machine; 0 takes a free one.")
    ] = 0,
    certificate: Certificate = None,
    key: CertificateKey = None,
    browser: Annotated[
        bool,
        typer.Option(help="Open the page in a browser, besides printing its address, if it is for this machine alone."),
    ] = True,
) -> None:
    """Show runs in a browser: truth, beliefs, claims and events on one clock, of several arms together.

    Runs of a study, a comparison or a matrix that were not kept are flown again. A run that flies is followed.
    """
    at = watching.ViewAddress(host, port, certificate, key)
    watching.watch(watching.WatchOptions(folder, run, seed, at, browser, time))


class Kind(StrEnum):
    """Kinds of capture that can be exported from a run."""

    REMOTE_ID = "remote_id"
    MAVLINK = "mavlink"


@app.command(epilog="Example: skyrange export runs/rid-spoofing --only remote_id --receiver green/g1")
def export(
    *,
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
    dataflash: Annotated[
        bool,
        typer.Option(
            "--dataflash", help="Write an ArduPilot DataFlash log (.BIN) of each aircraft to the folder logs instead."
        ),
    ] = False,
    labels: Annotated[
        bool, typer.Option("--labels", help="With --dataflash: log hostile acts and faults too, which no real log has.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="An existing folder to write to. Default: the run's folder.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write captures for Wireshark: remote_id.pcapng with received broadcasts, mavlink.pcapng with the gcs links. Or
    write files for other tools: CSV files, tlogs, MCAP, KML and DataFlash logs.
    """
    options = {
        "--csv": csv, "--tlog": tlog, "--mcap": mcap, "--kml": kml, "--tables": tables, "--dataflash": dataflash,
    }  # fmt: skip
    if labels and not dataflash:
        raise InputError.one("export", "--labels", "without --dataflash", "--dataflash --labels")
    chosen = [option for option, wanted in options.items() if wanted]
    if chosen:
        if only is not None or receiver:
            hint = "Captures and other files are written by two commands."
            raise InputError.one("export", ", ".join(chosen), "with --only or --receiver", "one of both", hint)
        kinds = [option.removeprefix("--") for option in chosen]
        exports.export_files(run, kinds, out, as_json=as_json, with_labels=labels)
        return
    exports.export_captures(run, only.value if only is not None else None, receiver or [], out, as_json=as_json)


@app.command("import", epilog="Example: skyrange import flight.tlog --out my-flight")
def import_(
    *,
    flight: Annotated[
        Path,
        typer.Argument(
            metavar="LOG",
            help="A telemetry log (.tlog), a DataFlash log of ArduPilot (.BIN), a ULog of PX4 (.ulg), or the folder of "
            "a run.",
            show_default=False,
        ),
    ],
    number: Annotated[
        int | None,
        typer.Option("--flight", metavar="N", help="Which flight of the log, from 1 on. Default: the longest."),
    ] = None,
    system: Annotated[
        int | None,
        typer.Option(metavar="ID", help="MAVLink system id of the vehicle. Default: the one with the most frames."),
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option(metavar="ID", help="Vehicle of a run, such as blue/b1. Default: its first.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="A new or an empty folder. Default: the log's name and N.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Make a scenario of a real flight from its log, and a page that says what was taken, estimated, assumed and
    ignored.
    """
    flightlogs.import_flight(flight, number, system, vehicle, out, as_json=as_json)


class LogEnd(StrEnum):
    """The end of its links at which a log was made."""

    GCS = "gcs"
    COMPANION = "companion"


@app.command(epilog="Example: skyrange detect flight.tlog --benign --out alerts")
def detect(
    *,
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG",
            help="Telemetry logs (.tlog), captures (.pcapng, .pcap) of MAVLink or Remote ID, or folders of runs.",
            show_default=False,
        ),
    ],
    detector: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND",
            help="A kind of detector, or a pattern with *. May be repeated. Default: the detectors of a run that has "
            "some, else all kinds that apply.",
        ),
    ] = None,
    detectors: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="A TOML file with tables [[detectors]], such as a scenario, to take instead."
        ),
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="PATH=VALUE",
            help="Change a value of a detector, such as detectors.mavlink-rate.params.multiple=2. May be repeated.",
        ),
    ] = None,
    system: Annotated[
        list[int] | None,
        typer.Option(
            metavar="ID", min=0, max=255, help="MAVLink system id of a vehicle to judge. May be repeated. Default: all."
        ),
    ] = None,
    end: Annotated[
        LogEnd,
        typer.Option(
            metavar="SIDE", help="Where the log was made: gcs is the ground station, companion the computer on board."
        ),
    ] = LogEnd.GCS,
    from_s: Annotated[
        float, typer.Option("--from", metavar="SECONDS", min=0.0, help="Begin so long after the first frame.")
    ] = 0.0,
    to_s: Annotated[
        float | None,
        typer.Option("--to", metavar="SECONDS", min=0.0, help="End so long after the first frame. Default: its end."),
    ] = None,
    benign: Annotated[
        bool,
        typer.Option(
            "--benign", help="Say that the logs have no attack: every alarm is false, and is counted an hour."
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="A new or an empty folder for detection.html, detection.json, alerts.parquet and alerts.csv.",
        ),
    ] = None,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also renew the table of false alarms in this Markdown page.")
    ] = None,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Run detectors over logs, captures and runs, without a simulation, and count false alarms in benign ones."""
    load_plugins(plugin)
    options = log_detection.DetectOptions(
        logs=logs,
        kinds=detector or (),
        file=detectors,
        changes=changes or (),
        systems=system or (),
        end=end.value,
        from_s=from_s,
        to_s=to_s,
        benign=benign,
        out=out,
        page=page,
    )
    log_detection.detect(options, as_json=as_json)


@app.command(epilog="Example: skyrange diff runs/squares runs/squares-2")
def diff(
    *,
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
    runs.diff(a, b, tolerance, as_json=as_json)


class Keep(StrEnum):
    """What `skyrange matrix` keeps of runs: the values of `matrix.flights.Keep`."""

    RESULTS = "results"
    FIRST = "first"
    EVERYTHING = "everything"


@app.command(epilog="Example: skyrange matrix --column firewall --seeds 2 --out runs/firewall")
def matrix(
    *,
    file: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE]", help="Matrix file. Default: the shipped matrix.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder of the matrix: empty, new, or one to go on with. Default: runs/NAME, then -2 …"
        ),
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
    max_runs: MaxRuns = 1_000_000,
    jobs: Jobs = None,
    on: On = None,
    keep: Annotated[
        Keep,
        typer.Option(
            metavar="WHICH",
            help="What is kept of the runs: results, none; first, those of the first seed of each cell, as a pair with "
            "its report; everything, those of all seeds.",
        ),
    ] = Keep.FIRST,
    page: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the page in Markdown here too, and its figure beside it."),
    ] = None,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Fly every attack against every defence: effects, times to alarm, false alarms, costs."""
    load_plugins(plugin)
    options = comparisons.MatrixOptions(
        file=file,
        out=out,
        rows=row or (),
        columns=column or (),
        seeds=seeds,
        keep=keep.value,
        workers=Workers(jobs, on),
        page=page,
        max_runs=max_runs,
    )
    comparisons.matrix(options, as_json=as_json)


@app.command(epilog="Example: skyrange verify runs/squares")
def verify(*, run: RunFolder, as_json: AsJson = False) -> None:
    """Compare a run's files and tables with its manifest: hashes, counts, digests. The exit code is 3 if any differ."""
    runs.verify(run, as_json=as_json)


bench_app = typer.Typer(
    help="Measure how fast skyrange runs on this machine.\n\nExample: skyrange bench fleet --vehicles 100 --seconds 30",
    no_args_is_help=True,
)
for benchmarks in (fleet_benchmarks, part_benchmarks, benchmark_suite):
    bench_app.add_typer(benchmarks.commands)

# the help lists commands in this order, after those above
app.add_typer(catalogue.commands)
app.add_typer(installation.commands)
app.add_typer(live.commands)
app.add_typer(bench_app, name="bench")
app.add_typer(dataset_app, name="dataset")
app.add_typer(install_app, name="install")
app.add_typer(parity_app, name="parity")
app.add_typer(radio_app, name="radio")
app.add_typer(study_app, name="study")
app.add_typer(utm_app, name="utm")
