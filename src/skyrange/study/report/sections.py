"""What stands on the page in words and tables? Header, outcomes, belief against truth, where the data is."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from skyrange.study.flights import Flight
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
        f'<div class="banner" role="alert"><strong>{escape(title)}.</strong> {escape(text)} {escape(str(reason))}</div>'
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
    name = str(manifest.get("name") or "unnamed run")
    line = "".join(f"<span>{key} <b>{escape(value)}</b></span>" for key, value in facts)
    return (
        f'<div class="eyebrow">{LOGO}<span>skyrange</span><span class="dim">run report</span></div>'
        f'<h1>{escape(name)} <span class="pill {pill}">{escape(run.status)}</span>'
        f'</h1><p class="facts"><span><b>{good}</b> of <b>{len(run.fleet)}</b> missions complete</span>{line}</p>'
    )


def tiles(run: Gathered) -> str:
    """The run's numbers at a glance."""
    timings = run.manifest.get("timings") or {}
    wall = timings.get("wall_s")
    simulated = float(run.manifest.get("simulated_s") or run.recorded_ns * 1e-9)
    sent = sum(stats.sent for stats in run.links)
    delivered = sum(stats.delivered for stats in run.links)
    instances = len({(stats.kind, stats.owner) for stats in run.links})
    fingerprint = str((run.manifest.get("digests") or {}).get("fingerprint") or "")
    rows = [
        ("aircraft", words.count(len(run.fleet)), f"{len(run.operator_inks)} operators"),
        ("simulated", words.duration(simulated), f"of {words.duration(run.manifest.get('duration_s'))} asked"),
        ("wall time", words.duration(wall), "on this machine"),
        ("real-time factor", words.quantity(simulated / wall, "×") if wall else words.NONE, "simulated ÷ wall"),
        (
            "frames",
            words.count(sent),
            f"{words.size(sum(stats.size_bytes for stats in run.links))} on {instances} links",
        ),
        (
            "delivered",
            words.quantity(100 * delivered / sent, "%", 2) if sent else words.NONE,
            f"{words.count(sent - delivered)} not",
        ),
        ("events", words.count(len(run.events)), f"{words.count(len(run.decisions))} decisions"),
        ("hostile acts", words.count(len(run.attacks)), "labelled" if run.attacks else "none labelled"),
    ]
    cells = "".join(f"<div><dt>{name}</dt><dd>{value}</dd><dd class=sub>{sub}</dd></div>" for name, value, sub in rows)
    code = f"<code>{escape(fingerprint)}</code>" if fingerprint else words.NONE
    mark = (
        f'<p class="fingerprint"><span>fingerprint</span>{code}<span class="dim">{_versions(run.manifest)}</span></p>'
    )
    return f'<dl class="tiles">{cells}</dl>{mark}'


def outcomes(run: Gathered) -> str:
    """One row per aircraft, those that failed first: how its mission ended and what its flight was like."""
    if not run.flights:
        return words.nothing("The manifest names no aircraft.")
    top = max((flight.max_up_m or 0.0 for flight in run.flights), default=1.0)
    order = sorted(enumerate(run.flights), key=lambda row: _WORST_FIRST.get(row[1].state, 1))
    return words.table(
        "Outcome of each mission",
        ["aircraft", "mission", "altitude"],
        ["done at", "in the air", "flown", "highest", "fastest"],
        (_outcome(run, index, flight, top) for index, flight in order),
        "tall",
    )


def gaps(run: Gathered) -> str:
    """How far each ground station's picture was from the truth at most, with a bar, worst first."""
    known = [(index, flight) for index, flight in enumerate(run.flights) if flight.max_gap_m is not None]
    if not known:
        return words.nothing("No ground station received a position.")
    known.sort(key=lambda row: -(row[1].max_gap_m or 0.0))
    worst = max(known[0][1].max_gap_m or 0.0, 1e-9)
    return words.table(
        "Distance between belief and truth",
        ["aircraft", "solid: 95 % of the positions · pale: at most"],
        ["at most", "95 %", "positions"],
        (_gap(index, flight, worst) for index, flight in known),
        "tall",
    )


def data(run: Gathered, notes: dict[str, Any]) -> str:
    """How to open what this page is made from, and what the page left out."""
    path = escape(str(run.record.path), quote=True)
    code = _SNIPPET.format(path=path)
    thin = [
        f"{words.count(notes[f'{what}_drawn'])} of {words.count(notes[what])} {said}"
        for what, said in (("points", "samples of tracks"), ("buildings", "buildings, the nearest to the flights,"))
        if notes[f"{what}_drawn"] < notes[what]
    ]
    cut = f"<p>To keep this page light, {' and '.join(thin)} are drawn; the tables hold all.</p>" if thin else ""
    digests = "".join(
        f"<tr><th scope=row>{escape(str(name))}</th><td><code>{escape(str(value))}</code></td></tr>"
        for name, value in (run.manifest.get("digests") or {}).items()
    )
    return (
        f'<div class="cols"><div><pre><code>{code}</code></pre>{cut}</div><div class="scroll"><table class="grid">'
        f'<caption class="vh">Digests</caption><tbody>{digests}'
        f"<tr><th scope=row>folder</th><td><code>{path}</code></td></tr></tbody></table></div></div>"
    )


def _outcome(run: Gathered, index: int, flight: Flight, top: float) -> str:
    css, said = _BADGES.get(flight.state, ("wait", flight.state))
    vehicle = flight.vehicle
    kit = " · ".join(part for part in (vehicle.airframe, vehicle.autopilot) if part)
    numbers = words.cells(
        words.duration(flight.finished_s),
        words.duration(flight.airborne_s),
        words.quantity(flight.distance_m, "m"),
        words.quantity(flight.max_up_m, "m"),
        words.quantity(flight.max_speed_mps, "m/s"),
    )
    return (
        f'<tr data-v="{index}"><th scope=row>{words.named(index, vehicle.id)}<small>{escape(kit)}</small></th>'
        f'<td><span class="badge {css}">{escape(said)}</span><small class="reason">{_why(flight)}</small></td>'
        f"<td class=spark>{_spark(run.truth[vehicle.id], index, top, run)}</td>{numbers}</tr>"
    )


def _why(flight: Flight) -> str:
    """What befell it, then what its ground station made of that."""
    befell = f"<b>{escape(flight.mishap)}</b>" if flight.mishap else ""
    return " · ".join(part for part in (befell, escape(flight.reason)) if part)


def _gap(index: int, flight: Flight, worst: float) -> str:
    bars = "".join(
        f'<rect class="ink-{index} fill{css}" width="{number(100 * (gap or 0.0) / worst)}%" height="12" rx="2"/>'
        for gap, css in ((flight.max_gap_m, " soft"), (flight.p95_gap_m, ""))
    )
    numbers = words.cells(
        words.quantity(flight.max_gap_m, "m", 2),
        words.quantity(flight.p95_gap_m, "m", 2),
        words.count(flight.positions),
    )
    return (
        f'<tr data-v="{index}"><th scope=row>{words.named(index, flight.vehicle.id)}</th><td class=meter>'
        f'<svg width="100%" height="12" aria-hidden="true">{bars}</svg></td>{numbers}</tr>'
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


def _versions(manifest: Any) -> str:
    versions = manifest.get("versions") or {}
    system = (manifest.get("platform") or {}).get("system", "")
    named = [f"{name} {value}" for name, value in versions.items() if name != "skyrange"]
    return escape(" · ".join([*named, str(system)]))


_SNIPPET = """import pyarrow.compute as pc
import skyrange

run = skyrange.load(<span class="str">"{path}"</span>)
truth = run.table(<span class="str">"truth"</span>)      <span class="rem"># where every aircraft was</span>
seen = run.table(<span class="str">"telemetry"</span>)   <span class="rem"># what each ground station received</span>
frames = run.table(<span class="str">"frames"</span>)    <span class="rem"># every frame on every link</span>
lost = frames.filter(pc.field(<span class="str">"fate"</span>) == <span class="str">"lost"</span>)"""

LOGO = (
    '<svg viewBox="0 0 24 24" width="20" height="20" aria-hidden="true"><path d="M3 17L12 5l9 12" fill="none" '
    'stroke="currentColor" stroke-width="2.4" stroke-linejoin="round" stroke-linecap="round"/><path d="M8 18.5h8" '
    'stroke="currentColor" stroke-width="2.4" stroke-linecap="round"/></svg>'
)
