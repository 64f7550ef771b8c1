"""Handlers of the commands that fly one run, or read the record of a run or of a pair."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from skyrange.cli.comparisons import describe_pair
from skyrange.cli.options import ScenarioChoice, ViewerOptions, check_control, parse_ip_address
from skyrange.cli.output.console import print_json, print_notice, print_text, print_unverified
from skyrange.cli.watching import ViewAddress
from skyrange.core.errors import InputError, ShortfallError
from skyrange.core.files import expand_user

if TYPE_CHECKING:
    from collections.abc import Callable

    from skyrange.record import RunRecord
    from skyrange.runtime.run import Run
    from skyrange.twins.pair_folder import Pair
    from skyrange.view.control import RunControl
    from skyrange.view.flying import FlightView


class RunOptions(NamedTuple):
    """What `skyrange run` was told."""

    scenario: ScenarioChoice
    out: Path | None
    speed: float | None
    viewers: ViewerOptions
    allow_motion: bool
    cores: int
    view: bool = False
    """Whether a browser shows it while it flies."""
    view_at: ViewAddress = ViewAddress()
    control: bool = False
    """Whether that browser controls it too."""


def run(options: RunOptions, *, as_json: bool) -> None:
    """`skyrange run`."""
    from skyrange.assembly.build import Additions
    from skyrange.cli.output.progress import compile_if_cold, flight_progress
    from skyrange.cli.output.run_summary import print_summary
    from skyrange.cli.output.viewer_notices import open_viewers
    from skyrange.cli.output.warnings import print_interlock_notice, print_warnings
    from skyrange.cli.watching import make_control, show_flight
    from skyrange.metrics.summary import summary
    from skyrange.study.runs import fly
    from skyrange.twins.failed_missions import require_missions

    scenario = options.scenario.load()
    check_control(scenario, control=options.control, view=options.view)
    options.view_at.check(wanted=options.view)
    print_warnings(scenario)
    control = make_control() if options.control else None
    shortfall: ShortfallError | None = None
    compile_if_cold(quiet=as_json)
    host = parse_ip_address("viewers", "--viewer-host", options.viewers.host)
    opened = open_viewers(scenario, options.viewers._replace(host=host))
    with show_flight(scenario, options.view_at, wanted=options.view, control=control) as view:
        aircraft = sum(1 for _ in scenario.fleet)
        shown = flight_progress(scenario.name, aircraft, quiet=as_json, observed=options.cores == 1)
        with opened as viewers, shown as flight:
            try:
                record = fly(
                    scenario,
                    options.out,
                    additions=Additions(observers=flight.observers),
                    speed=options.speed,
                    viewers=viewers,
                    on_progress=flight.on_progress if control is None else control.between(flight.on_progress),
                    motion=options.allow_motion,
                    cores=options.cores,
                    on_notice=print_notice,
                    on_start=_starter(view, control),
                    real_time=control is not None,
                )
            except ShortfallError as error:
                from skyrange.record import load as load_run

                shortfall, record = error, load_run(error.path)
        if control:
            control.finish()
        if view:
            view.finish(record)
        facts = summary(record)
        if as_json:
            print_json(facts)
        else:
            print_summary(facts)
            print_interlock_notice(record.manifest)
        if shortfall is not None:
            raise shortfall
    require_missions(record)


def _starter(view: FlightView | None, control: RunControl | None) -> Callable[[Run], None] | None:
    """Tells the viewer, and what controls the run, of a run that begins; `None` where there is no viewer."""
    if view is None:
        return None

    def start(run: Run) -> None:
        view.start(run)
        if control is not None:
            control.start(run)

    return start


def _open_pair(folder: Path) -> Pair | None:
    """The pair in a folder, None if it is another folder; `InputError` for a pair whose runs did not all end."""
    from skyrange.twins.pair_folder import EFFECTS, MANIFEST, load_pair

    folder = expand_user(folder)
    if not (folder / MANIFEST).exists():
        return None
    result = load_pair(folder)
    if not (folder / EFFECTS).exists():
        hint = f"It was interrupted, or a run failed. See a single run: `skyrange show {folder / 'attacked'}`."
        raise InputError.one(str(folder), EFFECTS, "missing", "a pair whose runs have all ended", hint)
    return result


def show(folder: Path, *, as_json: bool) -> None:
    """`skyrange show`."""
    from skyrange.cli.output.pair_table import print_pair
    from skyrange.cli.output.run_summary import print_disk, print_summary
    from skyrange.metrics.summary import summary
    from skyrange.record import load

    result = _open_pair(folder)
    record = load(folder) if result is None else None
    facts = summary(record) if record is not None else {}
    print_unverified(expand_user(folder), is_pair=result is not None)
    _print_unmerged(record)
    if result is not None:
        if as_json:
            print_json(describe_pair(result))
        else:
            print_pair(result)
        return
    if as_json:
        print_json(facts)
    else:
        print_summary(facts)
        print_disk(facts)


def _print_unmerged(record: RunRecord | None) -> None:
    """Say what is not in the record of a live range yet, and what to do."""
    from skyrange.record.live_merge.merge import describe_parts

    if record is not None and (notice := describe_parts(record.path, str(record.manifest["status"]))):
        print_notice(notice)


def report(folder: Path, out: Path | None, *, as_json: bool) -> None:
    """`skyrange report`."""
    from skyrange.record import load
    from skyrange.report import write_report
    from skyrange.report.pair.page import write_comparison

    result = _open_pair(folder)
    record = load(folder) if result is None else None
    print_unverified(expand_user(folder), is_pair=result is not None)
    _print_unmerged(record)
    path = expand_user(out) if out is not None else expand_user(folder) / "report.html"
    try:
        if result is not None:
            write_comparison(result, path)
        elif record is not None:
            write_report(record, path)
    except OSError as error:
        raise InputError.one("--out", "file", str(path), f"a file that can be written ({error.strerror})") from None
    if as_json:
        print_json({"report": str(path), "bytes": path.stat().st_size})
    else:
        print_text(path)


def diff(a: Path, b: Path, tolerance_s: float | None, *, as_json: bool) -> None:
    """`skyrange diff`."""
    from skyrange.metrics.agreement import Agreement, agreement
    from skyrange.metrics.exact_difference import Difference
    from skyrange.metrics.exact_difference import diff as compare
    from skyrange.record import load

    runs = load(a), load(b)
    if tolerance_s is not None:  # without it, `compare` verifies both
        for run in runs:
            print_unverified(run.path)
    difference: Agreement | Difference = compare(*runs) if tolerance_s is None else agreement(*runs, tolerance_s)
    if as_json:
        print_json(difference.to_dict())
    else:
        print_text(difference)


def verify(folder: Path, *, as_json: bool) -> None:
    """`skyrange verify`."""
    from skyrange.record.read.run import open_folder
    from skyrange.record.verification import verify_run

    verification = verify_run(open_folder(folder))
    if as_json:
        print_json(verification.to_dict())
    else:
        print_text(verification)
    if not verification.ok:
        sys.exit(3)
