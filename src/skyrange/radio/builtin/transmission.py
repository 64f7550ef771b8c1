"""Start of a transmission: the receivers that a burst reaches, its power at each, and which of them lock on it.

A receiver locks on the first frame whose preamble it can find and stays with it to its end, unless a later one is
`CAPTURE_DB` stronger: that of message-in-message capture, 10 dB in J. Lee et al., "An experimental study on the
capture effect in 802.11a networks" (WinTECH 2007). A weaker one is then missed, even if it could be decoded alone.
"""

from __future__ import annotations

import math
from typing import Final

from skyrange.agent.air import Floats, Outcome
from skyrange.core.compiled import kernel
from skyrange.radio.access import FRAME_DBM, freeze, leave
from skyrange.radio.link import BUCKET_M, Setting, bucket, budget_dbm, luck_db, reach_m
from skyrange.radio.propagation import NEAREST_M, NO_EDGE, edge_db, noise_dbm, wavelength_m
from skyrange.radio.receivers import turn_at
from skyrange.radio.sightlines import BEYOND, Skyline, cost_db, enough, trace
from skyrange.radio.spectrum import centre_mhz, share_within
from skyrange.radio.table import (
    BLUETOOTH,
    CHANNEL,
    COUNT,
    DWELL,
    END,
    FIRST,
    FOLLOWED,
    FREE,
    HEARING,
    KEY,
    MISSED,
    ON_AIR,
    PHASE,
    POINTERS,
    RADIO,
    REST,
    ROLE,
    SIZE,
    START,
    STATE,
    TURNS,
    WAVE,
    WIFI,
    WINDOW,
    Air,
    Radios,
)
from skyrange.radio.waveforms import LEAST_SNIR_DB, LOCK_SNIR_DB, WIDTH_MHZ, airtime_ns, is_wifi

CAPTURE_DB: Final = 10.0
FOLLOWED_DB: Final = 3.0
"""A signal is tracked down to this far below the receiver's minimum, so that fading may still lift it."""
_WEAK: Final = int(Outcome.WEAK)
_ELSEWHERE: Final = int(Outcome.ELSEWHERE)


@kernel
def free_slot(air: Air) -> int:
    """A free slot for a burst, -1 if all are taken."""
    for s in range(air.slot.shape[1]):
        if air.slot[STATE, s] == FREE:
            return s
    return -1


@kernel
def _find_receivers(setting: Setting, sky: Skyline, radios: Radios, pos: Floats, vel: Floats, air: Air, s: int) -> None:
    """Fill a slot's list of receivers.

    One long function, because every call that passes arrays on costs as much as the work for one radio.
    """
    slot, head, follow, losses, pointers = air.slot, air.head, air.follow, air.losses, air.pointers
    rows, levels, powers, flags = air.row[s], air.dbm[s], air.mw[s], air.flag[s]
    lock_until, lock_dbm, sending_until, busy_until = air.lock_until, air.lock_dbm, air.sending_until, air.busy_until
    who, aerial, noise, chain = radios.who, radios.aerial, radios.noise_dbm, radios.chain
    turn_channel, turn_mask = radios.turn_channel, radios.turn_mask
    key, sender, kind, channel = slot[KEY, s], slot[RADIO, s], slot[WAVE, s], slot[CHANNEL, s]
    start, end, power, role = slot[START, s], slot[END, s], air.slot_dbm[s], slot[ROLE, s]
    centre, width = centre_mhz(kind, channel), WIDTH_MHZ[kind]
    wifi = is_wifi(kind)
    band = WIFI if wifi else BLUETOOTH
    least, finds = LEAST_SNIR_DB[kind] - FOLLOWED_DB, LOCK_SNIR_DB[kind]
    farthest = reach_m(radios.best_dbi, power, noise_dbm(radios.best_noise_db, width) + min(least, 0.0), centre)
    reach = min(farthest, setting.horizon_m)
    x, y, z = pos[sender, 0], pos[sender, 1], pos[sender, 2]
    vx, vy, vz = vel[sender, 0], vel[sender, 1], vel[sender, 2]
    pattern, gain, wavelength = aerial[sender, 0], aerial[sender, 1], wavelength_m(centre)
    mask = head.shape[0] - 1
    count = 0
    column0, column1 = math.floor((x - reach) / BUCKET_M), math.floor((x + reach) / BUCKET_M)
    row0, row1 = math.floor((y - reach) / BUCKET_M), math.floor((y + reach) / BUCKET_M)
    for column in range(column0, column1 + 1):
        for row in range(row0, row1 + 1):
            r = head[bucket(column, row, mask)]
            while r >= 0:
                i = r
                r = follow[i]
                ex, ey, ez = pos[i, 0] - x, pos[i, 1] - y, pos[i, 2] - z
                if i == sender or not ex * ex + ey * ey + ez * ez <= reach * reach:
                    continue
                if math.floor(pos[i, 0] / BUCKET_M) != column or math.floor(pos[i, 1] / BUCKET_M) != row:
                    continue  # a radio of another square that hashes to the same bucket
                hears = False
                own = chain[i, band]
                if role == FOLLOWED:
                    for k in range(POINTERS):
                        hears = hears or pointers[i, k] == key
                elif own[TURNS] > 0:
                    turn, until = turn_at(own[TURNS], own[DWELL], own[WINDOW], own[REST], own[PHASE], start)
                    if turn >= 0 and until >= end:
                        place = own[FIRST] + turn
                        hears = turn_channel[place] == channel and (turn_mask[place] >> kind & 1) == 1
                    if not hears:
                        losses[i, _ELSEWHERE] += 1
                if not hears and not wifi:  # it may still interfere with what is being received there
                    feels = role == FOLLOWED
                    for other in range(2):
                        own = chain[i, other]
                        turn, _ = turn_at(own[TURNS], own[DWELL], own[WINDOW], own[REST], own[PHASE], start)
                        if turn >= 0:
                            on = turn_channel[own[FIRST] + turn]
                            feels = feels or (
                                on == channel
                                if other == BLUETOOTH
                                else share_within(centre, width, centre_mhz(0, on), WIDTH_MHZ[0]) > 0.0
                            )
                    if not feels:
                        continue
                floor = noise[i, kind] + least if hears else noise[i, kind]
                bx, by, bz = pos[i, 0], pos[i, 1], pos[i, 2]
                distance = math.sqrt(ex * ex + ey * ey + ez * ez)
                dbm = budget_dbm(power, distance, z, bz, wavelength, pattern, gain, aerial[i, 0], aerial[i, 1])
                margin = dbm - floor
                loss = BEYOND
                if margin >= 0.0:
                    stop = enough(farthest / max(distance, NEAREST_M), x, y, bx, by, wavelength)
                    met = trace(sky, x, y, z, bx, by, bz, wavelength, stop)
                    loss = 0.0
                    if met.cut > 0:
                        loss = cost_db(sky, met, x, y, z, bx, by, bz, wavelength, margin)
                    elif met.graze > NO_EDGE:
                        loss = edge_db(met.graze)
                if loss > margin:
                    if hears:
                        losses[i, _WEAK] += 1
                    continue
                dbm -= loss
                if setting.chance:
                    ux, uy, uz = vel[i, 0] - vx, vel[i, 1] - vy, vel[i, 2] - vz
                    speed = math.sqrt(ux * ux + uy * uy + uz * uz)
                    dbm += luck_db(
                        setting.seed, who[sender], who[i], x, y, z, bx, by, bz, speed, wavelength, centre, start, loss
                    )
                flag = 0
                if hears:
                    flag = HEARING
                    locked = lock_until[i, band] > start
                    finding = dbm - noise[i, kind] >= finds and sending_until[i, band] <= start
                    if locked and (not finding or dbm < lock_dbm[i, band] + CAPTURE_DB):
                        flag = HEARING | MISSED
                    elif finding:
                        lock_until[i, band], lock_dbm[i, band] = end, dbm
                rows[count], levels[count], powers[count], flags[count] = i, dbm, 10.0 ** (0.1 * dbm), flag
                count += 1
                if wifi and dbm >= FRAME_DBM:
                    busy_until[i, channel] = max(busy_until[i, channel], end)
    slot[COUNT, s] = count


@kernel
def launch(
    setting: Setting, sky: Skyline, radios: Radios, pos: Floats, vel: Floats, air: Air, w: int, now: int, s: int
) -> None:
    """Start the transmission of a waiting burst, in slot `s`."""
    for column in range(SIZE + 1):
        air.slot[column, s] = air.wait[column, w]
    kind, sender, channel = air.slot[WAVE, s], air.slot[RADIO, s], air.slot[CHANNEL, s]
    air.slot[START, s], air.slot[END, s] = now, now + airtime_ns(kind, air.slot[SIZE, s])
    air.slot[STATE, s] = ON_AIR
    air.slot_dbm[s] = air.wait_dbm[w]
    leave(air, w)
    band = WIFI if is_wifi(kind) else BLUETOOTH
    air.sending_until[sender, band] = max(air.sending_until[sender, band], air.slot[END, s])
    _find_receivers(setting, sky, radios, pos, vel, air, s)
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
