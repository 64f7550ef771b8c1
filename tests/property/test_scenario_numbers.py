"""Any number at any numeric key of a scenario: an InputError, or a run that ends; never another error."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping
from copy import deepcopy
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel

from skyrange.assembly.build import build
from skyrange.core.errors import MAX_LINES, SkyrangeError
from skyrange.scenario.toml_files import load_data, parse_toml
from skyrange.study.runs import fly

Place = tuple[str | int, ...]

RICH: Final = """
name = "rich"
seed = 3
duration_s = 2
start_utc = 2024-05-01T12:00:00Z
origin = { lat = 40.7, lon = -74.0, alt_msl_m = 20, geoid_m = -32 }
wind = { speed_mps = 3, from_deg = 200, w20_mps = 4 }
sensors = { noise = 1 }
record = { truth_hz = 10, sensors_hz = 5 }

[city]
grid = { blocks = [2, 2], height_m = [20, 40], street_m = 40, block_m = 60, seed = 1 }

[radio]
city_busy = 0.1

[[radio.receivers]]
id = "street"
operator = "blue"
place = [0, 0, 4]

[autopilots]
deadline_s = 5

[[operators]]
id = "blue"
station = [0, -10]
params = { WPNAV_SPEED = 500 }
remote_id = { }
avoidance = { kind = "geometric" }
  [[operators.vehicles]]
  id = "b1"
  start = { east_m = 0, north_m = 0 }
  charge = 0.9
  depart_s = 0.5
  network = 0
  system_id = 7
  plan = { path = { points = [[0, 5], [0, 9, 6]], alt_m = 5 }, speed_mps = 4, end = "land" }
  [[operators.fleets]]
  count = 2
  start = { east_m = 0, north_m = 40, heading_deg = 90 }
  spacing_m = [4, 4]
  every_s = 0.2
  plan = { square = { side_m = 6, alt_m = 5 } }

[[links]]
match = "gcs:*"
latency_ms = 10
jitter_ms = 2
loss = 0.1
duplicate = 0.1
reorder = 0.1
reorder_ms = 5
rate_bps = 1e6
queue_bytes = 10000

[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 0.5
stop_s = 1.5
params = { form = "swarm", at = [0, 5, 5], transmitter_m = [0, 5, 3] }

[[attacks]]
id = "again"
kind = "remote_id.replay"
start_s = 0.5
params = { transmitter_m = [0, 5, 3] }

[[attacks]]
id = "noise"
kind = "remote_id.jam"
start_s = 0.5
params = { transmitter_m = [0, 5, 3] }

[[attacks]]
id = "drift"
kind = "gnss.drift"
start_s = 0.5
params = { vehicles = ["blue/b1"], rate_mps = [1, 0, 0] }

[[detectors]]
id = "gap"
kind = "heartbeat.gap"
"""
BASE: Final = parse_toml(RICH)
FLOWN_S: Final = 3.0
MOST: Final = 10
"""Aircraft; scenarios that are no larger and not longer than `FLOWN_S` are flown."""
NUMBERS: Final = st.one_of(
    st.sampled_from(
        (
            *(0, 1, -1, 255, 256, 2**31, 2**63, 2**64, -(2**63) - 1, 10**400, 10**4_999, True),
            *(-0.0, 5e-324, 1e-300, 1e-9, 0.5, 1e9, 1e18, 1e300, 1.7976931348623157e308),
            *(math.nan, math.inf, -math.inf),
        )
    ),
    st.floats(),
    st.integers(-(2**70), 2**70),
)


def numeric_places(value: Any, annotation: Any = None, place: Place = ()) -> Iterator[Place]:
    """The places of all numbers in a built scenario, also of those left out that may be numbers."""
    if isinstance(value, BaseModel):
        for name, field in type(value).model_fields.items():
            yield from numeric_places(getattr(value, name), field.annotation, (*place, name))
    elif isinstance(value, Mapping):
        for name, part in value.items():
            yield from numeric_places(part, None, (*place, name))
    elif isinstance(value, list | tuple):
        for number, part in enumerate(value):
            yield from numeric_places(part, None, (*place, number))
    elif value is None:
        if {float, int} & set(_types(annotation)):
            yield place
    elif isinstance(value, float | int) and not isinstance(value, bool):
        yield place


def _types(annotation: Any) -> Iterator[Any]:
    yield annotation
    for part in get_args(annotation):
        yield from _types(part)


def with_number(place: Place, number: float) -> dict[str, Any]:
    """The scenario's data with a number at a place; tables on the way that are left out are made."""
    data = deepcopy(BASE)
    at: Any = data
    for name, after in pairwise(place):
        at = at[int(name)] if isinstance(at, list) else at.setdefault(name, [] if isinstance(after, int) else {})
    if isinstance(at, list):
        at[int(place[-1]) :] = [number]
    else:
        at[place[-1]] = number
    return data


_BUILT: Final = [
    place for place in numeric_places(load_data(BASE)) if place[2:3] != ("vehicles",) or place[3:4] == (0,)
]
PLACES: Final = sorted({*numeric_places(BASE), *_BUILT}, key=str)
"""Those of fleets as they are written, because a built scenario has vehicles in their place."""


def test_the_places_are_those_of_the_whole_model() -> None:
    """Keys that are left out count too, and parameters of plugins."""
    assert ("operators", 0, "vehicles", 0, "start", "heading_deg") in PLACES
    assert ("operators", 0, "fleets", 0, "count") in PLACES
    assert ("duration_s",) in PLACES
    assert any(place[:1] == ("attacks",) and "params" in place for place in PLACES)
    assert len(PLACES) > 60


def flown_or_refused(data: dict[str, Any]) -> str:
    """Build a scenario, and fly it if it is short; the message of the error that refused it, or ""."""
    try:
        scenario = load_data(data)
        build(scenario)
        if scenario.duration_s <= FLOWN_S and len(list(scenario.fleet)) <= MOST:
            with tempfile.TemporaryDirectory() as scratch:
                fly(scenario, Path(scratch) / "run", report=False)
    except SkyrangeError as error:
        return str(error)
    return ""


@settings(deadline=60_000)
@given(place=st.sampled_from(PLACES), number=NUMBERS)
@pytest.mark.rotating
def test_any_number_is_refused_or_flown(place: Place, number: float) -> None:
    said = flown_or_refused(with_number(place, number))
    assert len(said.splitlines()) <= MAX_LINES + 2


@pytest.mark.parametrize(
    ("place", "number"), [(("operators", 0, "station", 1), 1e300), (("links", 0, "rate_bps"), 1e-300)], ids=str
)
def test_numbers_that_were_accepted_and_broke_a_run(place: Place, number: float) -> None:
    assert place in PLACES
    assert ".".join(map(str, place[-2:])) in flown_or_refused(with_number(place, number))
