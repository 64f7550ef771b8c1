"""Path gains between radios of control links, by the propagation model of the medium."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.medium import Floats, Ints, RadioTable
from skyrange.core.chance import Chance
from skyrange.core.compiled import compiled
from skyrange.core.ids import hash64
from skyrange.core.time import Time
from skyrange.radio.builtin.state import ANTENNAS
from skyrange.radio.propagation.link_budget import MediumParams, received_power_dbm
from skyrange.radio.propagation.loss_table import NO_TABLE, LossTable
from skyrange.radio.propagation.obstruction import Obstacles, obstacle_index

if TYPE_CHECKING:
    from skyrange.city.city import City

HORIZON_M: Final = 20_000.0
_FLOOR_DB: Final = -300.0


@compiled
def _fill_gains(  # noqa: PLR0917
    params: MediumParams, obstacles: Obstacles, who: NDArray[np.uint64], antenna: Floats, pos: Floats, vel: Floats,
    one: Ints, other: Ints, centre: float, time_ns: int, out: Floats,
) -> None:  # fmt: skip
    for k in range(one.shape[0]):
        out[k] = received_power_dbm(
            params, obstacles, who, antenna, pos, vel, one[k], other[k], 0.0, centre, time_ns, _FLOOR_DB
        )


class Propagation:
    """Gains between radios, given by name and antenna. Copies share it: nothing in it changes."""

    def __init__(
        self,
        names: Sequence[str],
        antennas: Sequence[tuple[str, float]],
        chance: Chance,
        city: City | None,
        *,
        randomness: bool,
        table: LossTable = NO_TABLE,
    ) -> None:
        """`antennas` has the pattern and the gain in dBi of each radio. Where `table` covers two positions, its losses
        replace those of open ground and buildings.
        """
        self._obstacles = obstacle_index(city.walls()) if city is not None else obstacle_index()
        self._who = np.array([hash64(name) for name in names], dtype=np.uint64)
        self._antenna = np.array([(ANTENNAS.index(pattern), gain) for pattern, gain in antennas], dtype=np.float64)
        self._params = MediumParams(
            seed=chance.key,
            horizon_m=HORIZON_M,
            randomness=randomness,
            background_share=0.0,
            background_mean_mw=0.0,
            every_pair=False,
            tabled=len(table.places) > 0,
            table=table._replace(lookups=np.zeros_like(table.lookups)),
        )

    def __deepcopy__(self, memo: object) -> Propagation:
        return self

    def gains_db(self, radios: RadioTable, first: Ints, second: Ints, centre_mhz: float, at: Time) -> Floats:
        """(k,) gain of the path between the radios `one[i]` and `other[i]`, antennas included, the same both ways.

        `radios` has its rows in the order of the names. −inf beyond 20 km, and where a radio has no position.
        """
        out = np.empty(len(first))
        pos, vel = radios.pos_enu_m, radios.vel_enu_mps
        _fill_gains(
            self._params, self._obstacles, self._who, self._antenna, pos, vel, first, second, centre_mhz, at, out
        )
        return out
