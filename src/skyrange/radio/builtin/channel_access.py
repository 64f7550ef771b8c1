"""Channel access: carrier sense and backoff for Wi-Fi, a random delay for Bluetooth advertising.

Wi-Fi: the DCF of IEEE 802.11-2020 10.3.4 for frames that are not acknowledged. A sender whose channel has been idle
for DIFS transmits at once. Otherwise it draws a backoff from 0…CWmin and counts down that many idle slots; the
countdown stands still while the channel is busy. Slot, SIFS, CWmin: 20 µs, 10 µs, 31 (DSSS, table 15-6) and 9 µs, 10
µs, 15 (OFDM at 2.4 GHz, table 18-5). A channel is busy from the moment at which a frame on it arrives with -82 dBm or
more (17.3.10.6), or noise with -62 dBm. What started within the last 15 µs (DSSS) or 4 µs (OFDM) is not sensed yet, so
equal draws collide, and so do senders that are hidden from each other.

Background traffic of the city counts as frames. A frame that has waited half a second is dropped as outdated.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from skyrange.contracts.medium import Floats, Ints, TransmissionFate
from skyrange.core.chance import uniform4
from skyrange.core.compiled import compiled
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_MS, NS_PER_US
from skyrange.radio.builtin.state import (
    BACKOFF,
    CHANNEL,
    CONTENDING,
    DEADLINE,
    GIVING_UP,
    KEY,
    NTH,
    OFFERED,
    PLANNED,
    QUEUED,
    RADIO,
    RESUME,
    ROLE,
    SLOTS_LEFT,
    STAGE,
    WAIT_ROWS,
    WAVEFORM,
    WIFI,
    MediumState,
    Radios,
)
from skyrange.radio.phy.channels import centre_mhz, filter_overlap
from skyrange.radio.phy.waveforms import WIDTH_MHZ, is_wifi
from skyrange.radio.propagation.link_budget import NO_SIGNAL, MediumParams, received_power_dbm
from skyrange.radio.propagation.obstruction import Obstacles

SLOT_NS: Final = np.array([20, 9]) * NS_PER_US
DIFS_NS: Final = np.array([50, 28]) * NS_PER_US
CCA_TIME_NS: Final = np.array([15, 4]) * NS_PER_US
CW_MIN: Final = np.array([31, 15])
"""CWmin."""
CCA_FRAME_DBM: Final = -82.0
CCA_ENERGY_DBM: Final = -62.0
MAX_WAIT_NS: Final = 500 * NS_PER_MS
"""Longest wait for access; a frame that has waited longer is dropped."""
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
def remove_waiting(state: MediumState, w: int) -> None:
    """Remove a burst from the waiting ones."""
    last = state.counts[0] - 1
    for column in range(WAIT_ROWS):
        state.wait[column, w] = state.wait[column, last]
    state.wait_dbm[w] = state.wait_dbm[last]
    state.counts[0] = last


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
            power -= share * params.background_mean_mw * math.log(1.0 - draws[3])
    return power


@compiled
def _defer(state: MediumState, w: int, until: int) -> None:
    """Defer until a busy channel becomes idle, and then for the remaining slots."""
    kind = state.wait[WAVEFORM, w]
    if state.wait[SLOTS_LEFT, w] < 0:
        state.wait[SLOTS_LEFT, w] = state.wait[BACKOFF, w]
    state.wait[RESUME, w] = until + DIFS_NS[kind]
    state.wait[PLANNED, w] = state.wait[RESUME, w] + state.wait[SLOTS_LEFT, w] * SLOT_NS[kind]
    state.wait[STAGE, w] = CONTENDING
    if state.wait[PLANNED, w] > state.wait[DEADLINE, w]:
        state.wait[PLANNED, w] = max(state.wait[DEADLINE, w], state.wait[OFFERED, w])
        state.wait[STAGE, w] = GIVING_UP


@compiled
def freeze_backoff(state: MediumState, w: int, now: int, until: int) -> None:
    """A frame that the sender of a waiting one senses starts at `now`: stop the countdown."""
    kind = state.wait[WAVEFORM, w]
    if state.wait[STAGE, w] != CONTENDING or state.wait[PLANNED, w] < now + CCA_TIME_NS[kind]:
        return  # the countdown has not begun, or the start is too late to be sensed
    if state.wait[SLOTS_LEFT, w] > 0:
        counted = max(now - state.wait[RESUME, w], 0) // SLOT_NS[kind]
        state.wait[SLOTS_LEFT, w] = max(state.wait[SLOTS_LEFT, w] - counted, 0)
    _defer(state, w, max(until, state.wait[RESUME, w] - DIFS_NS[kind]))


@compiled
def _busy_until(
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
        if power > 0.0 and 10.0 * math.log10(power) >= CCA_FRAME_DBM:
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
            total += share * 10.0 ** (0.1 * power)
    if total > 0.0 and 10.0 * math.log10(total) >= CCA_ENERGY_DBM:
        return now + NOISE_RECHECK_NS
    return now


@compiled
def try_access(
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
    if state.wait[STAGE, w] == GIVING_UP or not abs(there) < math.inf:
        row = state.counts[2]
        state.sent[0, row], state.sent[1, row], state.sent[2, row] = state.wait[KEY, w], radio, channel
        state.sent[3, row] = state.sent[4, row] = now
        state.sent[5, row] = _NO_ACCESS
        state.counts[2] = row + 1
        remove_waiting(state, w)
        return WAITS
    if not is_wifi(kind):
        return STARTS
    own = state.sending_until[radio, WIFI]
    if state.wait[STAGE, w] == QUEUED:
        background_share = max(state.busy_until[radio, channel], own)
        if background_share > now:
            _defer(state, w, background_share)
        else:
            state.wait[STAGE, w], state.wait[RESUME, w] = CONTENDING, now + DIFS_NS[kind]
            state.wait[PLANNED, w] = state.wait[RESUME, w]
        return WAITS
    if own > now:
        _defer(state, w, own)
        return WAITS
    noisy = _busy_until(params, obstacles, radios, pos, vel, w, state, now, emitters, emitted)
    if noisy > now:
        state.wait[SLOTS_LEFT, w] = min(state.wait[SLOTS_LEFT, w], 0)  # its slots are counted down already
        _defer(state, w, noisy)
        return WAITS
    return STARTS
