"""The page of a detection: alerts on a timeline of each log, rates of false alarms, and what was not judged."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from skyrange.core.files import atomic_write
from skyrange.core.time import NS_PER_S, Time
from skyrange.figures.svg import format_tick, ticks
from skyrange.log_detection.airborne import Spans, airborne_ns
from skyrange.log_detection.false_alarms import (
    SETTINGS,
    SHOWN_LIMITS,
    DetectorRates,
    FalseAlarmRate,
    count_alarms,
    warn_of_copies,
)
from skyrange.log_detection.judging import Findings
from skyrange.log_detection.result_files import alert_row_of
from skyrange.record.notes import parse_details
from skyrange.report import quantities
from skyrange.report.marked_page import MarkedPart
from skyrange.report.rendering import asset, content_policy, render, table_script

PAGE: Final = "detection.html"
RATES: Final = MarkedPart("<!-- skyrange detect: begin -->", "<!-- skyrange detect: end -->")
MAX_MARKS: Final = 400
"""Alerts drawn in one lane."""
MAX_ROWS: Final = 3_000
"""Alerts in the table of one log."""
MAX_SUBJECTS: Final = 50
"""Subjects with lanes."""


def write_page(findings: Sequence[Findings], rates: Sequence[DetectorRates] | None, folder: Path) -> Path:
    """Write the page into a folder; its path. Raises `OSError`."""
    path = folder / PAGE
    with atomic_write(path) as file:
        file.write(render_page(findings, rates).encode())
    return path


def render_page(findings: Sequence[Findings], rates: Sequence[DetectorRates] | None) -> str:
    """The page as HTML; `rates` are those of benign logs, None if they were not said to be."""
    style, script = asset("style.css"), table_script()
    names = [found.log.path.name for found in findings]
    name = names[0] if len(names) == 1 else f"{len(names)} logs"
    alerts = sum(len(found.alerts) for found in findings)
    kinds = {one.kind for found in findings for one in found.choice.chosen}
    verdict = f"{len(kinds)} detectors raised {alerts:,} alerts"
    verdict += ", all of them false, because the logs are said to be benign." if rates is not None else "."
    return str(
        render(
            "log_detection/page.html.jinja",
            policy=content_policy(style, script),
            title=f"{name} · detection · skyrange",
            style=style,
            script=script,
            name=name,
            verdict=verdict,
            tiles=_tiles(findings, alerts),
            rates=None if rates is None else [_row_of_rates(rate) for rate in rates],
            warnings=[] if rates is None else warn_of_copies(findings),
            confidence=SHOWN_LIMITS,
            episode_s=f"{SETTINGS.episode_s:g}",
            logs=[_describe_log(found) for found in findings],
        )
    )


def describe_rate(rate: FalseAlarmRate) -> tuple[str, str, str, str]:
    """Alarms and hours, rate, limits, and the least rate that can be claimed, as text."""
    if rate.per_h is None:
        return "no hours", "–", "–", "–"
    low, high = rate.limits
    return (
        f"{rate.episodes} in {rate.hours:.3g} h",
        f"{rate.per_h:.3g}",
        f"{low:.3g} to {high:.3g}" if math.isfinite(high) else f"over {low:.3g}",
        f"{rate.lowest_per_h:.3g}",
    )


def renew_page(findings: Sequence[Findings], rates: Sequence[DetectorRates], page: Path) -> None:
    """Renew `RATES` in a Markdown page. Raises `InputError` for a page without its marks."""
    logs = ", ".join(found.log.path.name for found in findings)
    head = ("detector", "in the air", "an hour", SHOWN_LIMITS, "whole logs", "an hour", SHOWN_LIMITS)
    lines = [f"False alarms over {logs}.", "", f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for rate in rates:
        air, whole = describe_rate(rate.airborne), describe_rate(rate.whole)
        lines.append(f"| `{rate.kind}` | {' | '.join((*air[:3], *whole[:3]))} |")
    least = rates[0].airborne.lowest_per_h if rates else math.inf
    lines += ["", f"Without any alarm in the air, no rate below {least:.3g} an hour could be claimed.", ""]
    RATES.write(page, lines)


def _tiles(findings: Sequence[Findings], alerts: int) -> list[tuple[str, Any, str]]:
    observed = sum(one.observed_ns for found in findings for one in found.exposures) / NS_PER_S
    airborne = sum(airborne_ns(one.airborne) for found in findings for one in found.exposures) / NS_PER_S
    left_out = {one.kind for found in findings for one in found.choice.left_out}
    reduced = {one.kind for found in findings for one in found.choice.chosen if one.less}
    ran = {one.kind for found in findings for one in found.choice.chosen}
    return [
        ("logs", quantities.count(len(findings)), ", ".join(sorted({found.log.format for found in findings}))),
        ("frames", quantities.count(sum(found.frames for found in findings)), "at the ends that were judged"),
        ("observed", quantities.duration(observed), "from first to last frame, summed over subjects"),
        ("in the air", quantities.duration(airborne), "by heartbeats and positions of the telemetry"),
        ("detectors", quantities.count(len(ran)), "kinds that ran"),
        ("with less", quantities.count(len(reduced)), "kinds that lack something in a log"),
        ("not run", quantities.count(len(left_out)), "kinds that a log has nothing for"),
        ("alerts", quantities.count(alerts), f"in {sum(_alarms(found) for found in findings):,} alarms"),
    ]


def _alarms(found: Findings) -> int:
    ids = {raised.detector for raised in found.alerts}
    return sum(count_alarms(raised for raised in found.alerts if raised.detector == id_) for id_ in ids)


def _row_of_rates(rate: DetectorRates) -> Mapping[str, Any]:
    return {"kind": rate.kind, "id": rate.detector, "alerts": f"{rate.alerts:,}",
            "whole": describe_rate(rate.whole), "airborne": describe_rate(rate.airborne)}  # fmt: skip


def _describe_log(found: Findings) -> Mapping[str, Any]:
    begin, end = found.first_ns, max(found.last_ns, found.first_ns + NS_PER_S)
    subjects = sorted({one.subject for one in found.exposures} | {raised.alert.subject for raised in found.alerts})
    rows = sorted(map(alert_row_of, found.alerts), key=lambda row: (row[5], row[1]))
    return {
        "name": found.log.path.name,
        "lead": f"{found.log.format}, {found.frames:,} frames; time 0 is {found.log.epoch.iso(0)}.",
        "remarks": found.remarks,
        "ticks": _ticks(begin, end),
        "groups": [_group(found, subject, begin, end) for subject in subjects[:MAX_SUBJECTS]],
        "more_subjects": max(len(subjects) - MAX_SUBJECTS, 0),
        "rows": [
            {"time_s": row[5] / NS_PER_S, "utc": found.log.epoch.iso(row[5]), "kind": row[2], "detector": row[1],
             "subject": row[3], "score": f"{row[4]:.2f}", "data": parse_details(row[6])}
            for row in rows[:MAX_ROWS]
        ],
        "total": len(rows),
        "not_run": found.choice.left_out,
        "notes": [(one.kind, one.note) for one in found.choice.chosen if one.note],
        "less": [(one.kind, less) for one in found.choice.chosen for less in one.less],
    }  # fmt: skip


def _part(at: Time, begin: Time, end: Time) -> str:
    """The position of a time, in percent."""
    return f"{100.0 * min(max((at - begin) / (end - begin), 0.0), 1.0):.2f}"


def _ticks(begin: Time, end: Time) -> list[tuple[str, str]]:
    values, step = ticks(begin / NS_PER_S, end / NS_PER_S, 10)
    places = [(_part(round(value * NS_PER_S), begin, end), format_tick(value, step)) for value in values]
    return [(place, text) for place, text in places if 1.0 < float(place) < 99.0]


def _group(found: Findings, subject: str, begin: Time, end: Time) -> Mapping[str, Any]:
    """The lanes of a subject: when it flew, and the alerts of each detector."""
    flights: Spans = next((one.airborne for one in found.exposures if one.subject == subject), ())
    lanes = []
    for one in found.choice.chosen:
        raised = [alert for id_, alert in ((a.detector, a.alert) for a in found.alerts)
                  if id_ == one.id and alert.subject == subject]  # fmt: skip
        marks = [
            {"place": _part(alert.at, begin, end),
             "title": f"{alert.kind} at {alert.at / NS_PER_S:.2f} s, score {alert.score:.2f}"}
            for alert in raised[:MAX_MARKS]
        ]  # fmt: skip
        lanes.append({"name": one.kind, "spoken": f"{one.kind}: {len(raised)} alerts", "marks": marks,
                      "left_out": max(len(raised) - MAX_MARKS, 0)})  # fmt: skip
    bands = [
        {"start": _part(first, begin, end), "width": f"{100.0 * (last - first) / (end - begin):.2f}",
         "title": f"in the air from {first / NS_PER_S:.1f} s to {last / NS_PER_S:.1f} s"}
        for first, last in flights
    ]  # fmt: skip
    return {"subject": subject, "bands": bands, "lanes": lanes}
