"""How did the links do, kind by kind and instance by instance? The tables of the section on links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from skyrange.agent.frames import Fate
from skyrange.core.ids import owner_of
from skyrange.study.linkstats import LinkStats, summed
from skyrange.study.report import words
from skyrange.study.report.gathered import Gathered
from skyrange.study.svg import number

_HEADS = ("sent", "delivered", "lost", "overflow", "other", "bytes", "mean", "95 %", "frames/s", "rate")


def links(run: Gathered) -> str:
    """Totals by link kind, then every instance, folded by operator."""
    if not run.links:
        return words.nothing("No link is on record.")
    seconds = max(run.recorded_ns - min(run.start_ns, 0), 1) * 1e-9
    roles = _roles(run.manifest)
    folds = [_table("All links by kind", [_row(each, each.kind, roles, seconds) for each in summed(run.links)])]
    for place, operator in enumerate(run.operator_inks):
        own = [stats for stats in run.links if stats.operator == operator]
        if not own:
            continue
        sent, delivered = sum(stats.sent for stats in own), sum(stats.delivered for stats in own)
        share = f"{100 * delivered / sent:.2f} % delivered" if sent else "silent"
        count = len({(stats.kind, stats.owner) for stats in own})
        rows = [_row(each, f"{each.kind}:{each.owner}", roles, seconds) for each in own if each.sent]
        folds.append(
            f'<details><summary><span class="swatch op-{place}"></span><b>{escape(operator)}</b><span class="dim">'
            f"{count} links · {words.count(sent)} frames · {share}</span></summary>"
            f"{_table(f'Links of {operator}', rows)}</details>"
        )
    return "".join(folds)


def _table(title: str, rows: Sequence[str]) -> str:
    return words.table(title, ["link"], _HEADS, rows) if rows else words.nothing("No frame crossed these links.")


def _row(stats: LinkStats, name: str, roles: Mapping[tuple[str, str], str], seconds: float) -> str:
    """One direction of one link, or the sum of several."""
    lost, full = stats.fates.get(Fate.LOST, 0), stats.fates.get(Fate.OVERFLOW, 0)
    other = stats.sent - stats.delivered - lost - full
    way = roles.get((stats.kind, stats.direction), stats.direction)
    numbers = words.cells(
        words.count(stats.sent),
        _share(stats),
        *(words.count(each) if each else words.NONE for each in (lost, full, other)),
        words.size(stats.size_bytes),
        words.latency(stats.mean_latency_s),
        words.latency(stats.p95_latency_s),
        words.quantity(stats.sent / seconds, ""),
        words.size(stats.size_bytes / seconds) + "/s",
    )
    return (
        f"<tr{'' if stats.sent else ' class=quiet'}><th scope=row><code>{escape(name)}</code> "
        f"<small>{escape(way)}</small></th>{numbers}</tr>"
    )


def _share(stats: LinkStats) -> str:
    """The delivered part in percent, never rounded up to all, and as a bar."""
    part = 100 * stats.delivered / stats.sent if stats.sent else 0.0
    said = words.quantity(part, "%", 2 if 99 < part < 100 else 1) if stats.sent else words.NONE
    return (
        f'{said}<svg class=share width="48" height="6" aria-hidden="true">'
        '<rect class=track width="48" height="6" rx="3"/>'
        f'<rect class=part width="{number(part * 0.48)}" height="6" rx="3"/></svg>'
    )


def _roles(manifest: Any) -> dict[tuple[str, str], str]:
    """`gcs → companion` for each kind and direction, from the ends that the manifest names."""
    found = {}
    for row in manifest.get("links") or []:
        kind = str(row.get("name", "")).split(":", 1)[0]
        first, second = (_role(str(row.get(end, ""))) for end in "ab")
        found[kind, "fwd"], found[kind, "rev"] = f"{first} → {second}", f"{second} → {first}"
    return found


def _role(name: str) -> str:
    owner = owner_of(name)
    return name[len(owner) + 1 :] if owner != name else name
