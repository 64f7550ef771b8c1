"""Queue of frames: which of the offered ones can exist, and their entries among the waiting bursts."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.medium import ANY_CHANNEL, Floats, Ints, Waveform
from skyrange.core.chance import uniform4
from skyrange.core.compiled import compiled
from skyrange.core.ids import hash64
from skyrange.radio.builtin.backoff import CW_MIN, MAX_WAIT_NS
from skyrange.radio.builtin.state import (
    BACKOFF,
    BLUETOOTH,
    CHANNEL,
    DEADLINE,
    KEY,
    NEXT_BACKOFF,
    NTH,
    OFFERED,
    PLANNED,
    QUEUED,
    RADIO,
    RESUME,
    ROLE,
    SIZE,
    SLOTS_LEFT,
    STAGE,
    STANDALONE,
    WAVEFORM,
    WIFI,
    MediumState,
    Radios,
)
from skyrange.radio.phy.waveforms import MAX_BYTES, MIN_BYTES, is_wifi

MAX_POWER_DBM: Final = 60.0
DEFAULT_CHANNEL: Final = 6
LAST_CHANNEL: Final = 13
QUEUED_WIFI, ADVERTISED, REFUSED = range(3)
"""What became of an offered frame: it waits; its advertising event is still to be queued; it cannot exist."""
ACCESS: Final = np.uint64(hash64("radio.access"))
_WAVEFORMS: Final = len(Waveform)


@compiled
def queue_frames(
    radios: Radios,
    state: MediumState,
    seed: np.uint64,
    order: Ints,
    key: Ints,
    radio: Ints,
    at: Ints,
    kind: Ints,
    channel: Ints,
    size: Ints,
    power: Floats,
    fate: NDArray[np.int8],
    nth: Ints,
    dbm: Floats,
) -> int:
    """Queue the Wi-Fi frames among some offered ones; returns how many of all were not queued.

    `order` sorts the rows by radio, time and row; the other inputs are columns of a `TxBatch`. For each row `fate` gets
    what became of it, `nth` the number of good frames of the same radio and instant before it, and `dbm` its power. The
    state needs room for all of them.
    """
    others, before, count = 0, -1, 0
    for place in range(order.shape[0]):
        row = order[place]
        r, wave, on = radio[row], kind[row], channel[row]
        fate[row] = REFUSED
        others += 1
        if not 0 <= wave < _WAVEFORMS or key[row] < 0:
            continue
        wifi = is_wifi(wave)
        level = power[row]
        if level != level:
            level = radios.tx_power_dbm[r, WIFI if wifi else BLUETOOTH]
        if wifi and on == ANY_CHANNEL:
            on = DEFAULT_CHANNEL
        if not -np.inf < level <= MAX_POWER_DBM or not MIN_BYTES[wave] <= size[row] <= MAX_BYTES[wave]:
            continue
        if wifi and not 1 <= on <= LAST_CHANNEL:
            continue
        count = count + 1 if before >= 0 and radio[before] == r and at[before] == at[row] else 0
        before = row
        nth[row], dbm[row] = count, level
        if not wifi:
            fate[row] = ADVERTISED
            continue
        fate[row] = QUEUED_WIFI
        others -= 1
        first, second, _, _ = uniform4(seed, ACCESS, radios.who[r], np.uint64(at[row]), np.uint64(count))
        w = state.counts[0]
        wait = state.wait
        wait[KEY, w], wait[RADIO, w], wait[WAVEFORM, w], wait[CHANNEL, w] = key[row], r, wave, on
        wait[ROLE, w], wait[NTH, w], wait[SIZE, w] = STANDALONE, count, size[row]
        wait[OFFERED, w], wait[PLANNED, w], wait[STAGE, w], wait[RESUME, w] = at[row], at[row], QUEUED, at[row]
        wait[SLOTS_LEFT, w] = -1
        wait[BACKOFF, w] = int(first * (CW_MIN[wave] + 1))
        wait[NEXT_BACKOFF, w] = int(second * (CW_MIN[wave] + 1))
        wait[DEADLINE, w] = at[row] + MAX_WAIT_NS
        state.wait_dbm[w] = level
        state.counts[0] = w + 1
    return others
