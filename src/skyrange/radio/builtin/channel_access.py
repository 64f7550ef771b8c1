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

from skyrange.agent.air import Fate, Floats, Ints
from skyrange.core.chance import uniform4
from skyrange.core.compiled import kernel
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_MS, NS_PER_US
from skyrange.radio.link import SILENT, Setting, arriving_dbm
from skyrange.radio.sightlines import Skyline
from skyrange.radio.spectrum import centre_mhz, share_within
from skyrange.radio.table import (
    ASKED,
    CHANNEL,
    CONTENDING,
    DRAWN,
    GIVING_UP,
    KEY,
    LAST,
    NTH,
    PLAN,
    QUEUED,
    RADIO,
    RESUME,
    ROLE,
    SLOTS,
    STAGE,
    WAIT_ROWS,
    WAVE,
    WIFI,
    Air,
    Radios,
)
from skyrange.radio.waveforms import WIDTH_MHZ, is_wifi

SLOT_NS: Final = np.array([20, 9]) * NS_PER_US
DIFS_NS: Final = np.array([50, 28]) * NS_PER_US
SENSE_NS: Final = np.array([15, 4]) * NS_PER_US
WINDOW: Final = np.array([31, 15])
"""CWmin."""
FRAME_DBM: Final = -82.0
ENERGY_DBM: Final = -62.0
PATIENCE_NS: Final = 500 * NS_PER_MS
"""Longest wait for access; a frame that has waited longer is dropped."""
LOOK_AGAIN_NS: Final = NS_PER_MS
"""How often a sender that defers to noise senses the channel again."""
BURST_NS: Final = NS_PER_MS
"""The background traffic is drawn in intervals of this length, busy or idle, separately on the channels 1, 6 and 11."""
ADV_DELAY_NS: Final = 10 * NS_PER_MS
"""Bluetooth Core 5.4 vol. 6 part B 4.4.2.2.1: advDelay is 0 to 10 ms."""
ADV_GAP_NS: Final = 400 * NS_PER_US
"""Between the PDUs of an advertising event; 4.4.2.6 permits at most 10 ms less a PDU, and
controllers use about this."""
POINTER_GAP_NS: Final = 300 * NS_PER_US
"""T_MAFS: the minimum from the last ADV_EXT_IND to the packet it announces (4.1.5)."""
_CITY: Final = np.uint64(hash64("radio.city"))
_NO_ACCESS: Final = int(Fate.NO_ACCESS)

STARTS, WAITS = True, False


@kernel
def next_waiting(air: Air) -> int:
    """The waiting burst that acts next, -1 if there is none; ties by sender, then by the sender's own order."""
    best = -1
    for w in range(air.counts[0]):
        if best >= 0:
            first = air.wait[PLAN, w] - air.wait[PLAN, best]
            if first == 0:
                first = air.wait[RADIO, w] - air.wait[RADIO, best]
            if first == 0:
                first = air.wait[NTH, w] - air.wait[NTH, best]
            if first == 0:
                first = air.wait[ROLE, w] - air.wait[ROLE, best]
            if first >= 0:
                continue
        best = w
    return best


@kernel
def leave(air: Air, w: int) -> None:
    """Remove a burst from the waiting ones."""
    last = air.counts[0] - 1
    for column in range(WAIT_ROWS):
        air.wait[column, w] = air.wait[column, last]
    air.wait_dbm[w] = air.wait_dbm[last]
    air.counts[0] = last


@kernel
def city_mw(setting: Setting, who: np.uint64, piece: int, centre: float, width: float) -> float:
    """Power of background traffic within a receiver's filter in one interval; exponentially distributed about its
    mean.
    """
    if setting.busy <= 0.0:
        return 0.0
    power = 0.0
    draws = uniform4(setting.seed, _CITY, who, np.uint64(piece * BURST_NS), np.uint64(0))
    for k in range(3):
        share = share_within(2412.0 + 25.0 * k, 22.0, centre, width)
        if share > 0.0 and draws[k] < setting.busy:
            power -= share * setting.busy_mw * math.log(1.0 - draws[3])
    return power


@kernel
def _defer(air: Air, w: int, until: int) -> None:
    """Defer until a busy channel becomes idle, and then for the remaining slots."""
    kind = air.wait[WAVE, w]
    if air.wait[SLOTS, w] < 0:
        air.wait[SLOTS, w] = air.wait[DRAWN, w]
    air.wait[RESUME, w] = until + DIFS_NS[kind]
    air.wait[PLAN, w] = air.wait[RESUME, w] + air.wait[SLOTS, w] * SLOT_NS[kind]
    air.wait[STAGE, w] = CONTENDING
    if air.wait[PLAN, w] > air.wait[LAST, w]:
        air.wait[PLAN, w] = max(air.wait[LAST, w], air.wait[ASKED, w])
        air.wait[STAGE, w] = GIVING_UP


@kernel
def freeze(air: Air, w: int, now: int, until: int) -> None:
    """A frame that the sender of a waiting one senses starts at `now`: stop the countdown."""
    kind = air.wait[WAVE, w]
    if air.wait[STAGE, w] != CONTENDING or air.wait[PLAN, w] < now + SENSE_NS[kind]:
        return  # the countdown has not begun, or the start is too late to be sensed
    if air.wait[SLOTS, w] > 0:
        counted = max(now - air.wait[RESUME, w], 0) // SLOT_NS[kind]
        air.wait[SLOTS, w] = max(air.wait[SLOTS, w] - counted, 0)
    _defer(air, w, max(until, air.wait[RESUME, w] - DIFS_NS[kind]))


@kernel
def _busy_until(
    setting: Setting, sky: Skyline, radios: Radios, pos: Floats, vel: Floats, w: int, air: Air, now: int,
    emitters: Ints, emitted: Floats,
) -> int:  # fmt: skip
    """The time until which a sender senses noise or background traffic; `now` if the channel is idle."""
    radio, channel, kind = air.wait[RADIO, w], air.wait[CHANNEL, w], air.wait[WAVE, w]
    centre, width = centre_mhz(kind, channel), WIDTH_MHZ[kind]
    if setting.busy > 0.0:
        piece = now // BURST_NS
        power = city_mw(setting, radios.who[radio], piece, centre, width)
        if power > 0.0 and 10.0 * math.log10(power) >= FRAME_DBM:
            return (piece + 1) * BURST_NS
    total = 0.0
    for e in range(emitters.shape[1]):
        if emitters[0, e] == radio or not emitters[1, e] <= now < emitters[2, e]:
            continue
        share = share_within(emitted[0, e], emitted[1, e], centre, width)
        if share <= 0.0:
            continue
        power = arriving_dbm(
            setting,
            sky,
            radios.who,
            radios.aerial,
            pos,
            vel,
            emitters[0, e],
            radio,
            emitted[2, e],
            emitted[0, e],
            now,
            ENERGY_DBM - 20.0,
        )
        if power > SILENT:
            total += share * 10.0 ** (0.1 * power)
    if total > 0.0 and 10.0 * math.log10(total) >= ENERGY_DBM:
        return now + LOOK_AGAIN_NS
    return now


@kernel
def gets_on_air(
    setting: Setting, sky: Skyline, radios: Radios, pos: Floats, vel: Floats, air: Air, w: int, emitters: Ints,
    emitted: Floats,
) -> bool:  # fmt: skip
    """Act on a waiting burst whose time has come: `STARTS`, or `WAITS` with a new plan or after it was dropped."""
    radio, kind, channel = air.wait[RADIO, w], air.wait[WAVE, w], air.wait[CHANNEL, w]
    now = air.wait[PLAN, w]
    there = pos[radio, 0] + pos[radio, 1] + pos[radio, 2]
    if air.wait[STAGE, w] == GIVING_UP or not abs(there) < math.inf:
        row = air.counts[2]
        air.sent[0, row], air.sent[1, row], air.sent[2, row] = air.wait[KEY, w], radio, channel
        air.sent[3, row] = air.sent[4, row] = now
        air.sent[5, row] = _NO_ACCESS
        air.counts[2] = row + 1
        leave(air, w)
        return WAITS
    if not is_wifi(kind):
        return STARTS
    own = air.sending_until[radio, WIFI]
    if air.wait[STAGE, w] == QUEUED:
        busy = max(air.busy_until[radio, channel], own)
        if busy > now:
            _defer(air, w, busy)
        else:
            air.wait[STAGE, w], air.wait[RESUME, w] = CONTENDING, now + DIFS_NS[kind]
            air.wait[PLAN, w] = air.wait[RESUME, w]
        return WAITS
    if own > now:
        _defer(air, w, own)
        return WAITS
    noisy = _busy_until(setting, sky, radios, pos, vel, w, air, now, emitters, emitted)
    if noisy > now:
        air.wait[SLOTS, w] = min(air.wait[SLOTS, w], 0)  # its slots are counted down already
        _defer(air, w, noisy)
        return WAITS
    return STARTS
