"""What stands on the page in words and tables? Header, outcomes, belief against truth, links, decisions, data."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from skyrange.agent.frames import Fate
from skyrange.core.ids import owner_of
from skyrange.study.flights import Flight
from skyrange.study.linkstats import LinkStats, summed
from skyrange.study.report import words
from skyrange.study.report.gathered import Gathered
from skyrange.study.series import Track
from skyrange.study.svg import number

_BANNERS = {
    "running": (
        "This run has no ending",
        "Its manifest still says “running”: it was killed, or it is flying now. The page shows what had been written.",
    ),
    "interrupted": ("This run was interrupted", "Everything up to the interruption is recorded and shown."),
    "failed": ("This run failed", "A component broke; what was recorded up to then is shown."),
}
_BADGES = {"complete": ("ok", "complete"), "failed": ("bad", "failed"), "unfinished": ("wait", "unfinished")}
_WORST_FIRST = {"failed": 0, "unfinished": 1, "complete": 2}


def banner(run: Gathered) -> str:
    """A visible warning on every run that did not complete."""
    if run.status == "complete":
        return ""
    title, text = _BANNERS.get(run.status, (f"Status: {run.status}", "This run did not complete."))
    reason = run.manifest.get("reason") or run.manifest.get("error") or ""
    return (
        f'<div class="banner" role="alert"><strong>{escape(title)}.</strong> {escape(text)} '
        f"{escape(str(reason))}</div>"
    )


def masthead(run: Gathered) -> str:
    """The run's name, status and identity."""
    manifest = run.manifest
    good = sum(flight.state == "complete" for flight in run.flights)
    pill = "ok" if run.status == "complete" else "bad" if run.status == "failed" else "wait"
    facts = [
        ("seed", str(manifest.get("seed", "–"))),
        ("starts", str(manifest.get("start_utc") or "–")),
        ("skyrange", str(manifest.get("skyrange") or "–")),
    ]
    line = "".join(f"<span>{key} <b>{escape(value)}</b></span>" for key, value in facts)
    return (
        f'<div class="eyebrow">{_LOGO}<span>skyrange</span><span class="dim">run report</span></div>'
        f'<h1>{escape(str(manifest.get("name") or "unnamed run"))} <span class="pill {pill}">{escape(run.status)}</span>'
        f'</h1><p class="facts"><span><b>{good}</b> of <b>{len(run.fleet)}</b> missions complete</span>{line}</p>'
    )


def tiles(run: Gathered) -> str:
    """The run's numbers at a glance."""
    timings = run.manifest.get("timings") or {}
    wall = timings.get("wall_s")
    simulated = float(run.manifest.get("simulated_s") or run.recorded_ns * 1e-9)
    sent = sum(stats.sent for stats in run.links)
    delivered = sum(stats.delivered for stats in run.links)
    fingerprint = str((run.manifest.get("digests") or {}).get("fingerprint") or "")
    rows = [
        ("aircraft", words.count(len(run.fleet)), f"{len(run.operator_inks)} operators"),
        ("simulated", words.duration(simulated), f"of {words.duration(run.manifest.get('duration_s'))} asked"),
        ("wall time", words.duration(wall), "on this machine"),
        ("real-time factor", words.quantity(simulated / wall, "×") if wall else words.NONE, "simulated ÷ wall"),
        ("frames", words.count(sent), f"{words.size(sum(stats.size_bytes for stats in run.links))} on {_links(run)} links"),
        ("delivered", words.quantity(100 * delivered / sent, "%", 2) if sent else words.NONE, f"{words.count(sent - delivered)} not"),
        ("events", words.count(len(run.events)), f"{words.count(len(run.decisions))} decisions"),
        ("hostile acts", words.count(len(run.attacks)), "labelled" if run.attacks else "a nominal run"),
    ]
    cells = "".join(f"<div><dt>{name}</dt><dd>{value}</dd><dd class=sub>{sub}</dd></div>" for name, value, sub in rows)
    code = f'<code title="{escape(fingerprint, quote=True)}">{escape(fingerprint[:24])}</code>' if fingerprint else words.NONE
    mark = f'<p class="fingerprint"><span>fingerprint</span>{code}<span class="dim">{_versions(run.manifest)}</span></p>'
    return f'<dl class="tiles">{cells}</dl>{mark}'


def outcomes(run: Gathered) -> str:
    """One row per aircraft, those that failed first: how its mission ended and what its flight was like."""
    if not run.flights:
        return _nothing("The manifest names no aircraft.")
    top = max((flight.max_up_m or 0.0 for flight in run.flights), default=1.0)
    head = "".join(
        f"<th scope=col{' class=num' if numeric else ''}>{name}</th>"
        for name, numeric in (
            ("aircraft", False),
            ("mission", False),
            ("altitude", False),
            ("done at", True),
            ("in the air", True),
            ("flown", True),
            ("highest", True),
            ("fastest", True),
        )
    )
    order = sorted(enumerate(run.flights), key=lambda row: _WORST_FIRST.get(row[1].state, 1))
    body = "".join(_outcome(run, index, flight, top) for index, flight in order)
    return (
        '<div class="scroll tall"><table class="grid"><caption class="vh">Outcome of each mission</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def gaps(run: Gathered) -> str:
    """How far each ground station's picture was from the truth at most, with a bar, worst first."""
    known = [(index, flight) for index, flight in enumerate(run.flights) if flight.max_gap_m is not None]
    if not known:
        return _nothing("No ground station received a position.")
    known.sort(key=lambda row: -(row[1].max_gap_m or 0.0))
    worst = max(known[0][1].max_gap_m or 0.0, 1e-9)
    rows = []
    for index, flight in known:
        wide, usual = 100 * (flight.max_gap_m or 0) / worst, 100 * (flight.p95_gap_m or 0) / worst
        rows.append(
            f'<tr data-v="{index}"><th scope=row>{_name(index, flight.vehicle.id)}</th>'
            f'<td class=meter><svg width="100%" height="12" aria-hidden="true"><rect class="ink-{index} fill soft" '
            f'width="{number(wide)}%" height="12" rx="2"/><rect class="ink-{index} fill" width="{number(usual)}%" height="12" '
            f'rx="2"/></svg></td><td class=num>{words.quantity(flight.max_gap_m, "m", 2)}</td>'
            f'<td class=num>{words.quantity(flight.p95_gap_m, "m", 2)}</td><td class=num>{words.count(flight.positions)}</td></tr>'
        )
    return (
        '<div class="scroll tall"><table class="grid"><caption class="vh">Distance between belief and truth</caption>'
        "<thead><tr><th scope=col>aircraft</th><th scope=col>solid: 95 % of the time · pale: at most</th>"
        "<th scope=col class=num>at most</th><th scope=col class=num>95 %</th><th scope=col class=num>positions</th></tr>"
        f"</thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def links(run: Gathered) -> str:
    """Totals by link kind, then every instance, folded by operator."""
    if not run.links:
        return _nothing("No link is on record.")
    seconds = max(run.recorded_ns - min(run.start_ns, 0), 1) * 1e-9
    roles = _roles(run.manifest)
    total = _link_table(summed(list(run.links)), roles, seconds, "All links by kind", whole=True)
    folds = []
    for operator in run.operator_inks:
        own = [stats for stats in run.links if stats.operator == operator]
        if own:
            sent, delivered = sum(stats.sent for stats in own), sum(stats.delivered for stats in own)
            share = f"{100 * delivered / sent:.2f} % delivered" if sent else "silent"
            place = list(run.operator_inks).index(operator)
            folds.append(
                f'<details><summary><span class="swatch op-{place}"></span><b>{escape(operator)}</b>'
                f'<span class="dim">{len({(s.kind, s.owner) for s in own})} links · {words.count(sent)} frames · {share}</span>'
                f"</summary>{_link_table(own, roles, seconds, f'Links of {operator}')}</details>"
            )
    return total + "".join(folds)


def data(run: Gathered, notes: dict[str, Any]) -> str:
    """How to open what this page is made from, and what the page left out."""
    path = escape(str(run.record.path))
    code = (
        f'import skyrange\n\nrun = skyrange.load(<span class="str">"{path}"</span>)\n'
        'truth = run.table(<span class="str">"truth"</span>)          <span class="rem"># where every aircraft was</span>\n'
        'seen = run.table(<span class="str">"telemetry"</span>)       <span class="rem"># what each ground station received</span>\n'
        'frames = run.table(<span class="str">"frames"</span>)        <span class="rem"># every frame on every link</span>\n'
        'lost = frames.filter(<span class="str">pc.field</span>(<span class="str">"fate"</span>) != <span class="str">"delivered"</span>)'
        '      <span class="rem"># import pyarrow.compute as pc</span>'
    )
    thin = []
    if notes["points_drawn"] < notes["points"]:
        thin.append(f"{words.count(notes['points_drawn'])} of {words.count(notes['points'])} samples of tracks are drawn")
    if notes["buildings_drawn"] < notes["buildings"]:
        thin.append(f"the {words.count(notes['buildings_drawn'])} buildings nearest to the flights of {words.count(notes['buildings'])} are drawn")
    cut = f"<p>To keep this page light, {' and '.join(thin)}; the tables hold all.</p>" if thin else ""
    digests = "".join(
        f"<tr><th scope=row>{escape(str(name))}</th><td><code>{escape(str(value))}</code></td></tr>"
        for name, value in (run.manifest.get("digests") or {}).items()
    )
    return (
        f'<div class="cols"><div><pre><code>{code}</code></pre>{cut}</div><div class="scroll"><table class="grid">'
        f'<caption class="vh">Digests</caption><tbody>{digests}<tr><th scope=row>folder</th><td><code>{path}</code></td></tr>'
        "</tbody></table></div></div>"
    )


def _outcome(run: Gathered, index: int, flight: Flight, top: float) -> str:
    css, said = _BADGES.get(flight.state, ("wait", flight.state))
    vehicle = flight.vehicle
    kit = " · ".join(part for part in (vehicle.airframe, vehicle.autopilot) if part)
    return (
        f'<tr data-v="{index}"><th scope=row>{_name(index, vehicle.id)}<small>{escape(kit)}</small></th>'
        f'<td><span class="badge {css}">{escape(said)}</span><small class="reason">{escape(flight.reason)}</small></td>'
        f'<td class=spark>{_spark(run.truth[vehicle.id], index, top, run)}</td>'
        f"<td class=num>{words.duration(flight.finished_s)}</td><td class=num>{words.duration(flight.airborne_s)}</td>"
        f"<td class=num>{words.quantity(flight.distance_m, 'm')}</td><td class=num>{words.quantity(flight.max_up_m, 'm')}</td>"
        f"<td class=num>{words.quantity(flight.max_speed_mps, 'm/s')}</td></tr>"
    )


def _spark(track: Track, index: int, top: float, run: Gathered) -> str:
    """Altitude over the whole run, one scale for all rows."""
    if not len(track):
        return words.NONE
    span = max(run.end_ns - run.start_ns, 1)
    times = np.linspace(track.time_ns[0], track.time_ns[-1], 48).astype(np.int64)
    x = (times - run.start_ns) / span * 120
    y = 26 - track.at(times)[:, 2] / max(top, 0.1) * 22
    points = " ".join(f"{number(a)},{number(b)}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
    return (
        '<svg viewBox="0 0 120 28" width="120" height="28" preserveAspectRatio="none" aria-hidden="true">'
        f'<polygon class="ink-{index} fill faint" points="{number(x[0])},26 {points} {number(x[-1])},26"/>'
        f'<polyline class="ink-{index} line" fill="none" stroke-width="1.5" points="{points}"/></svg>'
    )


def _link_table(rows: Sequence[LinkStats], roles: dict[tuple[str, str], str], seconds: float, title: str, whole: bool = False) -> str:
    heads = ("sent", "delivered", "lost", "overflow", "other", "bytes", "mean", "95 %", "frames/s", "rate")
    head = "".join(f"<th scope=col class=num>{name}</th>" for name in heads)
    body = []
    for stats in rows:
        if not stats.sent and not whole:
            continue
        lost, full = stats.fates.get(Fate.LOST, 0), stats.fates.get(Fate.OVERFLOW, 0)
        other = stats.sent - stats.delivered - lost - full
        way = roles.get((stats.kind, stats.direction), stats.direction)
        name = stats.kind if whole else f"{stats.kind}:{stats.owner}"
        share = 100 * stats.delivered / stats.sent if stats.sent else 0.0
        body.append(
            f"<tr{'' if stats.sent else ' class=quiet'}><th scope=row><code>{escape(name)}</code> <small>{escape(way)}</small></th>"
            f"<td class=num>{words.count(stats.sent)}</td>"
            f'<td class=num>{words.quantity(share, "%", 1) if stats.sent else words.NONE}'
            f'<svg class=share width="48" height="6" aria-hidden="true"><rect class=track width="48" height="6" rx="3"/>'
            f'<rect class=part width="{number(share * 0.48)}" height="6" rx="3"/></svg></td>'
            + "".join(f"<td class=num>{words.count(each) if each else words.NONE}</td>" for each in (lost, full, other))
            + f"<td class=num>{words.size(stats.size_bytes)}</td><td class=num>{words.latency(stats.mean_latency_s)}</td>"
            f"<td class=num>{words.latency(stats.p95_latency_s)}</td>"
            f"<td class=num>{words.quantity(stats.sent / seconds, '')}</td><td class=num>{words.size(stats.size_bytes / seconds)}/s</td></tr>"
        )
    if not body:
        return _nothing("No frame crossed these links.")
    return (
        f'<div class="scroll"><table class="grid links"><caption class="vh">{escape(title)}</caption><thead><tr>'
        f"<th scope=col>link</th>{head}</tr></thead><tbody>{''.join(body)}</tbody></table></div>"
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


def _name(index: int, vehicle: str) -> str:
    return f'<span class="swatch ink-{index}"></span>{escape(vehicle)}'


def _links(run: Gathered) -> int:
    return len({(stats.kind, stats.owner) for stats in run.links})


def _versions(manifest: Any) -> str:
    versions = manifest.get("versions") or {}
    system = (manifest.get("platform") or {}).get("system", "")
    named = [f"{name} {value}" for name, value in versions.items() if name != "skyrange"]
    return escape(" · ".join([*named, str(system)]))


def _nothing(words_: str) -> str:
    return f'<p class="nothing">{escape(words_)}</p>'


_LOGO = (
    '<svg viewBox="0 0 24 24" width="20" height="20" aria-hidden="true"><path d="M3 17L12 5l9 12" fill="none" '
    'stroke="currentColor" stroke-width="2.4" stroke-linejoin="round" stroke-linecap="round"/><path d="M8 18.5h8" '
    'stroke="currentColor" stroke-width="2.4" stroke-linecap="round"/></svg>'
)
