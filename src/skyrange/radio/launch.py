"""A burst starts: whom does it reach, how strongly, and who stays with it?

A receiver locks on the first frame whose preamble it can find, and stays with it to the end of it, unless a later one is
`CAPTURE_DB` stronger: that of message-in-message capture, 10 dB in J. Lee et al., "An experimental study on the capture
effect in 802.11a networks" (WinTECH 2007). What is weaker is then missed, however well it could be heard alone.
"""

from __future__ import annotations

import math
from typing import Final

from skyrange.agent.air import Floats, Outcome
from skyrange.core.compiled import kernel
from skyrange.radio.access import FRAME_DBM, freeze, leave
from skyrange.radio.link import BUCKET_M, SILENT, Setting, arriving_dbm, bucket, reach_m
from skyrange.radio.propagation import noise_dbm
from skyrange.radio.receivers import tuned
from skyrange.radio.sightlines import Skyline
from skyrange.radio.spectrum import centre_mhz, share_within
from skyrange.radio.table import (
    BLUETOOTH,
    CHANNEL,
    COUNT,
    END,
    FOLLOWED,
    FREE,
    HEARING,
    KEY,
    MISSED,
    ON_AIR,
    POINTERS,
    RADIO,
    ROLE,
    SIZE,
    START,
    STATE,
    WAVE,
    WIFI,
    Air,
    Radios,
)
from skyrange.radio.waveforms import LEAST_SNIR_DB, LOCK_SNIR_DB, WIDTH_MHZ, airtime_ns, is_wifi

CAPTURE_DB: Final = 10.0
FOLLOWED_DB: Final = 3.0
"""A signal is followed down to this far below what its receiver could use, so that chance may lift it."""
_WEAK: Final = int(Outcome.WEAK)
_ELSEWHERE: Final = int(Outcome.ELSEWHERE)
_NOT, _HEARS, _FEELS = range(3)


@kernel
def free_slot(air: Air) -> int:
    """A slot for a burst, -1 where all are taken."""
    for s in range(air.slot.shape[1]):
        if air.slot[STATE, s] == FREE:
            return s
    return -1


@kernel
def _concern(radios: Radios, air: Air, s: int, r: int, centre: float) -> int:
    """What a burst is to a radio: it `_HEARS` it, only `_FEELS` it, or does `_NOT` notice."""
    kind, channel, start, end = air.slot[WAVE, s], air.slot[CHANNEL, s], air.slot[START, s], air.slot[END, s]
    band = WIFI if is_wifi(kind) else BLUETOOTH
    if air.slot[ROLE, s] == FOLLOWED:
        for k in range(POINTERS):
            if air.pointers[r, k] == air.slot[KEY, s]:
                return _HEARS
    else:
        on, mask, until = tuned(radios, r, band, start)
        if on == channel and mask >> kind & 1 and until >= end:
            return _HEARS
        if radios.turns[r, band] > 0:
            air.losses[r, _ELSEWHERE] += 1
    if band == WIFI:
        return _FEELS  # may have to wait for it
    on, _, _ = tuned(radios, r, WIFI, start)
    if on >= 0 and share_within(centre, WIDTH_MHZ[kind], centre_mhz(0, on), WIDTH_MHZ[0]) > 0.0:
        return _FEELS
    on, _, _ = tuned(radios, r, BLUETOOTH, start)
    return _FEELS if on == channel or air.slot[ROLE, s] == FOLLOWED else _NOT


@kernel
def _lock(radios: Radios, air: Air, s: int, r: int, dbm: float) -> int:
    """The flags of a burst at a receiver that is tuned to it."""
    kind = air.slot[WAVE, s]
    band = WIFI if is_wifi(kind) else BLUETOOTH
    start, end = air.slot[START, s], air.slot[END, s]
    if air.sending_until[r, band] > start:
        return HEARING
    locked = air.lock_until[r, band] > start
    if dbm - radios.noise_dbm[r, kind] < LOCK_SNIR_DB[kind]:
        return HEARING | MISSED if locked else HEARING
    if locked and dbm < air.lock_dbm[r, band] + CAPTURE_DB:
        return HEARING | MISSED
    air.lock_until[r, band], air.lock_dbm[r, band] = end, dbm
    return HEARING


@kernel
def _reach(setting: Setting, sky: Skyline, radios: Radios, pos: Floats, vel: Floats, air: Air, s: int) -> None:
    """Fill a slot's list of receivers."""
    sender, kind, channel = air.slot[RADIO, s], air.slot[WAVE, s], air.slot[CHANNEL, s]
    start, end = air.slot[START, s], air.slot[END, s]
    power, centre = air.slot_dbm[s], centre_mhz(kind, channel)
    lowest = noise_dbm(radios.best_noise_db, WIDTH_MHZ[kind]) + min(LEAST_SNIR_DB[kind] - FOLLOWED_DB, 0.0)
    reach = reach_m(setting, radios, power, lowest, centre)
    x, y, z = pos[sender, 0], pos[sender, 1], pos[sender, 2]
    mask = air.head.shape[0] - 1
    count = 0
    wide = reach / BUCKET_M > 0.25 * air.head.shape[0] ** 0.5  # then all buckets, and each once
    column0, column1 = int(math.floor((x - reach) / BUCKET_M)), int(math.floor((x + reach) / BUCKET_M))
    row0, row1 = int(math.floor((y - reach) / BUCKET_M)), int(math.floor((y + reach) / BUCKET_M))
    if wide:
        column0, column1, row0, row1 = 0, pos.shape[0] - 1, 0, 0
    for column in range(column0, column1 + 1):
        for row in range(row0, row1 + 1):
            r = column if wide else air.head[bucket(column, row, mask)]
            while r >= 0:
                i = r
                r = -1 if wide else air.follow[i]
                ex, ey, ez = pos[i, 0] - x, pos[i, 1] - y, pos[i, 2] - z
                if i == sender or not ex * ex + ey * ey + ez * ez <= reach * reach:
                    continue
                if not wide and (math.floor(pos[i, 0] / BUCKET_M) != column or math.floor(pos[i, 1] / BUCKET_M) != row):
                    continue  # of another square that shares the bucket
                concern = _concern(radios, air, s, i, centre)
                if concern == _NOT:
                    continue
                floor = radios.noise_dbm[i, kind]
                if concern == _HEARS:
                    floor += LEAST_SNIR_DB[kind] - FOLLOWED_DB
                dbm = arriving_dbm(setting, sky, radios, pos, vel, sender, i, power, centre, start, floor)
                if dbm == SILENT:
                    if concern == _HEARS:
                        air.losses[i, _WEAK] += 1
                    continue
                air.row[s, count], air.dbm[s, count], air.mw[s, count] = i, dbm, 10.0 ** (0.1 * dbm)
                air.flag[s, count] = _lock(radios, air, s, i, dbm) if concern == _HEARS else 0
                count += 1
                if is_wifi(kind) and dbm >= FRAME_DBM:
                    air.busy_until[i, channel] = max(air.busy_until[i, channel], end)
    air.slot[COUNT, s] = count


@kernel
def launch(
    setting: Setting, sky: Skyline, radios: Radios, pos: Floats, vel: Floats, air: Air, w: int, now: int, s: int
) -> None:
    """Put a waiting burst on the air, in slot `s`."""
    for column in range(SIZE + 1):
        air.slot[column, s] = air.wait[column, w]
    kind, sender, channel = air.slot[WAVE, s], air.slot[RADIO, s], air.slot[CHANNEL, s]
    air.slot[START, s], air.slot[END, s] = now, now + airtime_ns(kind, air.slot[SIZE, s])
    air.slot[STATE, s] = ON_AIR
    air.slot_dbm[s] = air.wait_dbm[w]
    leave(air, w)
    band = WIFI if is_wifi(kind) else BLUETOOTH
    air.sending_until[sender, band] = max(air.sending_until[sender, band], air.slot[END, s])
    _reach(setting, sky, radios, pos, vel, air, s)
    if band == BLUETOOTH or air.counts[0] == 0:
        return
    for k in range(air.slot[COUNT, s]):
        air.mark[air.row[s, k]] = k + 1
    for other in range(air.counts[0]):
        if not is_wifi(air.wait[WAVE, other]):
            continue
        radio = air.wait[RADIO, other]
        k = air.mark[radio] - 1
        sensed = k >= 0 and air.dbm[s, k] >= FRAME_DBM and air.wait[CHANNEL, other] == channel
        if sensed or radio == sender:
            freeze(air, other, now, air.slot[END, s])
    for k in range(air.slot[COUNT, s]):
        air.mark[air.row[s, k]] = 0
