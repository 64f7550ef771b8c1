"""Constellations that a receiver uses, and which of its satellites an attacker simulates.

A u-blox SAM-M10Q receives four at once (data sheet, UBX-22013293): GPS L1 C/A, Galileo E1 and BeiDou B1C at 1575.42
MHz, and GLONASS L1OF around 1602 MHz, where signals at the former are no noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field

from skyrange.attack.gnss.emitter import AUTHENTIC_DBM
from skyrange.attack.gnss.receiver_noise import LEAST_SATELLITES, TRACKING_DB_HZ, effective_db_hz, total_dbm
from skyrange.contracts.components import Floats
from skyrange.contracts.params import items, refuse
from skyrange.core.errors import Problem

Constellation = Literal["gps", "galileo", "glonass", "beidou"]
ALL_CONSTELLATIONS: Final[tuple[Constellation, ...]] = ("gps", "galileo", "glonass", "beidou")
_OWN_BAND: Final = ALL_CONSTELLATIONS.index("glonass")
Marks = NDArray[np.bool_]
PARTLY_SIMULATED: Final = {
    "constellations of the receiver": "cited: four (data sheet of the u-blox SAM-M10Q, UBX-22013293); assumed: equal "
    "shares of the satellites, in turn by strength",
    "receiver of which a part is simulated": "assumed: satellites that agree are the fix if they are more than the "
    "others, and the others are rejected; u-blox says that its detection of spoofing relies on several constellations "
    "(ZED-F9T integration manual, spoofing detection)",
}
"""Realism of a simulator of some constellations."""


def _each_once(names: tuple[Constellation, ...]) -> tuple[Constellation, ...]:
    if len(set(names)) < len(names):
        raise refuse(Problem("", repr(list(names)), "each constellation once"))
    return names


Constellations = Annotated[
    tuple[Constellation, ...],
    BeforeValidator(items, json_schema_input_type=list[str]),
    Field(min_length=1),
    AfterValidator(_each_once),
]
"""Constellations, one or more, each once."""


def mark_simulated(names: Sequence[Constellation], satellites: int) -> Marks:
    """Which of the satellites of a receiver are of these constellations (satellites,)."""
    chosen = [ALL_CONSTELLATIONS.index(name) for name in names]
    return np.isin(np.arange(satellites) % len(ALL_CONSTELLATIONS), chosen)


def noise_dbm(signal_dbm: float, simulated: Marks, heard: int = 0) -> Floats:
    """Power of the simulated signals together, at each satellite's frequency (satellites,), dBm.

    There is one for each satellite that is `simulated`, and no fewer than a fix needs. `heard` of those at a frequency
    are not noise: 1 for the simulated signals themselves.
    """
    own_band = np.arange(len(simulated)) % len(ALL_CONSTELLATIONS) == _OWN_BAND
    counts = [int((simulated & ~own_band).sum()), int((simulated & own_band).sum())]
    counts[0 if counts[0] else 1] += max(LEAST_SATELLITES - sum(counts), 0)
    powers = [total_dbm(signal_dbm, count - heard) for count in counts]
    return np.where(own_band, powers[1], powers[0])


def find_loss_db(names: Sequence[Constellation], satellites: int) -> float:
    """Power of each simulated signal over the authentic ones at which a receiver loses its fix, dB; at most 60.

    The signals are not aligned with the authentic ones, and so noise.
    """
    simulated = mark_simulated(names, satellites)
    low, high = 0.0, 60.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        db_hz = effective_db_hz(noise_dbm(AUTHENTIC_DBM + middle, simulated)[None, :], satellites)[0]
        if int((db_hz >= TRACKING_DB_HZ).sum()) < LEAST_SATELLITES:
            high = middle
        else:
            low = middle
    return high
