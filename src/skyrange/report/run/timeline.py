"""Timeline of a run: one lane of modes and events per aircraft, and tables of events and decisions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from markupsafe import Markup

from skyrange.core.ids import operator_of
from skyrange.core.time import NS_PER_S
from skyrange.figures.svg import format_tick, ticks
from skyrange.metrics.safety import mishap_kind
from skyrange.metrics.time_series import RecordedNote, Vehicle
from skyrange.report import quantities
from skyrange.report.rendering import render
from skyrange.report.run.contents import RunContents
from skyrange.report.viewer import link_moment

MAX_MARKS = 400
"""Marks drawn in one lane; the table has more."""
MAX_LANES = 24
"""With more aircraft the lanes scroll in a box below a fixed time axis."""
MAX_ROWS = 3_000
"""Rows of one table on the page."""

HARD_MPS = 2.0
"""A ground contact at a higher speed is drawn as a crash; ArduCopter's LAND_SPEED is 0.5 m/s by default."""

_SYMBOLS = {
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
    "event.signing_key": ("alarm", "signing key changed"),
    "event.signature_refused": ("alarm", "signature refused"),
    "event.outcome": ("outcome", "mission reported complete"),
}
_ACTS = {"attack": "hostile act", "fault": "act of a fault", "harmless": "act of a sham"}
"""Symbols of labelled acts by their author, and their meanings."""


def quiet_end(run: RunContents) -> quantities.Quantity | None:
    """Duration of the record after the end of the page's clock; `None` if it is less than 5 % of the record."""
    if run.recorded_ns - run.end_ns < 0.05 * run.recorded_ns:
        return None
    return quantities.duration((run.recorded_ns - run.end_ns) / NS_PER_S)


def render_lanes(run: RunContents) -> Markup:
    """Render one lane per aircraft: modes as bands, events as marks, acts as strokes: red, or grey those of faults."""
    by_owner: dict[str, list[RecordedNote]] = {}
    for happening in sorted([*run.events, *run.attacks], key=lambda item: item.time_ns):
        by_owner.setdefault(happening.about.split(".", 1)[0], []).append(happening)
    modes: dict[str, int] = {}
    places = {operator: place for place, operator in enumerate(run.operator_colours)}
    groups = []
    for operator, fleet in groupby(enumerate(run.fleet), key=lambda entry: entry[1].operator):
        drawn = [_lane(run, index, vehicle, by_owner.get(vehicle.id, []), modes) for index, vehicle in fleet]
        groups.append({"operator": operator, "place": places[operator], "lanes": drawn})
    return render(
        "run/lanes.html.jinja",
        groups=groups if run.events or run.attacks else [],
        modes=modes,
        symbols=_legend(run),
        many=len(run.fleet) > MAX_LANES,
        ticks=_ticks(run),
    )


def render_happenings(rows: Sequence[RecordedNote], run: RunContents, name: str, title: str) -> Markup:
    """Render a table of events or decisions, which the page's script filters and whose rows set the clock."""
    shown = sorted(rows, key=lambda row: row.time_ns)[:MAX_ROWS]
    places = {vehicle.id: index for index, vehicle in enumerate(run.fleet)}
    return render(
        "run/notes.html.jinja",
        name=name,
        title=title,
        kinds=sorted({row.kind for row in shown}),
        rows=[_row(row, places) for row in shown],
        total=len(rows),
    )


def _row(row: RecordedNote, places: Mapping[str, int]) -> Mapping[str, Any]:
    family, _, rest = row.kind.partition(".")
    vehicle = row.about.split(".", 1)[0]
    return {
        "link": link_moment(row.time_ns / NS_PER_S, vehicle if vehicle in places else ""),
        "time_s": row.time_ns * 1e-9,
        "place": places.get(vehicle),
        "about": row.about,
        "kind": row.kind,
        "family": family,
        "said": (rest or family).replace("_", " "),
        "data": row.data,
        "causes": row.causes,
        "source": row.source,
    }


def _lane(
    run: RunContents, index: int, vehicle: Vehicle, notes: Sequence[RecordedNote], modes: dict[str, int]
) -> Mapping[str, Any]:
    return {
        "index": index,
        "name": vehicle.short,
        "spoken": _spoken(vehicle.id, notes),
        "bands": _bands(run, notes, modes),
        "marks": _marks(run, notes),
    }


def _part(run: RunContents, time_ns: int) -> str:
    """Position of a time between the start and end of the page's clock, in percent."""
    return f"{100 * min(max((time_ns - run.start_ns) / (run.end_ns - run.start_ns), 0.0), 1.0):.2f}"


def _bands(run: RunContents, notes: Sequence[RecordedNote], modes: dict[str, int]) -> Sequence[Mapping[str, Any]]:
    """The flight modes of one aircraft; `modes` numbers them in order of appearance and is extended."""
    changes = [row for row in notes if row.kind == "event.mode"]
    bands = []
    ends = [row.time_ns for row in changes[1:]] + [run.end_ns]
    for row, until in zip(changes, ends, strict=False):  # no change, no band
        mode = str(row.data.get("mode", "?"))
        why = f" for {reason}" if (reason := str(row.data.get("reason", "")).replace("_", " ")) else ""
        span = f"{row.time_ns * 1e-9:.2f} s to {until * 1e-9:.2f} s"
        share = (until - row.time_ns) / (run.end_ns - run.start_ns)
        bands.append(
            {
                "mode": modes.setdefault(mode, len(modes)) % 8,
                "start": _part(run, row.time_ns),
                "width": f"{100 * max(share, 0):.2f}",
                "title": f"{mode + why} from {span}",
            }
        )
    return bands


def _marks(run: RunContents, notes: Sequence[RecordedNote]) -> Sequence[Mapping[str, str]]:
    marks = []
    for row in [row for row in notes if row.kind != "event.mode" or mishap_kind(row)][:MAX_MARKS]:
        details = " ".join(f"{key} {value}" for key, value in row.data.items())
        title = f"{row.kind} at {row.time_ns * 1e-9:.2f} s {details}"
        marks.append({"place": _part(run, row.time_ns), "symbol": _symbol(row), "title": title})
    return marks


def _symbol(row: RecordedNote) -> str:
    """The name under which the template draws an event's symbol."""
    author = row.kind.partition(".")[0]
    if author in _ACTS:
        return author
    if row.kind == "event.mode":
        return "alarm"
    if row.kind == "event.outcome" and row.data.get("state") != "complete":
        return "failed"
    if row.data.get("on") is False:  # over again
        return "other"
    speed = row.data.get("speed_mps")
    if row.kind == "event.contact" and isinstance(speed, float) and speed > HARD_MPS:
        return "crash"
    return _SYMBOLS.get(row.kind, ("other", ""))[0]


def _ticks(run: RunContents) -> list[tuple[str, str]]:
    """Positions in percent and texts of the ticks of the time axis."""
    values, step = ticks(run.start_ns * 1e-9, run.end_ns * 1e-9, 10)
    return [
        (_part(run, round(value * NS_PER_S)), format_tick(value, step))
        for value in values
        if 0.01 < (value * NS_PER_S - run.start_ns) / (run.end_ns - run.start_ns) < 0.99
    ]


def _legend(run: RunContents) -> list[tuple[str, str]]:
    """Names and meanings of the symbols in use."""
    kinds = {row.kind for row in run.events if _symbol(row) == _SYMBOLS.get(row.kind, ("", ""))[0]}
    used = [pair for kind, pair in _SYMBOLS.items() if kind in kinds]
    if any(mishap_kind(row) == "failsafe" for row in run.events):
        used.append(("alarm", "failsafe"))
    if any(_symbol(row) == "failed" for row in run.events):
        used.append(("failed", "mission failed"))
    for author, meaning in _ACTS.items():
        if any(_symbol(row) == author for row in run.attacks):
            used.append((author, meaning))
    if any(_symbol(row) == "other" and row.kind != "event.mode" for row in run.events):
        used.append(("other", "another event"))
    return used


def _spoken(vehicle: str, notes: Sequence[RecordedNote]) -> str:
    """Description of a lane for screen readers."""
    phrases = []
    for row in notes[:20]:
        what = row.data.get("mode") if row.kind == "event.mode" else row.kind.split(".", 1)[-1].replace("_", " ")
        phrases.append(f"{what} at {row.time_ns * 1e-9:.1f} s")
    return f"{vehicle} of {operator_of(vehicle)}: {', '.join(phrases) or 'no events'}"
