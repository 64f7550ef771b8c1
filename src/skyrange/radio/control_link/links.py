"""Radio conditions of all control links over the air, kept up to date during a run."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from skyrange.codec.wifi_management import DEAUTHENTICATION, decode_management
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.medium import Floats, RadioTable
from skyrange.core import elementary, elementary_python, elementwise, matrices
from skyrange.core.chance import Chance
from skyrange.core.errors import DecodeError
from skyrange.core.ids import Port, hash64
from skyrange.core.time import NS_PER_MS, Time
from skyrange.core.whole_numbers import worth_noting
from skyrange.radio.control_link.cellular_link import NO_CELL, CellularLink
from skyrange.radio.control_link.channel_changes import ChannelChanges, FollowingJammers
from skyrange.radio.control_link.foreign_radio import ForeignRadio
from skyrange.radio.control_link.noise_at_radios import NoiseAtRadios
from skyrange.radio.control_link.propagation import Propagation
from skyrange.radio.control_link.sik.link import SikLink
from skyrange.radio.control_link.sik.updates import SikUpdates
from skyrange.radio.control_link.wifi_link import (
    BEACON_BYTES,
    MAX_OCCUPANCY,
    Transmitter,
    WifiDirection,
    WifiLink,
)
from skyrange.radio.control_link.wifi_rates import (
    MIN_SNIR_DB,
    PREAMBLE_DBM,
    RATES_MBPS,
    WIDTH_MHZ,
    fill_successes,
    success_probability,
)
from skyrange.radio.phy import OFDM, centre_mhz
from skyrange.radio.propagation.link_budget import max_range_m
from skyrange.radio.spectrum import ManagementFrame, NoiseBurst, Spectrum, Transmission

NAME: Final = "radio links"
"""It is later than the oracle in order of names, so that it learns in the same instant what the oracle knows."""
STEP_NS: Final[Time] = 20 * NS_PER_MS
_RATE_WEIGHT: Final = 1.0 - elementary_python.power(0.75, STEP_NS / (100 * NS_PER_MS))
"""Linux's Minstrel rate control gives a new interval of 100 ms a weight of 25 % (`EWMA_LEVEL`)."""
_OCCUPANCY_WEIGHT: Final = STEP_NS / (100 * NS_PER_MS)
"""Occupancy is an average over about 100 ms (assumed)."""
_PROBE_BITS: Final = 8.0 * 200
"""Length of the frame for which rates are compared, 200 bytes: most MAVLink frames with their overhead are shorter."""
_BEACON_BITS: Final = 8.0 * BEACON_BYTES
_TRAFFIC_CHANNELS: Final = (1, 6, 11)
"""The channels of the city's background traffic."""
_OVERLAP_CHANNELS: Final = 4
"""Channels closer than this, 20 MHz, overlap."""


class ControlLinks:
    """The agent that updates the channels of control links (`skyrange.contracts.components.Agent`).

    Every 20 ms it works out the power of each link's signal at both ends, the noise of jammers there, how much of the
    time others use the channel, associations and hand-overs. It sends nothing; the links read what it writes.
    """

    name = NAME
    service_ns: Time = STEP_NS
    ports: Sequence[Port] = ()

    def __init__(
        self,
        wifi: Sequence[WifiLink],
        cellular: Sequence[CellularLink],
        spectrum: Spectrum,
        *,
        places: Mapping[str, tuple[float, float, float]],
        propagation: Mapping[float, Propagation],
        chance: Chance,
        city_busy: float = 0.0,
        foreign: Sequence[ForeignRadio] = (),
        sik: Sequence[SikLink] = (),
    ) -> None:
        """`places` has the fixed radios by name, in metres from the origin. Rows of radios are those of
        `spectrum.radios`, then those of `places`; `propagation` is by centre frequency in MHz, for `sik` by the middle
        of the band. `foreign` are radios of attackers on channels of `wifi`, at places of their names.
        """
        self._wifi = sorted(wifi, key=lambda link: link.name)
        self._cellular = sorted(cellular, key=lambda link: link.name)
        self._spectrum = spectrum
        self._propagation = propagation
        self._chance = chance
        self._fixed = np.array(list(places.values()), dtype=np.float64).reshape(-1, 3)
        rows = {name: row for row, name in enumerate((*spectrum.radios, *places))}
        self._sik = SikUpdates(sik, rows)
        self._foreign = sorted(foreign, key=lambda radio: (radio.link.name, radio.transmitter.name))
        sending = [end for link in self._wifi for end in (link.station, link.aircraft)]
        sending += [radio.transmitter for radio in self._foreign]
        self._transmitters = list({id(transmitter): transmitter for transmitter in sending}.values())
        for transmitter in self._transmitters:
            transmitter.row = rows[transmitter.name]
        self._rows = np.array([t.row for t in self._transmitters], dtype=np.int64)
        self._city_busy = city_busy
        self._changes = ChannelChanges(self._wifi, chance)
        self._jammers = FollowingJammers([link.station for link in self._wifi])
        self._read_channels()
        for cellular_link in self._cellular:
            cellular_link.row = rows[cellular_link.vehicle]
        self._cells = [
            (
                np.array([rows[cell_name(link, place)] for place in range(len(link.params.base_stations))]),
                np.array([station.power_dbm for station in link.params.base_stations]),
                np.array([station.load for station in link.params.base_stations]),
            )
            for link in self._cellular
        ]
        """Of each cellular link: rows, powers and loads of its cells."""
        self._due: Time = -(2**62)
        self._refused: Counter[str] = Counter()

    def _read_channels(self) -> None:
        """Take the channels of the radios as they are."""
        self._channels = np.array([t.channel for t in self._transmitters], dtype=np.int64)
        self._reach_m = np.array(
            [max_range_m(0.0, t.power_dbm, PREAMBLE_DBM, centre_mhz(OFDM, t.channel)) for t in self._transmitters]
        )
        self._background = np.array(
            [
                self._city_busy if min(abs(t.channel - busy_channel) for busy_channel in _TRAFFIC_CHANNELS) < 2 else 0.0
                for t in self._transmitters
            ]
        )
        self._by_channel = {
            channel: [link for link in self._wifi if link.station.channel == channel]
            for channel in sorted({link.station.channel for link in self._wifi})
        }
        """Links by the channel of their access point."""
        self._foreign_by_channel = {
            channel: [radio for radio in self._foreign if radio.transmitter.channel == channel]
            for channel in sorted({radio.transmitter.channel for radio in self._foreign})
        }

    def next_wakeup(self) -> Time | None:
        """The next update."""
        return self._due

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Update every link."""
        out = Outbox()
        self._due = now + STEP_NS
        table = self._spectrum.table
        sent, frames = self._spectrum.take()
        if table is None:
            return out
        radios = RadioTable(
            table.from_ns,
            np.concatenate([table.pos_enu_m, self._fixed]),
            np.concatenate([table.vel_enu_mps, np.zeros_like(self._fixed)]),
        )
        self._update_occupancy(radios.pos_enu_m, sent)
        if self._changes.carry_out(now, out):
            self._read_channels()
        self._update_wifi(now, radios, out)
        for frame in frames:
            self._receive(frame, radios, out)
        self._update_cellular(now, radios, out)
        self._sik.update(now, radios, self._spectrum.bursts, self._propagation, out)
        return out

    # ---------------------------------------------------------------- Wi-Fi

    def _update_wifi(self, now: Time, radios: RadioTable, out: Outbox) -> None:
        bursts = self._jammers.tune(now, self._spectrum.bursts, self._propagation, radios)
        for channel, links in self._by_channel.items():
            centre = centre_mhz(OFDM, channel)
            propagation = self._propagation[centre]
            stations = np.array([link.station.row for link in links])
            aircraft = np.array([link.aircraft.row for link in links])
            gains = propagation.gains_db(radios, stations, aircraft, centre, now).tolist()
            for link, gain in zip(links, gains, strict=True):
                if link.aircraft.channel != channel:
                    gain = -math.inf
                link.to_aircraft.signal_dbm = link.station.power_dbm + gain
                link.to_station.signal_dbm = link.aircraft.power_dbm + gain
            ends = {transmitter.row for link in links for transmitter in (link.station, link.aircraft)}
            noise = NoiseAtRadios(
                bursts, propagation, radios, sorted(ends), centre_mhz=centre, width_mhz=WIDTH_MHZ, now=now
            )
            for link in links:
                link.to_aircraft.interference.bursts = noise.between(link.station, link.aircraft)
                link.to_station.interference.bursts = noise.between(link.aircraft, link.station)
            self._choose_rates(now, links)
            for link in links:
                for direction in (link.to_aircraft, link.to_station):
                    if direction.outcomes is not None and direction.snir_db(now) >= MIN_SNIR_DB[0]:
                        direction.heard_dbm = direction.signal_dbm
                worst_snir_db = min(link.to_aircraft.snir_db(now), link.to_station.snir_db(now))
                hears_beacons = success_probability(0, worst_snir_db, _BEACON_BITS) >= 0.5
                change = link.update_association(now, beacons_heard=hears_beacons)
                if change:
                    kind = "event.link_up" if link.associated else "event.link_down"
                    out.note(kind, link.name, {"channel": "wifi", "why": change})
        self._update_foreign(now, radios, bursts)

    def _update_foreign(self, now: Time, table: RadioTable, bursts: Sequence[NoiseBurst]) -> None:
        """Work out how attackers' radios and the ends of links on their channels hear each other."""
        for channel, radios in self._foreign_by_channel.items():
            centre = centre_mhz(OFDM, channel)
            propagation = self._propagation[centre]
            foreign_rows = np.array([radio.transmitter.row for radio in radios for _ in range(2)])
            end_rows = np.array([end.row for radio in radios for end in (radio.link.station, radio.link.aircraft)])
            gains = propagation.gains_db(table, foreign_rows, end_rows, centre, now).reshape(-1, 2).tolist()
            rows = sorted({*foreign_rows.tolist(), *end_rows.tolist()})
            noise = NoiseAtRadios(bursts, propagation, table, rows, centre_mhz=centre, width_mhz=WIDTH_MHZ, now=now)
            for radio, pair_gains in zip(radios, gains, strict=True):
                attacker, link = radio.transmitter, radio.link
                for end, gain, sent, heard in (
                    (link.station, pair_gains[0], radio.to_station.path, radio.from_station),
                    (link.aircraft, pair_gains[1], radio.to_aircraft.path, radio.from_aircraft),
                ):
                    if end.channel != channel:
                        gain = -math.inf
                    sent.signal_dbm, heard.signal_dbm = attacker.power_dbm + gain, end.power_dbm + gain
                    sent.interference.bursts, heard.interference.bursts = (
                        noise.between(attacker, end),
                        noise.between(end, attacker),
                    )

    def _choose_rates(self, now: Time, links: Sequence[WifiLink]) -> None:
        """Let each direction use the rate with the greatest average of rate times success, as Minstrel does."""
        directions = [direction for link in links for direction in (link.to_aircraft, link.to_station)]
        snir = np.array([direction.snir_db(now) for direction in directions])
        successes = np.empty((len(directions), len(RATES_MBPS)))
        fill_successes(snir, _PROBE_BITS, successes)
        for place, link in enumerate(links):
            of_link = successes[2 * place : 2 * place + 2]
            if link.successes is None:
                link.successes = of_link.copy()
            else:
                link.successes += _RATE_WEIGHT * (of_link - link.successes)
            best = np.argmax(link.successes * RATES_MBPS, axis=1).tolist()
            link.to_aircraft.rate, link.to_station.rate = best

    def _update_occupancy(self, pos: Floats, sent: Sequence[Transmission]) -> None:
        """How much of the last 20 ms others in reach kept each transmitter's channel busy.

        In reach is who is heard with -82 dBm in free space; walls are not counted. Of frames of the medium the power is
        not known: they count as sent with that of the radio that hears them.
        """
        if not self._transmitters:
            return
        uses = [
            (t.row, channel, t.airtime_ns, reach_m)
            for t, channel, reach_m in zip(
                self._transmitters, self._channels.tolist(), self._reach_m.tolist(), strict=True
            )
            if t.airtime_ns
        ]
        uses += [
            (transmission.radio, transmission.channel, transmission.ended_ns - transmission.started_ns, math.nan)
            for transmission in sent
        ]
        table = np.array(uses, dtype=np.float64).reshape(-1, 4)
        senders, channels = table[:, :2].astype(np.int64).T
        airtime, reach_m = table[:, 2], np.where(np.isnan(table[:, 3]), self._reach_m[:, None], table[:, 3])
        away = pos[self._rows][:, None, :] - pos[senders][None, :, :]
        near = (away * away).sum(axis=2) <= (reach_m * reach_m)
        near &= self._rows[:, None] != senders[None, :]
        near &= np.abs(self._channels[:, None] - channels[None, :]) < _OVERLAP_CHANNELS
        busy = np.minimum(matrices.multiply(near, airtime / STEP_NS), 1.0)
        busy = np.minimum(1.0 - (1.0 - busy) * (1.0 - self._background), MAX_OCCUPANCY)
        for transmitter, share in zip(self._transmitters, busy.tolist(), strict=True):
            transmitter.airtime_ns = 0
            transmitter.occupancy += _OCCUPANCY_WEIGHT * (share - transmitter.occupancy)

    def _receive(self, frame: ManagementFrame, radios: RadioTable, out: Outbox) -> None:
        """Let the links that a management frame is about receive it, or not."""
        try:
            decoded = decode_management(frame.mac_frame)
        except DecodeError:
            return
        if decoded.subtype != DEAUTHENTICATION:
            return
        for link in self._wifi:
            for direction, sender, receiver in (
                (link.to_aircraft, link.station, link.aircraft),
                (link.to_station, link.aircraft, link.station),
            ):
                if receiver.channel != frame.channel:
                    continue
                if decoded.source == sender.address and decoded.is_for(receiver.address):
                    self._deauthenticate(frame, link, direction, receiver, radios, out)

    def _deauthenticate(
        self,
        frame: ManagementFrame,
        link: WifiLink,
        direction: WifiDirection,
        receiver: Transmitter,
        radios: RadioTable,
        out: Outbox,
    ) -> None:
        """A deauthentication that claims to come from the link's other end reaches `receiver`, or does not."""
        centre = centre_mhz(OFDM, frame.channel)
        rows = np.array([frame.radio]), np.array([receiver.row])
        gain = self._propagation[centre].gains_db(radios, *rows, centre, frame.at_ns).item()
        noise_mw = direction.interference.steady_mw(frame.at_ns)
        snir_db = frame.power_dbm + gain - 10.0 * elementary.log10(noise_mw)
        heard = success_probability(0, snir_db, 8.0 * len(frame.mac_frame))
        who = hash64(f"{link.name}|{receiver.name}")
        if self._chance.uniform4("deauthentication", who, frame.at_ns, frame.ref.serial)[0] >= heard:
            return
        data: dict[str, str | float] = {"receiver": receiver.name, "rssi_dbm": round(frame.power_dbm + gain, 1)}
        if link.params.protected:
            self._refused[link.name] += 1
            count = self._refused[link.name]
            if worth_noting(count):
                out.note("event.management_frame_refused", link.name, {**data, "count": count}, (frame.ref,))
            return
        if frame.at_ns >= link.down_until:
            out.note("event.deauthenticated", link.name, data, (frame.ref,))
        link.disconnect(frame.at_ns)

    # ---------------------------------------------------------------- cellular

    def _update_cellular(self, now: Time, radios: RadioTable, out: Outbox) -> None:
        for link, (rows, cell_dbm, cell_loads) in zip(self._cellular, self._cells, strict=True):
            params = link.params
            centre = params.frequency_mhz
            propagation = self._propagation[centre]
            gains = propagation.gains_db(radios, rows, np.full(len(rows), link.row), centre, now)
            powers = cell_dbm + gains
            was = link.serving
            change = link.measure(now, powers)
            if change is not None and was != NO_CELL:
                out.note("event.handover", link.name, {"from": change[0], "to": change[1]})
            candidate = link.serving if link.serving != NO_CELL else int(np.argmax(powers))
            width = params.bandwidth_mhz
            cells_mw = cell_loads * elementwise.exp10(0.1 * powers)
            others_mw = float(cells_mw.sum() - cells_mw[candidate])
            ends = [link.row, int(rows[candidate])]
            noise = NoiseAtRadios(
                self._spectrum.bursts, propagation, radios, ends, centre_mhz=centre, width_mhz=width, now=now
            )
            down, up = link.to_aircraft.interference, link.to_station.interference
            down.noise_mw = elementary.exp10(0.1 * link.aircraft_noise_dbm) + others_mw
            down.bursts = noise.at(ends[1], ends[0])
            # the uplink uses a share of the band, and so does the noise that it meets
            up.bursts = [
                burst._replace(receiver_mw=burst.receiver_mw * params.share) for burst in noise.at(ends[0], ends[1])
            ]
            link.set_conditions(now, float(powers[candidate]), params.aircraft_dbm + float(gains[candidate]))
            change_of_state = link.monitor(now, link.to_aircraft.snir_db(now))
            if change_of_state:
                kind = "event.link_down" if change_of_state == "failure" else "event.link_up"
                out.note(kind, link.name, {"channel": "cellular", "why": change_of_state, "cell": link.cell})


def cell_name(link: CellularLink, place: int) -> str:
    """The name of a cell's radio, which addresses its shadowing: cells of the same id and place are one."""
    station = link.params.base_stations[place]
    return f"cell {station.id} {station.place}"
