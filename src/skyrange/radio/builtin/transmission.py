"""Start of a transmission: the receivers that a burst reaches, its power at each, and which of them lock on it.

A receiver searches for a preamble in the first 4 µs of an OFDM frame or 15 µs of a DSSS frame (aCCATime), and locks on
the strongest frame that it detects in that time. Then it stays with that frame to its end, unless a later one is
stronger by a margin, 10 dB by default: message-in-message capture, which J. Lee et al., "An experimental study on the
capture effect in 802.11a networks" (WinTECH 2007), measured whenever the stronger frame begins. A weaker one is missed,
even if it could be decoded alone. `BuiltinParams` has other rules: no capture, and the first preamble.
"""

from __future__ import annotations

import math
from typing import Final

from skyrange.contracts.medium import Floats, ReceptionOutcome
from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.radio.builtin.backoff import CCA_TIME_NS, begin_next_backoff, freeze_backoff, remove_waiting
from skyrange.radio.builtin.channel_access import CCA_ENERGY_DBM
from skyrange.radio.builtin.listening import listening_turn
from skyrange.radio.builtin.state import (
    AUX_ADV_IND,
    BLUETOOTH,
    CHANNEL,
    COUNT,
    DWELL,
    END,
    FIRST,
    FREE,
    KEY,
    LOCKED,
    LOCKED_ELSEWHERE,
    NEXT_BACKOFF,
    ON_AIR,
    PHASE,
    POINTERS,
    RADIO,
    REST,
    ROLE,
    SENSED,
    SIZE,
    START,
    STATE,
    TUNED,
    TURNS,
    WAVEFORM,
    WIFI,
    WINDOW,
    MediumState,
    Radios,
)
from skyrange.radio.phy import LOCK_SNIR_DB, MIN_SNIR_DB, WIDTH_MHZ, airtime_ns, centre_mhz, filter_overlap, is_wifi
from skyrange.radio.propagation.link_budget import (
    BUCKET_SIDE_M,
    MAX_RANDOM_GAIN_DB,
    NO_SIGNAL,
    MediumParams,
    bucket_of,
    max_range_m,
    median_power_dbm,
    path_power_dbm,
    tabled_loss_db,
)
from skyrange.radio.propagation.obstruction import Obstacles
from skyrange.radio.propagation.path_loss import ground_excess_db, noise_dbm, wavelength_m
from skyrange.radio.propagation.street_canyon import in_street_canyon

INTERFERING_DB: Final = 3.0
"""A signal is tracked down to this far below the least that can be decoded, because it interferes with others."""
_WEAK: Final = int(ReceptionOutcome.WEAK)
_ELSEWHERE: Final = int(ReceptionOutcome.ELSEWHERE)


@compiled
def free_slot(state: MediumState) -> int:
    """A free slot for a burst, -1 if all are taken."""
    for s in range(state.slot.shape[1]):
        if state.slot[STATE, s] == FREE:
            return s
    return -1


@compiled
def _find_receivers(  # noqa: PLR0917
    params: MediumParams, obstacles: Obstacles, radios: Radios, pos: Floats, vel: Floats, state: MediumState, s: int
) -> None:
    """Fill a slot's list of receivers.

    One long function, because every call that passes arrays on costs as much as the work for one radio; only the path
    itself, which takes longer, is a call.
    """
    slot, head, follow, losses, pointers = state.slot, state.head, state.follow, state.losses, state.pointers
    rows, levels, powers, flags = state.row[s], state.dbm[s], state.mw[s], state.flag[s]
    lock_until, lock_dbm, lock_slot, sync_until = state.lock_until, state.lock_dbm, state.lock_slot, state.sync_until
    sending_until, busy_until, energy_until = state.sending_until, state.busy_until, state.energy_until
    who, antenna, noise, chain = radios.who, radios.antenna, radios.noise_dbm, radios.chain
    sense = radios.sense_dbm
    turn_channel, turn_mask = radios.turn_channel, radios.turn_mask
    key, sender, kind, channel = slot[KEY, s], slot[RADIO, s], slot[WAVEFORM, s], slot[CHANNEL, s]
    start, end, power, role = slot[START, s], slot[END, s], state.slot_dbm[s], slot[ROLE, s]
    centre, width = centre_mhz(kind, channel), WIDTH_MHZ[kind]
    wifi = is_wifi(kind)
    band = WIFI if wifi else BLUETOOTH
    least, finds = MIN_SNIR_DB[kind] - INTERFERING_DB, LOCK_SNIR_DB[kind]
    felt = min(finds, 0.0) if wifi else 0.0
    sync_ns = CCA_TIME_NS[kind] if wifi else 0
    floor = noise_dbm(radios.best_noise_db, width) + min(least, 0.0) - params.table.best_gain_db - MAX_RANDOM_GAIN_DB
    reach = min(max_range_m(radios.best_dbi, power, floor, centre), params.horizon_m)
    x, y, z = pos[sender, 0], pos[sender, 1], pos[sender, 2]
    vx, vy, vz = vel[sender, 0], vel[sender, 1], vel[sender, 2]
    pattern, gain, wavelength = antenna[sender, 0], antenna[sender, 1], wavelength_m(centre)
    in_street = int(in_street_canyon(obstacles, x, y, z))
    mask = head.shape[0] - 1
    count = 0
    column0, column1 = math.floor((x - reach) / BUCKET_SIDE_M), math.floor((x + reach) / BUCKET_SIDE_M)
    row0, row1 = math.floor((y - reach) / BUCKET_SIDE_M), math.floor((y + reach) / BUCKET_SIDE_M)
    for column in range(column0, column1 + 1):
        for row in range(row0, row1 + 1):
            r = head[bucket_of(column, row, mask)]
            while r >= 0:
                i = r
                r = follow[i]
                ex, ey, ez = pos[i, 0] - x, pos[i, 1] - y, pos[i, 2] - z
                if i == sender or not ex * ex + ey * ey + ez * ez <= reach * reach:
                    continue
                if math.floor(pos[i, 0] / BUCKET_SIDE_M) != column or math.floor(pos[i, 1] / BUCKET_SIDE_M) != row:
                    continue  # a radio of another square that hashes to the same bucket
                hears = False
                own = chain[i, band]
                if role == AUX_ADV_IND:
                    for k in range(POINTERS):
                        hears = hears or pointers[i, k] == key
                elif own[TURNS] > 0:
                    turn, until = listening_turn(own[TURNS], own[DWELL], own[WINDOW], own[REST], own[PHASE], start)
                    if turn >= 0 and until >= end:
                        place = own[FIRST] + turn
                        hears = turn_channel[place] == channel and (turn_mask[place] >> kind & 1) == 1
                    if not hears:
                        losses[i, _ELSEWHERE] += 1
                if not hears and not wifi:  # it may still interfere with what is being received there
                    feels = role == AUX_ADV_IND
                    for other in range(2):
                        own = chain[i, other]
                        turn, _ = listening_turn(own[TURNS], own[DWELL], own[WINDOW], own[REST], own[PHASE], start)
                        if turn >= 0:
                            on = turn_channel[own[FIRST] + turn]
                            feels = feels or (
                                on == channel
                                if other == BLUETOOTH
                                else filter_overlap(centre, width, centre_mhz(0, on), WIDTH_MHZ[0]) > 0.0
                            )
                    if not feels:
                        continue
                floor = noise[i, kind] + (least if hears else felt)
                bx, by, bz = pos[i, 0], pos[i, 1], pos[i, 2]
                distance = math.sqrt(ex * ex + ey * ey + ez * ez)
                median = median_power_dbm(
                    power, distance, z, bz, wavelength, pattern, gain, antenna[i, 0], antenna[i, 1]
                )
                tabled = math.nan
                if params.tabled:
                    tabled = tabled_loss_db(params.table, x, y, z, bx, by, bz, distance, wavelength)
                ux, uy, uz = vel[i, 0] - vx, vel[i, 1] - vy, vel[i, 2] - vz
                dbm = path_power_dbm(
                    obstacles, params.seed, params.randomness, who[sender], who[i], x, y, z, bx, by, bz,
                    math.sqrt(ux * ux + uy * uy + uz * uz), wavelength, centre, start, median, tabled,
                    ground_excess_db(distance, z, bz, wavelength), floor, in_street,
                )  # fmt: skip
                if dbm == NO_SIGNAL:
                    if hears:
                        losses[i, _WEAK] += 1
                    continue
                flag = 0
                finding = dbm - noise[i, kind] >= finds and sending_until[i, band] <= start
                detected = finding
                if hears:
                    flag = TUNED
                    if lock_until[i, band] > start:
                        stronger = dbm - lock_dbm[i, band]
                        detected = finding and (
                            stronger >= params.capture_db
                            or (params.strongest_preamble and start < sync_until[i, band] and stronger > 0.0)
                        )
                        if not detected:
                            flag = TUNED | LOCKED_ELSEWHERE
                    if detected:
                        flag = TUNED | LOCKED
                        lock_until[i, band], lock_dbm[i, band], lock_slot[i, band] = end, dbm, s
                        sync_until[i, band] = start + sync_ns
                if wifi:
                    if dbm >= CCA_ENERGY_DBM:
                        energy_until[i, channel] = max(energy_until[i, channel], end)
                        flag |= SENSED
                    elif detected and dbm >= sense[i, kind] and (hears or busy_until[i, channel] <= start):
                        flag |= SENSED
                    if flag & SENSED:
                        busy_until[i, channel] = max(busy_until[i, channel], end)
                rows[count], levels[count], powers[count], flags[count] = i, dbm, elementary.exp10(0.1 * dbm), flag
                count += 1
    slot[COUNT, s] = count


@compiled
def _leave_reception(state: MediumState, radio: int, now: int) -> None:
    """A radio turns to sending: it misses the frames on the air, and will sense their energy alone."""
    state.lock_until[radio, WIFI], state.lock_slot[radio, WIFI] = now, -1
    for channel in range(state.busy_until.shape[1]):
        state.busy_until[radio, channel] = state.energy_until[radio, channel]
        state.error_until[radio, channel] = now


@compiled
def start_transmission(  # noqa: PLR0917
    params: MediumParams,
    obstacles: Obstacles,
    radios: Radios,
    pos: Floats,
    vel: Floats,
    state: MediumState,
    w: int,
    now: int,
    s: int,
) -> None:
    """Start the transmission of a waiting burst, in slot `s`."""
    for column in range(SIZE + 1):
        state.slot[column, s] = state.wait[column, w]
    kind, sender, channel = state.slot[WAVEFORM, s], state.slot[RADIO, s], state.slot[CHANNEL, s]
    state.slot[START, s], state.slot[END, s] = now, now + airtime_ns(kind, state.slot[SIZE, s])
    state.slot[STATE, s] = ON_AIR
    state.slot_dbm[s] = state.wait_dbm[w]
    slots = state.wait[NEXT_BACKOFF, w]
    remove_waiting(state, w)
    band = WIFI if is_wifi(kind) else BLUETOOTH
    state.sending_until[sender, band] = max(state.sending_until[sender, band], state.slot[END, s])
    if band == WIFI:
        _leave_reception(state, sender, now)
        begin_next_backoff(state, s, slots)
    _find_receivers(params, obstacles, radios, pos, vel, state, s)
    if band == BLUETOOTH:
        return
    for k in range(state.slot[COUNT, s]):
        if state.flag[s, k] & SENSED:
            state.mark[state.row[s, k]] = 1
    for other in range(state.counts[0]):
        if state.mark[state.wait[RADIO, other]] and state.wait[CHANNEL, other] == channel:
            freeze_backoff(state, other, now, state.slot[END, s])
    for k in range(state.slot[COUNT, s]):
        state.mark[state.row[s, k]] = 0
