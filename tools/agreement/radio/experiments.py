"""Experiments that compare media with equal losses: trials of fixed radios, for reach over a city, contention and
hidden terminals; the places of radios, and the share of frames that each receiver decodes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.contracts.medium import ANY_CHANNEL, Floats, RadioSpec, RadioTable, ReceptionOutcome, TxBatch, Waveform
from skyrange.core.chance import Chance
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.radio.builtin.listening import SNIFFER
from skyrange.radio.builtin.params import RadioEnvironment
from skyrange.radio.builtin.state import radio_arrays
from skyrange.radio.external.paths import PathFinder
from skyrange.radio.propagation.obstruction import has_line_of_sight, obstacle_index
from tools.agreement.radio.setups import EngineSetup

CLASSES: Final = ("street", "roof", "flight")
STREET_M: Final = 1.5
"""Height of a phone in a hand, in metres; 3GPP TR 38.901 table 7.2-1 has the same for UMi."""
ABOVE_ROOF_M: Final = 2.0
FLIGHT_M: Final = (30.0, 120.0)
"""Heights of flight in metres above the ground; 14 CFR 107.51 permits 122 m."""


class Places(NamedTuple):
    """n places."""

    enu_m: Floats
    """(n, 3)"""
    kind: NDArray[np.int64]
    """(n,) rows of `CLASSES`."""


def draw_places(city: City, count: int, kind: str, rng: np.random.Generator) -> Floats:
    """`count` places of a class, (count, 3) metres: outside of buildings, or on a roof. Evenly over the city's bounds,
    without its outer tenth; over roofs evenly by building.
    """
    west, south, east, north = city.bounds
    margin_x, margin_y = 0.1 * (east - west), 0.1 * (north - south)
    found: list[tuple[float, float, float]] = []
    while len(found) < count:
        if kind == "roof":
            building = city.buildings[int(rng.integers(len(city.buildings)))]
            point = building.shape.representative_point()
            x, y, z = float(point.x), float(point.y), building.height_m + ABOVE_ROOF_M
        else:
            x = float(rng.uniform(west + margin_x, east - margin_x))
            y = float(rng.uniform(south + margin_y, north - margin_y))
            z = STREET_M if kind == "street" else float(rng.uniform(*FLIGHT_M))
        if city.inside(x, y, z) is None:
            found.append((x, y, z))
    return np.array(found)


def draw_all(city: City, count: int, rng: np.random.Generator) -> Places:
    """`count` places of each class."""
    parts = [draw_places(city, count, kind, rng) for kind in CLASSES]
    return Places(np.concatenate(parts), np.repeat(np.arange(len(CLASSES)), count))


FRAME_BYTES = 250
"""A beacon with a pack of six messages or so."""
STEP_NS = 10 * NS_PER_S
SETTLE_NS = NS_PER_S
"""After the last frame; every frame has been told of then (see `Medium.offer`: 0.5 s of waiting at most)."""


class Cell(NamedTuple):
    """A receiver of a trial, and how the cell is described."""

    receiver: int
    """Row of the trial's places."""
    facts: dict[str, Any]


class Trial(NamedTuple):
    """Frames of radios that stand still."""

    experiment: str
    seed: int
    in_city: bool
    horizon_m: float
    places_m: Floats
    """(n, 3)"""
    sender: NDArray[np.int64]
    """(k,) rows of `places_m`, one for each frame."""
    at_ns: NDArray[np.int64]
    """(k,) ascending."""
    cells: Sequence[Cell]


class Shares(NamedTuple):
    """Results of a trial: for each cell, decoded frames, and frames that were offered."""

    decoded: NDArray[np.int64]
    offered: NDArray[np.int64]


def run_trial(trial: Trial, setup: EngineSetup, city: City | None) -> Shares:
    """Offer the frames of a trial to an engine, with skyrange's path losses, and count what its cells decode."""
    names = [f"r{row:04d}" for row in range(len(trial.places_m))]
    radios = [RadioSpec(name, None, SNIFFER, wifi_dbm=15.0) for name in names]  # senders defer by what they receive
    surroundings = RadioEnvironment(horizon_m=trial.horizon_m)
    medium = setup.make(radios, trial.seed, city if trial.in_city else None, surroundings)
    try:
        table = RadioTable(0, trial.places_m, np.zeros_like(trial.places_m))
        decoded = np.zeros(len(names), dtype=np.int64)
        begin, last = 0, int(trial.at_ns[-1]) + SETTLE_NS
        keys = np.arange(len(trial.at_ns))
        for until in range(STEP_NS, last + STEP_NS, STEP_NS):
            end = int(np.searchsorted(trial.at_ns, until, side="right"))
            if end > begin:
                rows = slice(begin, end)
                same = np.zeros(end - begin, dtype=np.int64)
                medium.offer(
                    until,
                    TxBatch(
                        trial.sender[rows], trial.at_ns[rows], same + int(Waveform.OFDM_6M), same + ANY_CHANNEL,
                        np.full(end - begin, np.nan), same + FRAME_BYTES, keys[rows],
                    ),
                )  # fmt: skip
                begin = end
            heard = medium.advance(until, table).heard
            np.add.at(decoded, heard.radio[heard.outcome == ReceptionOutcome.DECODED], 1)
    finally:
        medium.close()
    offered = np.array([int((trial.sender != cell.receiver).sum()) for cell in trial.cells])
    return Shares(decoded[[cell.receiver for cell in trial.cells]], offered)


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
                experiment="reach",
                seed=seed + sender,
                in_city=True,
                horizon_m=surroundings.horizon_m,
                places_m=candidates.enu_m[rows],
                sender=np.zeros(FRAMES, dtype=np.int64),
                at_ns=at.astype(np.int64),
                cells=cells,
            )


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
                yield _rounds(
                    "contention", seed, places, rng, receiver=(0.0, 0.0, 80.0), window_ns=window_ns, facts=facts
                )


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
                yield _rounds(
                    "hidden terminals", seed, places, rng, receiver=(0.0, 0.0, 60.0), window_ns=window_ns, facts=facts
                )


def _rounds(
    experiment: str,
    seed: int,
    places: np.ndarray,
    rng: np.random.Generator,
    *,
    receiver: tuple[float, float, float],
    window_ns: int,
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
        experiment=experiment,
        seed=seed,
        in_city=False,
        horizon_m=5_000.0,
        places_m=placed,
        sender=sender,
        at_ns=at.ravel()[order].astype(np.int64),
        cells=[Cell(nodes, dict(facts))],
    )
