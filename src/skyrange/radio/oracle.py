"""Environment oracle: takes Remote ID from `rid_up`, lets a medium decide who receives it, and delivers it.

A frame on `rid_up:<radio>` becomes a transmission of that radio at the time in its header, or at once. What a receiver
decodes is sent on its `rid_down:<radio>` with its signal strength and the end of its reception. What an operator's
ground receivers decode is sent as JSON on `oracle:<operator>`. Between two observations of the world the radios stand
where the later one saw them (20 ms, 0.4 m at 20 m/s).

Broadcasts in flight are in a ring buffer, by the keys under which the medium has them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.codec import wifi_management
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import ANY_CHANNEL, RidColumns
from skyrange.contracts.components import InstanceStatus, World
from skyrange.contracts.frames import Bytes, Payloads
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox
from skyrange.contracts.medium import ANY_CHANNEL as ANY
from skyrange.contracts.medium import (
    Heard,
    Ints,
    Medium,
    ProgramStatus,
    RadioTable,
    ReceptionOutcome,
    ReceptionRows,
    Receptions,
    Sent,
    TransmissionFate,
    TxBatch,
)
from skyrange.contracts.references import FrameRefTable
from skyrange.core.compiled import compiled
from skyrange.core.errors import DecodeError, InputError, Problem, nearest
from skyrange.core.ids import Port, link_name
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.core.whole_numbers import worth_noting
from skyrange.radio.builtin.medium import fixed_positions
from skyrange.radio.ground_receptions import MAX_RECEPTIONS, Reception, ReceptionReport, encode
from skyrange.radio.jamming import MAX_DBM, JammingBursts
from skyrange.radio.phy import MAX_BODY_BYTES, MIN_BODY_BYTES, OVERHEAD_BYTES, TRANSPORT_WAVEFORM
from skyrange.radio.spectrum import ManagementFrame, Spectrum, Transmission

WIDTH = 256
"""Bytes of the longest body of any transport, rounded up."""
KEPT_NS: Time = 2 * NS_PER_S
"""How long a broadcast is kept: it waits half a second at most, and no event lasts longer than 50 ms."""


@compiled
def _copy_bodies(data: Bytes, starts: Ints, sizes: Ints, bodies: Bytes, places: Ints) -> None:
    for row in range(starts.shape[0]):
        for offset in range(sizes[row]):
            bodies[places[row], offset] = data[starts[row] + offset]


class InFlight:
    """Broadcasts by key; keys count up from 0."""

    __slots__ = ("_bodies", "_headers", "_sizes", "next")

    def __init__(self, room: int = 256) -> None:
        """`room` is a power of two; it grows as needed."""
        self.next = 0
        # at, transport, channel, counter, address (6), the frame that brought it (number, serial)
        self._headers = np.zeros((12, room), dtype=np.int64)
        self._sizes = np.zeros(room, dtype=np.int64)
        self._bodies = np.zeros((room, WIDTH), dtype=np.uint8)

    def add(self, now: Time, rows: RidColumns, chosen: Ints, at_ns: Ints, ref: Ints, serial: Ints) -> Ints:
        """Keep some rows, which the frames (`ref`, `serial`) of a `FrameRefTable` brought; returns their keys."""
        count = len(chosen)
        keys = np.arange(self.next, self.next + count)
        self._grow(now, count)
        places = self.rows_of(keys)
        self._headers[0, places] = at_ns
        for k, column in enumerate((rows.transport, rows.channel, rows.counter)):
            self._headers[1 + k, places] = column[chosen]
        self._headers[4:10, places] = rows.address[chosen].T
        self._headers[10, places], self._headers[11, places] = ref, serial
        bodies = rows.bodies
        self._sizes[places] = bodies.sizes[chosen]
        _copy_bodies(bodies.data, bodies.starts[chosen], bodies.sizes[chosen], self._bodies, places)
        self.next += count
        return keys

    def _grow(self, now: Time, count: int) -> None:
        """Double the ring until the new keys overwrite nothing younger than `KEPT_NS`."""
        while True:
            room = len(self._sizes)
            replaced = np.arange(max(self.next - room, 0), self.next + count - room)
            if not len(replaced) or (count <= room and bool((self._headers[0, replaced % room] < now - KEPT_NS).all())):
                return
            kept_keys = np.arange(max(self.next - room, 0), self.next)
            larger = InFlight(2 * room)
            slots = kept_keys & (2 * room - 1)
            larger._headers[:, slots] = self._headers[:, kept_keys % room]
            larger._sizes[slots] = self._sizes[kept_keys % room]
            larger._bodies[slots] = self._bodies[kept_keys % room]
            self._headers, self._sizes, self._bodies = larger._headers, larger._sizes, larger._bodies

    def rows_of(self, keys: Ints) -> Ints:
        """The row of each key."""
        return keys & (len(self._sizes) - 1)

    def transport(self, keys: Ints) -> Ints:
        """The transport of each key."""
        transport: Ints = self._headers[1, self.rows_of(keys)]
        return transport

    def counter(self, keys: Ints) -> Ints:
        """The message counter of each key."""
        counter: Ints = self._headers[3, self.rows_of(keys)]
        return counter

    def address(self, keys: Ints) -> NDArray[np.uint8]:
        """(n, 6) the claimed sender address of each key."""
        return self._headers[4:10, self.rows_of(keys)].T.astype(np.uint8)

    def frames(self, keys: Ints) -> tuple[Ints, Ints]:
        """The frames that brought the broadcasts: (numbers, serials) of the `FrameRefTable`."""
        places = self.rows_of(keys)
        return self._headers[10, places], self._headers[11, places]

    def bodies(self, keys: Ints) -> Payloads:
        """The bodies, as views of the ring."""
        places = self.rows_of(keys)
        return Payloads(self._bodies.reshape(-1), places * WIDTH, self._sizes[places])


ENDPOINT = "oracle"
STEP_NS: Time = 20 * NS_PER_MS
MAX_AHEAD_NS: Time = 100 * NS_PER_MS
"""A radio holds a frame until the time in its header, but no longer than this."""
_WIFI = (link_payload.Transport.WIFI_BEACON, link_payload.Transport.WIFI_NAN)
_WHY_NOT_SENT = {
    TransmissionFate.NO_ACCESS: "no access",
    TransmissionFate.REFUSED: "no such frame",
    TransmissionFate.LOST: "no radio engine",
}


class Oracle:
    """The agent that owns the medium (`skyrange.contracts.components.Agent`).

    `losses` of its medium counts what was not received, by reason; `refused` counts what could not be sent.
    """

    name = ENDPOINT
    service_ns: Time = STEP_NS
    observe_period_ns: Time = STEP_NS

    def __init__(
        self,
        medium: Medium,
        senders: Sequence[str],
        receivers: Sequence[str],
        grounds: Mapping[str, str] | None = None,
        *,
        recording: bool = False,
        spectrum: Spectrum | None = None,
    ) -> None:
        """Connect radios by name: `senders` have a `rid_up`, `receivers` a `rid_down`; `grounds` maps receivers to
        operators.

        `recording` keeps receptions for `drain_receptions`. `spectrum` is told what is on the air.

        Raises `InputError` for a name that no radio has.
        """
        rows = {radio.name: row for row, radio in enumerate(medium.radios)}
        grounds = grounds or {}
        unknown = sorted({*senders, *receivers, *grounds} - rows.keys())
        if unknown:
            raise InputError(
                ENDPOINT, [Problem("radio", name, "a radio of the medium", nearest(name, rows)) for name in unknown]
            )
        self.medium = medium
        up_ports = [Port(ENDPOINT, link_name("rid_up", name)) for name in senders]
        down_ports = [Port(ENDPOINT, link_name("rid_down", name)) for name in receivers]
        self._operators = sorted(set(grounds.values()))
        self.ports: Sequence[Port] = (
            *up_ports,
            *down_ports,
            *(Port(ENDPOINT, link_name("oracle", o)) for o in self._operators),
        )
        self._places = {port: place for place, port in enumerate(self.ports)}
        self._sender = np.full(len(self.ports), -1, dtype=np.int64)
        self._sender[: len(up_ports)] = [rows[name] for name in senders]
        self._down = np.full(len(rows), -1, dtype=np.int64)
        self._down[[rows[name] for name in receivers]] = np.arange(len(up_ports), len(up_ports) + len(down_ports))
        self._ground = {rows[name]: operator for name, operator in grounds.items()}
        self._in_flight = InFlight()
        self._table = fixed_positions(medium.radios)
        self._moving: tuple[Ints, Ints] | None = None
        self._last: Time | None = None
        self._refs = FrameRefTable()
        self._jamming = JammingBursts()
        self._spectrum = spectrum
        if spectrum is not None:
            spectrum.radios = [radio.name for radio in medium.radios]
        self.hears: NDArray[np.bool_] | None = None
        """(radios,) whose receptions are delivered, reported and kept, where others deliver the rest; None for all."""
        self._recording = recording
        self._drained: list[ReceptionRows] = []
        self._deaths: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        """Frames that never became transmissions, by reason."""

    def observe(self, now: Time, world: World) -> None:
        """Observe the positions at a tick of the world; called before the steps of that instant."""
        if self._moving is None:
            rows = {radio.name: row for row, radio in enumerate(self.medium.radios) if radio.place_enu_m is None}
            pairs = [(rows[name], at) for at, name in enumerate(world.vehicles) if name in rows]
            moving = np.array(pairs, dtype=np.int64).reshape(-1, 2)
            self._moving = (moving[:, 0], moving[:, 1])
        position, velocity = world.motion()
        radio_rows, vehicle_rows = self._moving
        pos, vel = self._table.pos_enu_m.copy(), self._table.vel_enu_mps.copy()
        pos[radio_rows], vel[radio_rows] = position[vehicle_rows], velocity[vehicle_rows]
        self._table = RadioTable(now, pos, vel)
        if self._spectrum is not None:
            self._spectrum.table = self._table

    def next_wakeup(self) -> Time | None:
        """The next step while anything is on the air; otherwise arriving frames wake it."""
        return None if self.medium.quiet or self._last is None else self._last + self.service_ns

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Transmit what arrived, let time pass, and deliver the receptions."""
        outbox = Outbox()
        if len(inbox):
            self._offer(now, inbox, outbox)
        on_air = self.medium.advance(now, self._table)
        self._last = now
        if self._spectrum is not None:
            self._tell_of_airtime(self._spectrum, on_air.sent)
        if on_air.sent.fate.any():
            for fate in on_air.sent.fate[on_air.sent.fate > 0].tolist():
                self.refused[_WHY_NOT_SENT[TransmissionFate(fate)]] += 1
        for program in self.medium.programs:
            if len(program.ended) > self._deaths[program.name]:
                self._tell_of_death(program, int((on_air.sent.fate == TransmissionFate.LOST).sum()), outbox)
        heard = on_air.heard
        if self.hears is not None:
            rows = np.flatnonzero(self.hears[heard.radio])
            heard = _take(heard, rows)
        if len(heard.key):
            self._tell(heard, outbox)
        return outbox

    def _tell_of_airtime(self, spectrum: Spectrum, sent: Sent) -> None:
        """Pass on the Wi-Fi frames that were sent."""
        wifi = np.isin(self._in_flight.transport(sent.key), _WIFI) & (sent.fate == TransmissionFate.SENT)
        for _, radio, channel, start, end, _ in zip(*(column[wifi].tolist() for column in sent), strict=True):
            spectrum.add_transmission(Transmission(radio, channel, start, end))

    def _tell_of_death(self, program: ProgramStatus, lost: int, outbox: Outbox) -> None:
        """Note that a program of the medium ended, and whether another one has taken its place."""
        self._deaths[program.name] = len(program.ended)
        outbox.note("event.engine_dead", program.name, {"was": "ready", "why": program.ended[-1], "lost": lost})
        if program.state is InstanceStatus.READY:
            outbox.note("event.engine_ready", program.name, {"was": "dead"})

    def _offer(self, now: Time, inbox: Inbox, outbox: Outbox) -> None:
        columns = inbox.columns(self._places)
        rows = link_payload.unpack_rows(columns.payloads)
        sender = self._sender[columns.places]
        kind = rows.transport.astype(np.int64)
        size = rows.bodies.sizes
        is_valid = rows.valid & (sender >= 0)
        fits = is_valid & (size >= MIN_BODY_BYTES[kind]) & (size <= MAX_BODY_BYTES[kind])
        chosen = np.flatnonzero(fits)
        for row in np.flatnonzero(~fits).tolist():
            if sender[row] >= 0 and self._take_request(now, sender.item(row), inbox.arrival(columns.order.item(row))):
                continue
            reason = (
                "not a broadcast" if not rows.valid[row] else "not for the air" if not is_valid[row] else "does not fit"
            )
            self.refused[reason] += 1
            count = self.refused[reason]
            if worth_noting(count):
                about = self.ports[columns.places.item(row)].link
                ref = inbox.arrival(columns.order.item(row)).ref
                outbox.note("event.bad_broadcast", ENDPOINT, {"link": about, "why": reason, "count": count}, (ref,))
        if self._jamming.changed:
            # from where the medium stands: what was ordered since then begins when the order came, not at this step
            since = now - self.service_ns if self._last is None else self._last
            self.medium.emit(since, self._jamming.emitters(since))
            if self._spectrum is not None:
                self._spectrum.bursts = self._jamming.bursts()
        if not len(chosen):
            return
        at = columns.at_ns[chosen] if self._last is None else np.maximum(columns.at_ns[chosen], self._last + 1)
        requested_ns = rows.time_ns[chosen]
        at = np.where((requested_ns > at) & (requested_ns <= at + MAX_AHEAD_NS), requested_ns, at)
        keys = self._in_flight.add(now, rows, chosen, at, *self._refs.read(inbox, columns.order[chosen]))
        kind, channel = kind[chosen], rows.channel[chosen].astype(np.int64)
        channel[channel == ANY_CHANNEL] = ANY
        self.medium.offer(
            now,
            TxBatch(
                sender[chosen],
                at,
                TRANSPORT_WAVEFORM[kind],
                channel,
                np.full(len(keys), np.nan),
                size[chosen] + OVERHEAD_BYTES[kind],
                keys,
            ),
        )

    def _take_request(self, now: Time, radio: int, arrival: Arrival) -> bool:
        """Take an attacker's request for noise, or for a management frame; `False` for any other payload."""
        if self._jamming.request(now, radio, arrival.at, arrival.payload):
            return True
        if self._spectrum is None:
            return False
        try:
            request = wifi_management.unpack_request(arrival.payload)
        except DecodeError:
            return False
        power_dbm = request.power_cdbm / 100.0
        if power_dbm > MAX_DBM:
            return False
        frame = ManagementFrame(radio, arrival.at, request.channel, power_dbm, request.mac_frame, arrival.ref)
        self._spectrum.add_management_frame(frame)
        return True

    def _tell(self, heard: Heard, outbox: Outbox) -> None:
        if self._recording:
            self._keep(heard)
        if (heard.outcome != ReceptionOutcome.DECODED).any():  # a medium that tells of every pair
            heard = _take(heard, np.flatnonzero(heard.outcome == ReceptionOutcome.DECODED))
        place = self._down[heard.radio]
        rows = np.flatnonzero(place >= 0)
        if len(rows):
            keys = heard.key[rows]
            payloads = link_payload.pack_rows(
                transport=self._in_flight.transport(keys),
                channel=heard.channel[rows],
                counter=self._in_flight.counter(keys),
                address=self._in_flight.address(keys),
                rssi_cdbm=np.clip(np.round(heard.rssi_dbm[rows] * 100.0), -32767, 32767),
                time_ns=heard.ended_ns[rows],
                bodies=self._in_flight.bodies(keys),
            )
            outbox.send_block(place[rows], payloads, self._refs.parents(*self._in_flight.frames(keys)))
        if self._ground:
            self._report(heard, outbox)

    def _keep(self, heard: Heard) -> None:
        number, serial = self._in_flight.frames(heard.key)
        self._drained.append(
            ReceptionRows(
                time_ns=heard.ended_ns,
                number=number,
                serial=serial,
                radio=heard.radio,
                place_enu_m=self._table.pos_enu_m[heard.radio],
                transport=self._in_flight.transport(heard.key),
                channel=heard.channel,
                rssi_dbm=heard.rssi_dbm,
                snir_db=heard.snir_db,
                outcome=heard.outcome,
            )
        )

    def _report(self, heard: Heard, outbox: Outbox) -> None:
        """Send operators what their ground receivers decoded."""
        reports: dict[str, list[Reception]] = {operator: [] for operator in self._operators}
        for row, radio in enumerate(heard.radio.tolist()):
            operator = self._ground.get(radio)
            if operator is None:
                continue
            key = heard.key[row : row + 1]
            reports[operator].append(
                Reception(
                    receiver=self.medium.radios[radio].name,
                    time_ns=int(heard.ended_ns[row]),
                    transport=int(self._in_flight.transport(key)[0]),
                    channel=int(heard.channel[row]),
                    counter=int(self._in_flight.counter(key)[0]),
                    rssi_dbm=round(float(heard.rssi_dbm[row]), 2),
                    address=self._in_flight.address(key).tobytes().hex(),
                    body=self._in_flight.bodies(key)[0].hex(),
                )
            )
        for operator, receptions in reports.items():
            port = Port(ENDPOINT, link_name("oracle", operator))
            for start in range(0, len(receptions), MAX_RECEPTIONS):
                outbox.send(port, encode(ReceptionReport(body=tuple(receptions[start : start + MAX_RECEPTIONS]))))

    def close(self) -> None:
        """End the medium; again does nothing."""
        self.medium.close()

    def drain_receptions(self) -> Receptions | None:
        """The receptions since the last call, if `recording`; None if there are none."""
        parts, self._drained = self._drained, []
        if not parts:
            return None
        rows = ReceptionRows(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        return Receptions(self._refs.names, [radio.name for radio in self.medium.radios], rows)


def _take(heard: Heard, rows: Ints) -> Heard:
    """Some of the outcomes."""
    columns: list[Any] = [column[rows] for column in heard]
    return Heard(*columns)
