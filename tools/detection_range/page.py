"""Measurements of the study, its tables in Markdown, and its figure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np

from skyrange.core.arrays import Floats
from skyrange.figures import svg
from skyrange.figures.palette import OKABE_ITO
from skyrange.figures.svg import Figure, format_number
from skyrange.optics.extinction import Weather
from skyrange.optics.sensor_models import D435, LIDAR_LITE_V3HP, MID_360, VLP_16
from skyrange.report.marked_page import MarkedPart
from skyrange.world.airframes import IRIS
from tools.detection_range.encounters import (
    BIRD,
    BODY,
    OUTLINE,
    RULE,
    WIRE,
    Approach,
    Encounter,
    Rule,
    approach,
    count_aimed,
    count_at,
)
from tools.detection_range.needs import Need, count_false_per_hour, find_speed_mps, list_needs

PART: Final = MarkedPart("<!-- measured: detection-range -->", "<!-- end: detection-range -->")
SPEED_MPS: Final = 10.0
CLOSING_MPS: Final = 2.0 * SPEED_MPS
FROM_M: Final = 60.0
DISTANCES_M: Final = (5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0)
RULES: Final = (Rule(1, 1, 1), Rule(2, 1, 1), Rule(3, 1, 1), Rule(1, 2, 3), RULE)
RAIN_MMPH: Final = 10.0
FOG_M: Final = 200.0
SHARES: Final = (0.5, 0.9, 0.99)
SCANNING: Final = (VLP_16, MID_360)


@dataclass(frozen=True, slots=True)
class Study:
    """All measurements."""

    trials: int
    counts: Mapping[str, Mapping[float, Floats]]
    """Returns in one scan, by sensor and target and by distance."""
    approaches: Mapping[str, Sequence[Approach]]
    """By sensor, target and condition."""
    aimed: Mapping[float, float]
    """Share of the pulses of the single beam that return, by distance, if it is aimed at the body."""
    clutter: Mapping[str, Mapping[float, Floats]]


def run_study(trials: int) -> Study:
    """Measure everything with so many trials of each."""
    counts, approaches, clutter = {}, {}, {}
    weathers = {
        f"rain, {RAIN_MMPH:g} mm/h (P.1814)": Weather(RAIN_MMPH),
        f"rain, {RAIN_MMPH:g} mm/h (Goodin)": Weather(RAIN_MMPH, rain_law="goodin"),
        f"fog, {FOG_M:g} m": Weather(0.0, FOG_M),
    }
    lean_rad = find_lean_rad(SPEED_MPS)
    for model in SCANNING:
        for target in (BODY, OUTLINE):
            encounter = Encounter(model, target)
            counts[f"{model.name}, {target.name}"] = {
                distance: count_at(encounter, distance, trials).astype(float)
                for distance in DISTANCES_M
                if distance <= model.reach_m
            }
            approaches[f"{model.name}, {target.name}"] = _approach(encounter, trials)
        for name, weather in weathers.items():
            approaches[f"{model.name}, body, {name}"] = _approach(Encounter(model, BODY, weather), trials)
        for reflectivity in (0.05, 0.3):
            shade = BODY._replace(reflectivity=reflectivity)
            name = f"{model.name}, body, reflectivity {reflectivity:g}"
            approaches[name] = _approach(Encounter(model, shade), trials)
        name = f"{model.name}, body, fixed to an aircraft that leans {math.degrees(lean_rad):.0f}°"
        approaches[name] = _approach(Encounter(model, BODY, tilt_rad=lean_rad), trials)
        for kind, encounter in (
            ("bird", Encounter(model, BIRD)),
            ("upright wire", Encounter(model, WIRE)),
            ("level wire", Encounter(model, WIRE, level=True)),
        ):
            clutter[f"{model.name}, {kind}"] = {
                distance: count_at(encounter, distance, max(trials // 4, 20)).astype(float)
                for distance in (10.0, 15.0, 20.0, 30.0, 40.0)
            }
    aimed = {
        distance: count_aimed(Encounter(LIDAR_LITE_V3HP, BODY), distance, trials) / trials
        for distance in (5.0, 10.0, 12.0, 15.0, 20.0, 25.0, 30.0, 40.0)
    }
    return Study(trials, counts, approaches, aimed, clutter)


def _approach(encounter: Encounter, trials: int) -> list[Approach]:
    return [approach(encounter, CLOSING_MPS, FROM_M, k) for k in range(trials)]


def find_distances(approaches: Sequence[Approach], rule: Rule = RULE) -> Floats:
    """The distance at which each approach is detected by a rule, 0 for never."""
    return np.array([one.find_detection_m(rule) for one in approaches])


def find_lean_rad(speed_mps: float) -> float:
    """How far an Iris leans forward at a speed, by the same drag as `Airframe.thrust_for`."""
    weight_n = IRIS.thrust_for(0.0, 0.0, 0.0)
    thrust_n = IRIS.thrust_for(speed_mps, 0.0, 0.0)
    return math.acos(weight_n / thrust_n)


def find_share_m(distances: Floats, share: float) -> float:
    """The distance by which that share of the approaches is detected, 0 if it is not."""
    ordered = np.sort(distances)[::-1]
    return float(ordered[math.ceil(share * len(ordered)) - 1])


def write_lines(study: Study) -> list[str]:
    """The tables in Markdown, with what each is."""
    needs = list_needs(SPEED_MPS)
    return [
        f"{study.trials} trials of each. Numbers are those of the program.",
        "",
        "**Returns in one scan**: mean, and in brackets the share of scans with two or more, and the most:",
        "",
        *_write_counts(study.counts),
        "",
        f"**Approaches at {CLOSING_MPS:g} m/s**, detected by “{RULE}”: the distance left when so many are detected.",
        "",
        *_write_approaches(study.approaches),
        "",
        f"**What avoidance needs** at {CLOSING_MPS:g} m/s, with 2.5 m/s² and a decision every quarter of a second:",
        "",
        "| manoeuvre | distance | angle of the body's height there |",
        "|---|---|---|",
        *(
            f"| {need.name} | {need.distance_m:.0f} m | {math.degrees(BODY.height_m / need.distance_m):.2f}° |"
            for need in needs
        ),
        "",
        "**Closing speed that leaves time** to swerve by 8 m or past contact, in nine approaches of ten, if detection",
        f"is no farther than at {CLOSING_MPS:g} m/s (slower approaches have more scans):",
        "",
        *_write_speeds(study.approaches),
        "",
        "**By rule**: the distance left when nine approaches in ten are detected, and how often an hour noise alone",
        "meets the rule in an empty sky (calculated, at most):",
        "",
        *_write_rules(study.approaches),
        "",
        "**Clutter**, mean returns in one scan:",
        "",
        *_write_clutter(study),
        "",
        "**LIDAR-Lite v3HP, aimed at the body**, share of pulses that return it: "
        + ", ".join(f"{share:.0%} at {distance:g} m" for distance, share in study.aimed.items())
        + f". Its beam is {math.degrees(LIDAR_LITE_V3HP.divergence_rad[0]):.2f}° wide.",
        "",
        "**D435 at 320 × 240**, pixels that the body covers and the noise of the depth:",
        "",
        *_write_depth(),
        "",
    ]


def _write_counts(counts: Mapping[str, Mapping[float, Floats]]) -> list[str]:
    heads = [f"{distance:g} m" for distance in DISTANCES_M]
    lines = [f"| sensor, target | {' | '.join(heads)} |", f"|{'---|' * (len(heads) + 1)}"]
    for name, by_distance in counts.items():
        cells = [
            f"{by_distance[distance].mean():.1f} ({(by_distance[distance] >= 2).mean():.0%}; "
            f"{by_distance[distance].max():.0f})"
            if distance in by_distance
            else "–"
            for distance in DISTANCES_M
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def _write_approaches(approaches: Mapping[str, Sequence[Approach]]) -> list[str]:
    heads = [f"{share:.0%}" for share in SHARES]
    lines = [f"| sensor, target, condition | {' | '.join(heads)} | never |", f"|{'---|' * (len(heads) + 2)}"]
    for name, flown in approaches.items():
        distances = find_distances(flown)
        cells = [f"{found:.0f} m" if (found := find_share_m(distances, share)) else "–" for share in SHARES]
        lines.append(f"| {name} | {' | '.join(cells)} | {(distances == 0.0).mean():.0%} |")
    return lines


def _write_rules(approaches: Mapping[str, Sequence[Approach]]) -> list[str]:
    lines = [f"| sensor, target | {' | '.join(map(str, RULES))} |", f"|{'---|' * (len(RULES) + 1)}"]
    for model in SCANNING:
        for target in (BODY, OUTLINE):
            name = f"{model.name}, {target.name}"
            distances = [find_share_m(find_distances(approaches[name], rule), 0.9) for rule in RULES]
            lines.append(f"| {name} | {' | '.join(f'{away:.0f} m' if away else '–' for away in distances)} |")
    for model in SCANNING:
        cells = [_write_rate(count_false_per_hour(model, rule)) for rule in RULES]
        lines.append(f"| {model.name}, false in an hour | {' | '.join(cells)} |")
    return lines


def _write_speeds(approaches: Mapping[str, Sequence[Approach]]) -> list[str]:
    lines = ["| sensor, target | by 8 m | past contact |", "|---|---|---|"]
    for model in SCANNING:
        for target in (BODY, OUTLINE):
            distance = find_share_m(find_distances(approaches[f"{model.name}, {target.name}"]), 0.9)
            speeds = [find_speed_mps(distance, aside) for aside in (8.0, 2.0 * IRIS.radius_m)]
            lines.append(f"| {model.name}, {target.name} | {speeds[0]:.1f} m/s | {speeds[1]:.1f} m/s |")
    return lines


def _write_rate(rate: float) -> str:
    if rate >= 10.0:
        return f"{rate:,.0f}"
    return f"{rate:.1g}" if rate >= 1e-4 else "below 0.0001"


def _write_clutter(study: Study) -> list[str]:
    distances = next(iter(study.clutter.values()))
    lines = [
        f"| sensor, what | {' | '.join(f'{distance:g} m' for distance in distances)} |",
        f"|{'---|' * (len(distances) + 1)}",
    ]
    for name, by_distance in study.clutter.items():
        cells = [f"{values.mean():.1f}" for values in by_distance.values()]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def _write_depth() -> list[str]:
    focal = D435.pattern.focal_px
    distances = (5.0, 10.0, 15.0, 20.0, 30.0)
    lines = [f"| | {' | '.join(f'{distance:g} m' for distance in distances)} |", f"|{'---|' * (len(distances) + 1)}"]
    sizes = [2.0 * BODY.radius_m * focal[0] * BODY.height_m * focal[1] / distance**2 for distance in distances]
    lines.append(f"| pixels | {' | '.join(f'{size:.1f}' for size in sizes)} |")
    noises = [D435.noise_m(distance) for distance in distances]
    cells = [
        f"{noise:.1f} m" + (" (beyond its range)" if distance > D435.reach_m else "")
        for noise, distance in zip(noises, distances, strict=True)
    ]
    lines.append(f"| noise | {' | '.join(cells)} |")
    return lines


def draw(study: Study) -> Figure:
    """The share of approaches that are detected while a distance is left, and the distances that manoeuvres need."""
    width, height, left, top, right, foot = 720.0, 360.0, 56.0, 40.0, 14.0, 48.0
    last = 80.0

    def place(distance: float, share: float) -> tuple[float, float]:
        x = left + distance / last * (width - left - right)
        return x, height - foot - share * (height - top - foot)

    body = []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        x, y = place(0.0, share)
        body.append(svg.element("path", {"d": f"M{format_number(x)} {format_number(y)}H{width - right}", **svg.GRID}))
        body.append(svg.label(x - 8, y + 4, f"{share:.0%}", "end"))
    body.extend(
        svg.label(place(distance, 0.0)[0], height - foot + 18, f"{distance} m")
        for distance in range(0, int(last) + 1, 10)
    )
    body.append(
        svg.label(width - right, height - 8, f"distance left when detected, closing at {CLOSING_MPS:g} m/s", "end")
    )
    body.append(svg.label(left, 12, "approaches that are detected", "start", extra={"opacity": ".7"}))
    body += _draw_needs(list_needs(SPEED_MPS), place, last)
    chosen = [f"{model.name}, {target.name}" for model in SCANNING for target in (BODY, OUTLINE)]
    for number, name in enumerate(chosen):
        ordered = np.sort(find_distances(study.approaches[name]))
        left_m = np.linspace(last, 0.0, 321).tolist()
        points = [place(distance, float((ordered >= max(distance, 1e-9)).mean())) for distance in left_m]
        dashes = {} if number % 2 == 0 else {"stroke-dasharray": "5 4"}
        ink = {"stroke": OKABE_ITO[number // 2], "fill": "none", "stroke-width": "2", **dashes}
        body.append(svg.element("path", {"d": svg.path_data(np.array(points)), **ink}))
        y = top + 24 + 18 * number
        body.append(svg.element("path", {"d": f"M330 {format_number(y - 4)}h24", **ink}))
        body.append(svg.label(360, y, name, "start", 12))
    return svg.document(width, height, "Distance at which an approaching Iris is detected", body)


def _draw_needs(
    needs: Sequence[Need], place: Callable[[float, float], tuple[float, float]], last: float
) -> list[Element]:
    """A dotted line for each distance within the chart."""
    made = []
    ink = {"stroke": "currentColor", "stroke-opacity": ".55", "stroke-dasharray": "2 3"}
    for number, need in enumerate(reversed(needs)):
        if need.distance_m > last:
            continue
        (x, low), (_, high) = place(need.distance_m, 0.0), place(need.distance_m, 1.0)
        made.append(
            svg.element("path", {"d": f"M{format_number(x)} {format_number(low)}V{format_number(high)}", **ink})
        )
        made.append(svg.label(x, 26 + 11 * (number % 2), f"{need.name}: {need.distance_m:.0f} m", size=10))
    return made
