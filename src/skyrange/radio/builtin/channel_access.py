"""Channel access: the queue of frames, which waiting burst acts next, and whether it finds the channel idle.

Wi-Fi senders wait by the rules in `backoff`. A channel is busy from the moment at which a radio detects the preamble of
a frame, for as long as the length in the frame's header says (IEEE 802.11-2020 17.3.10.6 and 17.3.12 for OFDM, 15.4.6.5
for DSSS), whether or not the frame is decoded. The standard requires that at -82 dBm; receivers detect weaker ones, and
so does this one, down to `LOCK_SNIR_DB` over its noise or to `carrier_sense_dbm`. A radio that missed a preamble, as it
was sending or receiving another frame, senses only power of -62 dBm or more, as of noise (17.3.10.6).

Background traffic of the city counts as frames. Senders that are hidden from each other collide.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.medium import ANY_CHANNEL, Floats, Ints, TransmissionFate, TxBatch, Waveform
from skyrange.core import elementary
from skyrange.core.chance import uniform4
from skyrange.core.compiled import compiled
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_MS, NS_PER_US
from skyrange.radio.builtin.backoff import (
    CW_MIN,
    MAX_WAIT_NS,
    begin_contention,
    defer,
    pass_contention_on,
    remove_waiting,
)
from skyrange.radio.builtin.state import (
    BACKOFF,
    BEHIND,
    BLUETOOTH,
    CHANNEL,
    CONTENDING,
    DEADLINE,
    GIVING_UP,
    KEY,
    NEXT_BACKOFF,
    NO_FRAME,
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
from skyrange.radio.phy import MAX_BYTES, MIN_BYTES, WIDTH_MHZ, centre_mhz, filter_overlap, is_wifi
from skyrange.radio.propagation.link_budget import NO_SIGNAL, MediumParams, received_power_dbm
from skyrange.radio.propagation.obstruction import Obstacles

CCA_ENERGY_DBM: Final = -62.0
"""Power that is sensed whatever its source: 20 dB above the minimum sensitivity of -82 dBm (17.3.10.6)."""
NOISE_RECHECK_NS: Final = NS_PER_MS
"""How often a sender that defers to noise senses the channel again."""
BACKGROUND_INTERVAL_NS: Final = NS_PER_MS
"""The background traffic is drawn in intervals of this length, busy or idle, separately on the channels 1, 6 and 11."""
ADV_DELAY_NS: Final = 10 * NS_PER_MS
"""Bluetooth Core 5.4 vol. 6 part B 4.4.2.2.1: advDelay is 0 to 10 ms."""
ADV_GAP_NS: Final = 400 * NS_PER_US
"""Between the PDUs of an advertising event; 4.4.2.6 permits at most 10 ms less a PDU, and
controllers use about this."""
AUX_GAP_NS: Final = 300 * NS_PER_US
"""T_MAFS: the minimum from the last ADV_EXT_IND to the packet it announces (4.1.5)."""
_CITY: Final = np.uint64(hash64("radio.city"))
_NO_ACCESS: Final = int(TransmissionFate.NO_ACCESS)

STARTS, WAITS = True, False


@compiled
def next_access(state: MediumState) -> int:
    """The waiting burst that acts next, -1 if there is none; ties by sender, then by the sender's own order."""
    best = -1
    for w in range(state.counts[0]):
        if best >= 0:
            first = state.wait[PLANNED, w] - state.wait[PLANNED, best]
            if first == 0:
                first = state.wait[RADIO, w] - state.wait[RADIO, best]
            if first == 0:
                first = state.wait[NTH, w] - state.wait[NTH, best]
            if first == 0:
                first = state.wait[ROLE, w] - state.wait[ROLE, best]
            if first >= 0:
                continue
        best = w
    return best


@compiled
def background_power_mw(params: MediumParams, who: np.uint64, piece: int, centre: float, width: float) -> float:
    """Power of background traffic within a receiver's filter in one interval; exponentially distributed about its
    mean.
    """
    if params.background_share <= 0.0:
        return 0.0
    power = 0.0
    draws = uniform4(params.seed, _CITY, who, np.uint64(piece * BACKGROUND_INTERVAL_NS), np.uint64(0))
    for k in range(3):
        share = filter_overlap(2412.0 + 25.0 * k, 22.0, centre, width)
        if share > 0.0 and draws[k] < params.background_share:
            power -= share * params.background_mean_mw * elementary.log(1.0 - draws[3])
    return power


@compiled
def _busy_until(  # noqa: PLR0917
    params: MediumParams,
    obstacles: Obstacles,
    radios: Radios,
    pos: Floats,
    vel: Floats,
    w: int,
    state: MediumState,
    now: int,
    emitters: Ints,
    emitted: Floats,
) -> int:
    """The time until which a sender senses noise or background traffic; `now` if the channel is idle."""
    radio, channel, kind = state.wait[RADIO, w], state.wait[CHANNEL, w], state.wait[WAVEFORM, w]
    centre, width = centre_mhz(kind, channel), WIDTH_MHZ[kind]
    if params.background_share > 0.0:
        piece = now // BACKGROUND_INTERVAL_NS
        power = background_power_mw(params, radios.who[radio], piece, centre, width)
        if power > 0.0 and 10.0 * elementary.log10(power) >= min(radios.sense_dbm[radio, kind], CCA_ENERGY_DBM):
            return (piece + 1) * BACKGROUND_INTERVAL_NS
    total = 0.0
    for e in range(emitters.shape[1]):
        if emitters[0, e] == radio or not emitters[1, e] <= now < emitters[2, e]:
            continue
        share = filter_overlap(emitted[0, e], emitted[1, e], centre, width)
        if share <= 0.0:
            continue
        power = received_power_dbm(
            params,
            obstacles,
            radios.who,
            radios.antenna,
            pos,
            vel,
            emitters[0, e],
            radio,
            emitted[2, e],
            emitted[0, e],
            now,
            CCA_ENERGY_DBM - 20.0,
        )
        if power > NO_SIGNAL:
            total += share * elementary.exp10(0.1 * power)
    if total > 0.0 and 10.0 * elementary.log10(total) >= CCA_ENERGY_DBM:
        return now + NOISE_RECHECK_NS
    return now


@compiled
def try_access(  # noqa: PLR0917
    params: MediumParams,
    obstacles: Obstacles,
    radios: Radios,
    pos: Floats,
    vel: Floats,
    state: MediumState,
    w: int,
    emitters: Ints,
    emitted: Floats,
) -> bool:
    """Act on a waiting burst whose time has come: `STARTS`, or `WAITS` with a new plan or after it was dropped."""
    radio, kind, channel = state.wait[RADIO, w], state.wait[WAVEFORM, w], state.wait[CHANNEL, w]
    now = state.wait[PLANNED, w]
    there = pos[radio, 0] + pos[radio, 1] + pos[radio, 2]
    stage = state.wait[STAGE, w]
    if state.wait[ROLE, w] == NO_FRAME:
        remove_waiting(state, w)
        return WAITS
    if stage in (GIVING_UP, BEHIND) or not abs(there) < math.inf:
        row = state.counts[2]
        state.sent[0, row], state.sent[1, row], state.sent[2, row] = state.wait[KEY, w], radio, channel
        state.sent[3, row] = state.sent[4, row] = now
        state.sent[5, row] = _NO_ACCESS
        state.counts[2] = row + 1
        if stage in (GIVING_UP, CONTENDING):
            pass_contention_on(state, w, now)
        remove_waiting(state, w)
        return WAITS
    if not is_wifi(kind):
        return STARTS
    if stage == QUEUED:
        begin_contention(state, w, now)
        return WAITS
    noisy = _busy_until(params, obstacles, radios, pos, vel, w, state, now, emitters, emitted)
    if noisy > now:
        state.wait[SLOTS_LEFT, w] = min(state.wait[SLOTS_LEFT, w], 0)  # its slots are counted down already
        defer(state, w, noisy)
        return WAITS
    return STARTS


MAX_POWER_DBM: Final = 60.0
DEFAULT_CHANNEL: Final = 6
LAST_CHANNEL: Final = 13
QUEUED_WIFI, ADVERTISED, REFUSED = range(3)
"""What became of an offered frame: it waits; its advertising event is still to be queued; it cannot exist."""
ACCESS: Final = np.uint64(hash64("radio.access"))
_WAVEFORMS: Final = len(Waveform)


@compiled
def queue_frames(  # noqa: PLR0917
    radios: Radios,
    state: MediumState,
    seed: np.uint64,
    order: Ints,
    frames: TxBatch,
    fate: NDArray[np.int8],
    nth: Ints,
    dbm: Floats,
) -> int:
    """Queue the Wi-Fi frames among some offered ones; returns how many of all were not queued.

    `order` sorts the rows of `frames` by radio, time and row. For each row `fate` gets
    what became of it, `nth` the number of good frames of the same radio and instant before it, and `dbm` its power. The
    state needs room for all of them.
    """
    radio, at, kind, channel, power, size, key = frames
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
