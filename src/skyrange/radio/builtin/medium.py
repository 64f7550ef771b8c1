"""The builtin radio medium: 2.4 GHz among buildings, frame by frame, each step in one compiled call.

Before it is made, its radios and its environment are checked, and every problem is named at once.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.medium import (
    EmitterTable,
    Floats,
    Heard,
    Ints,
    MediumBase,
    OnAir,
    RadioSpec,
    RadioTable,
    ScanSchedule,
    Sent,
    TransmissionFate,
    TxBatch,
    Waveform,
)
from skyrange.core import elementary
from skyrange.core.chance import Chance
from skyrange.core.compiled import compiled
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.time import NEVER, Time
from skyrange.radio.builtin import channel_access
from skyrange.radio.builtin import state as medium_state
from skyrange.radio.builtin.channel_access import ADVERTISED, REFUSED, next_access, queue_frames, try_access
from skyrange.radio.builtin.params import DEFAULT_PARAMS, OPEN_GROUND, BuiltinParams, RadioEnvironment
from skyrange.radio.builtin.reception_decision import decide_receptions, next_completion
from skyrange.radio.builtin.state import ANTENNAS, MediumState, Radios
from skyrange.radio.builtin.transmission import free_slot, start_transmission
from skyrange.radio.phy import ADVERTISING_CHANNELS, DATA_CHANNELS, WIFI_CHANNELS, airtime_ns
from skyrange.radio.propagation.link_budget import MediumParams, index_positions
from skyrange.radio.propagation.loss_table import NO_TABLE, LossTable
from skyrange.radio.propagation.obstruction import Obstacles, obstacle_index

if TYPE_CHECKING:
    from skyrange.city.city import City

_DONE, _SLOTS, _HEARD = range(3)
_POINTER_BYTES = 7
"""ADV_EXT_IND: extended header length, flags, ADI 2, AuxPtr 3 (Core vol. 6 part B 2.3.4)."""
_NONE = np.zeros(0, dtype=np.int64)
_NOTHING = OnAir(Sent(*(_NONE,) * 6), Heard(_NONE, _NONE, _NONE, _NONE, np.zeros(0), np.zeros(0), _NONE))
_NO_TIME = np.iinfo(np.int64).max


@compiled
def _run(  # noqa: PLR0917
    params: MediumParams,
    obstacles: Obstacles,
    radios: Radios,
    pos: Floats,
    vel: Floats,
    state: MediumState,
    emitters: Ints,
    emitted: Floats,
    until: int,
) -> int:
    """Process events in order of time up to `until`; at one instant ends of bursts precede starts."""
    while True:
        w, s = next_access(state), next_completion(state)
        start = state.wait[medium_state.PLANNED, w] if w >= 0 else _NO_TIME
        end = state.slot[medium_state.END, s] if s >= 0 else _NO_TIME
        if min(start, end) > until:
            return _DONE
        if end <= start:
            if state.counts[1] + state.slot[medium_state.COUNT, s] > state.heard.shape[1]:
                return _HEARD
            decide_receptions(params, obstacles, radios, pos, vel, state, s, emitters, emitted)
        else:
            free = free_slot(state)
            if free < 0:
                return _SLOTS
            if try_access(params, obstacles, radios, pos, vel, state, w, emitters, emitted):
                start_transmission(params, obstacles, radios, pos, vel, state, w, start, free)


class BuiltinMedium(MediumBase):
    """A `Medium` for Wi-Fi and Bluetooth at 2.4 GHz, over open ground or in a city.

    Its clock starts with the first `advance`. Deep copies continue alike; they share the city.
    """

    def __init__(
        self,
        radios: Sequence[RadioSpec],
        chance: Chance,
        city: City | None = None,
        surroundings: RadioEnvironment = OPEN_GROUND,
        *,
        every_pair: bool = False,
        table: LossTable = NO_TABLE,
        params: BuiltinParams = DEFAULT_PARAMS,
    ) -> None:
        """`every_pair` also reports frames that were not decoded. Where `table` covers two positions, its losses
        replace those of open ground and buildings.

        Raises `InputError` with every problem of the radios at once: duplicate names, a position that is not finite or
        inside a building, an antenna, a channel or a power that does not exist.
        """
        check_radios(radios, city, surroundings)
        self.radios: Sequence[RadioSpec] = tuple(sorted(radios, key=lambda radio: radio.name))
        self._chance = chance
        self._obstacles = obstacle_index(city.walls()) if city is not None else obstacle_index()
        self._radios = medium_state.radio_arrays(
            self.radios,
            chance,
            -math.inf if surroundings.carrier_sense_dbm is None else float(surroundings.carrier_sense_dbm),
        )
        self._params = MediumParams(
            seed=chance.key,
            horizon_m=float(surroundings.horizon_m),
            randomness=surroundings.chance,
            background_share=float(surroundings.city_busy),
            background_mean_mw=elementary.exp10(0.1 * surroundings.city_dbm),
            every_pair=every_pair,
            tabled=len(table.places) > 0,
            table=table._replace(lookups=np.zeros_like(table.lookups)),
            capture_db=params.capture_db,
            strongest_preamble=params.preamble_choice == "strongest",
            eifs=params.eifs,
        )
        self._state = medium_state.empty_state(len(self.radios))
        self._emitters = np.zeros((3, 0), dtype=np.int64)
        self._emitted = np.zeros((3, 0))
        self._until: Time | None = None
        self._sorted: NDArray[np.float64] | None = None
        self._refused: list[tuple[int, int, int, Time]] = []

    def __deepcopy__(self, memo: dict[int, Any]) -> BuiltinMedium:
        """Share what is declared and never changes; copy what is on the air."""
        twin = object.__new__(type(self))
        twin.__dict__.update(self.__dict__)
        twin._state = self._state._replace(**{name: array.copy() for name, array in self._state._asdict().items()})
        twin._refused = copy.copy(self._refused)
        table = self._params.table
        twin._params = self._params._replace(table=table._replace(lookups=table.lookups.copy()))
        return twin

    @property
    def losses(self) -> Ints:
        """(radios, outcomes): counts of each `ReceptionOutcome` at each receiver.

        Bursts that would not arrive even in free space are not counted, and ADV_EXT_IND packets only if they were not
        decoded.
        """
        return self._state.losses

    @property
    def table_lookups(self) -> Ints:
        """(2,): how many losses the loss table gave, and how many it did not cover."""
        return self._params.table.lookups

    @property
    def quiet(self) -> bool:
        """Whether nothing waits or is on the air."""
        roles = self._state.wait[medium_state.ROLE, : int(self._state.counts[0])]
        return (
            bool((roles == medium_state.NO_FRAME).all())
            and not self._refused
            and not (self._state.slot[medium_state.STATE] == medium_state.ON_AIR).any()
        )

    def offer(self, now: Time, requests: TxBatch) -> None:
        """Take frames; those that cannot exist (size, channel, waveform, power) are REFUSED in the next result."""
        count = len(requests.key)
        if count == 0:
            return
        radio, at, kind = requests.radio, requests.at_ns, requests.waveform
        if radio.min() < 0 or radio.max() >= len(self.radios):
            raise ValueError(f"a radio in row {int(radio.min())} or {int(radio.max())} of {len(self.radios)}")
        if self._until is not None and at.min() <= self._until:
            raise ValueError(f"a frame offered at {int(at.min())} ns, when {self._until} ns had passed")
        rows = np.arange(count)
        order = rows if count == 1 else np.lexsort((rows, at, radio))
        self._state = medium_state.grow(self._state, waiting=int(self._state.counts[0]) + 4 * count)
        fate, nth, power = np.empty(count, dtype=np.int8), np.empty(count, dtype=np.int64), np.empty(count)
        others = queue_frames(self._radios, self._state, self._params.seed, order, requests, fate, nth, power)
        if not others:
            return
        for row in np.flatnonzero(fate == REFUSED).tolist():
            self._refused.append((int(requests.key[row]), int(radio[row]), int(requests.channel[row]), int(at[row])))
        for row in order[fate[order] == ADVERTISED].tolist():
            draw = self._chance.uniform4("radio.access", int(self._radios.who[radio[row]]), int(at[row]), int(nth[row]))
            self._advertise(
                int(requests.key[row]), int(radio[row]), kind=int(kind[row]), at=int(at[row]),
                size=int(requests.size_bytes[row]), dbm=float(power[row]), nth=int(nth[row]), draw=draw,
            )  # fmt: skip

    def _advertise(
        self, key: int, radio: int, *, kind: int, at: Time, size: int, dbm: float, nth: int, draw: Sequence[float]
    ) -> None:
        """Queue the bursts of one advertising event."""
        extended = kind == Waveform.BLE_CODED
        role, bytes_ = (medium_state.ADV_EXT_IND, _POINTER_BYTES) if extended else (medium_state.STANDALONE, size)
        plan = at + int(draw[1] * channel_access.ADV_DELAY_NS)
        rest = (medium_state.QUEUED, at, -1, 0, 0, NEVER)
        for turn, channel_ in enumerate(ADVERTISING_CHANNELS):
            self._wait(dbm, (key, radio, kind, channel_, role, 4 * nth + turn, bytes_, at, plan, *rest))
            end = plan + airtime_ns(kind, bytes_)
            plan = end + channel_access.ADV_GAP_NS
        if extended:
            data = int(draw[2] * DATA_CHANNELS)
            followed = (
                key,
                radio,
                kind,
                data,
                medium_state.AUX_ADV_IND,
                4 * nth + 3,
                size,
                at,
                end + channel_access.AUX_GAP_NS,
            )
            self._wait(dbm, (*followed, *rest))

    def _wait(self, dbm: float, row: tuple[int, ...]) -> None:
        count = int(self._state.counts[0])
        self._state.wait[:, count] = row
        self._state.wait_dbm[count] = dbm
        self._state.counts[0] = count + 1

    def emit(self, now: Time, sources: EmitterTable) -> None:
        """Make noise from `now` on. Raises `ValueError` for a source without width, or with values that are not
        finite.
        """
        numbers = np.stack((sources.centre_mhz, sources.width_mhz, sources.power_dbm)).astype(np.float64)
        if not np.isfinite(numbers).all() or not (numbers[1] > 0.0).all() or not (numbers[2] <= 90.0).all():
            raise ValueError("a noise source needs a finite centre, a width above 0 MHz and at most 90 dBm")
        if len(sources.radio) and not 0 <= int(sources.radio.min()) <= int(sources.radio.max()) < len(self.radios):
            raise ValueError(f"a noise source that is none of {len(self.radios)} radios")
        order = np.lexsort((sources.from_ns, sources.radio))
        times = np.stack((sources.radio, np.maximum(sources.from_ns, now), sources.to_ns)).astype(np.int64)[:, order]
        still = self._emitters[2] > now - 50_000_000  # a frame on the air may have begun during it
        old = self._emitters[:, still].copy()
        old[2] = np.minimum(old[2], now)
        self._emitters = np.ascontiguousarray(np.concatenate((old, times), axis=1))
        self._emitted = np.ascontiguousarray(np.concatenate((self._emitted[:, still], numbers[:, order]), axis=1))

    def advance(self, until: Time, radios: RadioTable) -> OnAir:
        """Let time pass; see `Medium.advance`. Raises `ValueError` if time runs backwards or rows are missing."""
        pos, vel = radios.pos_enu_m, radios.vel_enu_mps
        if pos.shape != (len(self.radios), 3) or vel.shape != pos.shape:
            raise ValueError(f"places of shape {pos.shape} for {len(self.radios)} radios")
        if self._until is not None and until < self._until:
            raise ValueError(f"asked to advance to {until} ns from {self._until} ns")
        self._until = until
        if self.quiet:
            return _NOTHING
        if self._sorted is not pos:
            index_positions(self._state.head, self._state.follow, pos)
            self._sorted = pos
        state = medium_state.grow(self._state, sent=int(self._state.counts[0]) + self._state.slot.shape[1] + 8)
        while True:
            done = _run(
                self._params, self._obstacles, self._radios, pos, vel, state, self._emitters, self._emitted, until
            )
            if done == _DONE:
                break
            if done == _SLOTS:
                slots = 2 * state.slot.shape[1]
                state = medium_state.grow(state, slots=slots, sent=int(state.counts.sum()) + slots)
            else:
                state = medium_state.grow(state, heard=int(state.counts[1]) + len(self.radios))
        self._state = state
        return self._answer()

    def _answer(self) -> OnAir:
        state = self._state
        _, heard, sent = state.counts.tolist()
        state.counts[1:] = 0
        rows = state.heard[:, :heard]
        order = np.lexsort((rows[1], rows[0], rows[3]))
        rows, levels = rows[:, order], state.heard_db[:, :heard][:, order]
        sent_rows = state.sent[:, :sent].copy()
        if self._refused:
            refused = [
                (key, radio, channel, at, at, int(TransmissionFate.REFUSED))
                for key, radio, channel, at in self._refused
            ]
            sent_rows = np.concatenate((np.array(refused, dtype=np.int64).T, sent_rows), axis=1)
            self._refused = []
        return OnAir(Sent(*sent_rows), Heard(rows[0], rows[1], rows[2], rows[3], levels[0], levels[1], rows[4]))


def fixed_positions(radios: Sequence[RadioSpec], from_ns: Time = 0) -> RadioTable:
    """The table of radios with a fixed position; NaN in the rows of the others, for their owner to fill in."""
    pos = np.array([radio.place_enu_m or (math.nan,) * 3 for radio in radios], dtype=np.float64).reshape(-1, 3)
    return RadioTable(from_ns, pos, np.zeros_like(pos))


def check_radios(radios: Sequence[RadioSpec], city: City | None, surroundings: RadioEnvironment) -> None:
    """Raise one `InputError` with everything that is wrong."""
    problems = []
    names: set[str] = set()
    for radio in radios:
        if radio.name in names:
            problems.append(Problem(radio.name, "two radios", "names that are used once"))
        names.add(radio.name)
        problems += _faults_of(radio, city)
    if not 0.0 < surroundings.horizon_m < math.inf:
        problems.append(Problem("horizon_m", repr(surroundings.horizon_m), "a positive number of metres"))
    if not 0.0 <= surroundings.city_busy < 1.0:
        problems.append(Problem("city_busy", repr(surroundings.city_busy), "a share of time, 0 to less than 1"))
    if not -200.0 < surroundings.city_dbm < 60.0:
        problems.append(Problem("city_dbm", repr(surroundings.city_dbm), "a power in dBm, -200 to 60"))
    sense = surroundings.carrier_sense_dbm
    if sense is not None and not -200.0 < sense < 60.0:
        problems.append(Problem("carrier_sense_dbm", repr(sense), "a power in dBm, -200 to 60, or None"))
    if problems:
        raise InputError("radio", problems)


def _faults_of(radio: RadioSpec, city: City | None) -> Iterator[Problem]:
    place = radio.place_enu_m
    if place is not None:
        if not all(map(math.isfinite, place)):
            yield Problem(f"{radio.name}.place", repr(place), "three finite numbers")
        elif place[2] < 0.0:
            yield Problem(f"{radio.name}.place", repr(place), "a place on the ground (0) or above")
        elif city is not None and (building := city.inside(*place)) is not None:
            yield Problem(f"{radio.name}.place", repr(place), f"a place outside buildings; {building.id} stands there")
    if radio.antenna not in ANTENNAS:
        yield Problem(f"{radio.name}.antenna", repr(radio.antenna), "a known antenna", nearest(radio.antenna, ANTENNAS))
    for name, least, most in (
        ("wifi_dbm", -60.0, 60.0),
        ("ble_dbm", -60.0, 60.0),
        ("gain_dbi", -60.0, 40.0),
        ("noise_figure_db", 0.0, 60.0),
    ):
        value = getattr(radio, name)
        if not least <= value <= most:
            yield Problem(f"{radio.name}.{name}", repr(value), f"a number from {least:g} to {most:g}")
    bands = [_band(chain) for chain in radio.listening]
    if None in bands:
        yield Problem(
            f"{radio.name}.listening",
            repr(radio.listening),
            "turns of one band, on Wi-Fi channels 1 to 13 or advertising channels 37 to 39",
        )
    elif len(set(bands)) < len(bands):
        yield Problem(f"{radio.name}.listening", f"{len(bands)} chains", "at most one in each band")
    for chain in radio.listening:
        alone = len(chain.turns) == 1 and chain.rest_ns == 0 and chain.window_ns == chain.dwell_ns == 0
        if not alone and (not 0 < chain.window_ns <= chain.dwell_ns or chain.rest_ns < 0):
            times = f"{chain.window_ns} of {chain.dwell_ns} ns, rest {chain.rest_ns} ns"
            yield Problem(f"{radio.name}.listening", times, "0 < window_ns <= dwell_ns, and a rest of 0 or more")


def _band(chain: ScanSchedule) -> bool | None:
    """Whether all turns of a chain are Wi-Fi (True) or all Bluetooth (False); None for neither."""
    kinds = {waveform < Waveform.BLE_1M for turn in chain.turns for waveform in turn.waveforms}
    if len(kinds) != 1 or not all(turn.waveforms for turn in chain.turns):
        return None
    wifi = kinds.pop()
    channels = WIFI_CHANNELS if wifi else ADVERTISING_CHANNELS
    return wifi if all(turn.channel in channels for turn in chain.turns) else None
