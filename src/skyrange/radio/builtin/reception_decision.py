"""Reception decision: SNIR against the packet error rate of a waveform, when a burst ends.

The frame is split wherever anything that overlaps it in time and in its receiver's filter begins or ends: another
burst, a noise source, an interval of background traffic. Each part has its own SNIR and so its own bit error rate; all
bits must be right.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from skyrange.contracts.medium import Floats, Ints, ReceptionOutcome
from skyrange.core import elementary
from skyrange.core.chance import uniform4
from skyrange.core.compiled import compiled
from skyrange.core.ids import hash64
from skyrange.radio.builtin.backoff import ERROR_NS, end_deferral
from skyrange.radio.builtin.channel_access import BACKGROUND_INTERVAL_NS, background_power_mw
from skyrange.radio.builtin.state import (
    ADV_EXT_IND,
    BLUETOOTH,
    CHANNEL,
    COUNT,
    END,
    FREE,
    KEY,
    LOCKED,
    LOCKED_ELSEWHERE,
    NTH,
    ON_AIR,
    OVER,
    POINTERS,
    RADIO,
    ROLE,
    SIZE,
    START,
    STATE,
    TUNED,
    WAVEFORM,
    WIFI,
    MediumState,
    Radios,
)
from skyrange.radio.phy import WIDTH_MHZ, bits_success_probability, centre_mhz, filter_overlap, frame_bits, is_wifi
from skyrange.radio.propagation.fading import directed_pair_of
from skyrange.radio.propagation.link_budget import NO_SIGNAL, MediumParams, received_power_dbm
from skyrange.radio.propagation.obstruction import Obstacles

_DECODE: Final = np.uint64(hash64("radio.decode"))
_DECODED, _WEAK, _COLLIDED, _BUSY, _SENDING, _ELSEWHERE = (int(outcome) for outcome in ReceptionOutcome)
_MIN_INTERFERENCE: Final = 1e-3
"""Interference below this share of the receiver's noise is neglected."""


@compiled
def next_completion(state: MediumState) -> int:
    """The slot of the burst that ends next, -1 if nothing is on the air; ties by sender, then by the sender's own
    order.
    """
    best = -1
    for s in range(state.slot.shape[1]):
        if state.slot[STATE, s] != ON_AIR:
            continue
        if best >= 0:
            first = state.slot[END, s] - state.slot[END, best]
            if first == 0:
                first = state.slot[RADIO, s] - state.slot[RADIO, best]
            if first == 0:
                first = state.slot[NTH, s] - state.slot[NTH, best]
            if first == 0:
                first = state.slot[ROLE, s] - state.slot[ROLE, best]
            if first >= 0:
                continue
        best = s
    return best


@compiled
def _before(state: MediumState, s: int, other: int) -> bool:
    """Whether a burst precedes another in the order in which powers are added."""
    if state.slot[START, s] != state.slot[START, other]:
        return bool(state.slot[START, s] < state.slot[START, other])
    if state.slot[RADIO, s] != state.slot[RADIO, other]:
        return bool(state.slot[RADIO, s] < state.slot[RADIO, other])
    return bool(state.slot[NTH, s] < state.slot[NTH, other])


@compiled
def _overlapping(state: MediumState, s: int) -> Ints:
    """Slots of the bursts that overlap one in time, in the order of addition."""
    slots = np.empty(state.slot.shape[1], dtype=np.int64)
    count = 0
    for other in range(state.slot.shape[1]):
        if other == s or state.slot[STATE, other] == FREE:
            continue
        if state.slot[START, other] >= state.slot[END, s] or state.slot[END, other] <= state.slot[START, s]:
            continue
        place = count
        while place > 0 and _before(state, other, slots[place - 1]):
            slots[place] = slots[place - 1]
            place -= 1
        slots[place] = other
        count += 1
    return slots[:count]


@compiled
def frame_success_probability(  # noqa: PLR0917
    kind: int, bits: float, start: int, end: int, signal: float, noise: float, begins: Ints, ends: Ints, mw: Floats,
    count: int,
) -> tuple[float, float]:  # fmt: skip
    """The probability that all bits are right under `count` intervals of interference, and the
    lowest SNIR among them.
    """
    if count == 0:
        return bits_success_probability(kind, signal / noise, bits), signal / noise
    cuts = np.empty(2 * count + 2, dtype=np.int64)
    cuts[0], cuts[1] = start, end
    for k in range(count):
        cuts[2 + 2 * k], cuts[3 + 2 * k] = max(begins[k], start), min(ends[k], end)
    cuts.sort()
    chance, worst = 1.0, math.inf
    for c in range(2 * count + 1):
        if cuts[c + 1] == cuts[c]:
            continue
        total = noise
        for k in range(count):
            if begins[k] <= cuts[c] and ends[k] >= cuts[c + 1]:
                total += mw[k]
        ratio = signal / total
        worst = min(worst, ratio)
        chance *= bits_success_probability(kind, ratio, bits * (cuts[c + 1] - cuts[c]) / (end - start))
    return chance, worst


@compiled
def _release(state: MediumState, s: int) -> None:
    """End a burst; free the slots of those that overlap nothing that is still on the air."""
    state.slot[STATE, s] = OVER
    earliest = np.iinfo(np.int64).max
    for other in range(state.slot.shape[1]):
        if state.slot[STATE, other] == ON_AIR:
            earliest = min(earliest, state.slot[START, other])
    for other in range(state.slot.shape[1]):
        if state.slot[STATE, other] == OVER and state.slot[END, other] <= earliest:
            state.slot[STATE, other] = FREE


@compiled
def decide_receptions(  # noqa: PLR0917
    params: MediumParams,
    obstacles: Obstacles,
    radios: Radios,
    pos: Floats,
    vel: Floats,
    state: MediumState,
    s: int,
    emitters: Ints,
    emitted: Floats,
) -> None:
    """Decide the outcome at every receiver of the burst in slot `s`, write the receptions, and release the burst."""
    key, sender, kind, channel = (
        state.slot[KEY, s],
        state.slot[RADIO, s],
        state.slot[WAVEFORM, s],
        state.slot[CHANNEL, s],
    )
    start, end, reached = state.slot[START, s], state.slot[END, s], state.slot[COUNT, s]
    centre, width = centre_mhz(kind, channel), WIDTH_MHZ[kind]
    bits = float(frame_bits(kind, state.slot[SIZE, s]))
    others = _overlapping(state, s)
    if others.shape[0]:
        for k in range(reached):
            state.mark[state.row[s, k]] = k + 1
        for o in range(others.shape[0]):
            state.other[o, :reached] = 0.0
            slot = others[o]
            share = filter_overlap(
                centre_mhz(state.slot[WAVEFORM, slot], state.slot[CHANNEL, slot]),
                WIDTH_MHZ[state.slot[WAVEFORM, slot]],
                centre,
                width,
            )
            if share > 0.0:
                for k in range(state.slot[COUNT, slot]):
                    place = state.mark[state.row[slot, k]]
                    if place > 0:
                        state.other[o, place - 1] = share * state.mw[slot, k]
        for k in range(reached):
            state.mark[state.row[s, k]] = 0
    pieces = (
        (end - 1) // BACKGROUND_INTERVAL_NS - start // BACKGROUND_INTERVAL_NS + 1
        if params.background_share > 0.0
        else 0
    )
    band, received = WIFI if is_wifi(kind) else BLUETOOTH, 0
    room = others.shape[0] + emitters.shape[1] + pieces
    begins, ends, mw = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64), np.empty(room)
    for k in range(reached):
        if not state.flag[s, k] & TUNED:
            continue
        r, dbm, signal = state.row[s, k], state.dbm[s, k], state.mw[s, k]
        noise = radios.noise_mw[r, kind]
        sending = False
        count = 0
        for o in range(others.shape[0]):
            slot = others[o]
            if state.slot[RADIO, slot] == r and is_wifi(state.slot[WAVEFORM, slot]) == is_wifi(kind):
                sending = True
            if state.other[o, k] > 0.0:
                begins[count], ends[count] = state.slot[START, slot], state.slot[END, slot]
                mw[count] = state.other[o, k]
                count += 1
        for e in range(emitters.shape[1]):
            share = filter_overlap(emitted[0, e], emitted[1, e], centre, width)
            if share <= 0.0 or emitters[1, e] >= end or emitters[2, e] <= start or emitters[0, e] == r:
                continue
            floor = radios.noise_dbm[r, kind] - 10.0 - 10.0 * elementary.log10(share)
            power = received_power_dbm(
                params,
                obstacles,
                radios.who,
                radios.antenna,
                pos,
                vel,
                emitters[0, e],
                r,
                emitted[2, e],
                emitted[0, e],
                start,
                floor,
            )
            if power > NO_SIGNAL:
                begins[count], ends[count] = emitters[1, e], emitters[2, e]
                mw[count] = share * elementary.exp10(0.1 * power)
                count += 1
        for piece in range(pieces):
            number = start // BACKGROUND_INTERVAL_NS + piece
            power = background_power_mw(params, radios.who[r], number, centre, width)
            if power > _MIN_INTERFERENCE * noise:
                begins[count], ends[count], mw[count] = (
                    number * BACKGROUND_INTERVAL_NS,
                    (number + 1) * BACKGROUND_INTERVAL_NS,
                    power,
                )
                count += 1
        locked = state.flag[s, k] & LOCKED > 0
        held = locked and state.lock_slot[r, band] == s
        chance, worst = frame_success_probability(kind, bits, start, end, signal, noise, begins, ends, mw, count)
        if sending:
            outcome = _SENDING
        elif state.flag[s, k] & LOCKED_ELSEWHERE or (locked and not held):
            outcome = _BUSY
        else:
            nth = state.slot[NTH, s] * 8 + state.slot[ROLE, s]
            way = directed_pair_of(radios.who[sender], radios.who[r])
            draw, _, _, _ = uniform4(params.seed, _DECODE, way, np.uint64(start), np.uint64(nth))
            if draw < chance:
                outcome = _DECODED
            else:
                alone = bits_success_probability(kind, signal / noise, bits) if count else chance
                outcome = _COLLIDED if draw < alone else _WEAK
        if held and band == WIFI:
            idle = max(end, state.busy_until[r, channel])
            error = params.eifs and outcome != _DECODED
            state.error_until[r, channel] = idle + ERROR_NS if error else end
            state.mark[r] = 1
            received += 1
        if state.slot[ROLE, s] == ADV_EXT_IND and outcome == _DECODED:
            state.pointers[r, state.pointer_count[r] % POINTERS] = key
            state.pointer_count[r] += 1
            continue  # only the announced packet counts as received
        state.losses[r, outcome] += 1
        if outcome == _DECODED or params.every_pair:
            row = state.counts[1]
            state.heard[0, row], state.heard[1, row], state.heard[2, row] = key, r, channel
            state.heard[3, row], state.heard[4, row] = end, outcome
            state.heard_db[0, row], state.heard_db[1, row] = dbm, 10.0 * elementary.log10(worst)
            state.counts[1] = row + 1
    if received:
        end_deferral(state, channel, end)
        for k in range(reached):
            state.mark[state.row[s, k]] = 0
    row = state.counts[2]
    state.sent[0, row], state.sent[1, row], state.sent[2, row] = key, sender, channel
    state.sent[3, row], state.sent[4, row], state.sent[5, row] = start, end, 0
    state.counts[2] = row + 1
    _release(state, s)
