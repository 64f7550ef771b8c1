"""Results of the benchmark of Gazebo as tables in Markdown, and as a figure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from skyrange.figures import svg
from skyrange.figures.palette import OKABE_ITO
from skyrange.figures.svg import Figure, format_number

_NAMES: Final = {"gazebo": "Gazebo", "range": "the range's own physics"}
_MOTORS: Final = ("front right", "rear left", "front left", "rear right")
"""ArduCopter's order of the motors of an X frame."""


def make_markdown(data: Mapping[str, Any], picture: str = "") -> str:
    """The tables of the document that `measure_all` makes; `picture` is its figure as links name it, "" for none."""
    return "\n".join(_lines(data, picture))


def _lines(data: Mapping[str, Any], picture: str) -> Iterator[str]:
    rows, machine = data["rows"], data["machine"]
    first = rows[0]
    versions = first["versions"]
    yield (
        f"{versions['gazebo']} ({versions['physics']}) and ArduCopter {versions['arducopter']}, "
        f"{'with' if first['window'] else 'without'} Gazebo's window, on {machine['cores']} cores "
        f"({machine['processor']}). Medians of {first['windows']} times {first['seconds']:g} s, in Gazebo and in the "
        f"range's own physics in turn. The load average was {data['loadavg'][0]:g} before and {data['loadavg'][1]:g} "
        "after it. Where it is larger than the number of cores, others used the machine too: then read the last column."
    )
    yield ""
    heads = (
        "aircraft", "× real time in Gazebo", "inverse", "Gazebo, cores", "ArduPilots, cores", "skyrange, cores",
        *(["window, cores"] if first["window"] else []), "× real time in the range", "range / Gazebo",
    )  # fmt: skip
    yield "| " + " | ".join(heads) + " |"
    yield "|---:" * len(heads) + "|"
    for row in rows:
        there, here = row["gazebo"], row["range"]
        cells = [
            there["real_time_factor"], there["inverse"], there["gazebo_cpu_s"], there["autopilots_cpu_s"],
            there["ours_cpu_s"],
            *([there["window_cpu_s"]] if first["window"] else []), here["real_time_factor"], row["slower"],
        ]  # fmt: skip
        yield f"| {row['vehicles']} | " + " | ".join(f"{cell:.2f}" for cell in cells) + " |"
    yield ""
    yield (
        "*Cores* are processor seconds for one simulated second. Their sum is what real time needs at least, on a "
        "machine with nothing else to do."
    )
    yield ""
    published = data["published"]
    for physics, name in _NAMES.items():
        yield f"- In {name}, {_largest(data['real_time'][physics])}."
    yield (
        f"- The published system runs about {published['vehicles']} aircraft in Gazebo in real time, "
        f"{published['source']}."
    )
    yield ""
    if picture:
        yield f"![Inverse real-time factor in Gazebo, against the number of aircraft]({picture})"
        yield ""
    if data["collisions"]:
        yield from _collisions(data["collisions"])


def _largest(largest: Mapping[str, Any]) -> str:
    if largest["measured"] is None:
        return "none of these numbers of aircraft runs in real time"
    if largest["interpolated"] is None:
        return f"at least {largest['measured']} aircraft run in real time, the largest number measured"
    return (
        f"{largest['measured']} aircraft run in real time, the largest such number measured; by interpolation of the "
        f"inverse, {largest['interpolated']:.0f}"
    )


def _collisions(collisions: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield "Two aircraft fly toward each other at 5 m/s each, 30 m high, with ideal sensors in still air:"
    yield ""
    heads = (
        "physics", "aircraft", "contact at", "relative speed", "energy", "propellers lost", "height before",
        "after 0.5, 1 and 2 s", "on the ground after",
    )  # fmt: skip
    yield "| " + " | ".join(heads) + " |"
    yield "|---" * len(heads) + "|"
    for collision in collisions:
        for vehicle, fell in collision["aircraft"].items():
            cells = [
                _NAMES[collision["physics"]],
                vehicle.partition("/")[0],
                f"{collision['time_s']:.2f} s",
                f"{collision['speed_mps']:.2f} m/s",
                f"{collision['energy_j']:.1f} J",
                ", ".join(_MOTORS[motor] for motor in fell["lost_motors"]) or "none",
                f"{fell['height_before_m']:.1f} m",
                ", ".join(f"{height_m:.1f}" for height_m in fell["heights_after_m"]) + " m",
                "still flying" if fell["fell_s"] is None else f"{fell['fell_s']:.1f} s",
            ]
            yield "| " + " | ".join(cells) + " |"
    yield ""


def draw(data: Mapping[str, Any]) -> Figure:
    """Inverse real-time factor against the number of aircraft, in both kinds of physics, with real time and the
    published number marked.
    """
    width, height, left, top, right, foot = 720.0, 380.0, 56.0, 16.0, 190.0, 52.0
    rows = data["rows"]
    published = data["published"]["vehicles"]
    most = max([published, *(row["vehicles"] for row in rows)]) * 1.04
    slowest = max([1.2, *(row[physics]["inverse"] for row in rows for physics in _NAMES)]) * 1.06

    def place(vehicles: float, inverse: float) -> tuple[float, float]:
        x = left + vehicles / most * (width - left - right)
        return x, height - foot - inverse / slowest * (height - top - foot)

    body = []
    values, step = svg.ticks(0.0, slowest)
    for value in values:
        x, y = place(0.0, value)
        body.append(svg.element("path", {"d": f"M{format_number(x)} {format_number(y)}H{width - right}", **svg.GRID}))
        body.append(svg.label(left - 8, y + 4, svg.format_tick(value, step), "end"))
    counts, step = svg.ticks(0.0, most, 8)
    body += [svg.label(place(count, 0.0)[0], height - foot + 18, svg.format_tick(count, step)) for count in counts]
    body.append(svg.label(width - right, height - 10, "aircraft", "end", 12))
    strong = {"stroke": "currentColor", "stroke-opacity": ".55"}
    x, y = place(0.0, 1.0)
    body.append(svg.element("path", {"d": f"M{format_number(x)} {format_number(y)}H{width - right}", **strong}))
    body.append(svg.label(width - right + 8, y + 4, "real time", "start", 12))
    x, y = place(published, 1.0)
    mark: svg.Attributes = {"cx": x, "cy": y, "r": 6.0, "fill": "none", "stroke": "currentColor", "stroke-width": "2"}
    body.append(svg.element("circle", mark, svg.title(f"published: about {published} aircraft in real time")))
    caption = f"published, about {published}"
    body.append(
        svg.label(x, y - 14, caption, "middle", 12)
        if x > left + 62.0
        else svg.label(x + 10, y - 8, caption, "start", 12)
    )
    for number, (physics, name) in enumerate(_NAMES.items()):
        ink = {"stroke": OKABE_ITO[(2, 0)[number]], "fill": "none", "stroke-width": "2"}
        points = np.array([place(row["vehicles"], row[physics]["inverse"]) for row in rows])
        body.append(svg.element("path", {"d": svg.path_data(points), **ink}))
        for (x, y), row in zip(points.tolist(), rows, strict=True):
            dot: svg.Attributes = {"cx": x, "cy": y, "r": 3.0, "fill": ink["stroke"]}
            shown = f"{row['vehicles']} aircraft: {row[physics]['inverse']:.2f}"
            body.append(svg.element("circle", dot, svg.title(shown)))
        y = top + 14 + 20 * number
        line = f"M{format_number(width - right + 8)} {format_number(y - 4)}h22"
        body.append(svg.element("path", {"d": line, **ink}))
        body.append(svg.label(width - right + 36, y, name, "start", 12))
    return svg.document(width, height, "Inverse real-time factor in Gazebo, against the number of aircraft", body)
