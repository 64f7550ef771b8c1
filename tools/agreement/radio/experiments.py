"""Experiments that compare media with equal losses: reach over a city, contention, hidden terminals."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from skyrange.city.city import City
from skyrange.contracts.medium import RadioSpec, RadioTable
from skyrange.core.chance import Chance
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.radio.builtin.params import RadioEnvironment
from skyrange.radio.builtin.state import radio_arrays
from skyrange.radio.external.paths import PathFinder
from skyrange.radio.propagation.obstruction import has_line_of_sight, obstacle_index
from tools.agreement.radio.places import CLASSES, draw_all
from tools.agreement.radio.trials import Cell, Trial

FRAMES: Final = 1_000
"""At least so many frames in each cell."""
REACH_SENDERS: Final = 4
"""Transmitters of each class."""
REACH_RECEIVERS: Final = 3
"""Receivers of each class and sight, for each transmitter."""
REACH_DBM: Final = (-100.0, -78.0)
"""Median powers of the pairs: below, nothing is received, above, everything."""
REACH_EVERY_NS: Final = 70 * NS_PER_MS
"""Between the frames of a pair: longer than fading lasts between radios that stand still (2^26 ns)."""
CONTENTION_NODES: Final = (1, 2, 5, 10, 20, 50, 100, 200)
CONTENTION_WINDOWS_NS: Final = (NS_PER_MS, 10 * NS_PER_MS, 100 * NS_PER_MS, NS_PER_S)
CONTENTION_RADII_M: Final = (60.0, 500.0)
HIDDEN_NODES: Final = (1, 3, 10)
"""In each of two clusters."""
HIDDEN_M: Final = (200.0, 400.0, 500.0, 600.0, 700.0, 800.0, 900.0, 1000.0, 1200.0)
"""From the receiver to each cluster."""
HIDDEN_WINDOWS_NS: Final = (5 * NS_PER_MS, 20 * NS_PER_MS, 100 * NS_PER_MS)
_CHANNEL_MHZ: Final = 2437.0


def reach_trials(city: City, seed: int = 1) -> Iterator[Trial]:
    """One transmitter, alone on the air; its receivers are pairs over the city whose median power is in `REACH_DBM`."""
    rng = np.random.default_rng(seed)
    candidates = draw_all(city, 500, rng)
    walls = obstacle_index(city.walls())
    surroundings = RadioEnvironment(horizon_m=3_000.0, chance=False)
    radios = [RadioSpec(f"{row:04d}") for row in range(len(candidates.enu_m))]
    finder = PathFinder(radios, radio_arrays(radios, Chance(1)), Chance(1), city, surroundings, own_losses=False)
    table = RadioTable(0, candidates.enu_m, np.zeros_like(candidates.enu_m))
    for sender in range(len(CLASSES) * REACH_SENDERS):
        kind = sender // REACH_SENDERS
        first = int(rng.choice(np.flatnonzero(candidates.kind == kind)))
        paths = finder.find(table, first, 15.0, _CHANNEL_MHZ, 0)
        power = 15.0 + paths["gain_db"]
        good = paths["radio"][(power > REACH_DBM[0]) & (power < REACH_DBM[1])].astype(np.int64)
        medians = dict(zip(paths["radio"].tolist(), power.tolist(), strict=True))
        strata: dict[tuple[str, str], list[int]] = {}
        for row in rng.permutation(good).tolist():
            a, b = candidates.enu_m[first], candidates.enu_m[row]
            sight = "sight" if has_line_of_sight(walls, *a, *b) else "no sight"
            chosen = strata.setdefault((CLASSES[candidates.kind[row]], sight), [])
            if len(chosen) < REACH_RECEIVERS:
                chosen.append(row)
        rows = [first, *(row for chosen in strata.values() for row in chosen)]
        cells = []
        for (other, sight), chosen in strata.items():
            for row in chosen:
                distance = float(np.linalg.norm(candidates.enu_m[row] - candidates.enu_m[first]))
                facts = {
                    "heights": "-".join(sorted((CLASSES[kind], other), key=CLASSES.index)), "sight": sight,
                    "distance_m": round(distance, 1), "median_dbm": round(medians[row], 1),
                }  # fmt: skip
                cells.append(Cell(rows.index(row), facts))
        if cells:
            at = np.arange(FRAMES) * REACH_EVERY_NS + rng.integers(1, NS_PER_MS, FRAMES)
            yield Trial(
                "reach", seed + sender, True, surroundings.horizon_m, candidates.enu_m[rows],
                np.zeros(FRAMES, dtype=np.int64), at.astype(np.int64), cells,
            )  # fmt: skip


def contention_trials(seed: int = 2) -> Iterator[Trial]:
    """1 to 200 nodes in a disc that all broadcast within a window, once a round; a receiver above its centre."""
    for radius_m in CONTENTION_RADII_M:
        for nodes in CONTENTION_NODES:
            for window_ns in CONTENTION_WINDOWS_NS:
                rng = np.random.default_rng((seed, nodes, window_ns, int(radius_m)))
                angle = rng.uniform(0.0, 2.0 * np.pi, nodes)
                away = radius_m * np.sqrt(rng.uniform(0.0, 1.0, nodes))
                places = np.column_stack((away * np.cos(angle), away * np.sin(angle), np.full(nodes, 60.0)))
                facts = {"nodes": nodes, "window_ms": window_ns / NS_PER_MS, "radius_m": radius_m}
                yield _rounds("contention", seed, places, (0.0, 0.0, 80.0), window_ns, rng, facts)


def hidden_trials(seed: int = 3) -> Iterator[Trial]:
    """Two clusters of nodes with a receiver halfway between them: near ones sense each other, far ones do not."""
    for away_m in HIDDEN_M:
        for nodes in HIDDEN_NODES:
            for window_ns in HIDDEN_WINDOWS_NS:
                rng = np.random.default_rng((seed, nodes, window_ns, int(away_m)))
                spread = rng.uniform(-20.0, 20.0, (2 * nodes, 2))
                side = np.repeat((-away_m, away_m), nodes)
                places = np.column_stack((side + spread[:, 0], spread[:, 1], np.full(2 * nodes, 60.0)))
                facts = {"nodes": nodes, "window_ms": window_ns / NS_PER_MS, "apart_m": 2.0 * away_m}
                yield _rounds("hidden terminals", seed, places, (0.0, 0.0, 60.0), window_ns, rng, facts)


def _rounds(
    experiment: str,
    seed: int,
    places: np.ndarray,
    receiver: tuple[float, float, float],
    window_ns: int,
    rng: np.random.Generator,
    facts: dict[str, float],
) -> Trial:
    """All nodes broadcast at random times within a window, in as many rounds as `FRAMES` needs."""
    nodes = len(places)
    rounds = -(-FRAMES // nodes)
    every = window_ns + 600 * NS_PER_MS  # frames wait at most half a second
    at = (np.arange(rounds) * every)[:, None] + 1 + rng.integers(0, window_ns, (rounds, nodes))
    order = np.argsort(at, axis=None, kind="stable")
    sender = np.tile(np.arange(nodes), rounds)[order]
    placed = np.concatenate((places, np.array([receiver])))
    return Trial(
        experiment, seed, False, 5_000.0, placed, sender, at.ravel()[order].astype(np.int64), [Cell(nodes, dict(facts))]
    )
