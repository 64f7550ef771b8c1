"""How do the parts become one page? Template, styles, script and data in one file, sealed by a content policy."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping
from html import escape
from importlib.resources import files
from string import Template

from skyrange.core.time import NS_PER_S
from skyrange.study import figures
from skyrange.study.palette import Ink
from skyrange.study.report import hearing, linktable, sections, timeline, words
from skyrange.study.report.embedded import embed
from skyrange.study.report.gathered import Gathered, gather
from skyrange.study.series import Record
from skyrange.study.subject import Subject

SCRIPTS = ("base.js", "city.js", "gl.js", "flat.js", "scene.js", "panels.js", "chart.js", "page.js")
"""The page's script, in order; one function scope around all of them."""


def render(record: Record) -> str:
    """The whole page as text."""
    run = gather(record)
    data, notes = embed(run)
    style = asset("style.css") + ink_rules(run.operator_inks, run.subject)
    script = '"use strict";(()=>{\n' + "\n".join(asset(name) for name in SCRIPTS) + "\n})();"
    air = hearing.heard_section(run.hearings, len(run.fleet), run.recorded_ns / NS_PER_S)
    return Template(asset("page.html")).substitute(
        policy=escape(_policy(style, script), quote=True),
        title=escape(f"{run.manifest.get('name') or 'run'} · skyrange"),
        style=style,
        script=script,
        data=data,
        banner=sections.banner(run),
        masthead=sections.masthead(run),
        tiles=sections.tiles(run),
        outcomes=sections.outcomes(run),
        panels=_panels(run),
        plan=figures.draw_plan(run.subject, run.truth, run.waypoints, marks=run.marks).svg,
        marks="; crosses collisions and crashes, triangles failsafes" if run.marks else "",
        altitude=figures.draw_altitude(run.subject, run.truth).svg,
        gaps=sections.gaps(run),
        links=linktable.links(run),
        air=air,
        to_air='<a href="#air">Air</a>' if air else "",
        calm=timeline.calm(run),
        lanes=timeline.lanes(run),
        events=timeline.table([*run.events, *run.attacks], run, "events", "Events and hostile acts"),
        decisions=timeline.table(run.decisions, run, "decisions", "Decisions of ground stations"),
        opening=sections.data(run, notes),
        overview=figures.draw_overview(run.subject, run.truth, run.marks).svg,
    )


def _panels(run: Gathered) -> str:
    """One figure per operator: drawn by the script where there is one, else the still picture."""
    cells = []
    for place, operator in enumerate(run.operator_inks):
        own = [vehicle for vehicle in run.fleet if vehicle.operator == operator]
        heard = sum(flight.positions for flight in run.flights if flight.vehicle.operator == operator)
        still = figures.draw_boxes(run.subject, run.belief, [operator] if own else [], "belief", titled=False)
        cells.append(
            f'<figure class="card panel" data-op="{place}"><figcaption><span class="swatch op-{place}"></span>'
            f"<b>{escape(operator)}</b> <span class=dim>{len(own)} aircraft · {words.count(heard)} positions received"
            f'</span></figcaption><div class="still">{still.svg}</div></figure>'
        )
    return "".join(cells)


def ink_rules(operator_inks: Mapping[str, Ink], subject: Subject) -> str:
    """The colours of operators and aircraft as custom properties, for a light and for a dark page."""
    names = [(f".op-{place}", colour) for place, colour in enumerate(operator_inks.values())]
    names += [(f".ink-{index}", subject.inks[vehicle.id]) for index, vehicle in enumerate(subject.fleet)]
    light = "".join(f"{name}{{--ink:{colour.light}}}" for name, colour in names)
    dark = "".join(f"{name}{{--ink:{colour.dark}}}" for name, colour in names)
    return f"{light}@media screen and (prefers-color-scheme:dark){{{dark}}}"


def _policy(style: str, script: str) -> str:
    """Nothing may be fetched; only this very style and script count."""
    return (
        f"default-src 'none'; style-src '{_hash(style)}'; script-src '{_hash(script)}'; "
        "base-uri 'none'; form-action 'none'"
    )


def sealed(style: str) -> str:
    """The content policy of a page without a script."""
    policy = f"default-src 'none'; style-src '{_hash(style)}'; base-uri 'none'; form-action 'none'"
    return escape(policy, quote=True)


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def asset(name: str) -> str:
    """A file beside the page's code, as text."""
    return files("skyrange.study.report").joinpath("assets", name).read_text(encoding="utf-8")
