"""SiK channel of a control link: two radios with time slots, their signals and noise, and the fates of frames."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from skyrange.contracts.frames import Fate
from skyrange.contracts.links import OpenChannel, Uniforms
from skyrange.core import elementary
from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_MS, NS_PER_US, Time
from skyrange.radio.control_link.interference import Interference
from skyrange.radio.control_link.sik.modem import (
    bit_error,
    detection_probability,
    filter_khz,
    noise_figure_db,
    packet_success,
    rssi_of,
    sensitivity_dbm,
    untouched_probability,
)
from skyrange.radio.control_link.sik.params import SikParams
from skyrange.radio.control_link.sik.radio import RECEIVE_BUFFER, RadioReport, SikRadio
from skyrange.radio.control_link.sik.slots import AIRCRAFT, STATION, STATISTICS_NS, Held, Sent, Slots
from skyrange.radio.control_link.sik.timing import compute_timing, draw_hop_order, find_centres_mhz
from skyrange.radio.propagation.path_loss import noise_dbm

DECODE_NS: Final[Time] = 4 * NS_PER_US
"""Time to decode each byte with error correction (`Firmware/radio/golay.c: golay_decode`)."""
MAVLINK_OVERHEAD: Final = 12
"""Bytes of an unsigned MAVLink 2 frame beside its content."""
FRAMING_RESERVE: Final = 25
"""How many more bytes than its content a frame may have that is kept whole (`Firmware/radio/packet.c:
packet_get_next`)."""
_WHO: Final = ("station", "aircraft")


class Conditions(NamedTuple):
    """Signals and noise on the frequency of one slot."""

    signals_mw: tuple[float, float]
    """Power of each radio's signal at the other, by number."""
    noise: tuple[Interference, Interference]
    """Noise at each radio."""


class _Reception(NamedTuple):
    """What becomes of a frame at the other radio."""

    received: bool
    at: Time
    """When all of it has been decoded."""


class SikDirection:
    """One direction of a SiK link (`skyrange.contracts.links.OpenChannel`)."""

    __slots__ = ("_frames", "_link", "_sender")

    def __init__(self, link: SikLink, sender: int) -> None:
        self._link = link
        self._sender = sender
        self._frames = 0

    def carry(self, now: Time, size: int, draws: Uniforms) -> tuple[Fate, Time, Time | None]:
        """As `OpenChannel.carry`. The fate follows from draws for packets, which several frames may share."""
        link = self._link
        if not link.conditions:  # nothing is known before the first update, in the first instant of a run
            return Fate.DELIVERED, now + link.latency_ns, None
        link.advance(now)
        ready = link.radios[self._sender].receive_from_computer(now, size, link.params.queue_bytes)
        if ready is None:
            return Fate.OVERFLOW, now, None
        self._frames += 1
        data = Held(ready, size, link.keeps_whole(size), self._frames)
        reception = self._predict(data)
        if reception is None:
            return Fate.OVERFLOW, now, None
        link.slots.held[self._sender].append(data)
        if not reception.received:
            return Fate.LOST, now, None
        arrival = link.radios[1 - self._sender].send_to_computer(reception.at, size)
        if arrival is None:
            return Fate.OVERFLOW, now, None
        return Fate.DELIVERED, arrival + link.latency_ns, None

    def _predict(self, data: Held) -> _Reception | None:
        """What becomes of a frame if nobody sends another one; `None` if it finds the radio's buffer full.

        The radio then drops all of it (assumed; in `serial.c: serial_interrupt` the bytes that came before stay).
        """
        link, sender = self._link, self._sender
        slots, received, fits = link.slots.fork(), True, False
        slots.held[sender].append(data)
        while True:
            if not fits and slots.at > data.ready:
                if slots.buffered_bytes(sender, data.ready) > RECEIVE_BUFFER - 1:
                    return None
                fits = True
            sent = slots.step()
            if sent is None or sent.sender != sender or data.frame not in sent.frames:
                continue
            received &= link.receives(sent)
            if not slots.held[sender] or slots.held[sender][0].frame != data.frame:
                end = sent.start + slots.airtime_ns(sent.data_bytes)
                return _Reception(received, end + link.decode_ns(sent.data_bytes))


class SikLink:
    """The SiK channel of one control link (`skyrange.contracts.links.VariableChannel`)."""

    __slots__ = (
        "_bit_share",
        "_chance",
        "_changes",
        "_directions",
        "_link_update",
        "_who",
        "_whole_limit",
        "centres_mhz",
        "conditions",
        "hop_order",
        "latency_ns",
        "name",
        "netid",
        "noise_dbm",
        "params",
        "radios",
        "slots",
        "width_mhz",
    )

    def __init__(
        self, name: str, params: SikParams, netid: int, radios: tuple[SikRadio, SikRadio], chance: Chance
    ) -> None:
        """`radios` are those of the station and of the aircraft."""
        self.name = name
        self.params = params
        self.netid = netid
        self.radios = radios
        self.latency_ns: Time = round(params.latency_ms * NS_PER_MS)
        band = params.min_khz, params.max_khz, params.channels
        self.centres_mhz = find_centres_mhz(netid, *band)
        self.hop_order = draw_hop_order(netid, params.channels)
        self.width_mhz = filter_khz(params.air_speed_kbps, params.min_khz) / 1e3
        thermal = float(noise_dbm(noise_figure_db(params.air_speed_kbps), self.width_mhz))
        self.noise_dbm = (thermal + params.station_noise_rise_db, thermal + params.noise_rise_db)
        """Noise of each radio in its filter, without that of jammers."""
        self.conditions: dict[int, Conditions] = {}
        """By number of the slot."""
        timing = compute_timing(
            params.air_speed_kbps, ecc=params.ecc, max_window_ms=params.max_window_ms, channels=params.channels
        )
        self.slots = Slots(
            timing, params.air_speed_kbps, ecc=params.ecc, hears=self._hears, duty_percent=params.duty_percent
        )
        self._bit_share = self.width_mhz * 1e3 / params.air_speed_kbps
        self._whole_limit = timing.room(timing.window_ns) if params.mavlink else 0
        self._chance = chance
        self._who = tuple(hash64(f"{name}|{end}") for end in _WHO)
        self._directions = (SikDirection(self, STATION), SikDirection(self, AIRCRAFT))
        self._changes: list[tuple[str, bool]] = []
        self._link_update: Time = 0

    def open(self, direction: str) -> OpenChannel:
        """The direction `fwd`, from the station to the aircraft, or `rev`."""
        return self._directions[STATION if direction == "fwd" else AIRCRAFT]

    def describe(self) -> Mapping[str, Any]:
        """What the manifest says of it."""
        timing = self.slots.timing
        return {
            "kind": "sik",
            **self.params.model_dump(mode="json"),
            "netid": self.netid,
            "window_ms": timing.window_ns / NS_PER_MS,
            "slot_ms": timing.slot_ns / NS_PER_MS,
            "sensitivity_dbm": round(sensitivity_dbm(self.params.air_speed_kbps), 1),
        }

    def keeps_whole(self, size: int) -> bool:
        """Whether the radios send a frame in one packet (`packet.c: packet_get_next`, as for unsigned frames)."""
        return size - MAVLINK_OVERHEAD + FRAMING_RESERVE <= self._whole_limit

    def decode_ns(self, data_bytes: int) -> Time:
        """Time that a receiver takes to decode a packet."""
        return 2 * data_bytes * DECODE_NS if self.params.ecc else 0

    def report(self, end: int, now: Time) -> RadioReport:
        """What a radio tells its computer at `now`."""
        self.advance(now)
        return self.radios[end].report(self.slots.buffered_bytes(end, now))

    def centre_mhz(self, slot: int) -> float:
        """The frequency of a slot (`freq_hopping.c: fhop_window_change`)."""
        return self.centres_mhz[self.hop_order[slot % len(self.hop_order)]]

    def receives(self, sent: Sent) -> bool:
        """Whether the other radio receives a packet, by the conditions as known now."""
        success, _ = self._find_success(sent.sender, sent.slot, sent.start, sent.data_bytes)
        return self._draw(sent.sender, sent.start)[0] < success

    def advance(self, now: Time) -> None:
        """Have the radios do all that they decide by `now`."""
        while self.slots.at <= now:
            self._update_radios(self.slots.at)
            sent = self.slots.step()
            if sent is not None:
                self._settle(sent)
        self._update_radios(now)

    def update(self, now: Time, conditions: Mapping[int, Conditions]) -> list[tuple[str, bool]]:
        """Take over the conditions of the present slot and later ones.

        Returns the radios that have lost (`False`) or found (`True`) the other since the last time.
        """
        if not self.conditions:
            self.slots.start(now)
            self._link_update = now + STATISTICS_NS
            self.conditions.update(conditions)
        self.advance(now)
        self.conditions.update(conditions)
        for number in [number for number in self.conditions if number < self.slots.number_at(now) - 1]:
            del self.conditions[number]
        changes, self._changes = self._changes, []
        return changes

    def _update_radios(self, until: Time) -> None:
        while self._link_update <= until:
            self._link_update += STATISTICS_NS
            self._changes += [(radio.name, False) for radio in self.radios if radio.update_link()]

    def _settle(self, sent: Sent) -> None:
        """Have both radios count and measure a packet."""
        sender, receiver = self.radios[sent.sender], self.radios[1 - sent.sender]
        conditions = self._conditions_of(sent.slot)
        sender.note_noise(rssi_of(_dbm(conditions.noise[sent.sender].steady_mw(sent.start))))
        success, error = self._find_success(sent.sender, sent.slot, sent.start, sent.data_bytes)
        first, second, _, _ = self._draw(sent.sender, sent.start)
        if first >= success:
            detected = max(detection_probability(error) - success, 0.0)
            if self._is_tuned(receiver, sent.slot) and second * (1.0 - success) < detected:
                receiver.note_damaged()
            return
        if not receiver.locked:
            self._changes.append((receiver.name, True))
        total_mw = conditions.signals_mw[sent.sender] + conditions.noise[1 - sent.sender].steady_mw(sent.start)
        receiver.note_packet(rssi_of(_dbm(total_mw)))
        if self.params.ecc and second * success >= untouched_probability(error, sent.data_bytes):
            receiver.note_corrected()
        if sent.statistics:
            receiver.note_statistics(sender)

    def _hears(self, sender: int, slot: int, start: Time) -> bool:
        return self.receives(Sent(sender, slot, start, 0))

    def _conditions_of(self, slot: int) -> Conditions:
        known = self.conditions.get(slot)
        return known if known is not None else self.conditions[max(self.conditions)]

    def _is_tuned(self, receiver: SikRadio, slot: int) -> bool:
        """Whether a radio is on the frequency of a slot: one that searches waits on one frequency until the other has
        used all (`freq_hopping.c: fhop_window_change`).
        """
        return receiver.locked or slot % len(self.hop_order) == 0

    def _find_success(self, sender: int, slot: int, start: Time, data_bytes: int) -> tuple[float, float]:
        """Probability that the other radio receives a packet, and that of a wrong bit, the greatest in the packet."""
        if not self._is_tuned(self.radios[1 - sender], slot):
            return 0.0, 0.5
        conditions, ecc = self._conditions_of(slot), self.params.ecc
        bit_mw = conditions.signals_mw[sender] * self._bit_share
        end = start + self.slots.airtime_ns(data_bytes)
        success, worst = 1.0, 0.0
        for share, noise_mw in conditions.noise[1 - sender].pieces(start, end):
            error = bit_error(bit_mw / noise_mw)
            success *= packet_success(error, data_bytes, share, ecc=ecc)
            worst = max(worst, error)
        return success, worst

    def _draw(self, sender: int, start: Time) -> Uniforms:
        return self._chance.uniform4("SiK packet", self._who[sender], start)


def make_conditions(link: SikLink, gain_db: float, noise: tuple[Interference, Interference]) -> Conditions:
    """The conditions of one slot, for the gain of the path between the radios."""
    if gain_db == -math.inf:
        return Conditions((0.0, 0.0), noise)
    first, second = (float(elementary.exp10(0.1 * (radio.power_dbm + gain_db))) for radio in link.radios)
    return Conditions((first, second), noise)


def _dbm(power_mw: float) -> float:
    return 10.0 * float(elementary.log10(power_mw))
