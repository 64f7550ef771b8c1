"""The command that runs detectors over logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from rich.table import Table

from skyrange.cli.output.console import print_json, print_notice, print_text, terminal

if TYPE_CHECKING:
    from skyrange.log_detection.judging import Findings

_MOST_ROWS: Final = 50
"""Alerts in the table of a terminal; files, JSON and the page have all."""


@dataclass(frozen=True, slots=True)
class DetectOptions:
    """What `skyrange detect` was asked for."""

    logs: Sequence[Path]
    kinds: Sequence[str] = ()
    file: Path | None = None
    changes: Sequence[str] = ()


def detect(options: DetectOptions, *, as_json: bool) -> None:
    """`skyrange detect`."""
    from skyrange.log_detection.detector_choice import Request, check_request
    from skyrange.log_detection.judging import judge
    from skyrange.log_detection.opening import open_log

    request = Request(tuple(options.kinds), options.file, tuple(options.changes))
    check_request(request)
    findings = [judge(open_log(path), request) for path in options.logs]
    if as_json:
        print_json([_describe(found) for found in findings])
        return
    for found in findings:
        _print(found)


def _describe(found: Findings) -> dict[str, Any]:
    return {
        "log": str(found.log.path),
        "alerts": [
            {"time_ns": raised.time_ns, "detector": raised.detector, **raised.alert._asdict()}
            for raised in found.alerts
        ],
    }


def _print(found: Findings) -> None:
    for remark in found.remarks:
        print_notice(f"{found.log.path.name}: {remark.subject}: {remark.text}")
    for one in found.choice.left_out:
        print_notice(f"not run: {one.kind}: {one.reason}")
    for chosen in found.choice.chosen:
        for less in chosen.less:
            print_notice(f"runs with less: {chosen.kind}: {less}")
    table = Table(title=f"{found.log.path.name}", title_justify="left", title_style="bold")
    for column in ("time, s", "detector", "kind", "subject", "score"):
        table.add_column(column)
    for raised in found.alerts[:_MOST_ROWS]:
        alert = raised.alert
        table.add_row(f"{alert.at * 1e-9:.3f}", raised.detector, alert.kind, alert.subject, f"{alert.score:.2f}")
    terminal().print(table)
    print_text(f"{len(found.alerts):,} alerts of {len(found.choice.chosen)} detectors in {found.frames:,} frames")
