"""Path losses over a city by the model of each engine, compared with skyrange's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations_with_replacement, product
from typing import Final, NamedTuple

import numpy as np

from skyrange.city.city import City
from skyrange.contracts.medium import Floats, RadioSpec
from skyrange.core.chance import Chance
from skyrange.radio.builtin.params import RadioEnvironment
from skyrange.radio.builtin.state import radio_arrays
from skyrange.radio.external.medium import ExternalMedium
from skyrange.radio.propagation.link_budget import MediumParams, received_power_dbm
from skyrange.radio.propagation.loss_table import NO_TABLE
from skyrange.radio.propagation.obstruction import has_line_of_sight, obstacle_index
from tools.agreement.radio.experiments import CLASSES, draw_all
from tools.agreement.radio.setups import EngineSetup

PAIRS: Final = 10_000
RANGE_M: Final = (20.0, 1_000.0)
FREQUENCY_MHZ: Final = 2437.0
_HEIGHTS: Final = tuple("-".join(pair) for pair in combinations_with_replacement(CLASSES, 2))
_ATTEMPTS: Final = 40
MODELS: Final[Sequence[EngineSetup]] = (
    EngineSetup("ns3", "3GPP UMi", {"path_loss": "three_gpp_umi"}),
    EngineSetup("ns3", "P.1411 line of sight", {"path_loss": "itu_r_1411_los"}),
    EngineSetup("ns3", "free space", {"path_loss": "friis"}),
    EngineSetup("omnetpp", "two-ray", {"path_loss": "two_ray"}),
    EngineSetup("omnetpp", "dielectric obstacles", {"obstacle_loss": "dielectric"}),
)
"""Propagation models of the engines."""


class PairLosses(NamedTuple):
    """n pairs of places over a city."""

    ends_m: Floats
    """(n, 6)"""
    heights: list[str]
    """Classes of both ends, such as "street-flight"."""
    in_sight: np.ndarray
    """(n,) whether the line between them meets no building."""
    builtin_db: Floats
    """(n,) median basic transmission loss by skyrange."""
    other_db: dict[str, Floats]
    """By title of the model: (n,), NaN where it gives none."""


def draw_pairs(city: City, count: int = PAIRS, seed: int = 4) -> PairLosses:
    """Pairs of places of all classes, `RANGE_M` apart, with skyrange's median losses."""
    rng = np.random.default_rng(seed)
    places = draw_all(city, 1_500, rng)
    walls = obstacle_index(city.walls())
    radios = [RadioSpec("a"), RadioSpec("b")]
    arrays = radio_arrays(radios, Chance(1))
    params = MediumParams(
        seed=np.uint64(1),
        horizon_m=1e9,
        randomness=False,
        background_share=0.0,
        background_mean_mw=0.0,
        every_pair=False,
        tabled=False,
        table=NO_TABLE,
    )
    ends: list[tuple[float, ...]] = []
    heights: list[str] = []
    sight: list[bool] = []
    losses: list[float] = []
    still = np.zeros((2, 3))
    room = dict.fromkeys(product(_HEIGHTS, (True, False)), -(-count // (2 * len(_HEIGHTS))))
    for attempt in range(_ATTEMPTS * count):
        if len(ends) >= count:
            break
        i, j = rng.integers(len(places.enu_m), size=2)
        a, b = places.enu_m[i], places.enu_m[j]
        if not RANGE_M[0] <= float(np.linalg.norm(b - a)) <= RANGE_M[1]:
            continue
        name = "-".join(CLASSES[k] for k in sorted((places.kind[i], places.kind[j])))
        in_sight = bool(has_line_of_sight(walls, *a, *b))
        # the same number of each class, as far as they are found; in the last tenth of the attempts any
        if not room[(name, in_sight)] and attempt < 0.9 * _ATTEMPTS * count:
            continue
        room[(name, in_sight)] = max(room[(name, in_sight)] - 1, 0)
        power = received_power_dbm(
            params, walls, arrays.who, arrays.antenna, np.stack((a, b)), still, 0, 1, 0.0, FREQUENCY_MHZ, 0, -1e6
        )
        ends.append((*a, *b))
        heights.append(name)
        sight.append(in_sight)
        losses.append(-power)
    return PairLosses(np.array(ends), heights, np.array(sight), np.array(losses), {})


def add_model(pairs: PairLosses, setup: EngineSetup, city: City) -> None:
    """Let an engine compute the losses of the pairs by its own model."""
    medium = setup.make([RadioSpec("a")], 1, city, RadioEnvironment(), "engine")
    assert isinstance(medium, ExternalMedium)
    try:
        pairs.other_db[setup.title] = medium.path_losses_db(pairs.ends_m)
    finally:
        medium.close()


class Residual(NamedTuple):
    """Distribution of a model's loss minus skyrange's, in dB."""

    pairs: int
    missing: int
    """Pairs for which the model gives no finite loss."""
    median_db: float
    low_db: float
    """10th percentile."""
    high_db: float
    """90th percentile."""


def residuals(pairs: PairLosses, title: str) -> Mapping[tuple[str, bool], Residual]:
    """Residuals by heights and sight; empty classes are left out."""
    found = {}
    difference = pairs.other_db[title] - pairs.builtin_db
    heights = np.array(pairs.heights)
    for name in sorted(set(pairs.heights), key=lambda text: [CLASSES.index(part) for part in text.split("-")]):
        for sight in (True, False):
            rows = difference[(heights == name) & (pairs.in_sight == sight)]
            finite = rows[np.isfinite(rows)]
            if len(finite):
                low, median, high = np.percentile(finite, (10, 50, 90)).tolist()
                found[(name, sight)] = Residual(len(rows), len(rows) - len(finite), median, low, high)
    return found
