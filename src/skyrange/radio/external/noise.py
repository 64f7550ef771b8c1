"""Noise as an engine gets it: jammers and the city's background traffic, in pieces of limited length."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.medium_protocol import NO_RADIO, NOISE, PATH, Rows
from skyrange.contracts.medium import EmitterTable, Floats, Ints, RadioTable
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_MS, Time
from skyrange.radio.builtin.channel_access import BACKGROUND_INTERVAL_NS, background_power_mw
from skyrange.radio.external.paths import PathFinder
from skyrange.radio.propagation.link_budget import MediumParams

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
        self._told: dict[Emission, Time] = {}

    def emit(self, now: Time, sources: EmitterTable) -> None:
        """From `now` on, just these sources make noise; a piece that was handed over already lasts to its end."""
        told: dict[Emission, Time] = {}
        for row in zip(*(column.tolist() for column in sources), strict=True):
            one = Emission(*row)
            told[one] = self._told.get(one, max(one.from_ns, now))
        self._told = told

    def pieces(self, after: Time, until: Time, table: RadioTable, finder: PathFinder) -> tuple[list[Rows], list[Rows]]:
        """`NOISE` rows that begin after `after` and up to `until`, and the `PATH` rows of each."""
        rows, paths = [], []
        for one, told in sorted(self._told.items()):
            begin = max(told, after + 1)
            while begin <= until and begin < one.to_ns:
                end = min((begin // PIECE_NS + 1) * PIECE_NS, one.to_ns)
                found = finder.find(table, one.radio, one.power_dbm, one.centre_mhz, begin)
                row = np.zeros(1, dtype=NOISE)
                row[0] = (begin, end, one.centre_mhz, one.width_mhz, one.power_dbm, one.radio, 0, len(found), 0)
                rows.append(row)
                paths.append(found)
                begin = end
            self._told[one] = begin
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
                times[count], rows[count], dbm[count] = piece, r, 10.0 * np.log10(power)
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
