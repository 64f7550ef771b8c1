"""The command that runs detectors over logs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Final, Literal

from rich.table import Table

from skyrange.cli.output.console import print_json, print_notice, print_text, terminal
from skyrange.core.errors import InputError
from skyrange.core.files import expand_user
from skyrange.core.time import NS_PER_S, Time

if TYPE_CHECKING:
    from skyrange.log_detection.detector_choice import Request
    from skyrange.log_detection.false_alarms import DetectorRates
    from skyrange.log_detection.judging import Findings
    from skyrange.log_detection.opening import LogOptions

_MOST_ROWS: Final = 40
"""Alerts of a log in the table of a terminal; JSON, the files and the page have more."""
_PATIENCE_S: Final = 5.0
"""Wall time from which on progress is told."""


@dataclass(frozen=True, slots=True)
class DetectOptions:
    """What `skyrange detect` was asked for."""

    logs: Sequence[Path]
    kinds: Sequence[str] = ()
    file: Path | None = None
    changes: Sequence[str] = ()
    systems: Sequence[int] = ()
    end: Literal["gcs", "companion"] = "gcs"
    from_s: float = 0.0
    to_s: float | None = None
    benign: bool = False
    out: Path | None = None
    page: Path | None = None


def detect(options: DetectOptions, *, as_json: bool) -> None:
    """`skyrange detect`."""
    from skyrange.log_detection.detector_choice import Request, check_request
    from skyrange.log_detection.false_alarms import measure_false_alarms, warn_of_copies
    from skyrange.log_detection.opening import LogOptions
    from skyrange.log_detection.result_files import describe

    if options.to_s is not None and options.to_s <= options.from_s:
        raise InputError.one("--to", "seconds", f"{options.to_s:g}", f"more than --from, {options.from_s:g}")
    if options.page is not None:
        _check_page(options.page, benign=options.benign)
    _check_once(options.logs)
    request = Request(tuple(options.kinds), options.file, tuple(options.changes))
    check_request(request)
    folder = _new_folder(options.out)
    how = LogOptions(options.systems, options.end, options.from_s, options.to_s)
    findings = [_judge(path, how, request) for path in options.logs]
    rates = measure_false_alarms(findings) if options.benign else None
    files = {} if folder is None else _write(findings, rates, folder)
    if options.page is not None and rates is not None:
        from skyrange.log_detection.page import renew_page

        renew_page(findings, rates, options.page)
    if as_json:
        print_json({**describe(findings, rates), "files": {name: str(path) for name, path in files.items()}})
        return
    for found in findings:
        _print_log(found)
    if rates is not None:
        _print_rates(rates)
        for warning in warn_of_copies(findings):
            print_notice(warning)
    for path in files.values():
        print_text(f"wrote {path}")


def _check_page(page: Path, *, benign: bool) -> None:
    from skyrange.log_detection.page import RATES

    if not benign:
        raise InputError.one("--page", "with", "no --benign", "--benign: the table has rates of false alarms")
    RATES.read(page)


def _check_once(logs: Sequence[Path]) -> None:
    """Refuse a log that is named twice, whose hours would count twice."""
    named: set[Path] = set()
    for path in logs:
        real = expand_user(path).resolve()
        if real in named:
            raise InputError.one("LOG", "file", str(path), "each log once", "Its hours and alarms would count twice.")
        named.add(real)


def _judge(path: Path, options: LogOptions, request: Request) -> Findings:
    from skyrange.log_detection.judging import judge
    from skyrange.log_detection.opening import open_log

    return judge(open_log(path, options), request, _tell_progress(path.name))


def _tell_progress(name: str) -> Callable[[Time, Time], None]:
    """Tells each tenth of a log that takes long."""
    begun_s, tenth = monotonic(), 0

    def tell(now: Time, end: Time) -> None:
        nonlocal tenth
        reached = 10 * now // max(end, 1)
        if reached > tenth and monotonic() - begun_s > _PATIENCE_S:
            tenth = reached
            print_notice(f"{name}: {now / NS_PER_S:,.0f} of {end / NS_PER_S:,.0f} s")

    return tell


def _new_folder(out: Path | None) -> Path | None:
    if out is None:
        return None
    folder = expand_user(out)
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError.one("--out", "folder", str(folder), "a new or an empty folder")
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError.one("--out", "folder", str(folder), "a folder that can be written", str(error)) from error
    return folder


def _write(findings: Sequence[Findings], rates: Sequence[DetectorRates] | None, folder: Path) -> dict[str, Path]:
    from skyrange.log_detection.page import PAGE, write_page
    from skyrange.log_detection.result_files import write_results

    try:
        return {**write_results(findings, rates, folder), PAGE: write_page(findings, rates, folder)}
    except OSError as error:
        raise InputError.one("--out", "folder", str(folder), "a folder that can be written", str(error)) from error


def _print_log(found: Findings) -> None:
    """What a user has to know first, then the alerts."""
    from skyrange.log_detection.airborne import airborne_ns

    name, choice = found.log.path.name, found.choice
    for remark in found.remarks:
        print_notice(f"{name}: {remark.subject}: {remark.text}")
    for one in choice.left_out:
        print_notice(f"{name}: not run: {one.kind or one.id}: {one.reason}")
    for chosen in choice.chosen:
        for less in chosen.less:
            print_notice(f"{name}: runs with less: {chosen.kind}: {less}")
        if chosen.note:
            print_notice(f"{name}: {chosen.id}: {chosen.note}")
    table = Table(title=f"{name}: alerts", title_justify="left", title_style="bold")
    for column in ("time, s", "kind", "subject", "score"):
        table.add_column(column, justify="left" if column in ("kind", "subject") else "right", overflow="fold")
    for raised in found.alerts[:_MOST_ROWS]:
        alert = raised.alert
        table.add_row(f"{alert.at / NS_PER_S:,.3f}", alert.kind, alert.subject, f"{alert.score:.2f}")
    if found.alerts:
        terminal().print(table)
    if len(found.alerts) > _MOST_ROWS:
        print_text(f"… and {len(found.alerts) - _MOST_ROWS:,} further alerts; --json and --out have all")
    _print_counts(found)
    for exposure in found.exposures:
        flown_s, observed_s = airborne_ns(exposure.airborne) / NS_PER_S, exposure.observed_ns / NS_PER_S
        flights = f"{len(exposure.airborne)} flight{'s' if len(exposure.airborne) != 1 else ''}"
        print_text(f"{exposure.subject}: observed {observed_s:,.0f} s, in the air {flown_s:,.0f} s in {flights}")


def _print_counts(found: Findings) -> None:
    from skyrange.log_detection.false_alarms import SETTINGS, count_alarms

    choice = found.choice
    table = Table(title=f"{found.log.path.name}: detectors", title_justify="left", title_style="bold")
    for column in ("detector", "alerts", f"alarms of {SETTINGS.episode_s:g} s", "first, s"):
        table.add_column(column, justify="left" if column == "detector" else "right", overflow="fold")
    for one in choice.chosen:
        raised = [each for each in found.alerts if each.detector == one.id]
        first = f"{min(each.alert.at for each in raised) / NS_PER_S:,.3f}" if raised else "–"
        shown = one.kind if one.id == one.kind.replace(".", "-") else f"{one.id} ({one.kind})"
        table.add_row(shown, f"{len(raised):,}", f"{count_alarms(raised):,}", first)
    terminal().print(table)
    print_text(
        f"{len(found.alerts):,} alerts of {len(choice.chosen)} detectors over {found.frames:,} frames; "
        f"{sum(bool(one.less) for one in choice.chosen)} run with less, {len(choice.left_out)} do not run"
    )


def _print_rates(rates: Sequence[DetectorRates]) -> None:
    from skyrange.log_detection.false_alarms import SHOWN_LIMITS
    from skyrange.log_detection.page import describe_rate

    kinds = [rate.kind for rate in rates]
    for title, whole in (("whole logs, time on the ground included", True), ("in the air", False)):
        table = Table(title=f"false alarms an hour, {title}", title_justify="left", title_style="bold")
        for column in ("detector", "alarms", "an hour", SHOWN_LIMITS, "no claim below"):
            table.add_column(column, justify="left" if column == "detector" else "right", overflow="fold")
        for rate in rates:
            name = rate.kind if kinds.count(rate.kind) == 1 else rate.detector
            table.add_row(name, *describe_rate(rate.whole if whole else rate.airborne))
        terminal().print(table)
