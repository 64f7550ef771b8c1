"""Tables in Markdown about the range's own physics and Gazebo's, and the page that has them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from skyrange.core.errors import InputError
from skyrange.core.files import MIB, atomic_write, read_input
from tools.agreement.physics.comparison import (
    FINE_STEPS,
    AircraftDifference,
    Collision,
    ComparedScenario,
    PhysicsComparison,
    RunDifference,
)

_MEASURES: Final = (
    ("lift_off_s", "lift-off", "s", 2, 1.0),
    ("landed_s", "landed", "s", 2, 1.0),
    ("height_max_m", "greatest height", "m", 2, 1.0),
    ("speed_max_mps", "greatest speed", "m/s", 2, 1.0),
    ("climb_max_mps", "fastest climb", "m/s", 2, 1.0),
    ("descent_max_mps", "fastest descent", "m/s", 2, 1.0),
    ("tilt_max_deg", "greatest tilt", "°", 1, 1.0),
    ("charge_used", "charge used", "%", 2, 100.0),
)
"""Name, title, unit, decimals, and by what the value is multiplied."""

_CALM_MPS: Final = 1e-6
BEGIN: Final = "<!-- python -m tools.agreement gazebo-physics: begin -->"
END: Final = "<!-- python -m tools.agreement gazebo-physics: end -->"
_BLOCK: Final = re.compile(f"{re.escape(BEGIN)}.*?{re.escape(END)}", re.DOTALL)


def check_page(page: Path) -> None:
    """Raise `InputError` for a page without `BEGIN` and `END`, or one that cannot be read, before minutes are spent."""
    if _BLOCK.search(_read(page)) is None:
        raise InputError.one("--page", str(page), "a page without the marks", f"a page with {BEGIN} and {END}")


def renew_page(comparison: PhysicsComparison, page: Path) -> None:
    """Replace the tables between `BEGIN` and `END` in a page."""
    check_page(page)
    block = "\n".join([BEGIN, "", *tables(comparison), END])
    text = _BLOCK.sub(lambda _: block, _read(page))
    with atomic_write(page) as file:
        file.write(text.encode())


def _read(page: Path) -> str:
    return read_input(page, "--page", max_bytes=MIB, expected="a Markdown page").decode(errors="replace")


def tables(comparison: PhysicsComparison) -> Iterator[str]:
    """The versions, and the lines of all tables, each with its heading."""
    yield f"{comparison.gazebo} with the physics engine {comparison.physics}, and ArduCopter {comparison.arducopter}."
    yield ""
    yield from _overview(comparison.scenarios)
    for scenario in comparison.scenarios:
        if scenario.repeated is not None and scenario.fine is not None:
            yield from _steps(scenario, scenario.repeated, scenario.fine)
    for scenario in comparison.scenarios:
        yield from _scenario(scenario)


def _scenario(scenario: ComparedScenario) -> Iterator[str]:
    aircraft = scenario.difference.aircraft
    yield f"## {scenario.title}"
    yield ""
    flown = f"{len(aircraft)} aircraft, {scenario.duration_s:g} s, seed {scenario.seed}"
    yield f"{flown}. Of pairs the first value is the range's."
    yield ""
    yield "| | " + " | ".join(each.vehicle for each in aircraft) + " |"
    yield "|---" * (1 + len(aircraft)) + "|"
    rows: dict[str, list[str]] = {
        "airframe": [each.airframe for each in aircraft],
        "largest distance in the air": [f"{each.largest_m:.2f} m at {each.largest_at_s:.1f} s" for each in aircraft],
        "RMS distance in the air": [f"{each.rms_m:.2f} m" for each in aircraft],
        "distance at the end": [f"{each.end_apart_m:.2f} m" for each in aircraft],
        "outcome": [_both(each.outcomes) for each in aircraft],
    }
    rows |= {measure[1]: [_pair(each, *measure) for each in aircraft] for measure in _MEASURES}
    if any(each.until_s is not None for each in aircraft):
        rows["on the ground after the collision"] = [", ".join(map(_after, each.down_after_s)) for each in aircraft]
    for title, cells in rows.items():
        if any(cells):
            yield f"| {title} | " + " | ".join(cells) + " |"
    yield ""
    if any(each.until_s is not None for each in aircraft):
        yield "Values of an aircraft that collides are up to its first collision in either run."
        yield ""
    if any(scenario.difference.collisions):
        yield from _collisions(scenario.difference.collisions)
    gusts = [each for each in aircraft if each.gust_rms_mps > _CALM_MPS]
    if gusts:
        worst = max(gusts, key=lambda each: each.air_rms_mps)
        yield (
            f"Gusts have an RMS of {max(each.gust_rms_mps for each in gusts):.2f} m/s. The air at an aircraft in "
            f"Gazebo differs from that at its twin in the range by at most {worst.air_rms_mps:.3f} m/s RMS "
            f"({worst.vehicle}): both draw the same random numbers, and a gust depends on its aircraft's height and "
            "airspeed."
        )
        yield ""


def _after(seconds: float | None) -> str:
    return "none" if seconds is None else f"{seconds:.1f} s"


def _both(pair: tuple[str, str]) -> str:
    return pair[0] if pair[0] == pair[1] else " / ".join(pair)


def _pair(each: AircraftDifference, name: str, _: str, unit: str, decimals: int, times: float) -> str:
    if name not in each.measures:
        return ""
    # the sum takes the sign from a zero
    first, second = (f"{round(value * times, decimals) + 0.0:.{decimals}f}" for value in each.measures[name])
    return f"{first}, {second} {unit}"


def _collisions(both: tuple[Sequence[Collision], Sequence[Collision]]) -> Iterator[str]:
    yield "| collision | time | relative speed | energy | height |"
    yield "|---|---|---|---|---|"
    for physics, collisions in zip(("range", "Gazebo"), both, strict=True):
        for hit in collisions:
            yield (
                f"| {physics}: {hit.first} and {hit.second} | {hit.time_s:.2f} s | {hit.speed_mps:.2f} m/s | "
                f"{hit.energy_j:.1f} J | {hit.up_m:.2f} m |"
            )
        if not collisions:
            yield f"| {physics}: none | | | | |"
    yield ""


def _overview(scenarios: Sequence[ComparedScenario]) -> Iterator[str]:
    yield "## Largest differences"
    yield ""
    yield "Over all aircraft of a scenario, Gazebo's value less the range's:"
    yield ""
    yield (
        "| scenario | airframe | largest distance | RMS distance | "
        + " | ".join(title for _, title, *_ in _MEASURES)
        + " | moved while standing |"
    )
    yield "|---" * (5 + len(_MEASURES)) + "|"
    for scenario in scenarios:
        airframes = dict.fromkeys(each.airframe for each in scenario.difference.aircraft)
        for airframe in airframes:
            chosen = [each for each in scenario.difference.aircraft if each.airframe == airframe]
            yield "| " + " | ".join([scenario.title, airframe, *_largest(chosen)]) + " |"
    yield ""
    yield (
        "*Moved while standing* is how far an aircraft moved in the plane before its take-off or after its landing, "
        "the larger of both: in the range, in Gazebo. After a collision it is that of the wreck. A body that a "
        "simulator moves counts as standing while its gear is within 2 cm of the ground, so it lands that "
        "much earlier."
    )
    yield ""


def _largest(chosen: Sequence[AircraftDifference]) -> Iterator[str]:
    yield f"{max(each.largest_m for each in chosen):.2f} m"
    yield f"{max(each.rms_m for each in chosen):.2f} m"
    for name, _, unit, decimals, times in _MEASURES:
        pairs = [each.measures[name] for each in chosen if name in each.measures]
        if pairs:
            first, second = max(pairs, key=lambda pair: abs(pair[1] - pair[0]))
            yield f"{_signed((second - first) * times, decimals)} {unit}"
        else:
            yield ""
    first_m, second_m = (max(each.standing_drift_m[side] for each in chosen) for side in (0, 1))
    yield f"{first_m * 1e3:.1f}, {second_m * 1e3:.1f} mm"


def _signed(value: float, decimals: int) -> str:
    rounded = round(value, decimals)
    return f"{rounded:+.{decimals}f}" if rounded else f"{0.0:.{decimals}f}"


def _steps(scenario: ComparedScenario, repeated: RunDifference, fine: RunDifference) -> Iterator[str]:
    yield "## Steps, and runs again"
    yield ""
    yield (
        f"The same of `{scenario.name}` between runs in Gazebo: of two that are alike, which shows how far a run "
        f"repeats itself, and of one with {FINE_STEPS} steps of the physics engine in each tick."
    )
    yield ""
    yield "| runs | largest distance | RMS distance | landed, largest difference | greatest tilt, largest difference |"
    yield "|---|---|---|---|---|"
    compared: tuple[tuple[str, RunDifference], ...] = (
        ("range and Gazebo", scenario.difference),
        ("Gazebo twice", repeated),
        (f"Gazebo with 1 and {FINE_STEPS} steps in a tick", fine),
    )
    for title, difference in compared:
        aircraft = difference.aircraft
        cells = [
            f"{max(each.largest_m for each in aircraft):.3f} m",
            f"{max(each.rms_m for each in aircraft):.3f} m",
            f"{_gap(aircraft, 'landed_s'):.3f} s",
            f"{_gap(aircraft, 'tilt_max_deg'):.2f} °",
        ]
        yield f"| {title} | " + " | ".join(cells) + " |"
    yield ""


def _gap(aircraft: Sequence[AircraftDifference], name: str) -> float:
    pairs = [each.measures[name] for each in aircraft if name in each.measures]
    return max((abs(second - first) for first, second in pairs), default=0.0)
