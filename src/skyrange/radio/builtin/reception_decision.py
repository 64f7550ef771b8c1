"""Reception decision: SNIR against the packet error rate of a waveform, when a burst ends.

The frame is split wherever anything that overlaps it in time and in its receiver's filter begins or ends: another
burst, a noise source, an interval of background traffic. Each part has its own SNIR and so its own bit error rate; all
bits must be right.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from skyrange.agent.air import Floats, Ints, Outcome
from skyrange.core.chance import uniform4
from skyrange.core.compiled import kernel
from skyrange.core.ids import hash64
from skyrange.radio.access import BURST_NS, city_mw
from skyrange.radio.fading import way_of
from skyrange.radio.link import SILENT, Setting, arriving_dbm
from skyrange.radio.sightlines import Skyline
from skyrange.radio.spectrum import centre_mhz, share_within
from skyrange.radio.table import (
    CHANNEL,
    COUNT,
    END,
    FREE,
    HEARING,
    KEY,
    MISSED,
    NTH,
    ON_AIR,
    OVER,
    POINTER,
    POINTERS,
    RADIO,
    ROLE,
    SIZE,
    START,
    STATE,
    WAVE,
    Air,
    Radios,
)
from skyrange.radio.waveforms import WIDTH_MHZ, frame_bits, is_wifi, survival

_DECODE: Final = np.uint64(hash64("radio.decode"))
_DECODED, _WEAK, _COLLIDED, _BUSY, _SENDING, _ELSEWHERE = (int(outcome) for outcome in Outcome)
_MIN_INTERFERENCE: Final = 1e-3
"""Interference below this share of the receiver's noise is neglected."""


@kernel
def next_end(air: Air) -> int:
    """The slot of the burst that ends next, -1 if nothing is on the air; ties by sender, then by the sender's own
    order.
    """
    best = -1
    for s in range(air.slot.shape[1]):
        if air.slot[STATE, s] != ON_AIR:
            continue
        if best >= 0:
            first = air.slot[END, s] - air.slot[END, best]
            if first == 0:
                first = air.slot[RADIO, s] - air.slot[RADIO, best]
            if first == 0:
                first = air.slot[NTH, s] - air.slot[NTH, best]
            if first == 0:
                first = air.slot[ROLE, s] - air.slot[ROLE, best]
            if first >= 0:
                continue
        best = s
    return best


@kernel
def _before(air: Air, s: int, other: int) -> bool:
    """Whether a burst precedes another in the order in which powers are added."""
    if air.slot[START, s] != air.slot[START, other]:
        return bool(air.slot[START, s] < air.slot[START, other])
    if air.slot[RADIO, s] != air.slot[RADIO, other]:
        return bool(air.slot[RADIO, s] < air.slot[RADIO, other])
    return bool(air.slot[NTH, s] < air.slot[NTH, other])


@kernel
def _overlapping(air: Air, s: int) -> Ints:
    """Slots of the bursts that overlap one in time, in the order of addition."""
    found = np.empty(air.slot.shape[1], dtype=np.int64)
    count = 0
    for other in range(air.slot.shape[1]):
        if other == s or air.slot[STATE, other] == FREE:
            continue
        if air.slot[START, other] >= air.slot[END, s] or air.slot[END, other] <= air.slot[START, s]:
            continue
        place = count
        while place > 0 and _before(air, other, found[place - 1]):
            found[place] = found[place - 1]
            place -= 1
        found[place] = other
        count += 1
    return found[:count]


@kernel
def survives(
    kind: int, bits: float, start: int, end: int, signal: float, noise: float, begins: Ints, ends: Ints, mw: Floats,
    count: int,
) -> tuple[float, float]:  # fmt: skip
    """The probability that all bits are right under `count` intervals of interference, and the
    lowest SNIR among them.
    """
    if count == 0:
        return survival(kind, signal / noise, bits), signal / noise
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
        chance *= survival(kind, ratio, bits * (cuts[c + 1] - cuts[c]) / (end - start))
    return chance, worst


@kernel
def _release(air: Air, s: int) -> None:
    """End a burst; free the slots of those that overlap nothing that is still on the air."""
    air.slot[STATE, s] = OVER
    earliest = np.iinfo(np.int64).max
    for other in range(air.slot.shape[1]):
        if air.slot[STATE, other] == ON_AIR:
            earliest = min(earliest, air.slot[START, other])
    for other in range(air.slot.shape[1]):
        if air.slot[STATE, other] == OVER and air.slot[END, other] <= earliest:
            air.slot[STATE, other] = FREE


@kernel
def judge(
    setting: Setting, sky: Skyline, radios: Radios, pos: Floats, vel: Floats, air: Air, s: int, emitters: Ints,
    emitted: Floats,
) -> None:  # fmt: skip
    """Decide the outcome at every receiver of the burst in slot `s`, write the receptions, and release the burst."""
    key, sender, kind, channel = air.slot[KEY, s], air.slot[RADIO, s], air.slot[WAVE, s], air.slot[CHANNEL, s]
    start, end, reached = air.slot[START, s], air.slot[END, s], air.slot[COUNT, s]
    centre, width = centre_mhz(kind, channel), WIDTH_MHZ[kind]
    bits = float(frame_bits(kind, air.slot[SIZE, s]))
    others = _overlapping(air, s)
    if others.shape[0]:
        for k in range(reached):
            air.mark[air.row[s, k]] = k + 1
        for o in range(others.shape[0]):
            air.other[o, :reached] = 0.0
            slot = others[o]
            share = share_within(
                centre_mhz(air.slot[WAVE, slot], air.slot[CHANNEL, slot]),
                WIDTH_MHZ[air.slot[WAVE, slot]],
                centre,
                width,
            )
            if share > 0.0:
                for k in range(air.slot[COUNT, slot]):
                    place = air.mark[air.row[slot, k]]
                    if place > 0:
                        air.other[o, place - 1] = share * air.mw[slot, k]
        for k in range(reached):
            air.mark[air.row[s, k]] = 0
    pieces = (end - 1) // BURST_NS - start // BURST_NS + 1 if setting.busy > 0.0 else 0
    room = others.shape[0] + emitters.shape[1] + pieces
    begins, ends, mw = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64), np.empty(room)
    for k in range(reached):
        if not air.flag[s, k] & HEARING:
            continue
        r, dbm, signal = air.row[s, k], air.dbm[s, k], air.mw[s, k]
        noise = radios.noise_mw[r, kind]
        sending = False
        count = 0
        for o in range(others.shape[0]):
            slot = others[o]
            if air.slot[RADIO, slot] == r and is_wifi(air.slot[WAVE, slot]) == is_wifi(kind):
                sending = True
            if air.other[o, k] > 0.0:
                begins[count], ends[count] = air.slot[START, slot], air.slot[END, slot]
                mw[count] = air.other[o, k]
                count += 1
        for e in range(emitters.shape[1]):
            share = share_within(emitted[0, e], emitted[1, e], centre, width)
            if share <= 0.0 or emitters[1, e] >= end or emitters[2, e] <= start or emitters[0, e] == r:
                continue
            floor = radios.noise_dbm[r, kind] - 10.0 - 10.0 * math.log10(share)
            power = arriving_dbm(
                setting,
                sky,
                radios.who,
                radios.aerial,
                pos,
                vel,
                emitters[0, e],
                r,
                emitted[2, e],
                emitted[0, e],
                start,
                floor,
            )
            if power > SILENT:
                begins[count], ends[count] = emitters[1, e], emitters[2, e]
                mw[count] = share * 10.0 ** (0.1 * power)
                count += 1
        for piece in range(pieces):
            number = start // BURST_NS + piece
            power = city_mw(setting, radios.who[r], number, centre, width)
            if power > _MIN_INTERFERENCE * noise:
                begins[count], ends[count], mw[count] = number * BURST_NS, (number + 1) * BURST_NS, power
                count += 1
        chance, worst = survives(kind, bits, start, end, signal, noise, begins, ends, mw, count)
        if sending:
            outcome = _SENDING
        elif air.flag[s, k] & MISSED:
            outcome = _BUSY
        else:
            nth = air.slot[NTH, s] * 8 + air.slot[ROLE, s]
            way = way_of(radios.who[sender], radios.who[r])
            draw, _, _, _ = uniform4(setting.seed, _DECODE, way, np.uint64(start), np.uint64(nth))
            if draw < chance:
                outcome = _DECODED
            else:
                alone = survival(kind, signal / noise, bits) if count else chance
                outcome = _COLLIDED if draw < alone else _WEAK
        if air.slot[ROLE, s] == POINTER and outcome == _DECODED:
            air.pointers[r, air.pointed[r] % POINTERS] = key
            air.pointed[r] += 1
            continue  # only the announced packet counts as received
        air.losses[r, outcome] += 1
        if outcome == _DECODED or setting.every_pair:
            row = air.counts[1]
            air.heard[0, row], air.heard[1, row], air.heard[2, row] = key, r, channel
            air.heard[3, row], air.heard[4, row] = end, outcome
            air.heard_db[0, row], air.heard_db[1, row] = dbm, 10.0 * math.log10(worst)
            air.counts[1] = row + 1
    row = air.counts[2]
    air.sent[0, row], air.sent[1, row], air.sent[2, row] = key, sender, channel
    air.sent[3, row], air.sent[4, row], air.sent[5, row] = start, end, 0
    air.counts[2] = row + 1
    _release(air, s)
