"""Transmitter of an attacker on the GPS L1 frequency: its power at the antennas of receivers, by their gain.

Power follows from free space, a constant loss where a building of the city is in the way, and the gain of the
receiver's antenna towards the transmitter. The medium of the range
has the 2.4 GHz band only, so this transmitter is no node of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, pi
from typing import TYPE_CHECKING, Final

import numpy as np

from skyrange.attack.contract import AttackContext, Place
from skyrange.contracts.components import Floats
from skyrange.core import elementary, elementary_python, elementwise
from skyrange.core.errors import InputError

if TYPE_CHECKING:
    from skyrange.city.city import City

ZENITH_DBIC: Final = 5.0
"""Assumed gain of a patch on a ground plane of some centimetres; u-blox asks for more than 4 dBic (GNSS antennas,
UBX-15030289, 2.2)."""
ATTENUATION_DB: Final = (
    0.00, 0.00, 0.22, 0.44, 0.67, 1.11, 1.56, 2.00, 2.44, 2.89, 3.56, 4.22, 4.89, 5.56, 6.22, 6.89, 7.56, 8.22, 8.89,
    9.78, 10.67, 11.56, 12.44, 13.33, 14.44, 15.56, 16.67, 17.78, 18.89, 20.00, 21.33, 22.67, 24.00, 25.56, 27.33,
    29.33, 31.56,
)  # fmt: skip
"""Attenuation of a patch antenna at 0, 5, … 180 degrees from its zenith (gps-sdr-sim, gpssim.c, `ant_pat_db`)."""
LEAST_DBIC: Final = -10.0
"""Assumed below the horizon: frame and arms scatter, and fill the null that the table has at the nadir."""
_STEP_DEG: Final = 5.0


def gain_dbic(elevation_deg: Floats) -> Floats:
    """Gain towards a source at elevations from the antenna's horizon (n,), dBic, for the polarisation of satellites."""
    steps = (90.0 - np.asarray(elevation_deg)) / _STEP_DEG
    table = np.array(ATTENUATION_DB)
    places = np.clip(steps, 0.0, len(table) - 1.0)
    below = np.fmin(np.floor(places), len(table) - 2.0)  # numpy's own interpolation may be contracted
    left = np.fmax(below, 0.0).astype(np.int64)
    attenuation = (table[left + 1] - table[left]) * (places - left) + table[left]
    return np.asarray(np.maximum(ZENITH_DBIC - attenuation, LEAST_DBIC), dtype=np.float64)


HORIZON_DBIC: Final = float(gain_dbic(np.zeros(1))[0])


SPEED_OF_LIGHT_MPS: Final = 299_792_458.0
L1_HZ: Final = 1_575_420_000.0
AUTHENTIC_DBM: Final = -128.5
"""Power of GPS L1 C/A out of an antenna of 0 dBi: the least that is specified, −158.5 dBW (IS-GPS-200, table 3-Va)."""
FIX_NONE: Final = 1
FIX_3D: Final = 3
_FREE_SPACE_1M_DB: Final = 20.0 * elementary_python.log10(4.0 * pi * L1_HZ / SPEED_OF_LIGHT_MPS)
_LEAST_M: Final = 0.5
_CLIMB_M: Final = 5.0
"""A path is tested against roofs in parts that climb no more than this."""


@dataclass(frozen=True, slots=True)
class Emitter:
    """A transmitter at a fixed place."""

    place_enu_m: Place
    power_dbm: float
    wall_loss_db: float
    city: City | None

    def received_dbm(self, places: Floats) -> Floats:
        """Power out of the antennas of receivers at `places` (n, 3), dBm.

        An antenna faces the zenith: aircraft are level, as far as this is concerned. Its polarisation fits.
        """
        level_m = elementwise.hypot(places[:, 0] - self.place_enu_m[0], places[:, 1] - self.place_enu_m[1])
        elevation = np.degrees(elementwise.atan2(self.place_enu_m[2] - places[:, 2], level_m))
        return np.asarray(self.power_dbm - self.loss_db(places) + gain_dbic(elevation), dtype=np.float64)

    def loss_db(self, places: Floats) -> Floats:
        """Loss on the way to `places` (n, 3), dB: that of free space (ITU-R P.525-4, eq. 3), and walls."""
        away_m = np.maximum(elementwise.length(places - np.array(self.place_enu_m)), _LEAST_M)
        loss = _FREE_SPACE_1M_DB + 20.0 * elementwise.log10(away_m)
        if self.city is not None:
            hidden = [not self.city.is_clear(_in_parts(self.place_enu_m, row)) for row in places.tolist()]
            loss = loss + self.wall_loss_db * np.array(hidden, dtype=np.float64)
        return np.asarray(loss, dtype=np.float64)

    @property
    def reach_m(self) -> float:
        """Distance in free space beyond which its signals are weaker than the authentic ones, in metres."""
        return reach_m(self.power_dbm, AUTHENTIC_DBM, ZENITH_DBIC)


def reach_m(power_dbm: float, least_dbm: float, gain: float = HORIZON_DBIC) -> float:
    """Distance in free space at which a power has fallen to `least_dbm`, in metres; by default along the horizon."""
    return float(elementary.exp10((power_dbm + gain - _FREE_SPACE_1M_DB - least_dbm) / 20.0))


def _in_parts(start: Place, end: Sequence[float]) -> list[Place]:
    """A straight path in parts so flat that the highest point of each stands for the part."""
    east, north, up = end
    parts = max(1, ceil(abs(up - start[2]) / _CLIMB_M))
    shares = [number / parts for number in range(parts + 1)]
    leg = (east - start[0], north - start[1], up - start[2])
    return [(start[0] + s * leg[0], start[1] + s * leg[1], start[2] + s * leg[2]) for s in shares]


def emitter_at(place: Place, power_dbm: float, wall_loss_db: float, context: AttackContext) -> Emitter:
    """The transmitter. Raises `InputError` for a place inside a building."""
    if context.city is not None:
        building = context.city.inside(*place)
        if building is not None:
            hint = f"The roof there is {building.height_m:g} m high."
            raise InputError.one(context.id, "transmitter_m", list(place), "a place outside of buildings", hint)
    return Emitter(place, power_dbm, wall_loss_db, context.city)
