"""Page of one run: its sections, styles, script and data in one file, sealed by a content policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from skyrange.core.time import NS_PER_S
from skyrange.study import figures
from skyrange.study.palette import Ink
from skyrange.study.report import hearing, linktable, sections, timeline, words
from skyrange.study.report.embedded import embed
from skyrange.study.report.gathered import Gathered, gather
from skyrange.study.report.rendering import asset, content_policy, render
from skyrange.study.series import Record
from skyrange.study.subject import Subject

SCRIPTS = ("base.js", "city.js", "gl.js", "flat.js", "scene.js", "panels.js", "chart.js", "page.js")
"""The page's script, in order; one function scope around all of them."""


def render_run(record: Record) -> str:
    """The whole page as text."""
    run = gather(record)
    scene, notes = embed(run)
    style = asset("style.css") + ink_rules(run.operator_inks, run.subject)
    script = Markup('"use strict";(()=>{\n') + Markup("\n").join(asset(name) for name in SCRIPTS) + Markup("\n})();")
    return render(
        "run/page.html.jinja",
        policy=content_policy(style, script),
        title=f"{run.manifest.get('name') or 'run'} · skyrange",
        style=style,
        script=script,
        scene=scene,
        warning=sections.warning(run),
        **sections.identity(run),
        numbers=sections.numbers(run),
        overview=figures.draw_overview(run.subject, run.truth, run.marks),
        outcomes=sections.outcomes(run),
        panels=_panels(run),
        plan=figures.draw_plan(run.subject, run.truth, run.waypoints, marks=run.marks),
        marked=bool(run.marks),
        altitude=figures.draw_altitude(run.subject, run.truth),
        gaps=sections.gaps(run),
        quiet=timeline.quiet_end(run),
        recorded=words.duration(run.recorded_ns / NS_PER_S),
        lanes=timeline.lanes(run),
        links=linktable.links(run),
        air=hearing.air(run.hearings, len(run.fleet), run.recorded_ns / NS_PER_S),
        events=timeline.table([*run.events, *run.attacks], run, "events", "Events and hostile acts"),
        decisions=timeline.table(run.decisions, run, "decisions", "Decisions of ground stations"),
        folder=str(run.record.path),
        left_out=sections.left_out(notes),
        digests=run.manifest.get("digests") or {},
    )


def _panels(run: Gathered) -> Sequence[Mapping[str, Any]]:
    """One figure per operator: drawn by the script where there is one, else the still picture."""
    panels = []
    for operator in run.operator_inks:
        own = [vehicle for vehicle in run.fleet if vehicle.operator == operator]
        panels.append(
            {
                "operator": operator,
                "aircraft": len(own),
                "positions": sum(each.positions for each in run.flights if each.vehicle.operator == operator),
                "drawing": figures.draw_boxes(
                    run.subject, run.belief, [operator] if own else [], "belief", titled=False
                ),
            }
        )
    return panels


def ink_rules(operator_inks: Mapping[str, Ink], subject: Subject) -> Markup:
    """The colours of operators and aircraft as custom properties, for a light and for a dark page."""
    return render(
        "inks.css.jinja",
        inks=[
            *((f".op-{place}", colour) for place, colour in enumerate(operator_inks.values())),
            *((f".ink-{index}", subject.inks[vehicle.id]) for index, vehicle in enumerate(subject.fleet)),
        ],
    )
