"""A made fleet for the viewer: aircraft on straight legs over a city, and their airspace, as a file of the stream."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.city.downtown import downtown_grid
from skyrange.core.time import NS_PER_S
from skyrange.figures.palette import base_colours, theme_colour
from skyrange.view.stream.events import EventTables
from skyrange.view.stream.messages import SCENE, VERSION, Message, Part, encode_file
from skyrange.view.stream.positions import Grid, Layer, Samples
from skyrange.view.stream.recorded import PART_NS, STEP_NS
from skyrange.view.stream.scene import MAX_VOLUMES, pack_buildings

Floats = NDArray[np.float64]

OPERATORS: Final = 10
LEG_M: Final = (80.0, 400.0)
SPEED_MPS: Final = (5.0, 12.0)
HEIGHT_M: Final = (30.0, 120.0)
WOBBLE_M: Final = 0.3
CORRIDOR_M: Final = 12.0
RADIO_S: Final = 1.0
"""Each aircraft broadcasts this often; two others decode it."""


@dataclass(frozen=True)
class Flights:
    """Waypoints of each aircraft with the times at which it is there."""

    corners: list[Floats]
    """(k, 3) metres each."""
    times_s: list[Floats]
    """(k,) each."""
    seconds: float

    def at(self, times_s: Floats) -> Floats:
        """(n, 3, m) places at (m,) times, each a little off the straight line, as aircraft in wind are."""
        found = np.zeros((len(self.corners), 3, len(times_s)))
        for place, (corners, known_s) in enumerate(zip(self.corners, self.times_s, strict=True)):
            for axis in range(3):
                found[place, axis] = np.interp(times_s, known_s, corners[:, axis])
                found[place, axis] += WOBBLE_M * np.sin(0.7 * times_s + 2.1 * place + axis)
        return found


def make_city(buildings: int = 1286) -> City:
    """A made downtown of about so many buildings; their number is a multiple of four."""
    across = max(round(math.sqrt(buildings / 4)), 1)
    return downtown_grid((across, max(round(buildings / 4 / across), 1)), street_m=14.0, block_m=44.0)


def make_flights(aircraft: int, city: City, seconds: float, seed: int = 1) -> Flights:
    """Flights from corner to corner within the bounds of a city."""
    chance = np.random.default_rng(seed)
    west, south, east, north = city.bounds
    low, high = np.array([west, south, HEIGHT_M[0]]), np.array([east, north, HEIGHT_M[1]])
    flights = Flights([], [], seconds)
    for _ in range(aircraft):
        corners, times, speed = [chance.uniform(low, high)], [0.0], chance.uniform(*SPEED_MPS)
        while times[-1] < seconds:
            turn, leg_m = chance.uniform(0, 2 * np.pi), chance.uniform(*LEG_M)
            step = np.array([np.sin(turn) * leg_m, np.cos(turn) * leg_m, chance.uniform(-15, 15)])
            corners.append(np.clip(corners[-1] + step, low, high))
            times.append(times[-1] + max(float(np.linalg.norm(corners[-1] - corners[-2])), 1.0) / speed)
        flights.corners.append(np.array(corners))
        flights.times_s.append(np.array(times))
    return flights


def encode_fleet(flights: Flights, city: City) -> bytes:
    """A file of the viewer's stream with the flights, a corridor of airspace for each leg, and receptions."""
    parts = []
    until_ns = round(flights.seconds * NS_PER_S)
    for start in range(0, until_ns, PART_NS):
        end = min(start + PART_NS, until_ns)
        grid = Grid(start, STEP_NS, (end - start) // STEP_NS + 1)
        places = flights.at(grid.times / NS_PER_S)
        ahead = flights.at(grid.times / NS_PER_S + 0.2) - places
        rows = list(range(len(places)))
        truth = Samples(0, Layer.TRUTH, grid, rows, places, np.arctan2(ahead[:, 0], ahead[:, 1]))
        believed = Samples(0, Layer.AUTOPILOT, grid, rows, places + 0.8)
        heard = _hear(places, start / NS_PER_S, end / NS_PER_S)
        messages = [truth.encode(), believed.encode(), heard.encode(0, start / NS_PER_S, end / NS_PER_S)]
        parts.append(Part(start / NS_PER_S, end / NS_PER_S, messages))
    return encode_file(_make_scene(flights, city), parts)


def _make_scene(flights: Flights, city: City) -> Message:
    names = [f"op{place}" for place in range(OPERATORS)]
    inks = [list(theme_colour(colour)) for colour in base_colours(dict.fromkeys(names, "")).values()]
    arrays, count = pack_buildings(
        [{"height_m": one.height_m, "rings": part} for one in city.buildings for part in one.polygons], np.zeros(2)
    )
    vehicles = [
        {
            "id": f"op{place % OPERATORS}/v{place}", "operator": place % OPERATORS, "airframe": "iris",
            "ink": inks[place % OPERATORS], "home": corners[0].round(1).tolist(), "plan": corners[1:].round(1).tolist(),
        }
        for place, corners in enumerate(flights.corners)
    ]  # fmt: skip
    head = {
        "version": VERSION, "name": f"{len(vehicles)} aircraft", "start_s": 0.0, "end_s": flights.seconds,
        "flying": False, "verdict": "", "arms": [{"id": "run", "title": "run", "status": "complete"}],
        "operators": [{"id": name, "ink": ink} for name, ink in zip(names, inks, strict=True)],
        "vehicles": vehicles, "radios": [], "volumes": _claim(flights)[:MAX_VOLUMES],
        "left_out": {} if len(arrays["heights"]) == count else {"buildings": [len(arrays["heights"]), count]},
    }  # fmt: skip
    return Message(SCENE, head, arrays)


def _claim(flights: Flights) -> list[dict[str, Any]]:
    """The corridor of each leg while it is flown."""
    found = []
    for place, (corners, times_s) in enumerate(zip(flights.corners, flights.times_s, strict=True)):
        for (first, last), (from_s, until_s) in zip(pairwise(corners), pairwise(times_s), strict=True):
            along = last[:2] - first[:2]
            along = along / max(float(np.linalg.norm(along)), 1e-6) * CORRIDOR_M
            side = np.array([-along[1], along[0]])
            ring = [
                first[:2] - along + side,
                first[:2] - along - side,
                last[:2] + along - side,
                last[:2] + along + side,
            ]
            heights = (float(min(first[2], last[2])) - 10.0, float(max(first[2], last[2])) + 10.0)
            found.append(
                {
                    "arm": 0,
                    "vehicle": place,
                    "name": "",
                    "from_s": float(from_s),
                    "until_s": float(until_s),
                    "lower_m": heights[0],
                    "upper_m": heights[1],
                    "ring": np.round(ring, 1).tolist(),
                }
            )
    return found


def _hear(places: Floats, from_s: float, until_s: float) -> EventTables:
    """Receptions by the two aircraft whose numbers follow the sender's."""
    count, tables = len(places), EventTables()
    tables.rows["receptions"] = [
        {"t": round(float(second), 2), "receiver": (node + other) % count, "node": node, "rssi": -70.0 - other}
        for second in np.arange(from_s, until_s, RADIO_S)
        for node in range(count)
        for other in (1, 2)
    ]
    return tables
