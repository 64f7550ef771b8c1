"""Measured speed of one run on several cores, and the figure of it.

`python -m tools.docs.measure_cores measure [CORES] [REPEAT]` flies the fleets of `FLEETS` on one core and on CORES, in
turn, REPEAT times, and rewrites `docs/data/cores.json`; it takes ten minutes for each repetition on two quiet cores.
`python -m tools.docs.measure_cores draw` rewrites the figure and the table of `docs/explanation/several-cores.md` from
that file.
"""

from __future__ import annotations

import json
import math
import platform
import re
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from skyrange.bench.cores import compare, measure
from skyrange.bench.fleet import FleetOptions
from skyrange.figures import svg
from skyrange.figures.palette import OKABE_ITO
from skyrange.figures.svg import Figure, format_number
from skyrange.runtime.cores import division

ROOT: Final = Path(__file__).parents[2]
DATA: Final = ROOT / "docs" / "data" / "cores.json"
PAGE: Final = ROOT / "docs" / "explanation" / "several-cores.md"
IMAGE: Final = ROOT / "docs" / "images" / "cores.svg"
SECTION: Final = re.compile(r"<!-- measured: cores -->\n(.*?)<!-- end: cores -->\n", re.DOTALL)
OPERATORS: Final = 4
FLEETS: Final = (
    *(("light", False, vehicles, 30.0) for vehicles in (8, 20, 100, 500, 1000, 2000)),
    *(("light", True, vehicles, 30.0) for vehicles in (8, 20, 100, 500, 1000, 2000)),
    *(("operator", False, vehicles, 10.0) for vehicles in (100, 1000)),
)
"""Load, whether with Remote ID, number of aircraft, seconds after the warm-up."""


def fly_fleets(cores: int, repeat: int) -> None:
    """Measure and write the file."""
    division.MIN_VEHICLES = division.MIN_ON_AIR = 1
    fleets = []
    for load, remote_id, vehicles, seconds in FLEETS:
        rows = [
            measure(
                vehicles, seconds, count, FleetOptions(load=load, remote_id=remote_id, operators=OPERATORS), turn=turn
            )
            for turn in range(repeat)
            for count in (1, cores)
        ]
        assert len({row["fingerprint"] for row in rows}) == 1
        fleet = {
            "load": load,
            "remote_id": remote_id,
            "vehicles": vehicles,
            "seconds": seconds,
            "compared": compare(rows),
        }
        fleets.append({**fleet, "rows": rows})
        print(json.dumps(fleet), flush=True)
    machine = {"system": platform.platform(), "processor": _processor()}
    DATA.write_text(
        json.dumps({"machine": machine, "cores": cores, "operators": OPERATORS, "fleets": fleets}, indent=1)
    )


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")


def draw(data: dict[str, Any]) -> Figure:
    """How many times as fast as one core, by number of aircraft, for each load: the whole command, and dashed the
    flight.
    """
    width, height, left, top, right, foot = 720.0, 380.0, 56.0, 16.0, 190.0, 52.0
    counts = sorted({fleet["vehicles"] for fleet in data["fleets"]})
    low, high = math.log(counts[0]), math.log(counts[-1])
    best = data["cores"] * 1.05

    def place(vehicles: float, factor: float) -> tuple[float, float]:
        across = (math.log(vehicles) - low) / (high - low)
        return left + across * (width - left - right), height - foot - factor / best * (height - top - foot)

    body = []
    for factor in np.arange(0.0, best, 0.25).tolist():
        x, y = place(counts[0], factor)
        strong = {"stroke": "currentColor", "stroke-opacity": ".55"} if factor == 1.0 else svg.GRID
        body.append(svg.element("path", {"d": f"M{format_number(x)} {format_number(y)}H{width - right}", **strong}))
        if factor % 0.5 == 0:
            body.append(svg.label(left - 8, y + 4, f"{factor:g}", "end"))
    for vehicles in counts:
        x, _ = place(vehicles, 0.0)
        body.append(svg.label(x, height - foot + 18, f"{vehicles}"))
    body.append(svg.label(width - right, height - 10, "aircraft, of four operators", "end", 12))
    for number, (load, remote_id) in enumerate((("light", False), ("light", True), ("operator", False))):
        fleets = [one for one in data["fleets"] if (one["load"], one["remote_id"]) == (load, remote_id)]
        if not fleets:
            continue
        ink = {"stroke": OKABE_ITO[number], "fill": "none", "stroke-width": "2"}
        for key, dashes in (("speed_up", {}), ("flight_speed_up", {"stroke-dasharray": "5 4"})):
            points = np.array([place(one["vehicles"], one["compared"][-1][key]) for one in fleets])
            body.append(svg.element("path", {"d": svg.path_data(points), **ink, **dashes}))
        name = f"{load}, Remote ID" if remote_id else load
        y = top + 14 + 20 * number
        line = f"M{format_number(width - right + 14)} {format_number(y - 4)}h22"
        body.append(svg.element("path", {"d": line, **ink}))
        body.append(svg.label(width - right + 42, y, name, "start", 12))
    y = top + 14 + 20 * 3
    line = f"M{format_number(width - right + 14)} {format_number(y - 4)}h22"
    body.append(svg.element("path", {"d": line, "stroke": "currentColor", "stroke-dasharray": "5 4"}))
    body.append(svg.label(width - right + 42, y, "the flight alone", "start", 12))
    return svg.document(width, height, f"Speed on {data['cores']} cores, times that on one", body)


def describe(data: dict[str, Any]) -> str:
    """The table of the page."""
    cores = data["cores"]
    lines = [
        f"| load | aircraft | one core, s | {cores} cores, s | times as fast | flight, times as fast |",
        "|---|---|---|---|---|---|",
    ]
    for fleet in data["fleets"]:
        alone, several = fleet["compared"][0], fleet["compared"][-1]
        name = f"{fleet['load']}, Remote ID" if fleet["remote_id"] else fleet["load"]
        lines.append(
            f"| {name} | {fleet['vehicles']} | {alone['total_s']:.1f} | {several['total_s']:.1f} | "
            f"{several['speed_up']:.2f} | {several['flight_speed_up']:.2f} |"
        )
    runs = data["fleets"][0]["compared"][0]["runs"]
    several = f"medians of {runs} runs each" if runs > 1 else "one run each"
    method = f"30 s of pre-flight and 30 s flown, at operator load 10 s; {several}, in turn"
    return "\n".join(
        [
            *lines,
            "",
            f"{method}, on {data['machine']['processor']}.",
            "",
        ]
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["measure"]:
        fly_fleets(*map(int, [*sys.argv[2:], *["2", "1"][len(sys.argv) - 2 :]]))
    read = json.loads(DATA.read_text())
    draw(read).save(IMAGE)
    page = PAGE.read_text()
    PAGE.write_text(SECTION.sub(lambda _: f"<!-- measured: cores -->\n{describe(read)}<!-- end: cores -->\n", page))
