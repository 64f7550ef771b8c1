"""Base of kinds that judge signal strengths: parameters of channel and map, and a test of strengths against a claim.

The defaults are those of standards and measurements, and an exact map. ITU-R P.1411-11 (4.1.1, table 2) and TR 38.901
state other spreads for other streets; a footprint of OpenStreetMap is off by about 4 m (H. Fan, A. Zipf, Q. Fu and P.
Neis, "Quality assessment for building footprints data on OpenStreetMap", IJGIS 28/4, 2014: Munich).

The claim is the null hypothesis. A sender of constant radiated power P, within the legal limits, is where it says; the
strength at a receiver in its sight is P − L(d) + S + F (dBm, dB). L is free space (ITU-R P.525-4, eq. 3). S is
shadowing: normal with σ = max(5·exp(−0.01·h), 2) dB, h being the lower antenna's height in metres (3GPP TR 36.777
table B-3, UMi-AV in sight), one value while both ends stay in cells of 10 m / 0.63 (decorrelation distance 10 m, TR
38.901 table 7.5-6). F is Rician fading with K = 12 dB (Matolak & Sun 2017), one value for each broadcast; the standard
deviation of its power in dB is (10/ln 10)·√(1 + 2K)/(1 + K) to first order.

The alternative is a mixture, with equal weights, of transmitters that stand elsewhere, with powers of their own, and of
claims that are right but sent with more than the legal power. E is the density of the strengths under the mixture over
their largest density under the null hypothesis. Under any legal P the ratio of the mixture to the density at P is a
martingale of mean 1, so by Ville's inequality E reaches 1/α at any time with a probability of at most α: the sequential
test of Wald (1945) with the maximum over P (universal inference: Wasserman, Ramdas & Balakrishnan, PNAS 117/29, 2020).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import floor, pi, sqrt
from typing import Annotated, Any, Final, Protocol

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator

import skyrange.plugin as sky
from skyrange.city.city import City
from skyrange.core import elementary, elementary_python, elementwise
from skyrange.core.chance import Chance
from skyrange.core.elementary import exp, log, log10
from skyrange.core.ids import hash64
from skyrange.defence.bases.receptions import BroadcastJudge
from skyrange.defence.receptions import Place

Floats = NDArray[np.float64]
RICIAN_K_DB: Final = 12.0
"""Matolak & Sun 2017, air to ground near a city."""
DECORRELATION_M: Final = 10.0
"""TR 38.901 table 7.5-6, UMi in sight."""
_LIGHT_MPS: Final = 299_792_458.0
_LEAST_M: Final = 0.5
"""Shorter distances have the loss of this one: free space holds in the far field alone."""
FREQUENCY_MHZ: Final = 2437.0
"""Wi-Fi channel 6; Bluetooth at 2.402 to 2.480 GHz differs by 0.15 dB at most."""
WAVELENGTH_M: Final = _LIGHT_MPS / (FREQUENCY_MHZ * 1e6)
_CONSTANT_DB: Final = 20.0 * elementary_python.log10(4.0 * pi / WAVELENGTH_M)
_RADII_M: Final = (20.0, 40.0, 80.0, 160.0, 320.0, 640.0)
_BEARINGS: Final = 12
_HEIGHT_M: Final = 2.0
"""Height of the transmitters of the alternative: held by hand."""
_POWERS_DBM: Final = np.arange(0.0, 36.0, 5.0)
_EXCESS_DB: Final = (10.0, 20.0)
"""By how much a power exceeds the legal limit, in the alternative."""
_COARSENESS_DB: Final = 2.0
"""Standard deviation of a strength of the alternative beyond that of the channel, because its places and powers are
coarse. It alters the power of the test, and not its error rate."""
MAX_CELLS: Final = 256


@dataclass(frozen=True, slots=True)
class AssumedChannel:
    """What a test assumes of signals in sight; the world's may be another."""

    rician_k_db: float = RICIAN_K_DB
    decorrelation_m: float = DECORRELATION_M
    sigma_db: float | None = None
    """Standard deviation of shadowing; `None`: by the height of the lower antenna, TR 36.777."""

    @property
    def fading_db(self) -> float:
        """Standard deviation of the power of one broadcast, in dB, to first order."""
        k: float = elementary.exp10(0.1 * self.rician_k_db)
        return 10.0 / log(10.0) * sqrt(1.0 + 2.0 * k) / (1.0 + k)

    @property
    def cell_m(self) -> float:
        """Side of the cells within which shadowing is one value."""
        return self.decorrelation_m / 0.63

    def shadowing_db(self, lower_m: float) -> float:
        """Standard deviation of shadowing, for the height of the lower antenna."""
        return shadowing_db(lower_m) if self.sigma_db is None else self.sigma_db


USUAL: Final = AssumedChannel()


def free_space_loss_db(distance_m: float) -> float:
    """Loss between isotropic antennas at 2437 MHz."""
    return _CONSTANT_DB + 20.0 * log10(max(distance_m, _LEAST_M))


def shadowing_db(lower_m: float) -> float:
    """Standard deviation of shadowing in sight, for the height of the lower antenna."""
    return max(5.0 * exp(-0.01 * max(lower_m, 0.0)), 2.0)


@dataclass(slots=True)
class _Cell:
    """Means of the receptions of one receiver while both ends stay in their cells."""

    channel: AssumedChannel
    count: int = 0
    strength_dbm: float = 0.0
    receiver: Place = (0.0, 0.0, 0.0)
    claimed: Place = (0.0, 0.0, 0.0)

    def add(self, strength_dbm: float, receiver: Place, claimed: Place) -> None:
        self.count += 1
        share = 1.0 / self.count
        self.strength_dbm += (strength_dbm - self.strength_dbm) * share
        self.receiver = _mix(self.receiver, receiver, share)
        self.claimed = _mix(self.claimed, claimed, share)

    @property
    def power_dbm(self) -> float:
        """Radiated power that the claim implies."""
        return self.strength_dbm + free_space_loss_db(elementary_python.distance(self.receiver, self.claimed))

    @property
    def variance(self) -> float:
        """Of the mean, in dB²."""
        lower_m = min(self.receiver[2], self.claimed[2])
        return (
            elementary_python.square(self.channel.shadowing_db(lower_m))
            + (self.channel.fading_db * self.channel.fading_db) / self.count
        )


def _mix(mean: Place, new: Place, share: float) -> Place:
    (a, b, c), (x, y, z) = mean, new
    return (a + (x - a) * share, b + (y - b) * share, c + (z - c) * share)


@dataclass(slots=True)
class StrengthTest:
    """The test of one sender. Deep-copyable."""

    legal_dbm: tuple[float, float]
    channel: AssumedChannel = USUAL
    _cells: dict[tuple[str, int, int, int, int, int, int], _Cell] = field(default_factory=dict)
    _places: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    _other: Floats = field(default_factory=lambda: np.zeros(0))
    """Log density of the strengths under each part of the mixture."""
    _sums: list[float] = field(default_factory=lambda: [0.0] * 4)
    """Of 1/v, x/v, x²/v and ln v over the cells; x: implied power, v: its variance."""

    def add(self, who: str, receiver: Place, claimed: Place, strength_dbm: float) -> None:
        """Take in a reception by `who` at `receiver`."""
        if not self._cells:
            self._places = _grid(receiver)
            self._other = np.zeros(len(self._places) * len(_POWERS_DBM) + len(_EXCESS_DB))
        side_m = self.channel.cell_m
        near, far = _cell_of(receiver, side_m), _cell_of(claimed, side_m)
        key = (who, *near, *far)
        cell = self._cells.get(key)
        if cell is None:
            if len(self._cells) >= MAX_CELLS:
                return
            cell = self._cells[key] = _Cell(self.channel)
        else:
            self._count(cell, -1.0)
        cell.add(strength_dbm, receiver, claimed)
        self._count(cell, 1.0)

    @property
    def cells(self) -> int:
        """Independent values so far."""
        return len(self._cells)

    @property
    def log_evidence(self) -> float:
        """Natural logarithm of E; minus infinity before the first reception."""
        if not self._cells:
            return -np.inf
        low, high = self.legal_dbm
        weight, mean, square, logs = self._sums
        best = min(max(mean / weight, low), high)
        null = -0.5 * (square - 2.0 * best * mean + best * best * weight + logs)
        top = float(self._other.max())
        return top + log(float(elementwise.exp(self._other - top).mean())) - null

    @property
    def power_dbm(self) -> float:
        """Radiated power that the claims imply, over all cells."""
        return self._sums[1] / self._sums[0] if self._cells else float("nan")

    @property
    def likely_place(self) -> Place | None:
        """The place of the most likely transmitter of the mixture; `None` for the claimed one."""
        best = int(self._other.argmax()) - len(_EXCESS_DB)
        if best < 0:
            return None
        east, north, up = self._places[best // len(_POWERS_DBM)].tolist()
        return (east, north, up)

    def _count(self, cell: _Cell, sign: float) -> None:
        power, variance = cell.power_dbm, cell.variance
        for place, term in enumerate((1.0 / variance, power / variance, power * power / variance, log(variance))):
            self._sums[place] += sign * term
        away = self._places - np.array(cell.receiver)
        distance = np.maximum(np.sqrt((away * away).sum(axis=1)), _LEAST_M)
        implied = cell.strength_dbm + _CONSTANT_DB + 20.0 * elementwise.log10(distance)
        illegal = power - self.legal_dbm[1] - np.array(_EXCESS_DB)
        error = np.concatenate((illegal, (implied[:, None] - _POWERS_DBM[None, :]).ravel()))
        spread = variance + (_COARSENESS_DB * _COARSENESS_DB)
        self._other += sign * -0.5 * (error * error / spread + log(spread))


def _grid(centre: Place) -> Floats:
    """Places of transmitters: on circles around where the sender was first heard, and there."""
    bearing = np.arange(_BEARINGS) * (2.0 * pi / _BEARINGS)
    radius = np.array(_RADII_M)[:, None]
    east = np.concatenate(([0.0], (radius * elementwise.sin(bearing)).ravel())) + centre[0]
    north = np.concatenate(([0.0], (radius * elementwise.cos(bearing)).ravel())) + centre[1]
    return np.column_stack((east, north, np.full(len(east), _HEIGHT_M)))


def _cell_of(place: Place, side_m: float) -> tuple[int, int, int]:
    x, y, z = (floor(v / side_m) for v in place)
    return (x, y, z)


_STREAM: Final = "defence.map"


def map_with_errors(city: City | None, shift_m: tuple[float, float], missing: float, chance: Chance) -> City | None:
    """The city with all footprints moved by `shift_m`, east and north in metres, and without a share of its buildings.

    Which are missing depends on their ids and the seed. `None` where there is no building (left).
    """
    if city is None or (shift_m == (0.0, 0.0) and missing == 0.0):
        return city
    kept = [
        building for building in city.buildings if chance.uniform4(_STREAM, hash64(building.id), 0, 0)[0] >= missing
    ]
    moved = [
        replace(building, shape=shapely.transform(building.shape, lambda points: points + shift_m)) for building in kept
    ]
    return City(moved, f"{city.source}, with errors") if moved else None


def _is_pair(values: tuple[float, ...]) -> tuple[float, ...]:
    if len(values) != 2:
        raise sky.refuse(sky.Problem("", repr(list(values)), "east and north in metres, such as [4, -3]"))
    return values


Shift = Annotated[
    tuple[sky.Number, ...],
    BeforeValidator(sky.items, json_schema_input_type=list[float]),
    AfterValidator(_is_pair),
]


def assumed_k() -> Any:
    """The parameter `rician_k_db`."""
    return sky.param(
        "Rician K of signals in sight that it assumes, in dB; the default is by Matolak & Sun, 2017.",
        default=RICIAN_K_DB, ge=-20, le=60,
    )  # fmt: skip


def assumed_decorrelation() -> Any:
    """The parameter `decorrelation_m`."""
    return sky.param(
        "Decorrelation distance of shadowing that it assumes, in metres; the default is by 3GPP TR 38.901.",
        default=DECORRELATION_M, gt=0, le=1_000,
    )  # fmt: skip


def assumed_shadowing() -> Any:
    """The parameter `shadowing_db`."""
    return sky.param(
        "Standard deviation of shadowing in sight that it assumes, in dB; default: by the height of the lower antenna, "
        "3GPP TR 36.777.",
        default=None, gt=0, le=30,
    )  # fmt: skip


def assumed_shift() -> Any:
    """The parameter `map_shift_m`."""
    return sky.param(
        "Error of its map, [east, north] in metres, by which every building is off; about 4 m in OpenStreetMap.",
        default=(0.0, 0.0),
    )


def assumed_missing() -> Any:
    """The parameter `map_missing`."""
    return sky.param("Share of the buildings that its map lacks.", default=0.0, ge=0, le=1)


class Knowing(Protocol):
    """A kind with these parameters."""

    rician_k_db: float
    decorrelation_m: float
    shadowing_db: float | None
    map_shift_m: tuple[float, ...]
    map_missing: float


def channel_of(kind: Knowing) -> AssumedChannel:
    """The channel that a kind assumes."""
    return AssumedChannel(kind.rician_k_db, kind.decorrelation_m, kind.shadowing_db)


def map_of(kind: Knowing, context: sky.DefenceContext) -> sky.City | None:
    """The map that a kind has."""
    east_m, north_m = kind.map_shift_m
    return map_with_errors(context.city, (east_m, north_m), kind.map_missing, context.chance)


class SignalJudge(BroadcastJudge):
    """Judges broadcasts by their signals: what it assumes of the channel and of its map are parameters."""

    rician_k_db: sky.Number = assumed_k()
    decorrelation_m: sky.Number = assumed_decorrelation()
    shadowing_db: sky.Number | None = assumed_shadowing()
    map_shift_m: Shift = assumed_shift()
    map_missing: sky.Number = assumed_missing()
    city: sky.City | None
    """Its map."""

    def prepare(self, context: sky.DefenceContext) -> None:
        """Draw the map."""
        self.city = map_of(self, context)
