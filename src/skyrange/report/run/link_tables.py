"""Tables of the links: frames, fates, latency and rates, by kind and by instance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from skyrange.contracts.frames import Fate
from skyrange.core.ids import owner_of
from skyrange.figures.svg import format_number
from skyrange.metrics.link_statistics import LinkStatistics, sum_by_kind
from skyrange.report import quantities
from skyrange.report.rendering import render
from skyrange.report.run.contents import RunContents


def render_links(run: RunContents) -> Markup:
    """Render the totals by kind of link, then a folded table of link instances per operator."""
    seconds = max(run.recorded_ns - min(run.start_ns, 0), 1) * 1e-9
    roles = _roles(run.manifest)
    folds = []
    for place, operator in enumerate(run.operator_colours):
        own = [stats for stats in run.links if stats.operator == operator]
        if not own:
            continue
        sent, delivered = sum(stats.sent for stats in own), sum(stats.delivered for stats in own)
        folds.append(
            {
                "place": place,
                "operator": operator,
                "count": len({(stats.kind, stats.owner) for stats in own}),
                "sent": sent,
                "share": f"{100 * delivered / sent:.2f} % delivered" if sent else "silent",
                "rows": [_row(each, f"{each.kind}:{each.owner}", roles, seconds) for each in own if each.sent],
            }
        )
    kinds = [_row(each, each.kind, roles, seconds) for each in sum_by_kind(run.links)]
    return render("run/links.html.jinja", kinds=kinds, folds=folds)


def _row(stats: LinkStatistics, name: str, roles: Mapping[tuple[str, str], str], seconds: float) -> Mapping[str, Any]:
    """One direction of one link, or the sum of several. A delivered share below 100 % is not rounded up to 100 %."""
    lost, overflow = stats.fates.get(Fate.LOST, 0), stats.fates.get(Fate.OVERFLOW, 0)
    part = 100 * stats.delivered / stats.sent if stats.sent else 0.0
    return {
        "name": name,
        "ends": roles.get((stats.kind, stats.direction), stats.direction),
        "sent": stats.sent,
        "delivered": quantities.quantity(part, "%", 2 if 99 < part < 100 else 1) if stats.sent else quantities.MISSING,
        "bar": format_number(part * 0.48),
        "lost": lost,
        "overflow": overflow,
        "other": stats.sent - stats.delivered - lost - overflow,
        "size": quantities.size(stats.size_bytes),
        "mean": quantities.latency(stats.mean_latency_s),
        "p95": quantities.latency(stats.p95_latency_s),
        "frame_rate": quantities.quantity(stats.sent / seconds, ""),
        "byte_rate": quantities.size(stats.size_bytes / seconds),
    }


def _roles(manifest: Any) -> dict[tuple[str, str], str]:
    """For each kind and direction of link its ends, as `gcs → companion`, from the manifest."""
    found = {}
    for row in manifest.get("links") or []:
        kind = str(row.get("name", "")).split(":", 1)[0]
        first, second = (_role(str(row.get(end, ""))) for end in "ab")
        found[kind, "fwd"], found[kind, "rev"] = f"{first} → {second}", f"{second} → {first}"
    return found


def _role(name: str) -> str:
    owner = owner_of(name)
    return name[len(owner) + 1 :] if owner != name else name
