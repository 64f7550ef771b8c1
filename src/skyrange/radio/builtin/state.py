"""State of the builtin medium as arrays for its kernels: the radios as declared, and the bursts that wait or are on
the air.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.medium import Floats, Ints, RadioSpec, ReceptionOutcome
from skyrange.core import elementwise
from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.core.time import NEVER
from skyrange.radio.phy import LOCK_SNIR_DB, WIDTH_MHZ
from skyrange.radio.propagation.path_loss import dipole_dbi, noise_dbm

WIFI, BLUETOOTH = 0, 1
"""Bands: a radio has at most one receive chain in each, and sends one frame at a time in each."""
POINTERS: Final = 16
"""How many announced extended advertisements a receiver can follow at once."""
ANTENNAS: Final = ("isotropic", "dipole")

# rows of `MediumState.wait`: bursts that are to be sent, one column each
KEY, RADIO, WAVEFORM, CHANNEL, ROLE, NTH, SIZE, OFFERED = range(8)
PLANNED, STAGE, RESUME, SLOTS_LEFT, BACKOFF, NEXT_BACKOFF, DEADLINE = range(8, 15)
WAIT_ROWS: Final = 15
QUEUED, BEHIND, CONTENDING, GIVING_UP = range(4)
"""Stages of a waiting burst; one that is `BEHIND` waits for an earlier frame of the same radio."""
STANDALONE, ADV_EXT_IND, AUX_ADV_IND, NO_FRAME = range(4)
"""Roles: a self-contained frame, an ADV_EXT_IND that announces another packet, the packet that is announced, the
backoff after a transmission while no frame waits."""

# rows of `MediumState.slot`, after those up to SIZE: bursts on the air and over
START, END, STATE, COUNT = 7, 8, 9, 10
SLOT_ROWS: Final = 11
FREE, ON_AIR, OVER = range(3)

# columns of `Radios.chain`: where its turns begin, how many (0: no chain), times in ns
FIRST, TURNS, DWELL, WINDOW, REST, PHASE = range(6)
ALWAYS: Final = NEVER // 4
"""Dwell of a chain that never changes its channel."""

TUNED, LOCKED_ELSEWHERE, LOCKED, SENSED = 1, 2, 4, 8
"""Flags: the receiver is tuned to the burst; it was locked on another one; it locked on this one; it senses the burst
as a busy channel."""


class Radios(NamedTuple):
    """n radios as declared; chains are by band."""

    who: NDArray[np.uint64]
    antenna: Floats
    """(n, 2): index of the pattern, and gain in dBi."""
    tx_power_dbm: Floats
    """(n, 2) transmit power by band."""
    noise_dbm: Floats
    """(n, waveforms) noise in the width of each waveform."""
    chain: Ints
    """(n, 2, 6): `FIRST` to `PHASE`."""
    turn_channel: Ints
    turn_mask: Ints
    """Bit w: receives waveform w."""
    noise_mw: Floats
    sense_dbm: Floats
    """(n, waveforms): the weakest Wi-Fi frame that each radio senses as a busy channel."""
    best_dbi: float
    best_noise_db: float
    """The highest gain and the lowest noise figure of all radios."""


class MediumState(NamedTuple):
    """State of the medium: w waiting bursts, s slots of bursts on the air or just over, n radios."""

    wait: Ints
    """(WAIT_ROWS, w)"""
    wait_dbm: Floats
    slot: Ints
    """(SLOT_ROWS, s)"""
    slot_dbm: Floats
    row: NDArray[np.int32]
    """(s, n): receivers that a burst reaches, the first `COUNT` of each slot; so are `dbm`, `mw` and `flag`."""
    dbm: Floats
    mw: Floats
    flag: NDArray[np.uint8]
    lock_until: Ints
    """(n, 2); so are `lock_dbm` and `lock_slot`, power and slot of the burst that a chain is locked on, and
    `sync_until`, the end of its search for a preamble."""
    lock_dbm: Floats
    lock_slot: Ints
    sync_until: Ints
    sending_until: Ints
    """(n, 2)"""
    busy_until: Ints
    """(n, 14): until when a radio senses a Wi-Fi channel as busy; `energy_until` by the energy of frames alone."""
    energy_until: Ints
    error_until: Ints
    """(n, 14): after a frame that was received with an error, the end of the time by which EIFS exceeds DIFS."""
    pointers: Ints
    """(n, POINTERS): keys of the ADV_EXT_INDs decoded last; column `pointer_count % POINTERS` is overwritten next."""
    pointer_count: Ints
    losses: Ints
    """(n, outcomes)"""
    head: Ints
    """Buckets of positions: the first radio in each; `follow` holds the next."""
    follow: Ints
    mark: NDArray[np.int32]
    """(n,) scratch: index + 1 in the current list, 0 between uses."""
    other: Floats
    """(s, n) scratch: interference by burst and index."""
    heard: Ints
    """(5, h): key, radio, channel, end, outcome."""
    heard_db: Floats
    """(2, h): rssi, snir."""
    sent: Ints
    """(6, t): as `Sent`."""
    counts: Ints
    """Numbers of waiting bursts, rows of `heard`, and rows of `sent`."""


def radio_arrays(specs: Sequence[RadioSpec], chance: Chance, carrier_sense_dbm: float = -math.inf) -> Radios:
    """The arrays of some radios, in their order; they sense no frame below `carrier_sense_dbm`."""
    n = len(specs)
    shape = (n, 2)
    chains = np.zeros((n, 2, 6), dtype=np.int64)
    channels: list[int] = []
    masks: list[int] = []
    for i, spec in enumerate(specs):
        for chain in spec.listening:
            band = WIFI if chain.turns[0].waveforms[0] < 2 else BLUETOOTH
            first = len(channels)
            for turn in chain.turns:
                channels.append(turn.channel)
                masks.append(sum(1 << int(waveform) for waveform in set(turn.waveforms)))
            always = len(chain.turns) == 1 and chain.rest_ns == 0 and chain.window_ns >= chain.dwell_ns
            cycle = 0 if always else len(chain.turns) * chain.dwell_ns + chain.rest_ns
            phase = int(chance.uniform4("radio.phase", hash64(spec.name), 0, band)[0] * cycle)
            dwell, window = (ALWAYS, ALWAYS) if always else (chain.dwell_ns, chain.window_ns)
            chains[i, band] = (first, len(chain.turns), dwell, window, chain.rest_ns, phase)
    noise = np.array([[noise_dbm(spec.noise_figure_db, float(width)) for width in WIDTH_MHZ] for spec in specs])
    noise = noise.reshape(n, len(WIDTH_MHZ))
    peaks = [spec.gain_dbi + (float(dipole_dbi(0.0)) if spec.antenna == "dipole" else 0.0) for spec in specs]
    return Radios(
        who=np.array([hash64(spec.name) for spec in specs], dtype=np.uint64),
        antenna=np.array([(ANTENNAS.index(spec.antenna), spec.gain_dbi) for spec in specs]).reshape(shape),
        tx_power_dbm=np.array([(spec.wifi_dbm, spec.ble_dbm) for spec in specs], dtype=np.float64).reshape(shape),
        noise_dbm=noise,
        noise_mw=elementwise.exp10(0.1 * noise),
        sense_dbm=np.maximum(noise + LOCK_SNIR_DB, carrier_sense_dbm),
        chain=chains,
        turn_channel=np.array(channels, dtype=np.int64),
        turn_mask=np.array(masks, dtype=np.int64),
        best_dbi=max(peaks, default=0.0),
        best_noise_db=min((spec.noise_figure_db for spec in specs), default=0.0),
    )


def empty_state(n: int, waiting: int = 64, slots: int = 16, rows: int = 256) -> MediumState:
    """The state with nothing waiting or on the air among `n` radios, with room for some."""
    buckets = 1
    while buckets < 2 * n:
        buckets *= 2

    def ints(*shape: int) -> Any:
        return np.zeros(shape, dtype=np.int64)

    return MediumState(
        wait=ints(WAIT_ROWS, waiting), wait_dbm=np.zeros(waiting), slot=ints(SLOT_ROWS, slots),
        slot_dbm=np.zeros(slots), row=np.zeros((slots, n), dtype=np.int32), dbm=np.zeros((slots, n)),
        mw=np.zeros((slots, n)), flag=np.zeros((slots, n), dtype=np.uint8), lock_until=ints(n, 2) - NEVER,
        lock_dbm=np.zeros((n, 2)), lock_slot=ints(n, 2) - 1, sync_until=ints(n, 2) - NEVER,
        sending_until=ints(n, 2) - NEVER, busy_until=ints(n, 14) - NEVER, energy_until=ints(n, 14) - NEVER,
        error_until=ints(n, 14) - NEVER,
        pointers=ints(n, POINTERS) - 1, pointer_count=ints(n), losses=ints(n, len(ReceptionOutcome)),
        head=ints(buckets) - 1,
        follow=ints(n) - 1, mark=np.zeros(n, dtype=np.int32), other=np.zeros((slots, n)), heard=ints(5, rows),
        heard_db=np.zeros((2, rows)), sent=ints(6, rows), counts=ints(3),
    )  # fmt: skip


_WAIT = ("wait", "wait_dbm")
_SLOTS = ("slot", "slot_dbm")
_LISTS = ("row", "dbm", "mw", "flag", "other")
_HEARD = ("heard", "heard_db")


def _widened(state: MediumState, names: Sequence[str], axis: int, size: int) -> dict[str, Any]:
    wide = {}
    for name in names:
        array = getattr(state, name)
        shape = list(array.shape)
        shape[axis] = size - shape[axis]
        wide[name] = np.concatenate((array, np.zeros(shape, dtype=array.dtype)), axis=axis)
    return wide


def grow(state: MediumState, waiting: int = 0, slots: int = 0, heard: int = 0, sent: int = 0) -> MediumState:
    """The same state with room for at least so many of each."""
    wide: dict[str, Any] = {}
    if waiting > state.wait_dbm.shape[0]:
        wide |= _widened(state, _WAIT, -1, max(waiting, 2 * state.wait_dbm.shape[0]))
    if slots > state.slot_dbm.shape[0]:
        wide |= _widened(state, _SLOTS, -1, slots) | _widened(state, _LISTS, 0, slots)
    if heard > state.heard.shape[1]:
        wide |= _widened(state, _HEARD, -1, max(heard, 2 * state.heard.shape[1]))
    if sent > state.sent.shape[1]:
        wide |= _widened(state, ("sent",), -1, max(sent, 2 * state.sent.shape[1]))
    return state._replace(**wide) if wide else state
