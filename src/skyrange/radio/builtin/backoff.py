"""Backoff of Wi-Fi senders: the DCF of IEEE 802.11-2020 10.3.4 for frames that are not acknowledged.

A radio contends for its frames one by one, in the order in which they were handed to it. A frame that finds the channel
idle is sent after DIFS (10.3.4.2: the medium "is idle when a frame is queued for transmission, and remains idle for a
period of a DIFS"). A frame that does not, or whose channel becomes busy in that time, waits for DIFS on an idle channel
and then for a backoff of 0…CWmin idle slots, whose countdown stands still while the channel is busy (10.3.4.3). Another
backoff follows each transmission, even if no frame waits (10.3.4.3); the next frame continues its countdown.

After a frame that was received with an error, EIFS replaces DIFS until a frame is received without one (10.3.2.3.7).
EIFS is SIFS, the Ack's airtime at the lowest mandatory rate, and DIFS. At 2.4 GHz that rate is 1 Mb/s (clause 18), and
the airtime 192 + 8·14 = 304 µs. Chips do so: the initial EIFS of the AR5416 (register 0x10b0, ar5008_initvals.h of
Linux) is 15,928 cycles of 44 MHz or 362 µs at 2.4 GHz, the standard's 364 with long slots less 2 as in its SIFS; it is
92 µs at 5 GHz, where the rate is 6 Mb/s.

Slot, SIFS, CWmin: 20 µs, 10 µs, 31 (DSSS, table 15-6) and 9 µs, 10 µs, 15 (OFDM at 2.4 GHz with short slots, table
18-5). A frame that began within the last 15 µs (DSSS) or 4 µs (OFDM), aCCATime, is not sensed yet.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from skyrange.core.compiled import compiled
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_US
from skyrange.radio.builtin.state import (
    BACKOFF,
    BEHIND,
    CHANNEL,
    CONTENDING,
    DEADLINE,
    END,
    GIVING_UP,
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
    WAIT_ROWS,
    WAVEFORM,
    MediumState,
)
from skyrange.radio.phy import is_wifi

SLOT_NS: Final = np.array([20, 9]) * NS_PER_US
DIFS_NS: Final = np.array([50, 28]) * NS_PER_US
ERROR_NS: Final = (10 + 192 + 8 * 14) * NS_PER_US
"""What EIFS has more than DIFS: SIFS, and an Ack of 14 bytes at 1 Mb/s with the long preamble."""
CCA_TIME_NS: Final = np.array([15, 4]) * NS_PER_US
CW_MIN: Final = np.array([31, 15])
"""CWmin."""
MAX_WAIT_NS: Final = 500 * NS_PER_MS
"""Longest wait for access; a frame that has waited longer is dropped."""


@compiled
def remove_waiting(state: MediumState, w: int) -> None:
    """Remove a burst from the waiting ones."""
    last = state.counts[0] - 1
    for column in range(WAIT_ROWS):
        state.wait[column, w] = state.wait[column, last]
    state.wait_dbm[w] = state.wait_dbm[last]
    state.counts[0] = last


@compiled
def _plan(state: MediumState, w: int, resume: int, slots: int) -> None:
    """Plan a burst for `slots` slots after `resume`; with -1 slots, for `resume`, and without a backoff so far."""
    state.wait[RESUME, w], state.wait[SLOTS_LEFT, w] = resume, slots
    state.wait[PLANNED, w] = resume + max(slots, 0) * SLOT_NS[state.wait[WAVEFORM, w]]
    state.wait[STAGE, w] = CONTENDING
    if state.wait[PLANNED, w] > state.wait[DEADLINE, w]:
        state.wait[PLANNED, w] = max(state.wait[DEADLINE, w], state.wait[OFFERED, w])
        state.wait[STAGE, w] = GIVING_UP


@compiled
def defer(state: MediumState, w: int, until: int) -> None:
    """Defer until a busy channel becomes idle, and then for the remaining slots."""
    slots = state.wait[SLOTS_LEFT, w]
    if slots < 0:
        slots = state.wait[BACKOFF, w]
    _plan(state, w, until + DIFS_NS[state.wait[WAVEFORM, w]], slots)


@compiled
def freeze_backoff(state: MediumState, w: int, now: int, until: int) -> None:
    """A frame that the sender of a waiting one senses starts at `now`: stop the countdown."""
    kind = state.wait[WAVEFORM, w]
    if state.wait[STAGE, w] != CONTENDING or state.wait[PLANNED, w] < now + CCA_TIME_NS[kind]:
        return  # the countdown has not begun, or the start is too late to be sensed
    if state.wait[SLOTS_LEFT, w] > 0:
        counted = max(now - state.wait[RESUME, w], 0) // SLOT_NS[kind]
        state.wait[SLOTS_LEFT, w] = max(state.wait[SLOTS_LEFT, w] - counted, 0)
    defer(state, w, max(until, state.wait[RESUME, w] - DIFS_NS[kind]))


@compiled
def begin_contention(state: MediumState, w: int, now: int) -> None:
    """Begin the contention for a frame that was handed to its radio `now`, or line it up behind an earlier one."""
    radio, channel, kind = state.wait[RADIO, w], state.wait[CHANNEL, w], state.wait[WAVEFORM, w]
    busy = state.busy_until[radio, channel]
    idle = max(busy, state.error_until[radio, channel])
    for other in range(state.counts[0]):
        stage = state.wait[STAGE, other]
        if state.wait[RADIO, other] != radio or stage == QUEUED or not is_wifi(state.wait[WAVEFORM, other]):
            continue
        if state.wait[ROLE, other] != NO_FRAME:
            state.wait[STAGE, w], state.wait[PLANNED, w] = BEHIND, state.wait[DEADLINE, w]
            return
        # the frame takes over the backoff after the last transmission, as far as it has come
        _plan(state, w, max(state.wait[RESUME, other], idle + DIFS_NS[kind]), state.wait[SLOTS_LEFT, other])
        state.wait[PLANNED, w] = max(state.wait[PLANNED, w], now)
        remove_waiting(state, other)
        return
    if busy > now:
        defer(state, w, idle)
    else:
        _plan(state, w, max(now, idle) + DIFS_NS[kind], -1)


@compiled
def _next_in_line(state: MediumState, radio: int) -> int:
    """The frame that a radio was handed first of those that wait behind another; -1 if there is none."""
    best = -1
    for w in range(state.counts[0]):
        if state.wait[RADIO, w] != radio or state.wait[STAGE, w] != BEHIND:
            continue
        if best >= 0:
            first = state.wait[OFFERED, w] - state.wait[OFFERED, best]
            if first > 0 or (first == 0 and state.wait[NTH, w] > state.wait[NTH, best]):
                continue
        best = w
    return best


@compiled
def begin_next_backoff(state: MediumState, s: int, slots: int) -> None:
    """Begin the backoff that follows the transmission in slot `s`, for the next frame of its sender or for none."""
    radio, end = state.slot[RADIO, s], state.slot[END, s]
    w = _next_in_line(state, radio)
    if w < 0:
        w = state.counts[0]
        state.counts[0] = w + 1
        for column in range(SIZE + 1):
            state.wait[column, w] = state.slot[column, s]
        state.wait[ROLE, w], state.wait[OFFERED, w], state.wait[DEADLINE, w] = NO_FRAME, end, NEVER
    idle = max(end, state.busy_until[radio, state.wait[CHANNEL, w]])
    _plan(state, w, idle + DIFS_NS[state.wait[WAVEFORM, w]], slots)


@compiled
def pass_contention_on(state: MediumState, w: int, now: int) -> None:
    """Let the next frame of a radio contend in the place of one that is dropped."""
    radio, kind = state.wait[RADIO, w], state.wait[WAVEFORM, w]
    following = _next_in_line(state, radio)
    if following < 0:
        return
    slots, resume = max(state.wait[SLOTS_LEFT, w], 0), state.wait[RESUME, w]
    counted = min(max(now - resume, 0) // SLOT_NS[kind], slots)
    _plan(state, following, resume + counted * SLOT_NS[kind], slots - counted)
    busy = state.busy_until[radio, state.wait[CHANNEL, following]]
    if busy > now:
        defer(state, following, busy)


@compiled
def end_deferral(state: MediumState, channel: int, end: int) -> None:
    """A frame ends on a channel: the radios that received it, which are in `mark`, wait for EIFS or DIFS from then
    on.
    """
    for w in range(state.counts[0]):
        radio = state.wait[RADIO, w]
        if state.mark[radio] == 0 or state.wait[STAGE, w] != CONTENDING or state.wait[CHANNEL, w] != channel:
            continue
        idle = max(end, state.busy_until[radio, channel], state.error_until[radio, channel])
        _plan(state, w, idle + DIFS_NS[state.wait[WAVEFORM, w]], state.wait[SLOTS_LEFT, w])
