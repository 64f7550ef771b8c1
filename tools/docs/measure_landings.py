"""Measured emergency landings: the table of `docs/explanation/emergency-landing.md`.

`python -m tools.docs.measure_landings` flies the scenario `emergency-landing` with `SEEDS`, each with another place and
time of the command to land, in the ways of `ARMS`, and rewrites the table. A landing is judged by the truth: where the
aircraft stands in the end, and what it has hit.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

from skyrange.assembly.city import build_city
from skyrange.metrics.time_series import read_notes
from skyrange.record import RunRecord
from skyrange.scenario.shipped import load
from skyrange.statistics.exact_intervals import proportion_interval
from skyrange.study.runs import fly
from skyrange.world.airframes import AIRFRAMES

PAGE: Final = Path(__file__).parents[2] / "docs" / "explanation" / "emergency-landing.md"
SECTION: Final = re.compile(r"<!-- measured: landings -->\n(.*?)<!-- end: landings -->\n", re.DOTALL)
SEEDS: Final = 20
ATTACKED_SEEDS: Final = 8
"""Of each way with an attack: the first ones."""
VEHICLE: Final = "operators.blue.vehicles.b1"
BELIEVES: Final = f"{VEHICLE}.landing={{second_look=false}}"
BLIND: Final = 'attacks=[{id="blind",kind="link.drop",start_s=10,params={links=["scan:blue/b1"],probability=1.0}}]'
UNAIDED: Final = "as the autopilot lands"
NORTH_M, NORTH_S, SPEED_MPS = 30.0, 22.0, 5.0
"""Where north it is at a time, and how fast."""
ARMS: Final[dict[str, tuple[str, ...]]] = {
    UNAIDED: ("attacks=[]", "duration_s=75"),
    "by depth": ("attacks=[]", "duration_s=110"),
    "by depth, false floor": ("duration_s=155",),
    "the same without the second look": (BELIEVES, "duration_s=85"),
    "by depth, all scans dropped": (BLIND, "duration_s=75"),
}
"""Changes of the scenario."""


class Landing(NamedTuple):
    """How a flight ended."""

    is_down: bool
    is_flat: bool
    """Upright on the ground, with nothing of the car park within the radius of the airframe, and without a touch."""
    is_on_car: bool
    """Upright on a roof, without a touch."""
    is_blind: bool
    """The companion landed where it was, because it had found nothing."""
    seconds: float
    """From the command to land until it touched down."""
    away_m: float
    """From where it was commanded to land."""


def main() -> None:
    """Fly, judge and rewrite the table."""
    lines = [
        "| way | on flat ground | on a car | hit something or crashed | still in the air | blind | time to the ground |"
        " distance |",
        "|---|---|---|---|---|---|---|---|",
    ]
    with ProcessPoolExecutor(2) as pool:
        for arm in ARMS:
            landings = list(pool.map(partial(land, arm), range(1, count_seeds(arm) + 1)))
            lines.append(describe(arm, landings))
            print(lines[-1], flush=True)
    table = "\n".join(lines)
    text = PAGE.read_text(encoding="utf-8")
    block = f"<!-- measured: landings -->\n{table}\n<!-- end: landings -->\n"
    PAGE.write_text(SECTION.sub(lambda _: block, text), encoding="utf-8")


def count_seeds(arm: str) -> int:
    """How many flights an arm has."""
    return SEEDS if "attacks=[]" in ARMS[arm] else ATTACKED_SEEDS


def describe(arm: str, landings: Sequence[Landing]) -> str:
    """The row of an arm."""
    count = len(landings)
    flat = sum(one.is_flat for one in landings)
    on_car = sum(one.is_on_car for one in landings)
    aloft = sum(not one.is_down for one in landings)
    low, high = proportion_interval(flat, count, 0.95)
    down = [one for one in landings if one.is_down]
    cells = [
        arm,
        f"{flat} of {count} ({100 * low:.0f} to {100 * high:.0f} %)",
        str(on_car),
        str(count - flat - on_car - aloft),
        str(aloft),
        str(sum(one.is_blind for one in landings)),
        f"{median(one.seconds for one in down):.0f} s",
        f"{median(one.away_m for one in down):.1f} m",
    ]
    return f"| {' | '.join(cells)} |"


def land(arm: str, seed: int) -> Landing:
    """Fly one landing."""
    where, at_s = find_command(seed)
    changes = [*ARMS[arm], f"{VEHICLE}.start=[{where:.2f},0]", f"faults.mistake.start_s={at_s:.1f}"]
    city = build_city(load("emergency-landing"))
    if "attacks=[]" not in changes and BLIND not in changes:
        below = find_free(city, where, NORTH_M + SPEED_MPS * (at_s - NORTH_S))
        changes.append(f"attacks.projectors.params.at=[{below[0]:.2f},{below[1]:.2f},0.2]")
    scenario = load("emergency-landing", changes, seed=seed)
    if arm == UNAIDED:
        operator = scenario.operators[0]
        vehicle = operator.vehicles[0].model_copy(update={"landing": None, "sensors": ()})
        scenario = scenario.model_copy(update={"operators": (operator.model_copy(update={"vehicles": (vehicle,)}),)})
    with tempfile.TemporaryDirectory() as folder:
        return judge(fly(scenario, Path(folder) / "run"), city, at_s)


def find_free(city: Any, east_m: float, north_m: float) -> tuple[float, float]:
    """The place between the cars that is nearest to another one, on a grid of 0.1 m."""
    steps = [(0.1 * i, 0.1 * j) for i in range(-40, 41) for j in range(-40, 41)]
    steps.sort(key=lambda step: (round(step[0] ** 2 + step[1] ** 2, 6), step))
    places = ((east_m + x, north_m + y) for x, y in steps)
    return next(place for place in places if city.inside(*place, 0.2) is None)


def find_command(seed: int) -> tuple[float, float]:
    """Where east the route is, and when the command comes: spread over the car park (Weyl sequences)."""
    return -8.0 + 16.0 * (seed * 0.618034 % 1.0), round(20.5 + 10.0 * (seed * 0.754878 % 1.0), 1)


def judge(record: RunRecord, city: Any, at_s: float) -> Landing:
    """How a flight ended, by its truth."""
    truth = record.table("truth").to_pylist()
    begin = next(row for row in truth if row["time_ns"] >= at_s * 1e9)
    end = truth[-1]
    notes = [*read_notes(record, "events"), *read_notes(record, "decisions")]
    kinds = {note.kind for note in notes if note.time_ns >= at_s * 1e9}
    touched = sorted(note.time_ns / 1e9 for note in notes if note.kind in ("event.contact", "event.collision"))
    touched = [time for time in touched if time > at_s]
    broken = bool({"event.collision", "event.crash"} & kinds) or bool(end["crashed"])
    on_ground = bool(end["on_ground"]) and not broken
    radius_m = AIRFRAMES["iris"].radius_m
    near = city.obstacles_within(end["east_m"], end["north_m"], radius_m)
    away2 = (end["east_m"] - begin["east_m"]) ** 2 + (end["north_m"] - begin["north_m"]) ** 2
    return Landing(
        broken or on_ground,
        on_ground and not near,
        on_ground and bool(near),
        "decision.landing_blind" in kinds,
        (touched[0] if touched else end["time_ns"] / 1e9) - at_s,
        away2**0.5,
    )


if __name__ == "__main__":
    main()
