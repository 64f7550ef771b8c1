"""The builtin and a real ArduCopter fly the same missions in the same world: how far apart may they be?

Tolerances are from what was measured (docs/data/parity.json), with room for another version of ArduCopter, and
below the 10 % that the builtin promises.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from pathlib import Path

import pytest

from skyrange.parity.flights import Parity
from tests.ardupilot import needs_arducopter
from tests.catalogue import draw, in_turn
from tests.parity.missions import DEPART_S, WINDS, flown, flown_at

ABSOLUTE = {
    "lift_off_s": 0.15,
    "in_the_air_s": 0.5,
    "rest_s": 1.0,
    "height_max_m": 0.25,
    "speed_max_mps": 0.2,
    "climb_max_mps": 0.1,
    "descent_max_mps": 0.1,
    "disarmed_after_s": 0.3,
    "tilt_max_deg": 1.0,
    "turned_deg": 12.0,
    "yaw_rate_max_degps": 3.0,
    "cross_track_max_m": 0.2,
    "cross_track_rms_m": 0.1,
}
"""A difference of so much is none; a leg may take 0.3 s more or less."""
SHARE = 0.07
"""Nor is one of that share of ArduPilot's value."""
ONLY_BUILTIN = {"DISTANCE_SENSOR", "ESC_TELEMETRY_1_TO_4", "MCU_STATUS", "RANGEFINDER"}
ONLY_ARDUPILOT = {"PARAM_VALUE", "SIMSTATE", "TERRAIN_REQUEST", "TIMESYNC", "WIND"}
APART_M = 4.0


def _strays(parity: Parity) -> Iterator[str]:
    for row in parity.rows():
        allowed = 0.3 if row.measure.startswith("leg_") else ABSOLUTE[row.measure]
        share = 0.0 if row.measure == "lift_off_s" else SHARE
        if abs(row.difference) > max(allowed, share * abs(row.second)):
            yield f"{row.vehicle} {row.measure}: {row.first:.3f} against {row.second:.3f}"
    for name, one in parity.first.items():
        other = parity.second[name]
        if [mode for _, mode in one.modes] != [mode for _, mode in other.modes]:
            yield f"{name} modes: {one.modes} against {other.modes}"
        if parity.apart_m(name) > APART_M:
            yield f"{name}: {parity.apart_m(name):.2f} m apart"
        yield from _items(name, one.items, other.items)
        for message in one.rates_hz.keys() & other.rates_hz.keys():
            if abs(one.rates_hz[message] - other.rates_hz[message]) > 0.1:
                yield f"{name} {message}: {one.rates_hz[message]:.2f} Hz against {other.rates_hz[message]:.2f} Hz"
        if not one.sent.keys() - other.sent.keys() <= ONLY_BUILTIN:
            yield f"{name}: only the builtin sends {one.sent.keys() - other.sent.keys()}"
        if not other.sent.keys() - one.sent.keys() <= ONLY_ARDUPILOT:
            yield f"{name}: only ArduPilot sends {other.sent.keys() - one.sent.keys()}"


Items = tuple[tuple[float, int], ...]


def _items(name: str, items: Items, others: Items) -> Iterator[str]:
    """What is told to be reached, in which order, when; a return's end only where both noticed their landing."""
    count = min(len(items), len(others))
    if [seq for _, seq in items[:count]] != [seq for _, seq in others[:count]] or abs(len(items) - len(others)) > 1:
        yield f"{name} items: {items} against {others}"
    for (at_s, seq), (other_s, _) in zip(items, others, strict=False):
        if abs(at_s - other_s) > max(0.6, 0.02 * (other_s - DEPART_S)):
            yield f"{name} item {seq}: {at_s:.2f} s against {other_s:.2f} s"


@needs_arducopter
@pytest.mark.parametrize(
    "wind_mps", [pytest.param(one, marks=() if one else in_turn("parity", "no wind")) for one in sorted(WINDS)]
)
def test_both_fly_alike(wind_mps: float, tmp_path: Path) -> None:
    parity = flown(wind_mps, tmp_path, WINDS[wind_mps])
    assert list(_strays(parity)) == []
    ends = {"complete"} if wind_mps == 0.0 else {"unfinished"}  # it does not notice a landing in which it leans 15°
    seen = {name: one.outcome for name, one in parity.second.items() if not name.endswith("/lost")}
    assert set(seen.values()) == ends
    assert all(parity.first[name].outcome == "complete" for name in seen)


@in_turn("parity", "cheaper rates")
@needs_arducopter
@pytest.mark.parametrize(("rates", "wind_mps"), draw(product(("single", "reduced"), sorted(WINDS))))
def test_ardupilot_flies_alike_at_its_cheaper_rates(rates: str, wind_mps: float, tmp_path: Path) -> None:
    parity = flown_at(rates, wind_mps, tmp_path, WINDS[wind_mps])
    assert list(_strays(parity)) == []
    assert all(one.measures["in_the_air_s"] > 30.0 for one in (*parity.first.values(), *parity.second.values()))
    assert all(parity.apart_m(name) > 0.0 for name in parity.first)  # the same rates would fly the same to the byte
