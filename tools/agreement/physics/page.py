"""Page in Markdown about the range's own physics and Gazebo's: text around tables of what was measured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from skyrange.core.errors import InputError
from skyrange.core.files import atomic_write
from skyrange.parity.flights import TRUTH_HZ
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
_HEAD: Final = """# Physics of the range and of Gazebo

```console
$ python -m tools.agreement gazebo-physics --page docs/explanation/gazebo-parity.md
```

This command flies shipped scenarios with ArduCopter, with one seed, in [the range's own physics](physics.md)
(`autopilot = "ardupilot"`) and in Gazebo's (`autopilot = "gazebo"`), compares them, and writes this page. All numbers
are from the recorded truth, {hz:g} times a second.

{versions}

Both have the same rotors, batteries, air, sensors and parameters, and the same forces: Gazebo's plugin computes thrust
and drag as the range does. By construction they differ in this:

- **Delay.** Gazebo computes a tick of 2.5 ms while the ArduPilots compute their answers to its start. So the motors act
  one tick later than in the range.
- **Integration.** The range moves a body by the mean of old and new velocity, and turns it by the midpoint rule.
  Gazebo's engine steps the velocity first and then moves the body by the new one (semi-implicit Euler), once in each
  tick unless `steps_per_tick` is larger.
- **Ground.** In the range a plane stops the landing gear, brakes it by friction and brings the aircraft level. In
  Gazebo the box of the frame rests on the ground by contacts with friction. An aircraft that touches down with a lean
  touches with an edge first, and hops and slides before it stands. The range limits friction along the direction of
  sliding, and so does Gazebo 11's engine, ODE, as the world asks it to; Gazebo Sim's, DART, limits it along two axes,
  each by itself. In wind aircraft slide at take-off and landing, so they part there.
- **Collisions.** In the range an aircraft is an upright cylinder as wide as its propeller tips reach, with a
  restitution of 0.3. In Gazebo it is the box of its frame and the discs of its four rotors, which tilt with it, with
  friction and without bounce. So aircraft that meet nose to nose touch later in Gazebo, with the discs of their front
  rotors, or pass each other with the gaps between them. In both a touched propeller is lost; in the range also those
  within 60 degrees of the contact.

ArduCopter is a feedback loop around all of this: while it controls an aircraft, such differences do not grow. They can
move the moment at which it begins a leg, accepts a waypoint or detects a landing. In wind it may not detect a landing
at all ([decision](../decisions/archive.md#0032-the-builtin-autopilot-detects-a-landing-in-any-wind)),
and small differences at the touchdown decide that:
then the outcome is `unfinished`. After a collision nothing holds two flights together.
"""


def make_page(comparison: PhysicsComparison) -> str:
    """The whole page."""
    return "\n".join([*_lines(comparison), ""])


def write_page(comparison: PhysicsComparison, page: Path) -> None:
    """Write it to the file `page`, whatever that was before. Raises `OSError`."""
    with atomic_write(page) as file:
        file.write(make_page(comparison).encode())


def check_page(page: Path) -> None:
    """Raise `InputError` if a file cannot be there, before minutes are spent."""
    if page.is_dir() or not page.parent.is_dir():
        raise InputError.one("gazebo-physics", "--page", str(page), "a file in a folder that exists")


def tables(comparison: PhysicsComparison) -> Iterator[str]:
    """The lines of all tables, each with its heading."""
    for scenario in comparison.scenarios:
        yield from _scenario(scenario)
    yield from _overview(comparison.scenarios)
    for scenario in comparison.scenarios:
        if scenario.repeated is not None and scenario.fine is not None:
            yield from _steps(scenario, scenario.repeated, scenario.fine)


def _lines(comparison: PhysicsComparison) -> Iterator[str]:
    versions = (
        f"{comparison.gazebo} with the physics engine {comparison.physics}, and ArduCopter {comparison.arducopter}."
    )
    yield _HEAD.format(hz=TRUTH_HZ, versions=versions)
    yield from tables(comparison)


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
