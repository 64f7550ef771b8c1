"""Does the search find flat discs without boxes; does the landing act, yield and give up as its page says?"""

from __future__ import annotations

from copy import deepcopy
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.range_scans import DEPTH, RangeScan
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.optics.mounted_sensors import MountedSensor, list_pulses
from skyrange.optics.scan_patterns import PixelGrid
from skyrange.optics.sensor_models import DepthCameraModel
from skyrange.vehicle.landing.emergency import (
    GUIDED,
    LAND,
    EmergencyLanding,
    LandingRules,
    Order,
    OwnState,
    find_spiral,
)
from skyrange.vehicle.landing.ground_grid import CELL_M, FlatRules, GroundGrid
from skyrange.vehicle.sight.beams import Beams

RULES = FlatRules(clear_m=1.5, rough_m=0.3, slope=0.14)
AUTO = int(mav.COPTER_MODE_AUTO)
CAUSE = FrameId("scan:blue/b1", "fwd", "oracle", 1)
Box = tuple[float, float, float, float, float]
"""West, south, east, north and height in m."""


def surface(points: Any, boxes: list[Box], slope: float = 0.0) -> Any:
    """(n,) heights of a plane with boxes at points (n, 2)."""
    up = slope * points[:, 0]
    for west, south, east, north, height in boxes:
        on = (points[:, 0] >= west) & (points[:, 0] <= east) & (points[:, 1] >= south) & (points[:, 1] <= north)
        up = np.where(on, np.maximum(up, height), up)
    return up


def grid_of(
    boxes: list[Box], slope: float = 0.0, noise_m: float = 0.0, half_m: float = 6.0, seed: int = 0
) -> GroundGrid:
    """A grid that saw a square around (0, 0) in several scans."""
    draw = np.random.default_rng(seed)
    grid = GroundGrid(np.zeros(2))
    for _ in range(5):
        flat = draw.uniform(-half_m, half_m, (30_000, 2))
        points = np.column_stack((flat, surface(flat, boxes, slope) + draw.normal(0.0, noise_m, len(flat))))
        origin = np.array([0.0, 0.0, 30.0])
        way = points - origin
        distance = np.sqrt((way * way).sum(axis=1))
        grid.add(Beams(origin, way / distance[:, None], distance))
    return grid


def reaches(place: tuple[float, float, float], box: Box, radius_m: float) -> bool:
    """Whether a disc and a box overlap."""
    x = max(box[0] - place[0], 0.0, place[0] - box[2])
    y = max(box[1] - place[1], 0.0, place[1] - box[3])
    return x * x + y * y < radius_m * radius_m


@pytest.mark.parametrize("seed", range(12))
def test_no_place_has_a_box_in_it(seed: int) -> None:
    draw = np.random.default_rng(seed)
    corners = draw.uniform(-6.0, 5.0, (int(draw.integers(1, 14)), 2))
    boxes: list[Box] = [
        (x, y, x + draw.uniform(0.5, 3.0), y + draw.uniform(0.5, 3.0), draw.uniform(1.0, 2.5))
        for x, y in corners.tolist()
    ]
    place = grid_of(boxes, noise_m=0.2, seed=seed).find_place(np.zeros(2), RULES)
    steps = np.arange(-4.0, 4.01, 0.25)
    free = [(x, y, 0.0) for x in steps for y in steps if not any(reaches((x, y, 0.0), box, 2.0) for box in boxes)]
    if place is None:
        assert not free, "a disc with a margin is free, and was not found"
    elif place.centre[2] < 0.5:
        assert not any(reaches(place.centre, box, RULES.clear_m - 0.5 * CELL_M) for box in boxes)
        assert abs(place.centre[2]) < 0.1
    else:
        on = [box for box in boxes if reaches(place.centre, box, RULES.clear_m)]
        assert any(abs(place.centre[2] - box[4]) < 0.1 for box in on), "a roof that is large enough is flat too"


def test_the_nearest_place_is_taken() -> None:
    box = (-1.0, -1.0, 1.0, 1.0, 1.5)
    place = grid_of([box]).find_place(np.array([0.8, 0.0]), RULES._replace(clear_m=1.2))
    assert place is not None
    east, north, _ = place.centre
    assert 2.0 <= east <= 2.7
    assert abs(north) < 0.5


def test_a_slope_and_what_was_not_seen_are_no_place() -> None:
    assert grid_of([], slope=0.1).find_place(np.zeros(2), RULES) is not None
    assert grid_of([], slope=0.2).find_place(np.zeros(2), RULES) is None
    assert grid_of([], half_m=1.0).find_place(np.zeros(2), RULES) is None
    assert GroundGrid(np.zeros(2)).find_place(np.zeros(2), RULES) is None


def test_refused_places_are_left_out() -> None:
    grid = grid_of([])
    first = grid.find_place(np.zeros(2), RULES)
    assert first is not None
    other = grid.find_place(np.zeros(2), RULES, refused=[np.array(first.centre[:2])])
    assert other is not None
    assert np.hypot(*(np.array(other.centre[:2]) - first.centre[:2])) > RULES.clear_m


def test_the_spiral_passes_each_place_once() -> None:
    places = [find_spiral(k) for k in range(25)]
    assert sorted(places) == [(x, y) for x in range(-2, 3) for y in range(-2, 3)]
    assert all(abs(a - c) + abs(b - d) == 1 for (a, b), (c, d) in pairwise(places))


# --- the whole landing, over a plane with boxes -----------------------------------------------------

CAMERA = MountedSensor(
    "blue/b1",
    "down",
    0,
    DepthCameraModel("test", PixelGrid(160, 120, (75.0, 62.0), 5.0), 0.1, 10.0, 0.05, 0.08, 0.001),
    (0.0, 0.0, 0.0),
    pitch_deg=-90.0,
)


class Flight:
    """An aircraft that obeys at once, its camera, and its companion's landing."""

    def __init__(self, boxes: list[Box], moves: int = 4) -> None:
        self.landing = EmergencyLanding(LandingRules((CAMERA,), RULES, 6.0, moves))
        self.boxes, self.mode, self.now = boxes, AUTO, 0
        self.place = np.array([0.0, 0.0, 15.0])
        self.orders: list[Order] = []
        self.obeys = self.scans = True
        self.false_floor_m: float | None = None
        self.last: tuple[Any, RangeScan] | None = None

    def scan(self) -> RangeScan:
        if self.last is not None and (self.last[0] == self.place).all() and self.false_floor_m is None:
            return self.last[1]._replace(start_ns=self.now)
        ways = CAMERA.list_rays(0).direction
        depth = np.full(len(ways), np.inf)
        # the highest surface on each beam, by small steps down
        for up in (1.5, 1.25, 1.0, 0.75, 0.5, 0.25, 0.0):
            along = (up - self.place[2]) / ways[:, 2]
            meets = surface(self.place[:2] + ways[:, :2] * along[:, None], self.boxes) >= up - 1e-9
            depth = np.where(meets & np.isinf(depth) & (along > 0.0), along, depth)
        ahead = list_pulses(CAMERA.model.pattern, 0).direction[:, 0]
        depth = depth * ahead
        if self.false_floor_m is not None:
            depth = np.full(len(ways), self.false_floor_m)
        steps = np.where(depth <= 10.0, np.round(np.minimum(depth, 10.0) / 0.001), 0).astype(np.uint16)
        made = RangeScan(DEPTH, 0, 0, 0.001, self.now, (1.0, 0.0, 0.0, 0.0), steps)
        self.last = self.place.copy(), made
        return made

    def run(self, seconds: float) -> list[str]:
        """Fly on; returns the notes so far."""
        for _ in range(int(seconds * 4)):
            self.now += 250 * NS_PER_MS
            if self.scans:
                self.landing.see(self.now, self.scan(), self.place, np.zeros(3), CAUSE)
            own = OwnState(self.mode, self.now, True, float(self.place[2]), self.place.copy(), np.zeros(3))
            order = self.landing.check(self.now, own)
            if order is None:
                continue
            self.orders.append(order)
            if order.mode is not None and self.obeys:
                self.mode = order.mode
            if order.place is not None and self.mode == GUIDED:
                self.place = np.array(order.place)
        return [order.note.removeprefix("decision.landing_") for order in self.orders if order.note]

    def begin(self) -> None:
        self.run(1.0)
        self.mode = LAND


BOXES: list[Box] = [(-2.6 + 2.6 * k, -2.0, -0.6 + 2.6 * k, 2.5, 1.5) for k in range(-3, 5)]


def test_it_lands_beside_the_boxes() -> None:
    flight = Flight(BOXES)
    flight.begin()
    notes = flight.run(30.0)
    assert notes[0] == "search"
    assert notes[-1] == "decision.landing"
    assert flight.mode == LAND
    assert not any(reaches(tuple(flight.place.tolist()), box, 1.3) for box in BOXES)
    assert not flight.landing.is_engaged
    assert flight.run(5.0) == notes, "its own LAND is no emergency"


def test_it_lands_where_it_is_if_nothing_is_flat() -> None:
    boxes: list[Box] = [(x, y, x + 1.0, y + 1.0, 1.5) for x in range(-12, 14, 2) for y in range(-12, 14, 2)]
    flight = Flight(boxes)
    flight.begin()
    assert flight.run(60.0) == ["search", *["move"] * 4, "blind"]
    assert flight.mode == LAND


def test_it_lands_where_it_is_if_it_is_blind() -> None:
    flight = Flight([])
    flight.scans = False
    flight.begin()
    assert flight.run(10.0) == ["search", "blind"]
    assert flight.orders[-1].mode == LAND


def test_a_floor_that_is_as_far_from_near_is_refused() -> None:
    flight = Flight([], moves=0)
    flight.false_floor_m = 6.0
    flight.begin()
    notes = flight.run(20.0)
    assert notes == ["search", "place", "blind"]
    assert "another height" in str(flight.orders[-1].data["reason"])


@pytest.mark.parametrize("mode", [int(mav.COPTER_MODE_RTL), int(mav.COPTER_MODE_LOITER), LAND, AUTO])
def test_it_yields_to_whoever_sets_a_mode(mode: int) -> None:
    flight = Flight([])
    flight.begin()
    flight.run(2.0)
    flight.mode = mode
    assert flight.run(10.0)[-1] == "yield"
    assert flight.mode == mode
    assert sum(order.mode is not None for order in flight.orders) == 1


def test_it_gives_up_if_the_autopilot_does_not_obey() -> None:
    flight = Flight([])
    flight.obeys = False
    flight.begin()
    assert flight.run(20.0) == ["search", "refused"]
    assert sum(order.mode == GUIDED for order in flight.orders) == 3


def test_one_that_lands_low_or_on_its_own_is_left_alone() -> None:
    low = Flight([])
    low.place[2] = 3.0
    low.begin()
    assert low.run(5.0) == []
    always = Flight([])
    always.mode = LAND
    assert always.run(5.0) == []


def test_a_copy_goes_on_alike() -> None:
    flight = Flight(BOXES)
    flight.begin()
    flight.run(3.0)
    other = deepcopy(flight)
    assert flight.run(20.0) == other.run(20.0)
    assert (flight.place == other.place).all()
    assert flight.now == other.now == 24 * NS_PER_S
