"""Encounters of the table in docs/explanation/detect-and-avoid.md: separation held without attack, and walls respected.

Tolerance: the protected radius is 20 m, and both see each other up to 1.3 s late at up to 20 m/s closing, along
straight lines; 19 m is asked for, 1 m less for what acceleration (2.5 m/s²) makes of them. ORCA aims at the radius
itself and gets within rounding of it.
"""

from __future__ import annotations

import importlib.util
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shapely

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.vehicle.avoidance.contract import Avoidance, AvoidanceLimits, Tracks, Vector
from skyrange.vehicle.avoidance.geometric import Geometric
from skyrange.vehicle.avoidance.none import NoAvoidance
from skyrange.vehicle.avoidance.orca import Orca
from skyrange.vehicle.avoidance.stop import Stop
from tests.unit.avoidance_harness import Flyer, fly

pytestmark = pytest.mark.rotating

Z = 50.0
HELD_M = 19.0
NUMBER = re.compile(r"\d+\.\d")
Way = tuple[Vector, Vector, float]
ENCOUNTERS: dict[str, list[Way]] = {
    "head-on": [((-300, 0, Z), (300, 0, Z), 10.0), ((300, 0, Z), (-300, 0, Z), 10.0)],
    "crossing": [((-300, 0, Z), (300, 0, Z), 10.0), ((0, -300, Z), (0, 300, Z), 10.0)],
    "overtaking": [((-300, 0, Z), (500, 0, Z), 10.0), ((-200, 0, Z), (200, 0, Z), 4.0)],
    "four-way": [
        ((-300, 0, Z), (300, 0, Z), 10.0), ((300, 0, Z), (-300, 0, Z), 10.0),
        ((0, -300, Z), (0, 300, Z), 10.0), ((0, 300, Z), (0, -300, Z), 10.0),
    ],
}  # fmt: skip
PHASES = ((0.1, 0.6, 0.35, 0.85), (0.0, 0.0, 0.0, 0.0), (0.9, 0.2, 0.45, 0.7))
PASSAGE = [(-30, 12, 30, 72), (-30, -72, 30, -12)]


def encounter(name: str, make: Callable[[], Avoidance], phases: tuple[float, ...]) -> list[Flyer]:
    return [
        Flyer(start, goal, make(), speed, phase)
        for (start, goal, speed), phase in zip(ENCOUNTERS[name], phases, strict=False)
    ]


def town(*boxes: tuple[float, float, float, float], height_m: float = 60.0) -> City:
    return City([Building(str(i), height_m, shapely.box(*box)) for i, box in enumerate(boxes)], "test")


def ghosts(*places: Vector) -> Tracks:
    return Tracks(np.array(places, dtype=np.float64), np.zeros((len(places), 3)))


def nearest(flyer: Flyer, place: Vector) -> float:
    return min(math.dist(here[:2], place[:2]) for here in flyer.path)


def told(name: str, kind: type[Avoidance]) -> str:
    """A cell of the table in the docs."""
    least, late, home = math.inf, 0.0, False
    for phases in PHASES:
        done = fly(encounter(name, kind, phases), 320)
        least = min(least, done.least_m)
        for flyer, (start, goal, speed) in zip(done.flyers, ENCOUNTERS[name], strict=True):
            alone_s = math.dist(start, goal) / speed + 1.0  # slowing down for the goal
            late = max(late, (flyer.arrived_s or math.inf) - alone_s)
            home = home or flyer.home
    if kind is NoAvoidance:
        return f"{least:.1f} m"
    return f"{least:.1f} m, {'goes home' if home else f'{late:.1f} s'}"


@pytest.mark.parametrize("name", list(ENCOUNTERS))
def test_the_table_in_the_docs_is_what_is_measured(name: str) -> None:
    page = Path(__file__).parents[2] / "docs/explanation/detect-and-avoid.md"
    (row,) = [line for line in page.read_text().splitlines() if line.startswith(f"| {name} |")]
    cells = [cell.strip() for cell in row.split("|")[2:-1]]
    kinds: list[type[Avoidance]] = [NoAvoidance, Stop, Geometric]
    kinds += [Orca] if importlib.util.find_spec("pyrvo") else []
    for cell, kind in zip(cells, kinds, strict=False):
        now = told(name, kind)
        if kind is not Orca:
            assert cell == now
            continue
        assert NUMBER.sub("#", cell) == NUMBER.sub("#", now)
        # RVO2 has a sine of another library, which may turn a decision by a step of 0.25 s, at 10 m/s
        assert [float(n) for n in NUMBER.findall(cell)] == pytest.approx(
            [float(n) for n in NUMBER.findall(now)], abs=2.5
        )


@pytest.mark.parametrize("phases", PHASES)
@pytest.mark.parametrize("name", list(ENCOUNTERS))
def test_with_geometric_avoidance_all_arrive_and_stay_apart(name: str, phases: tuple[float, ...]) -> None:
    done = fly(encounter(name, Geometric, phases), 240)
    assert done.least_m >= HELD_M
    for flyer in done.flyers:
        assert flyer.arrived_s is not None
        assert flyer.arrived_s < math.dist(*ENCOUNTERS[name][done.flyers.index(flyer)][:2]) / flyer.speed_mps + 45.0
        assert len(flyer.log) <= 20  # no chatter: an episode is three changes


@pytest.mark.parametrize("name", list(ENCOUNTERS))
def test_with_orca_all_arrive_and_stay_apart(name: str) -> None:
    pytest.importorskip("pyrvo")
    done = fly(encounter(name, Orca, PHASES[0]), 240)
    assert done.least_m >= HELD_M
    assert all(flyer.arrived_s is not None for flyer in done.flyers)


@pytest.mark.parametrize("name", list(ENCOUNTERS))
def test_without_avoidance_they_meet_and_with_stop_they_do_not(name: str) -> None:
    assert fly(encounter(name, NoAvoidance, PHASES[0]), 240).least_m < 1.0
    done = fly(encounter(name, Stop, PHASES[0]), 300)
    assert done.least_m >= HELD_M
    if name in ("head-on", "four-way"):  # stopping resolves no head-on encounter: in the end they go home
        assert all(flyer.home for flyer in done.flyers)


@pytest.mark.parametrize("up_m", [30.0, math.nan])
def test_a_ghost_in_the_passage_sends_it_around_the_building(up_m: float) -> None:
    city = town(*PASSAGE)
    green = Flyer((-150, 0, 30), (150, 0, 30), Geometric(city))
    fly([green], 200, ghosts((0, 0, up_m)), city=city)
    assert green.arrived_s is not None
    assert nearest(green, (0, 0, 0)) > 72.0  # not through the passage: past a building's far side
    assert 36.0 < green.arrived_s < 60.0  # and not much longer than the detour takes


def test_without_a_ghost_the_passage_is_flown() -> None:
    city = town(*PASSAGE)
    green = Flyer((-150, 0, 30), (150, 0, 30), Geometric(city))
    fly([green], 100, city=city)
    assert green.log == [(0.0, "keep")]
    assert nearest(green, (0, 0, 0)) < 0.5
    assert green.arrived_s is not None
    assert green.arrived_s < 32.0


def test_a_ghost_high_above_or_beside_the_way_changes_nothing() -> None:
    for place in ((0, 0, 60.0), (0, 30, 30.0)):
        green = Flyer((-150, 0, 30), (150, 0, 30), Geometric())
        fly([green], 100, ghosts(place))
        assert green.log == [(0.0, "keep")]


def test_it_flies_around_a_ghost_in_the_open_by_a_little_on_the_right() -> None:
    green = Flyer((-150, 0, 30), (150, 0, 30), Geometric())
    fly([green], 100, ghosts((0, 0, 30)))
    assert 20.0 <= nearest(green, (0, 0, 0)) < 30.0
    assert min(place[1] for place in green.path) < -20.0  # flying east, right is south
    assert green.arrived_s is not None
    assert green.arrived_s < 36.0


def test_where_there_is_no_way_it_holds_then_squeezes_by_then_goes_home() -> None:
    # a court with one gate, too narrow for the protected radius; then also for the least one
    wide = town((-30, 14, 30, 3000), (-30, -3000, 30, -14))
    green = Flyer((-150, 0, 30), (150, 0, 30), Geometric(wide, AvoidanceLimits(least_m=6.0)))
    fly([green], 400, ghosts((0, -6, 30)), city=wide)
    assert "stop" in [name for _, name in green.log]
    assert green.arrived_s is not None
    assert green.arrived_s > 60.0  # patience_s is 30
    assert 5.0 <= nearest(green, (0, -6, 0)) < 20.0  # a metre less than asked, as above
    narrow = town((-30, 10, 30, 3000), (-30, -3000, 30, -10))
    green = Flyer((-150, 0, 30), (150, 0, 30), Geometric(narrow))
    done = fly([green], 400, ghosts((0, 0, 30)), city=narrow)
    assert green.home
    assert 119.0 < done.seconds < 125.0  # give_up_s is 120
    assert nearest(green, (0, 0, 0)) > 90.0


def test_the_mission_goes_on_when_a_ghost_disappears() -> None:
    narrow = town((-30, 10, 30, 3000), (-30, -3000, 30, -10))
    green = Flyer((-150, 0, 30), (150, 0, 30), Geometric(narrow))
    fly([green], 400, ghosts((0, 0, 30)), until_s=40.0, city=narrow)
    assert [name for _, name in green.log] == ["keep", "stop", "go", "resume", "keep"]
    assert green.arrived_s is not None
    assert green.arrived_s < 40.0 + 35.0
    assert nearest(green, (0, 0, 0)) < 1.0


def test_a_swarm_of_ghosts_around_the_passage_is_flown_around() -> None:
    city = town(*PASSAGE)
    green = Flyer((-150, 0, 30), (150, 0, 30), Geometric(city))
    swarm = [(x, y, 30.0) for x in (-20, 20, 60) for y in (-40, 0, 40)]
    fly([green], 200, ghosts(*swarm), city=city)
    assert green.arrived_s is not None
    assert min(nearest(green, place) for place in swarm) >= HELD_M


def test_two_meet_in_a_street_and_neither_touches_a_wall() -> None:
    street = town((-400, 30, 400, 90), (-400, -90, 400, -30))
    one = Flyer((-200, 0, 30), (200, 0, 30), Geometric(street), phase=0.1)
    two = Flyer((200, 0, 30), (-200, 0, 30), Geometric(street), phase=0.7)
    done = fly([one, two], 300, city=street)
    assert done.least_m >= HELD_M
    assert all(flyer.arrived_s is not None for flyer in done.flyers)
