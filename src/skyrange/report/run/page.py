"""Page of a run: head, sections, style, script and data in one file, with a content security policy."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from markupsafe import Markup

from skyrange.assembly.placement.moved_places import describe_placing
from skyrange.city.reading import describe_reading
from skyrange.codec.mission.ignored_keys import describe_mission_file
from skyrange.core.time import NS_PER_S
from skyrange.figures import run as run_figures
from skyrange.figures.palette import ThemeColour
from skyrange.figures.subject import Subject
from skyrange.figures.svg import format_number
from skyrange.metrics.safety import distinct_mishaps, mishap_kind
from skyrange.metrics.summary import FlightSummary, describe_missions, describe_radio_engine
from skyrange.metrics.time_series import Track
from skyrange.record import RunRecord
from skyrange.record.schema import FULL, level_of
from skyrange.report import quantities
from skyrange.report.rendering import asset, content_policy, render
from skyrange.report.run import sections, timeline
from skyrange.report.run.contents import MANY_AIRCRAFT, RunContents, draw_simply, pack_tracks, read_run
from skyrange.report.run.sections import render_airspace
from skyrange.report.viewer import embed_viewer, join_scripts
from skyrange.view.stream.recorded import RecordedArms
from skyrange.view.stream.scene import ArmRecord

_WARNINGS = {
    "running": (
        "This run has no ending",
        "Its manifest still says “running”: it was killed, or it is flying now. The page shows what had been written.",
    ),
    "interrupted": ("This run was interrupted", "Everything up to the interruption is recorded and shown."),
    "failed": ("This run failed", "A component broke; what was recorded up to then is shown."),
}
_BADGES = {"complete": ("ok", "complete"), "failed": ("bad", "failed"), "unfinished": ("wait", "unfinished")}
_MISHAPS: Final = {
    "collision": ("collision", "collisions"),
    "crash": ("crash", "crashes"),
    "failsafe": ("failsafe", "failsafes"),
    "breach": ("fence breach", "fence breaches"),
}
_WORST_FIRST = {"failed": 0, "unfinished": 1, "complete": 2}


def warning(run: RunContents) -> Mapping[str, str] | None:
    """Title, text and reason of the banner of a run that did not complete; `None` for one that did."""
    if run.status == "complete":
        return None
    title, text = _WARNINGS.get(run.status, (f"Status: {run.status}", "This run did not complete."))
    reason = run.manifest.get("reason") or run.manifest.get("error") or ""
    return {"title": title, "text": text, "reason": str(reason)}


def level(run: RunContents) -> str:
    """The level at which the run was recorded if it is not `full`; else ""."""
    run_level = level_of(run.manifest)
    return run_level if run_level != FULL else ""


def identity(run: RunContents) -> Mapping[str, Any]:
    """The run's name, status, facts and fingerprint."""
    manifest, states = run.manifest, [flight.state for flight in run.flights]
    return {
        "name": str(manifest.get("name") or "unnamed run"),
        "status": run.status,
        "missions": f"{describe_missions(states)} complete",
        "pill": "bad" if "failed" in states else "ok" if set(states) <= {"complete"} else "wait",
        "facts": [
            ("seed", str(manifest.get("seed", "–"))),
            ("starts", str(manifest.get("start_utc") or "–")),
            ("skyrange", str(manifest.get("skyrange") or "–")),
            *([("radio", engine)] if (engine := describe_radio_engine(manifest)) else []),
        ],
        "fingerprint": str((manifest.get("digests") or {}).get("fingerprint") or ""),
        "versions": _versions(manifest),
    }


def describe_run(run: RunContents) -> str:
    """The run in a sentence: missions, mishaps and acts."""
    mishaps = Counter(mishap_kind(row) for row in distinct_mishaps(run.events))
    found = [f"{count} {_MISHAPS.get(kind, (kind, kind))[count > 1]}" for kind, count in mishaps.items()] or [
        "no collision, crash or failsafe"
    ]
    acts = sum(act.kind.startswith("attack") for act in run.attacks)
    hostile = [f"{quantities.count(acts)} hostile act{'s' * (acts > 1)}"] if acts else []
    missions = describe_missions([flight.state for flight in run.flights])
    return f"{missions} complete; {', '.join([*found, *hostile])}."


def numbers(run: RunContents) -> list[tuple[str, Any, Any]]:
    """Tiles at the top of the page: name, value and caption."""
    timings = run.manifest.get("timings") or {}
    wall = timings.get("wall_s")
    simulated = float(run.manifest.get("simulated_s") or run.recorded_ns * 1e-9)
    sent = sum(stats.sent for stats in run.links)
    delivered = sum(stats.delivered for stats in run.links)
    instances = len({(stats.kind, stats.owner) for stats in run.links})
    sent_bytes = sum(stats.size_bytes for stats in run.links)
    acts = Counter(act.kind.partition(".")[0] for act in run.attacks)
    others = "".join(
        f", {quantities.count(acts[author])} {words}"
        for author, words in (("fault", "of faults"), ("harmless", "harmless"))
        if acts[author]
    )
    return [
        ("aircraft", quantities.count(len(run.fleet)), f"{len(run.operator_colours)} operators"),
        (
            "simulated",
            quantities.duration(simulated),
            ("of ", quantities.duration(run.manifest.get("duration_s")), " asked"),
        ),
        ("wall time", quantities.duration(wall), "on this machine"),
        (
            "real-time factor",
            quantities.quantity(simulated / wall, "×") if wall else quantities.MISSING,
            "simulated ÷ wall",
        ),
        ("frames", quantities.count(sent), (quantities.size(sent_bytes), f" on {instances} links")),
        (
            "delivered",
            quantities.quantity(100 * delivered / sent, "%", 2) if sent else quantities.MISSING,
            f"{quantities.count(sent - delivered)} not",
        ),
        ("events", quantities.count(len(run.events)), f"{quantities.count(len(run.decisions))} decisions"),
        ("hostile acts", quantities.count(acts["attack"]), f"labelled{others}" if run.attacks else "none labelled"),
    ]


def render_outcomes(run: RunContents) -> Markup:
    """Render the outcome and the flight of each aircraft, failed missions first."""
    top = max((flight.max_up_m or 0.0 for flight in run.flights), default=1.0)
    order = sorted(enumerate(run.flights), key=lambda row: _WORST_FIRST.get(row[1].state, 1))
    return render("run/outcomes.html.jinja", rows=[_outcome(run, index, flight, top) for index, flight in order])


def render_gaps(run: RunContents) -> Markup:
    """Render the distance between belief and truth of each aircraft, the largest first."""
    known = [(index, flight) for index, flight in enumerate(run.flights) if flight.max_gap_m is not None]
    known.sort(key=lambda row: -(row[1].max_gap_m or 0.0))
    worst = max((flight.max_gap_m or 0.0 for _, flight in known), default=0.0)
    return render("run/gaps.html.jinja", rows=[_gap(index, flight, max(worst, 1e-9)) for index, flight in known])


def city_lines(manifest: Mapping[str, Any]) -> list[str]:
    """Sentences on the file of buildings: what was kept and dropped of it; none for a generated city."""
    city = manifest.get("city")
    reading = city.get("reading") if isinstance(city, Mapping) else None
    return [str(city["source"]), *describe_reading(reading)] if city and reading else []


def mission_file_lines(manifest: Mapping[str, Any]) -> list[str]:
    """A sentence on each mission file: what is used of it, and what no flight uses."""
    return [describe_mission_file(row) for row in manifest.get("mission_files") or ()]


def left_out(notes: Mapping[str, int]) -> str:
    """What the charts show only in part, in words; `notes` are the counts of `pack_tracks`."""
    if notes["points_drawn"] == notes["points"]:
        return ""
    return f"{quantities.count(notes['points_drawn'])} of {quantities.count(notes['points'])} samples of tracks"


def _outcome(run: RunContents, index: int, flight: FlightSummary, top: float) -> Mapping[str, Any]:
    badge, state = _BADGES.get(flight.state, ("wait", flight.state))
    vehicle = flight.vehicle
    return {
        "index": index,
        "vehicle": vehicle.id,
        "equipment": " · ".join(part for part in (vehicle.airframe, vehicle.autopilot) if part),
        "badge": badge,
        "state": state,
        "mishap": flight.mishap,
        "reason": flight.reason,
        **_heights(run.truth[vehicle.id], top, run),
        "numbers": (
            quantities.duration(flight.landed_s),
            quantities.duration(flight.airborne_s),
            quantities.quantity(flight.distance_m, "m"),
            quantities.quantity(flight.max_up_m, "m"),
            quantities.quantity(flight.max_speed_mps, "m/s"),
        ),
    }


def _gap(index: int, flight: FlightSummary, worst: float) -> Mapping[str, Any]:
    most, usual = (format_number(100 * (gap or 0.0) / worst) for gap in (flight.max_gap_m, flight.p95_gap_m))
    return {
        "index": index,
        "vehicle": flight.vehicle.id,
        "most": most,
        "usual": usual,
        "numbers": (
            quantities.quantity(flight.max_gap_m, "m", 2),
            quantities.quantity(flight.p95_gap_m, "m", 2),
            quantities.count(flight.positions),
        ),
    }


def _heights(track: Track, top: float, run: RunContents) -> Mapping[str, str]:
    """Points of a small chart of altitude over time, on one scale for all rows, and their first and last abscissa."""
    if not len(track):
        return {"heights": "", "first": "", "last": ""}
    span = max(run.end_ns - run.start_ns, 1)
    times = np.linspace(track.time_ns[0], track.time_ns[-1], 48).astype(np.int64)
    x = (times - run.start_ns) / span * 120
    y = 26 - track.at(times)[:, 2] / max(top, 0.1) * 22
    points = " ".join(f"{format_number(a)},{format_number(b)}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
    return {"heights": points, "first": format_number(x[0]), "last": format_number(x[-1])}


def _versions(manifest: Mapping[str, Any]) -> str:
    versions = manifest.get("versions") or {}
    system = (manifest.get("platform") or {}).get("system", "")
    return " · ".join([*(f"{name} {value}" for name, value in versions.items() if name != "skyrange"), str(system)])


SCRIPTS: Final = ("packed.js", "rows.js", "moments.js", "base.js", "panels.js", "chart.js", "page.js")
"""Parts of the page's own script in order."""


def render_run(record: RunRecord) -> str:
    """The page as text."""
    run = read_run(record)
    tracks, notes = pack_tracks(run)
    name = str(run.manifest.get("name") or "run")
    embedded = embed_viewer(RecordedArms([ArmRecord("run", name, record)], name=name, verdict=describe_run(run)))
    style = embedded.style + asset("style.css") + colour_rules(run.operator_colours, run.subject)
    script = join_scripts(embedded, *SCRIPTS)
    truth, many = draw_simply(run.truth), len(run.fleet) > MANY_AIRCRAFT
    return render(
        "run/page.html.jinja",
        policy=content_policy(style, script),
        title=f"{name} · skyrange",
        style=style,
        script=script,
        stream=embedded.stream,
        tracks=tracks,
        verdict=describe_run(run),
        warning=warning(run),
        level=level(run),
        has_frames=run.has_frames,
        **identity(run),
        numbers=numbers(run),
        overview=run_figures.draw_overview(run.subject, truth, run.marks),
        many=many,
        outcomes=render_outcomes(run),
        panels=_panels(run),
        plan=run_figures.draw_plan(run.subject, truth, {} if many else run.waypoints, marks=run.marks),
        marked=bool(run.marks),
        altitude=None if many else run_figures.draw_altitude(run.subject, run.truth),
        gaps=render_gaps(run),
        airspace=render_airspace(run),
        quiet=timeline.quiet_end(run),
        recorded=quantities.duration(run.recorded_ns / NS_PER_S),
        lanes=timeline.render_lanes(run),
        links=sections.render_links(run),
        air=sections.reception_section(run.reception_summaries, len(run.fleet), run.recorded_ns / NS_PER_S),
        coverage=sections.coverage_section(run),
        events=timeline.render_happenings([*run.events, *run.attacks], run, "events", "Events and hostile acts"),
        decisions=timeline.render_happenings(run.decisions, run, "decisions", "Decisions of ground stations"),
        folder=str(run.record.path),
        left_out=left_out(notes),
        city=city_lines(run.record.manifest),
        mission_files=mission_file_lines(run.record.manifest),
        placing=describe_placing(run.record.manifest.get("placing") or ()),
        digests=run.manifest.get("digests") or {},
    )


def _panels(run: RunContents) -> Sequence[Mapping[str, Any]]:
    """One still figure per operator, which the page's script replaces by one that turns; of many aircraft none."""
    panels = []
    for operator in run.operator_colours:
        vehicles = [vehicle for vehicle in run.fleet if vehicle.operator == operator]
        panels.append(
            {
                "operator": operator,
                "aircraft": len(vehicles),
                "positions": sum(flight.positions for flight in run.flights if flight.vehicle.operator == operator),
                "drawing": None
                if len(run.fleet) > MANY_AIRCRAFT
                else run_figures.draw_boxes(
                    run.subject, run.belief, [operator] if vehicles else [], "belief", titled=False
                ),
            }
        )
    return panels


def colour_rules(operator_colours: Mapping[str, ThemeColour], subject: Subject) -> Markup:
    """CSS rules with the colours of operators and aircraft, for light and dark pages."""
    return render(
        "colours.css.jinja",
        colours=[
            *((f".op-{place}", colour) for place, colour in enumerate(operator_colours.values())),
            *((f".ink-{index}", subject.colours[vehicle.id]) for index, vehicle in enumerate(subject.fleet)),
        ],
    )
