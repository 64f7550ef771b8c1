"""The commands for live ranges: the range itself, machines that join it, viewers, taps, and records to merge."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from skyrange.cli.options import (
    AsJson,
    Buildings,
    Certificate,
    CertificateKey,
    Changes,
    Control,
    Grouping,
    Motion,
    Plugins,
    Qgc,
    RunFolder,
    RunOut,
    ScenarioChoice,
    ScenarioName,
    Seed,
    View,
    ViewerHost,
    ViewerPort,
    ViewHost,
    ViewPort,
    check_control,
    load_plugins,
    parse_address,
    parse_ip_address,
)
from skyrange.cli.output.console import print_json, print_notice, print_text
from skyrange.cli.output.live_table import live_progress
from skyrange.cli.output.run_summary import print_summary
from skyrange.cli.output.viewer_notices import print_open_ports, print_viewer_counts, tell_when_up
from skyrange.cli.output.warnings import print_interlock_notice
from skyrange.cli.watching import ViewAddress, show_range
from skyrange.core.extras import require_extra

commands = typer.Typer()


class Death(StrEnum):
    """Reactions of a live range to the death of a node."""

    STOP = "stop"
    CONTINUE = "continue"
    RESTART = "restart"


@commands.command("live", epilog="Example: skyrange live squares --external blue.gcs")
def live(
    *,
    scenario: ScenarioName,
    out: RunOut = None,
    seed: Seed = None,
    buildings: Buildings = None,
    changes: Changes = None,
    group: Annotated[
        Grouping | None,
        typer.Option(
            metavar="HOW",
            help="Components that share a process. component: none; operator: those of one operator; host: those on "
            "one machine; one: all. Default: component with at most eight components per core, else operator.",
        ),
    ] = None,
    external: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COMPONENT",
            help="Start no process for this component, such as blue.gcs; your own program replaces it. May be "
            "repeated.",
        ),
    ] = None,
    port_offset: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=-5000,
            max=35_000,
            help="Number added to every port. Default: 0, or the first multiple of 1000 with which all are free, "
            "if all processes are on this machine.",
        ),
    ] = None,
    on_death: Annotated[
        Death | None,
        typer.Option(
            metavar="HOW",
            help="Reaction to the death of a process: stop the range, continue without the process, or restart it (at "
            "most three times). Default: live.on_death of the scenario, else stop.",
        ),
    ] = None,
    view: View = False,
    view_host: ViewHost = "127.0.0.1",
    view_port: ViewPort = 0,
    certificate: Certificate = None,
    key: CertificateKey = None,
    control: Control = False,
    qgc: Qgc = False,
    viewer_port: ViewerPort = None,
    viewer_host: ViewerHost = "127.0.0.1",
    keys: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Folder with the keys of the range, made by `skyrange keys`, for machines that join."
        ),
    ] = None,
    netns: Annotated[
        bool,
        typer.Option(
            "--netns",
            help="Put every ground station and every aircraft in its own network namespace, for tools that act on "
            "packets (tc, Scapy). Linux only; needs root.",
        ),
    ] = False,
    allow_motion: Motion = False,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Run a scenario in real time, with its components as separate processes on real sockets."""
    require_extra("live", "live")
    from skyrange.cli.output.progress import compile_if_cold
    from skyrange.core.errors import ComponentError, ShortfallError, SkyrangeError
    from skyrange.io.zeromq.curve_keys import load_range
    from skyrange.metrics.summary import summary
    from skyrange.record import load as load_run
    from skyrange.report import write_report
    from skyrange.runtime.live.range import prepare_range
    from skyrange.runtime.live.supervisor.supervisor import run_range
    from skyrange.twins.failed_missions import require_missions
    from skyrange.view.flying import require_truth

    load_plugins(plugin)
    host = parse_ip_address("viewers", "--viewer-host", viewer_host)
    chosen = ScenarioChoice(scenario, seed=seed, buildings=buildings, changes=changes or ()).load()
    check_control(chosen, control=control, view=view)
    at = ViewAddress(view_host, view_port, certificate, key)
    at.check(wanted=view)
    if view:
        require_truth(chosen)
    compile_if_cold(quiet=as_json)
    flown = prepare_range(
        chosen,
        out,
        group=group.value if group is not None else None,
        outside=tuple(external or ()),
        port_offset=port_offset,
        on_death=on_death.value if on_death is not None else None,
        netns=netns,
        motion=allow_motion,
        watched=qgc or viewer_port is not None,
        viewer_port=viewer_port,
        viewer_host=host,
        keys=load_range(keys) if keys is not None else None,
    )
    if port_offset is None and flown.port_offset:
        print_notice(f"some of the usual ports are taken; all are moved (--port-offset {flown.port_offset})")
    with show_range(flown, at, wanted=view, control=control):
        print_open_ports(flown)
        failure: ShortfallError | ComponentError | None = None
        with live_progress(flown, quiet=as_json) as on_update:
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


@commands.command(epilog="Example: skyrange node --join 10.0.0.1 --key lab2.key_secret")
def node(
    *,
    range_: Annotated[
        str,
        typer.Option(
            "--join",
            metavar="ADDRESS",
            help="IP address of the machine that starts the range, with :PORT if the port is not 14500.",
        ),
    ],
    key: Annotated[Path, typer.Option(metavar="FILE", help="Secret key of this machine, made by `skyrange keys`.")],
    address: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="IP address at which the other machines reach this one, as in `hosts` of the scenario. Default: the "
            "address from which this machine connects to the range.",
        ),
    ] = None,
    wait: Annotated[
        float,
        typer.Option(metavar="SECONDS", min=1, max=86_400, help="Longest time to wait for the start of the range."),
    ] = 60.0,
) -> None:
    """Join this machine to a live range, and run the components that `hosts` in the scenario assigns to it."""
    require_extra("live", "node")
    from skyrange.io.zeromq.curve_keys import load_member
    from skyrange.runtime.live.node.host_agent import join_range
    from skyrange.runtime.live.range import CONTROL_PORT

    reached_at = None if address is None else parse_ip_address("node", "--address", address)
    range_at = parse_address("node", "--join", range_, CONTROL_PORT)
    join_range(range_at, load_member(key), reached_at, wait_s=wait, on_word=print_notice)


@commands.command("relay", epilog="Example: skyrange relay --from 10.0.0.1 --vehicles 5 --listen 0.0.0.0")
def relay(
    *,
    run: Annotated[
        str,
        typer.Option(
            "--from",
            metavar="ADDRESS",
            help="IP address of the run's --viewer-host, with :PORT of its first aircraft if that is not 5763.",
        ),
    ],
    vehicles: Annotated[int, typer.Option(metavar="N", min=1, max=500, help="Number of aircraft of the run.")],
    listen: Annotated[
        str,
        typer.Option(metavar="ADDRESS", help="IP address of this machine for viewers, with :PORT if not 5763."),
    ] = "127.0.0.1",
    wait: Annotated[
        float, typer.Option(metavar="SECONDS", min=1, max=86_400, help="Longest time to wait for the run.")
    ] = 60.0,
) -> None:
    """Relay the viewers' ports of a run to another network until the run ends. Nothing passes the other way."""
    from skyrange.cli.output.viewer_notices import viewer_counts_text
    from skyrange.runtime.viewers import FIRST_PORT, ViewerRelay

    source = parse_address("relay", "--from", run, FIRST_PORT)
    with ViewerRelay(source, parse_address("relay", "--listen", listen, FIRST_PORT), vehicles) as relaying:
        try:
            relaying.serve(wait, print_notice)
        except KeyboardInterrupt:
            print_notice("relay: closed")
        print_notice(viewer_counts_text(relaying.counts))


@commands.command(epilog="Example: skyrange keys lab-keys lab2 lab3")
def keys(
    *,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder for the keys of the range.")],
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="Name of a machine that may join. May be repeated."),
    ] = None,
) -> None:
    """Create the keys with which other machines join a live range."""
    require_extra("live", "keys")
    from skyrange.io.zeromq.curve_keys import RANGE, make_range_keys

    made = make_range_keys(folder, names or [])
    if not made:
        print_notice(f"{folder} already has the keys of a range; give the names of machines that may join")
    for path in made:
        use = "stays on this machine" if path.stem == RANGE else "copy it to that machine only"
        print_text(f"{path}  {use}")


class Fail(StrEnum):
    """Fates of a frame for which the program of an external tap returns no verdict."""

    OPEN = "open"
    CLOSED = "closed"


@commands.command(epilog="Example: skyrange tap gcs:blue/b1 --listen 127.0.0.1:7000 --run runs/squares")
def tap(
    *,
    link: Annotated[str, typer.Argument(metavar="LINK", help="A link of a live range, such as gcs:blue/b1.")],
    listen: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="Loopback address to which your program connects; port 0 selects a free port."
        ),
    ],
    run: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Run folder of the live range. Default: the newest one under runs."),
    ] = None,
    hold_ms: Annotated[
        float,
        typer.Option(
            metavar="MS", min=1, max=60_000, help="Longest time that a frame waits for your program's verdict."
        ),
    ] = 200.0,
    fail: Annotated[
        Fail, typer.Option(metavar="HOW", help="open: a frame without a verdict passes; closed: it is dropped.")
    ] = Fail.OPEN,
    name: Annotated[str, typer.Option(metavar="NAME", help="Name of the tap in labels.")] = "tap-process",
    wait_s: Annotated[
        float, typer.Option("--wait", metavar="S", min=0, max=3600, help="Longest time to wait for the range.")
    ] = 60.0,
    as_json: AsJson = False,
) -> None:
    """Connect your own program to a link of a live range, to alter, drop, delay and inject frames."""
    require_extra("live", "tap")
    from pydantic import ValidationError

    from skyrange.core.errors import InputError
    from skyrange.runtime.live.taps.external_tap import TapTerms
    from skyrange.runtime.live.taps.tap_process import TapProcess, parse_loopback

    given: dict[str, Any] = {"link": link, "name": name, "hold_ms": hold_ms, "fail": fail.value}
    try:
        terms = TapTerms.model_validate(given)
    except ValidationError as error:
        raise InputError.one("tap", "--name", name, "1 to 32 letters, digits, '-' or '_'") from error
    tapping = TapProcess(terms, parse_loopback(listen), run or newest_live_run(), wait_s)
    try:
        tapping.serve(print_notice)
    except KeyboardInterrupt:
        print_notice("tap: removed from the link")
    if as_json:
        print_json(dict(tapping.counts))
    else:
        counted = ", ".join(f"{count} {outcome}" for outcome, count in tapping.counts.items())
        print_text(f"{link}: {counted or 'no frames'}")


def newest_live_run() -> Path:
    """The folder of the newest live range under `runs`. Raises `InputError` if there is none."""
    from skyrange.core.errors import InputError
    from skyrange.record.folder import PARTS

    parts = sorted(Path("runs").glob(f"*/{PARTS}"), key=lambda path: path.stat().st_mtime)
    if not parts:
        raise InputError.one("tap", "--run", "no live range under runs", "the run folder of a live range")
    return parts[-1].parent


@commands.command(epilog="Example: skyrange merge runs/squares --out runs/squares-whole")
def merge(
    *,
    run: RunFolder,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Empty or new folder. Default: RUN-merged, beside RUN.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Merge the records that the processes of a killed live range left behind."""
    from skyrange.metrics.summary import summary
    from skyrange.record import load as load_run
    from skyrange.record.live_merge.merge import recover_run
    from skyrange.report import write_report

    folder = run.resolve()  # so that "." has a name
    into = out if out is not None else folder.with_name(f"{folder.name}-merged")
    recover_run(folder, into)
    record = load_run(into)
    write_report(record, into / "report.html")
    facts = summary(record)
    if as_json:
        print_json(facts)
    else:
        print_summary(facts)
