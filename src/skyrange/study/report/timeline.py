"""What happened when, and to whom? Swim lanes of events per aircraft, and the tables behind them."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from skyrange.core.ids import operator_of
from skyrange.core.time import NS_PER_S
from skyrange.study.marks import alarming
from skyrange.study.report import words
from skyrange.study.report.gathered import Gathered
from skyrange.study.series import Happening
from skyrange.study.svg import label, ticks

MOST_MARKS = 400
"""Marks drawn in one lane; later ones are in the table."""
MOST_LANES = 24
"""Lanes of a larger fleet scroll in a box of their own, below a time axis that stays."""
MOST_ROWS = 1_500
"""Rows of one table on the page."""

HARD_MPS = 2.0
"""A ground contact faster than this is marked red; ArduCopter's LAND_SPEED is 0.5 m/s by default."""

_GLYPHS = {
    "event.armed": ("armed", "armed"),
    "event.disarmed": ("disarmed", "disarmed"),
    "event.takeoff": ("takeoff", "take-off"),
    "event.landed": ("landed", "landed"),
    "event.item_reached": ("item", "item reached"),
    "event.contact": ("contact", "ground contact"),
    "event.collision": ("collision", "collision"),
    "event.crash": ("crash", "crash"),
    "event.fence_breach": ("alarm", "fence breached"),
    "event.battery": ("alarm", "battery low"),
    "event.estimator": ("alarm", "estimator"),
    "event.glitch": ("alarm", "GNSS glitch"),
    "event.ekf_failsafe": ("alarm", "estimator failsafe"),
    "event.signature_refused": ("alarm", "signature refused"),
    "event.outcome": ("outcome", "mission complete"),
}
_SHAPES = {
    "armed": '<circle r="4.5" class="hollow"/>',
    "disarmed": '<circle r="4.5" class="hollow"/><path d="M-3 3L3 -3" class="stroke"/>',
    "takeoff": '<path d="M0 -6L6 5H-6z"/>',
    "landed": '<path d="M0 6L6 -5H-6z"/>',
    "item": '<path d="M0 -5L5 0L0 5L-5 0z"/>',
    "contact": '<path d="M-4.5 4.5H4.5" class="stroke"/>',
    "collision": '<path d="M0 -7L0 7M-7 0L7 0M-5 -5L5 5M5 -5L-5 5" class="stroke alarm"/>',
    "alarm": '<path d="M0 -6L6 5H-6z" class="hollow stroke alarm"/>',
    "crash": '<path d="M-5 -5L5 5M5 -5L-5 5" class="stroke alarm"/>',
    "outcome": '<path d="M-5 0L-1.5 4L5.5 -5" class="stroke good"/>',
    "failed": '<circle r="6" class="hollow alarm"/><path d="M-2 -2L2 2M2 -2L-2 2" class="stroke alarm"/>',
    "attack": '<path d="M0 -11V11" class="stroke alarm"/>',
    "other": '<circle r="2.6"/>',
}


def calm(run: Gathered) -> str:
    """A sentence on where the views end, if the run went on without anything to see."""
    if run.recorded_ns - run.end_ns < 0.05 * run.recorded_ns:
        return ""
    return (
        f'<p class="lead">Nothing moved and nothing was noted in the last '
        f"{words.duration((run.recorded_ns - run.end_ns) * 1e-9)} of {words.duration(run.recorded_ns * 1e-9)}; "
        "the clock of this page stops there.</p>"
    )


def lanes(run: Gathered) -> str:
    """One lane per aircraft: its modes as bands, its events as marks, hostile acts on it as red strokes."""
    if not run.fleet or not (run.events or run.attacks):
        return words.nothing("No event is on record.")
    by_owner: dict[str, list[Happening]] = {}
    for happening in sorted([*run.events, *run.attacks], key=lambda each: each.time_ns):
        by_owner.setdefault(happening.about.split(".", 1)[0], []).append(happening)
    modes: dict[str, int] = {}
    rows = [_axis(run)]
    operator: str | None = None
    for index, vehicle in enumerate(run.fleet):
        if vehicle.operator != operator:
            operator = vehicle.operator
            place = list(run.operator_inks).index(operator)
            rows.append(f'<div class="lane-group"><span class="swatch op-{place}"></span>{escape(operator)}</div>')
        own = by_owner.get(vehicle.id, [])
        rows.append(
            f'<div class="lane" data-v="{index}"><div class="lane-name">{escape(vehicle.short)}</div>'
            f'<svg class="lane-marks ink-{index}" height="26" role="img" aria-label="{_spoken(vehicle.id, own)}">'
            f"{_bands(run, own, modes)}{_marks(run, own)}</svg></div>"
        )
    many = " many" if len(run.fleet) > MOST_LANES else ""
    drawn = f'<div class="lanes" id="lanes">{"".join(rows)}<div class="now" hidden></div></div>'
    return f'{_legend(run, modes)}<div class="scroll{many}">{drawn}</div>'


def table(rows: Sequence[Happening], run: Gathered, name: str, title: str) -> str:
    """A table that the page's script filters by text and kind; a row jumps to its time."""
    if not rows:
        return words.nothing(f"No {name} on record.")
    shown = sorted(rows, key=lambda row: row.time_ns)[:MOST_ROWS]
    places = {vehicle.id: index for index, vehicle in enumerate(run.fleet)}
    options = "".join(f"<option>{escape(kind)}</option>" for kind in sorted({row.kind for row in shown}))
    body = "".join(_row(row, places) for row in shown)
    heads = "".join(f"<th scope=col>{head}</th>" for head in ("about", "kind", "details", "noted by"))
    cut = f"<p class=note>The first {words.count(len(shown))} of {words.count(len(rows))}; the record holds all.</p>"
    return (
        f'<div class="filter" data-table="{name}">'
        f'<input type="search" placeholder="Filter {name}…" aria-label="Filter {name}">'
        f'<select aria-label="Kind of {name}"><option value="">every kind</option>{options}</select>'
        f'<output class="dim" aria-live="polite">{words.count(len(shown))} rows</output></div>'
        f'<div class="scroll tall"><table class="grid log" id="{name}"><caption class="vh">{escape(title)}</caption>'
        f"<thead><tr><th scope=col class=num>time, s</th>{heads}</tr></thead><tbody>{body}</tbody></table></div>"
        f"{cut if len(rows) > len(shown) else ''}"
    )


def _row(row: Happening, places: dict[str, int]) -> str:
    place = places.get(row.about.split(".", 1)[0])
    about = words.named(place, row.about) if place is not None else escape(row.about)
    marked = f' data-v="{place}"' if place is not None else ""
    family, _, rest = row.kind.partition(".")
    why = ""
    if row.causes:
        said = "1 cause" if len(row.causes) == 1 else f"{len(row.causes)} causes"
        why = f'<span class="why" title="{escape(", ".join(row.causes), quote=True)}">{said}</span>'
    return (
        f'<tr data-t="{row.time_ns * 1e-9:.3f}" data-k="{escape(row.kind, quote=True)}"{marked}>'
        f'<td class=num><button type="button">{row.time_ns * 1e-9:.2f}</button></td><td>{about}</td>'
        f'<td><span class="kind {escape(family, quote=True)}">{escape((rest or family).replace("_", " "))}</span></td>'
        f"<td>{words.details(row.data)}{why}</td><td class=dim>{escape(row.source)}</td></tr>"
    )


def _part(run: Gathered, time_ns: int) -> str:
    """Where a moment lies between the run's start and end, in percent."""
    return f"{100 * min(max((time_ns - run.start_ns) / (run.end_ns - run.start_ns), 0.0), 1.0):.2f}"


def _bands(run: Gathered, own: Sequence[Happening], modes: dict[str, int]) -> str:
    changes = [row for row in own if row.kind == "event.mode"]
    parts = []
    ends = [row.time_ns for row in changes[1:]] + [run.end_ns]
    for row, until in zip(changes, ends, strict=False):  # no change, no band
        mode = str(row.data.get("mode", "?"))
        place = modes.setdefault(mode, len(modes)) % 8
        why = f" for {reason}" if (reason := str(row.data.get("reason", "")).replace("_", " ")) else ""
        span = f"{row.time_ns * 1e-9:.2f} s to {until * 1e-9:.2f} s"
        share = (until - row.time_ns) / (run.end_ns - run.start_ns)
        parts.append(
            f'<rect class="mode-{place}" x="{_part(run, row.time_ns)}%" y="3" width="{100 * max(share, 0):.2f}%" '
            f'height="20" rx="3"><title>{escape(mode + why)} from {span}</title>'
            "</rect>"
        )
    return "".join(parts)


def _marks(run: Gathered, own: Sequence[Happening]) -> str:
    parts = []
    for row in [row for row in own if row.kind != "event.mode" or alarming(row)][:MOST_MARKS]:
        glyph = _glyph(row)
        said = " ".join(f"{key} {value}" for key, value in row.data.items())
        parts.append(
            f'<svg x="{_part(run, row.time_ns)}%" y="13" overflow="visible" class="mark"><g>{_SHAPES[glyph]}'
            f"<title>{escape(row.kind)} at {row.time_ns * 1e-9:.2f} s {escape(said)}</title></g></svg>"
        )
    return "".join(parts)


def _glyph(row: Happening) -> str:
    if row.kind.startswith("attack."):
        return "attack"
    if row.kind == "event.mode":
        return "alarm"
    if row.kind == "event.outcome" and row.data.get("state") != "complete":
        return "failed"
    if row.data.get("on") is False:  # over again
        return "other"
    speed = row.data.get("speed_mps")
    if row.kind == "event.contact" and isinstance(speed, float) and speed > HARD_MPS:
        return "crash"
    return _GLYPHS.get(row.kind, ("other", ""))[0]


def _axis(run: Gathered) -> str:
    values, step = ticks(run.start_ns * 1e-9, run.end_ns * 1e-9, 10)
    marks = "".join(
        f'<text x="{_part(run, round(value * NS_PER_S))}%" y="14" font-size="11" text-anchor="middle">'
        f"{label(value, step)}</text>"
        for value in values
        if 0.01 < (value * NS_PER_S - run.start_ns) / (run.end_ns - run.start_ns) < 0.99
    )
    return (
        '<div class="lane axis"><div class="lane-name">time, s</div>'
        f'<svg class="lane-marks" height="20" aria-hidden="true">{marks}</svg></div>'
    )


def _legend(run: Gathered, modes: dict[str, int]) -> str:
    seen = {row.kind for row in run.events if _glyph(row) == _GLYPHS.get(row.kind, ("", ""))[0]}
    items = [f'<span><i class="mode-{place % 8}"></i>{escape(mode)}</span>' for mode, place in modes.items()]
    used = [pair for kind, pair in _GLYPHS.items() if kind in seen]
    if any(alarming(row) == "failsafe" for row in run.events):
        used.append(("alarm", "failsafe"))
    if any(_glyph(row) == "failed" for row in run.events):
        used.append(("failed", "mission failed"))
    if run.attacks:
        used.append(("attack", "hostile act"))
    if any(_glyph(row) == "other" and row.kind != "event.mode" for row in run.events):
        used.append(("other", "another event"))
    for glyph, said in used:
        items.append(
            '<span><svg width="14" height="14" viewBox="-7 -7 14 14" class="mark" aria-hidden="true">'
            f"{_SHAPES[glyph]}</svg>{said}</span>"
        )
    return f'<div class="legend">{"".join(items)}</div>'


def _spoken(vehicle: str, own: Sequence[Happening]) -> str:
    """The lane in words, for a screen reader."""
    said = []
    for row in own[:20]:
        what = row.data.get("mode") if row.kind == "event.mode" else row.kind.split(".", 1)[-1].replace("_", " ")
        said.append(f"{what} at {row.time_ns * 1e-9:.1f} s")
    return escape(f"{vehicle} of {operator_of(vehicle)}: {', '.join(said) or 'no events'}", quote=True)
