"""Handler of `skyrange watch`, and the viewer beside the commands that fly: a browser that shows what flies or flew."""

from __future__ import annotations

import tempfile
import time
import webbrowser
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from skyrange.cli.options import parse_ip_address
from skyrange.cli.output.console import print_notice, print_text
from skyrange.core.errors import InputError
from skyrange.core.extras import require_extra
from skyrange.core.files import expand_user
from skyrange.runtime.interrupt import Interruptible

if TYPE_CHECKING:
    from skyrange.record import RunRecord
    from skyrange.runtime.live.range import LiveRange
    from skyrange.scenario.model.scenario import Scenario
    from skyrange.study.shown_runs import ShownRun
    from skyrange.view.access import Access
    from skyrange.view.control import RunControl
    from skyrange.view.control_server import Controllable
    from skyrange.view.flying import FlightView
    from skyrange.view.scan_queries import FlyingScans
    from skyrange.view.server import LiveStream
    from skyrange.view.stream.recorded import RecordedArms

HOST: Final = "127.0.0.1"
"""Nobody else reaches the viewer, unless another address is asked for; from another machine, `ssh -L` does."""


class ViewAddress(NamedTuple):
    """Where a viewer is served."""

    host: str = HOST
    port: int = 0
    certificate: Path | None = None
    key: Path | None = None

    def open_access(self) -> tuple[str, Access | None]:
        """The IP address, and what it needs to be reached there. Raises `InputError`."""
        from skyrange.view.access import open_access

        host = parse_ip_address("viewer", "--host", self.host)
        certificate, key = (None if path is None else expand_user(path) for path in (self.certificate, self.key))
        return host, open_access(host, certificate, key)

    def check(self, *, wanted: bool) -> None:
        """Raise `InputError` for an address that cannot be served, and for one without a viewer."""
        if wanted:
            require_extra("view", "--view")
            self.open_access()
        elif self != ViewAddress():
            expected = "--view with --view-host, --view-port, --certificate and --key"
            raise InputError.one("viewer", "--view", "missing", expected)


class WatchOptions(NamedTuple):
    """What `skyrange watch` was told."""

    folder: Path
    run: str | None
    seed: int | None
    at: ViewAddress
    in_browser: bool
    time_s: float | None = None


def watch(options: WatchOptions) -> None:
    """`skyrange watch`."""
    require_extra("view", "watch")
    from skyrange.view.opening import find_opening_s
    from skyrange.view.record_queries import RecordQueries
    from skyrange.view.server import LiveStream, RecordedStream, make_application, serve_beside

    host, access = options.at.open_access()
    with ExitStack() as stack:
        shown = stack.enter_context(_open_folder(options._replace(folder=expand_user(options.folder))))
        if isinstance(shown, LiveStream):
            application, time_s = make_application(shown, access=access), options.time_s
        else:
            recorded, queries = RecordedStream(shown.encode()), RecordQueries(shown.records)
            application = make_application(recorded, queries=queries, access=access)
            time_s = find_opening_s(shown.records) if options.time_s is None else options.time_s
        url = stack.enter_context(serve_beside(application, host, options.at.port))
        url += "" if time_s is None else f"#t={time_s:g}"
        print_text(url)
        print_notice("The viewer runs until Ctrl-C.")
        if options.in_browser and access is None:
            webbrowser.open(url)
        _wait()


@contextmanager
def _open_folder(options: WatchOptions) -> Iterator[LiveStream | RecordedArms]:
    """What is in a folder, whatever it is the folder of: a stream of a run that is still recorded, or arms."""
    from skyrange.study.execution.store import MANIFEST as PLAN
    from skyrange.twins.pair_folder import MANIFEST as PAIR
    from skyrange.view.folders import read_folder_arms
    from skyrange.view.following import follow, is_growing
    from skyrange.view.server import LiveStream

    folder = options.folder
    if (folder / PLAN).is_file() and not (folder / PAIR).is_file():
        with _open_plan(options) as arms:
            yield arms
        return
    if options.run is not None:
        expected = "none for a run or a pair: its folder names it"
        raise InputError.one(str(folder), "--run", options.run, expected)
    if not is_growing(folder):
        yield read_folder_arms(folder, options.seed)
        return
    if options.seed is not None:
        raise InputError.one(str(folder), "--seed", str(options.seed), "none while a run flies")
    stream = LiveStream()
    with follow(folder, stream):
        print_notice("The record has not ended: the viewer shows what is recorded so far, and follows it.")
        yield stream


@contextmanager
def _open_plan(options: WatchOptions) -> Iterator[RecordedArms]:
    """Runs of a study, a comparison or a matrix, which may be flown again."""
    from skyrange.cli.options import load_plugins
    from skyrange.cli.output.progress import compile_if_cold, progress
    from skyrange.study.execution.store import open_store
    from skyrange.study.shown_runs import choose_runs
    from skyrange.view.stream.recorded import RecordedArms
    from skyrange.view.stream.scene import ArmRecord

    load_plugins(open_store(options.folder).plugins)
    shown = choose_runs(options.folder, options.run, options.seed)
    more = f" There are {shown.others} more: choose with --run and --seed." if shown.others else ""
    print_notice(f"{shown.store.name}: {shown.name}, seed {shown.seed}.{more}")
    with tempfile.TemporaryDirectory(prefix="skyrange-watch-") as scratch:
        arms = []
        for run in shown.runs:
            record = run.kept
            if record is None:
                compile_if_cold(quiet=False)
                with progress(f"{run.arm}, again", quiet=False) as on_progress:
                    record = run.fly(Path(scratch) / run.arm, on_progress)
                print_notice(_describe_again(run, record))
            arms.append(ArmRecord(run.arm, run.arm, record))
        yield RecordedArms(arms, name=f"{shown.store.name}: {shown.name}, seed {shown.seed}")


def _describe_again(run: ShownRun, record: RunRecord) -> str:
    flown = str(record.manifest["digests"]["fingerprint"])
    if not run.fingerprint:
        return f"{run.arm} was flown again; the folder does not say whether its fingerprint was {flown}"
    if run.fingerprint == flown:
        return f"{run.arm} was flown again, with the same fingerprint"
    return (
        f"{run.arm} was flown again, and is ANOTHER flight than the one that was measured: its fingerprint is {flown}, "
        f"and was {run.fingerprint}. It was flown by another version of skyrange, or on another machine."
    )


def make_control() -> RunControl:
    """The control of a run that is to fly."""
    from skyrange.view.control import RunControl

    return RunControl()


@contextmanager
def show_flight(
    scenario: Scenario, at: ViewAddress, *, wanted: bool, control: RunControl | None = None
) -> Iterator[FlightView | None]:
    """Show a run in a browser while it flies, if that is `wanted`, and then until Ctrl-C; with `control` of it."""
    if not wanted:
        yield None
        return
    from skyrange.view.flying import FlightView
    from skyrange.view.server import LiveStream

    stream = LiveStream()
    view = FlightView(scenario, stream)
    with _serving(stream, at, control, view.scans):
        yield view
        if view.fault is not None:
            print_notice(f"the viewer does not show the run to its end: {view.fault!r}; its record is whole")


@contextmanager
def show_range(flown: LiveRange, at: ViewAddress, *, wanted: bool, control: bool = False) -> Iterator[None]:
    """Show a live range in a browser while it flies, if that is `wanted`, then its record, until Ctrl-C; with `control`
    of it.
    """
    if not wanted:
        yield
        return
    from skyrange.view.control import LiveControl
    from skyrange.view.following import follow
    from skyrange.view.server import LiveStream

    stream = LiveStream()
    controllable = LiveControl(flown) if control else None
    with _serving(stream, at, controllable), follow(flown.folder, stream, idle_s=inf) as view:
        yield
        view.update()  # the record has ended


@contextmanager
def _serving(
    stream: LiveStream, at: ViewAddress, control: Controllable | None, scans: FlyingScans | None = None
) -> Iterator[None]:
    """Serve a stream, and `control` of what it shows, while the context lasts, and then until Ctrl-C."""
    from skyrange.view.control_server import ControlServer
    from skyrange.view.server import make_application, serve_beside

    controlled = None if control is None else ControlServer(control)
    host, access = at.open_access()
    with serve_beside(make_application(stream, controlled, access=access, scans=scans), host, at.port) as url:
        if controlled is None:
            print_notice(f"watch the run at {url}")
        else:
            print_notice(f"watch and control the run at {controlled.address(url)}")
        if access is None:
            webbrowser.open(url if controlled is None else controlled.address_once(url))
        yield
        if controlled is not None and (words := controlled.counts.describe()):
            print_notice(f"requests to control the run that were not obeyed: {words}")
        print_notice("The flight has ended. The viewer runs until Ctrl-C.")
        _wait()


def _wait() -> None:
    with Interruptible() as interrupt:
        while not interrupt.requested:
            time.sleep(0.1)
