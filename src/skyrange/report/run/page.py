"""Page of a run: sections, style, script and data in one file, with a content security policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from skyrange.assembly.placement.moved_places import describe_placing
from skyrange.core.time import NS_PER_S
from skyrange.figures import run as run_figures
from skyrange.figures.palette import ThemeColour
from skyrange.figures.subject import Subject
from skyrange.metrics.time_series import Record
from skyrange.report import quantities, reception_tables
from skyrange.report.rendering import asset, content_policy, render
from skyrange.report.run import link_tables, overview, radio_coverage, timeline
from skyrange.report.run.airspace import render_airspace
from skyrange.report.run.contents import RunContents, read_run
from skyrange.report.run.scene_data import pack_scene

SCRIPTS = ("base.js", "city.js", "gl.js", "flat.js", "scene.js", "panels.js", "chart.js", "page.js")
"""Parts of the page's script in order, wrapped in one function."""


def render_run(record: Record) -> str:
    """The page as text."""
    run = read_run(record)
    scene, notes = pack_scene(run)
    style = asset("style.css") + colour_rules(run.operator_colours, run.subject)
    script = Markup('"use strict";(()=>{\n') + Markup("\n").join(asset(name) for name in SCRIPTS) + Markup("\n})();")
    return render(
        "run/page.html.jinja",
        policy=content_policy(style, script),
        title=f"{run.manifest.get('name') or 'run'} · skyrange",
        style=style,
        script=script,
        scene=scene,
        warning=overview.warning(run),
        level=overview.level(run),
        has_frames=run.has_frames,
        **overview.identity(run),
        numbers=overview.numbers(run),
        overview=run_figures.draw_overview(run.subject, run.truth, run.marks),
        outcomes=overview.render_outcomes(run),
        panels=_panels(run),
        plan=run_figures.draw_plan(run.subject, run.truth, run.waypoints, marks=run.marks),
        marked=bool(run.marks),
        altitude=run_figures.draw_altitude(run.subject, run.truth),
        gaps=overview.render_gaps(run),
        airspace=render_airspace(run),
        quiet=timeline.quiet_end(run),
        recorded=quantities.duration(run.recorded_ns / NS_PER_S),
        lanes=timeline.render_lanes(run),
        links=link_tables.render_links(run),
        air=reception_tables.reception_section(run.reception_summaries, len(run.fleet), run.recorded_ns / NS_PER_S),
        coverage=radio_coverage.coverage_section(run),
        events=timeline.render_happenings([*run.events, *run.attacks], run, "events", "Events and hostile acts"),
        decisions=timeline.render_happenings(run.decisions, run, "decisions", "Decisions of ground stations"),
        folder=str(run.record.path),
        left_out=overview.left_out(notes),
        city=overview.city_lines(run.record.manifest),
        mission_files=overview.mission_file_lines(run.record.manifest),
        placing=describe_placing(run.record.manifest.get("placing") or ()),
        digests=run.manifest.get("digests") or {},
    )


def _panels(run: RunContents) -> Sequence[Mapping[str, Any]]:
    """One still figure per operator, which the page's script replaces by one that turns."""
    panels = []
    for operator in run.operator_colours:
        own = [vehicle for vehicle in run.fleet if vehicle.operator == operator]
        panels.append(
            {
                "operator": operator,
                "aircraft": len(own),
                "positions": sum(each.positions for each in run.flights if each.vehicle.operator == operator),
                "drawing": run_figures.draw_boxes(
                    run.subject, run.belief, [operator] if own else [], "belief", titled=False
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
