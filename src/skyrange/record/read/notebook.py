"""What a notebook shows of a run's record: how it ended, the outcome of each mission, and its tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from skyrange.record.read.run import RunRecord

_AIRCRAFT_SHOWN: Final = 20


def describe_record(record: RunRecord) -> str:
    """A line: the folder, how the run ended, its aircraft and its duration."""
    return f"RunRecord({str(record.path)!r}: {record.status}, {len(record.outcomes)} aircraft, {record.duration:g} s)"


def render_record(record: RunRecord) -> str:
    """HTML for a notebook; all names are escaped."""
    manifest, outcomes = record.manifest, record.outcomes
    digests = manifest.get("digests") or {}
    facts = [
        ("status", record.status),
        ("seed", manifest.get("seed", "")),
        ("duration", f"{record.duration:g} s"),
        ("level", record.level),
        ("fingerprint", digests.get("fingerprint", "")),
        ("folder", record.path),
    ]
    missions = [
        (name, outcome.get("state", ""), _seconds(outcome.get("finished_s")), outcome.get("reason") or "")
        for name, outcome in list(outcomes.items())[:_AIRCRAFT_SHOWN]
    ]
    more = len(outcomes) - len(missions)
    counts = dict(manifest.get("counts") or {})
    parts = [f"<b>{escape(str(manifest.get('name') or record.path.name))}</b>", _table((), facts)]
    parts.append(_table(("aircraft", "mission", "ended", "reason"), missions))
    if more > 0:
        parts.append(f"<p>and {more} more aircraft</p>")
    if counts:
        rows = [(name, f"{count:,}") for name, count in sorted(counts.items())]
        parts.append(_table(("table", "rows"), rows))
    return "".join(parts)


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.1f} s"


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    top = "".join(f"<th>{escape(name)}</th>" for name in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table>{f'<thead><tr>{top}</tr></thead>' if head else ''}<tbody>{body}</tbody></table>"
