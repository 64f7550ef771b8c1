"""Paths of transmissions and of noise as an engine gets them: the radios that are reached, with the gain of each.

Noise is that of jammers and of the city's background traffic, in pieces of limited length.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.medium_protocol import NO_RADIO, NOISE, PATH, Rows
from skyrange.contracts.medium import EmitterTable, Floats, Ints, RadioSpec, RadioTable
from skyrange.core import elementary
from skyrange.core.chance import Chance
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_MS, Time
from skyrange.radio.builtin.channel_access import BACKGROUND_INTERVAL_NS, background_power_mw
from skyrange.radio.builtin.params import RadioEnvironment
from skyrange.radio.builtin.state import Radios
from skyrange.radio.propagation.link_budget import IndexedRadios, MediumParams, append_received_powers, index_positions
from skyrange.radio.propagation.loss_table import NO_TABLE, LossTable
from skyrange.radio.propagation.obstruction import obstacle_index
from skyrange.radio.propagation.path_loss import dipole_dbi, noise_dbm

if TYPE_CHECKING:
    from skyrange.city.city import City

BELOW_NOISE_DB: Final = 10.0
"""A path is left out if its median power is this far below the least noise of all receivers: it would add 0.4 dB."""
_WIDTH_MHZ: Final = 20.0
_NO_FLOOR_DBM: Final = -1e3


@compiled
def _antenna_gains(antenna: Floats, pos: Floats, sender: int, rows: Ints, gains: Floats, count: int) -> None:
    """Gains of both antennas for the first `count` of `rows`, in dB."""
    for k in range(count):
        r = rows[k]
        gain = antenna[sender, 1] + antenna[r, 1]
        ex, ey, ez = pos[r, 0] - pos[sender, 0], pos[r, 1] - pos[sender, 1], pos[r, 2] - pos[sender, 2]
        distance = math.sqrt(ex * ex + ey * ey + ez * ez)
        sine = ez / distance if distance > 0.0 else 0.0
        if antenna[sender, 0] == 1.0:
            gain += dipole_dbi(sine)
        if antenna[r, 0] == 1.0:
            gain += dipole_dbi(-sine)
        gains[k] = gain


class PathFinder:
    """Finds the paths of a transmitter. Their gains are those of skyrange's propagation or, with `own_losses`, those of
    the antennas alone. Deep copies share what is declared.
    """

    def __init__(
        self,
        radios: Sequence[RadioSpec],
        arrays: Radios,
        chance: Chance,
        city: City | None,
        surroundings: RadioEnvironment,
        *,
        own_losses: bool,
        table: LossTable = NO_TABLE,
    ) -> None:
        self._arrays = arrays
        self._obstacles = obstacle_index(city.walls()) if city is not None and not own_losses else obstacle_index()
        self.own_losses = own_losses
        self.params = MediumParams(
            seed=chance.key,
            horizon_m=float(surroundings.horizon_m),
            randomness=surroundings.chance and not own_losses,
            background_share=float(surroundings.city_busy),
            background_mean_mw=elementary.exp10(0.1 * surroundings.city_dbm),
            every_pair=False,
            tabled=len(table.places) > 0,
            table=table._replace(lookups=np.zeros_like(table.lookups)),
        )
        self._floor_dbm = float(noise_dbm(arrays.best_noise_db, _WIDTH_MHZ)) - BELOW_NOISE_DB
        count = len(radios)
        self._head = np.full(1 << max(2 * count - 1, 0).bit_length(), -1, dtype=np.int64)
        self._follow = np.zeros(count, dtype=np.int64)
        self._rows = np.zeros(count, dtype=np.int64)
        self._dbm = np.zeros(count)
        self._indexed: Floats | None = None

    def __deepcopy__(self, memo: dict[int, Any]) -> PathFinder:
        """Share all but the scratch arrays."""
        twin = object.__new__(type(self))
        twin.__dict__.update(self.__dict__)
        twin._head, twin._follow = self._head.copy(), self._follow.copy()
        twin._rows, twin._dbm = self._rows.copy(), self._dbm.copy()
        return twin

    def find(self, table: RadioTable, sender: int, power_dbm: float, centre_mhz: float, at: Time) -> Rows:
        """`PATH` rows of a transmission of `power_dbm` at `centre_mhz` and the time `at`, ascending by receiver."""
        pos = table.pos_enu_m
        if self._indexed is not pos:
            index_positions(self._head, self._follow, pos)
            self._indexed = pos
        # with own losses only the horizon counts: what the engine's model will say is not known here
        floor = _NO_FLOOR_DBM if self.own_losses else self._floor_dbm
        arrays = self._arrays
        radios = IndexedRadios(
            arrays.who, arrays.antenna, arrays.best_dbi, pos, table.vel_enu_mps, self._head, self._follow
        )
        count = append_received_powers(
            self.params, self._obstacles, radios, sender, power_dbm, centre_mhz, at, floor, self._rows, self._dbm, 0
        )
        paths = np.zeros(count, dtype=PATH)
        paths["radio"] = self._rows[:count]
        if self.own_losses:
            _antenna_gains(self._arrays.antenna, pos, sender, self._rows, self._dbm, count)
            paths["gain_db"] = self._dbm[:count]
        else:
            paths["gain_db"] = self._dbm[:count] - power_dbm
        return paths


PIECE_NS: Final = 20 * NS_PER_MS
"""The gain of a path from a jammer holds for at most this long; pieces begin at multiples of it."""
_WIFI_MHZ: Final = 20.0


class Emission(NamedTuple):
    """A noise source as declared: `EmitterTable`, one row."""

    radio: int
    centre_mhz: float
    width_mhz: float
    power_dbm: float
    from_ns: Time
    to_ns: Time


class NoiseSources:
    """Jammers, and until when the noise of each was handed over. Deep-copyable."""

    def __init__(self) -> None:
        self._handed_over: dict[Emission, Time] = {}

    def emit(self, now: Time, sources: EmitterTable) -> None:
        """From `now` on, just these sources make noise; a piece that was handed over already lasts to its end."""
        handed_over: dict[Emission, Time] = {}
        for row in zip(*(column.tolist() for column in sources), strict=True):
            source = Emission(*row)
            handed_over[source] = self._handed_over.get(source, max(source.from_ns, now))
        self._handed_over = handed_over

    def pieces(self, after: Time, until: Time, table: RadioTable, finder: PathFinder) -> tuple[list[Rows], list[Rows]]:
        """`NOISE` rows that begin after `after` and up to `until`, and the `PATH` rows of each."""
        rows, paths = [], []
        for source, since in sorted(self._handed_over.items()):
            begin = max(since, after + 1)
            while begin <= until and begin < source.to_ns:
                end = min((begin // PIECE_NS + 1) * PIECE_NS, source.to_ns)
                reached = finder.find(table, source.radio, source.power_dbm, source.centre_mhz, begin)
                row = np.zeros(1, dtype=NOISE)
                row[0] = (
                    begin,
                    end,
                    source.centre_mhz,
                    source.width_mhz,
                    source.power_dbm,
                    source.radio,
                    0,
                    len(reached),
                    0,
                )
                rows.append(row)
                paths.append(reached)
                begin = end
            self._handed_over[source] = begin
        return rows, paths


@compiled
def _background(
    params: MediumParams, who: NDArray[np.uint64], first: int, last: int, centre: float
) -> tuple[Ints, Ints, Floats]:
    """Interval, receiver and power in dBm of the background traffic in a channel, in intervals `first` to `last`."""
    most = (last - first + 1) * who.shape[0]
    times, rows, dbm = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64), np.empty(most)
    count = 0
    for piece in range(first, last + 1):
        for r in range(who.shape[0]):
            power = background_power_mw(params, who[r], piece, centre, _WIFI_MHZ)
            if power > 0.0:
                times[count], rows[count], dbm[count] = piece, r, 10.0 * elementary.log10(power)
                count += 1
    return times[:count].copy(), rows[:count].copy(), dbm[:count].copy()


def background_pieces(
    params: MediumParams, who: NDArray[np.uint64], after: Time, until: Time, centre_mhz: float
) -> tuple[list[Rows], list[Rows]]:
    """`NOISE` and `PATH` rows of the intervals that begin after `after` and up to `until`: one row for each interval
    and receiver in which the builtin medium would draw traffic.
    """
    first, last = after // BACKGROUND_INTERVAL_NS + 1, until // BACKGROUND_INTERVAL_NS
    if params.background_share <= 0.0 or last < first:
        return [], []
    times, radios, dbm = _background(params, who, first, last, centre_mhz)
    rows = np.zeros(len(times), dtype=NOISE)
    rows["from_ns"] = times * BACKGROUND_INTERVAL_NS
    rows["to_ns"] = rows["from_ns"] + BACKGROUND_INTERVAL_NS
    rows["centre_mhz"], rows["width_mhz"], rows["power_dbm"] = centre_mhz, _WIFI_MHZ, dbm
    rows["radio"], rows["paths"] = NO_RADIO, 1
    rows["first_path"] = np.arange(len(times))
    paths = np.zeros(len(times), dtype=PATH)
    paths["radio"] = radios
    return [rows], [paths]
