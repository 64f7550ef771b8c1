"""Remote ID transmitter: broadcasts made of the autopilot's belief, for many aircraft at once.

Every element is the last value that the aircraft's autopilot reported; its time mark is the time of that value. When
the autopilot falls silent the last position is still broadcast, with its old time mark, under the status "Remote ID
system failure". An autopilot with Open Drone ID makes the Location itself, and that Location is broadcast unchanged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.f3411 import (
    EPOCH_2019_S,
    BasicId,
    DescriptionType,
    Message,
    MessageType,
    OperatorId,
    OperatorLocationType,
    SelfId,
    Status,
    System,
    decode,
    encode,
    values,
)
from skyrange.codec.f3411.columns import (
    CODES,
    NUMBERS,
    Bodies,
    encode_locations,
    pack_bodies,
    single_bodies,
    stack_messages,
)
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.remote_id.link_payload import ANY_CHANNEL, NO_RSSI, Transport
from skyrange.codec.remote_id.link_payload import pack_rows as link_rows
from skyrange.contracts.frames import Ints, Payloads
from skyrange.core import elementary
from skyrange.core.chance import Chance
from skyrange.core.compiled import compiled
from skyrange.core.ids import hash64
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, Time
from skyrange.remoteid.autopilot_belief import Beliefs, clock_us, is_fresh, utc_us
from skyrange.remoteid.broadcast_profiles import Broadcast, BroadcastCycle, broadcast_cycle, sender_address

if TYPE_CHECKING:  # its imports are slow, and only authenticated broadcasts need them
    from skyrange.remoteid.drip.broadcasts import AuthenticationPages

PHASE_STREAM: Final = "remoteid.phase"
LEAD_NS: Final[Time] = 50 * NS_PER_MS
"""How long before its time a broadcast is handed to the radio, which sends it by its own clock, as Wi-Fi sends beacons
(IEEE 802.11-2020, 11.1.3.2): a program that polls late does not delay a broadcast."""
POSITION_TIMEOUT_NS: Final[Time] = 2 * NS_PER_S
"""An older position counts as missing: telemetry at 1 Hz, and one report lost."""
HEARTBEAT_TIMEOUT_NS: Final[Time] = 5 * NS_PER_S
"""Silence after which the autopilot counts as lost (mavlink.io, heartbeat: four or five missed)."""
GNSS_TIMEOUT_NS: Final[Time] = 5 * NS_PER_S
_TIMESTAMP: Final = slice(20, 24)
"""The bytes of the time in a System message (F3411-22a, System message)."""
_MAX_SLOTS: Final = 4096
_KINDS: Final = 8
"""Message counters: one per transport, and for Bluetooth 4 one per message type."""


_GROUND, _AIRBORNE, _EMERGENCY = int(Status.GROUND), int(Status.AIRBORNE), int(Status.EMERGENCY)
_FAILURE: Final = int(Status.REMOTE_ID_SYSTEM_FAILURE)
_ACTIVE, _CRITICAL = int(mav.MAV_STATE_ACTIVE), int(mav.MAV_STATE_CRITICAL)
_HORIZONTAL, _VERTICAL, _SPEED = (
    np.array([-1.0 if limit is None else limit for limit in table])
    for table in (values.HORIZONTAL_ACCURACY_M, values.VERTICAL_ACCURACY_M, values.SPEED_ACCURACY_MPS)
)
"""By code: the error is below this; -1: no error has this code."""


class Broadcaster:
    """The Remote ID transmitters of many aircraft. Deep-copyable; the broadcasts of an aircraft depend on no other
    aircraft.
    """

    def __init__(self, broadcasts: Sequence[Broadcast], chance: Chance) -> None:
        """`chance` spreads the aircraft within the second."""
        self.broadcasts = tuple(broadcasts)
        count = len(self.broadcasts)
        cycles = [broadcast_cycle(broadcast) for broadcast in self.broadcasts]
        self.cycles: list[BroadcastCycle] = sorted(set(cycles), key=repr)
        numbers = {cycle: number for number, cycle in enumerate(self.cycles)}
        self._cycle = np.array([numbers[cycle] for cycle in cycles], dtype=np.int64)
        self._slot = np.zeros(count, dtype=np.int64)
        phase = [int(chance.uniform4(PHASE_STREAM, hash64(b.vehicle), 0)[0] * NS_PER_S) for b in self.broadcasts]
        self._begin_ns = np.array(phase, dtype=np.int64)
        """When the current cycle began."""
        self.due_ns: Ints = np.array(
            [
                begin + cycle.slots[0].offset_ns if cycle.slots else NEVER
                for begin, cycle in zip(phase, cycles, strict=True)
            ],
            dtype=np.int64,
        )
        """(n,) when each aircraft broadcasts next."""
        self._counters = np.zeros((count, 2 * _KINDS), dtype=np.uint8)
        raw = b"".join(sender_address(broadcast.vehicle) for broadcast in self.broadcasts)
        self.addresses = np.frombuffer(raw, dtype=np.uint8).reshape(count, 6).copy()
        self._static: dict[int, Bodies] = {
            int(MessageType.BASIC_ID): stack_messages(
                [encode(BasicId(b.id_type, b.ua_type, b.id)) for b in self.broadcasts]
            ),
            int(MessageType.OPERATOR_ID): stack_messages(
                [encode(OperatorId(0, b.operator_id)) for b in self.broadcasts]
            ),
            int(MessageType.SELF_ID): stack_messages(
                [encode(SelfId(DescriptionType.TEXT, b.text)) for b in self.broadcasts]
            ),
        }
        self._system = stack_messages([encode(_system(b)) for b in self.broadcasts]).copy()
        self._fixed = np.array([b.operator_place is not None for b in self.broadcasts], dtype=np.bool_)
        self.autopilot_location = np.array([b.autopilot_location for b in self.broadcasts], dtype=np.bool_)
        """(n,) whether the autopilot makes the Location, and so has to be told identity, operator
        location and status."""
        self._takeoff = np.zeros((count, 4))
        """Latitude, longitude and height of the take-off in the System message; the last column is 1 once it is set."""
        self._pages = _authentication(self.broadcasts)

    def next_due(self) -> Time | None:
        """When `send` has to be called next."""
        due = int(self.due_ns.min(initial=NEVER))
        if self._pages is not None:
            due = min(due, self._pages.next_ns)
        return None if due == NEVER else due - LEAD_NS

    def send(self, now: Time, beliefs: Beliefs) -> tuple[Ints, Payloads] | None:
        """The broadcasts due within `LEAD_NS`: rows of the aircraft and their `rid_up` payloads; None if there are
        none.

        An aircraft whose autopilot was never heard counts as not powered yet, and sends nothing.
        """
        table = beliefs.table
        places: list[Ints] = []
        payloads: list[Payloads] = []
        until = now + LEAD_NS
        due = np.flatnonzero(self.due_ns < until)
        self._update_takeoff(due, table)
        while due.size:
            key = self._cycle[due] * _MAX_SLOTS + self._slot[due]
            for code in np.unique(key).tolist():
                rows = due[key == code]
                cycle = self.cycles[code // _MAX_SLOTS]
                at_ns = self.due_ns[rows]
                self._advance(rows, cycle, now)
                on = table["heartbeat_ns"][rows] >= 0
                rows, at_ns = rows[on], at_ns[on]
                if rows.size:
                    _, transport, messages = cycle.slots[code % _MAX_SLOTS]
                    places.append(rows)
                    payloads.append(self._frames(rows, at_ns, transport, messages, now, table))
            due = np.flatnonzero(self.due_ns < until)
        if self._pages is not None:
            self._send_pages(self._pages, now, clock_us(table, now), places, payloads)
        return (np.concatenate(places), Payloads.join(payloads)) if places else None

    def _send_pages(
        self, pages: AuthenticationPages, now: Time, clocks_us: Ints, places: list[Ints], payloads: list[Payloads]
    ) -> None:
        """Sign what was sent, and send the authentication pages that are due."""
        pages.sign(now, clocks_us, self.due_ns)
        for row, at_ns, transport, counter, body in pages.take(now, now + LEAD_NS):
            if transport != Transport.BT4:
                counter = self._counters.item(row, transport)
                self._counters[row, transport] += 1
            places.append(np.array([row], dtype=np.int64))
            payloads.append(
                link_rows(
                    transport=transport,
                    channel=ANY_CHANNEL,
                    counter=counter,
                    address=self.addresses[row : row + 1],
                    rssi_cdbm=NO_RSSI,
                    time_ns=at_ns,
                    bodies=Payloads.of([body]),
                )
            )

    def _advance(self, rows: Ints, cycle: BroadcastCycle, now: Time) -> None:
        """Move aircraft that have just sent to their next slot; one that is late by a period skips the missed
        broadcasts.
        """
        offsets = np.array([part.offset_ns for part in cycle.slots], dtype=np.int64)
        slot = (self._slot[rows] + 1) % len(offsets)
        begin = self._begin_ns[rows] + np.where(slot == 0, cycle.period_ns, 0)
        late = now - begin - offsets[slot]
        begin += np.where(late >= cycle.period_ns, (late // cycle.period_ns + 1) * cycle.period_ns, 0)
        self._slot[rows], self._begin_ns[rows], self.due_ns[rows] = slot, begin, begin + offsets[slot]

    def _frames(
        self, rows: Ints, at_ns: Ints, transport: int, messages: tuple[int, ...], now: Time, table: Any
    ) -> Payloads:
        parts = [self._message(kind, rows, now, table) for kind in messages]
        single = transport == Transport.BT4
        bodies = single_bodies(parts[0]) if single else pack_bodies(parts)
        column = _KINDS + messages[0] if single else transport
        counter = self._counters[rows, column].copy()
        self._counters[rows, column] += 1
        if self._pages is not None:
            for place, row in enumerate(rows.tolist()):
                self._pages.sent(row, at_ns.item(place), bodies[place])
        return link_rows(
            transport=transport, channel=ANY_CHANNEL, counter=counter, address=self.addresses[rows],
            rssi_cdbm=NO_RSSI, time_ns=at_ns, bodies=bodies,
        )  # fmt: skip

    def _message(self, kind: int, rows: Ints, now: Time, table: Any) -> Bodies:
        if kind == MessageType.LOCATION:
            return encode_location_messages(table[rows], now, self.autopilot_location[rows])
        if kind == MessageType.SYSTEM:
            bodies = self._system[rows]
            beliefs = table[rows]
            seconds = np.maximum(utc_us(beliefs, beliefs["boot_ms"]) // 1_000_000 - EPOCH_2019_S, 0)
            bodies[:, _TIMESTAMP] = seconds.astype("<u4").view(np.uint8).reshape(-1, 4)
            return bodies
        return self._static[kind][rows]

    def identity_messages(self, rows: Ints, now: Time, beliefs: Beliefs) -> list[tuple[Message, Message]]:
        """The Basic ID and System of some aircraft, as they broadcast them now."""
        self._update_takeoff(rows, beliefs.table)
        basic, system = (
            self._message(int(kind), rows, now, beliefs.table) for kind in (MessageType.BASIC_ID, MessageType.SYSTEM)
        )
        return [
            (decode(basic_body.tobytes()), decode(system_body.tobytes()))
            for basic_body, system_body in zip(basic, system, strict=True)
        ]

    def _update_takeoff(self, rows: Ints, table: Any) -> None:
        """Without a given control station, set the take-off location in the System message once the home position is
        known.
        """
        rows = rows[~self._fixed[rows] & (table["home_ns"][rows] >= 0) & ~np.isnan(table["geoid_m"][rows])]
        beliefs = table[rows]
        home = np.column_stack(
            (
                beliefs["home_lat_e7"] * 1e-7,
                beliefs["home_lon_e7"] * 1e-7,
                beliefs["home_msl_m"] + beliefs["geoid_m"],
                rows >= 0,
            )
        )
        # the receiver's heights fluctuate: half a metre, the resolution, is not another position
        moved = (np.abs(home - self._takeoff[rows]) > (1e-7, 1e-7, 0.5, 0.5)).any(axis=1)
        for row, (lat, lon, alt, _) in zip(rows[moved].tolist(), home[moved].tolist(), strict=True):
            self._takeoff[row] = (lat, lon, alt, 1.0)
            if abs(lat) <= 90.0 and abs(lon) <= 180.0:
                self._system[row] = stack_messages([encode(System(OperatorLocationType.TAKEOFF, lat, lon, alt))])[0]

    def arm_status(self, now: Time, beliefs: Beliefs) -> Ints:
        """(n,) why each aircraft's Remote ID is not serviceable (14 CFR 89.310(c)): an index into
        `ARM_STATUS_TEXTS`.
        """
        table = beliefs.table
        placed = is_fresh(table["position_ns"], now, POSITION_TIMEOUT_NS)
        high, timed = ~np.isnan(table["geoid_m"]), utc_us(table, table["boot_ms"]) >= 0
        rows = np.flatnonzero(self.autopilot_location & is_fresh(table["location_ns"], now, POSITION_TIMEOUT_NS))
        if rows.size:  # they broadcast the autopilot's own Location
            lacks = np.isnan(table["location_numbers"][rows])
            placed[rows], high[rows], timed[rows] = (~lacks[:, NUMBERS.index(name)] for name in _NEEDED)
        sets = [
            self.due_ns == NEVER,
            ~is_fresh(table["heartbeat_ns"], now, HEARTBEAT_TIMEOUT_NS),
            ~placed,
            ~is_fresh(table["gnss_ns"], now, GNSS_TIMEOUT_NS) | (table["fix"] < mav.GPS_FIX_TYPE_3D_FIX),
            ~high,
            ~timed,
            ~self._fixed & (table["home_ns"] < 0),
        ]
        return np.select(sets, range(1, len(ARM_STATUS_TEXTS)), 0)


_NEEDED: Final = ("lat_deg", "alt_geo_m", "timestamp_s")
"""What a Location made by the autopilot must contain."""
ARM_STATUS_TEXTS: Final = (
    "",
    "no transmitter",
    "autopilot silent",
    "LOC: no position",
    "LOC: no 3D fix",
    "LOC: no ellipsoid height",
    "LOC: no time",
    "OP_LOC: no operator location",
)
"""The texts of OPEN_DRONE_ID_ARM_STATUS, the first that applies."""


def _authentication(broadcasts: Sequence[Broadcast]) -> AuthenticationPages | None:
    """The senders of authentication pages; `None` if no aircraft has a key."""
    if all(broadcast.credentials is None for broadcast in broadcasts):
        return None
    from skyrange.remoteid.drip.broadcasts import AuthenticationPages

    return AuthenticationPages(broadcasts)


def _system(broadcast: Broadcast) -> System:
    if broadcast.operator_place is None:
        return System(OperatorLocationType.TAKEOFF)
    return System(OperatorLocationType.FIXED, *broadcast.operator_place)


def encode_location_messages(beliefs: Any, now: Time, autopilot_location: NDArray[np.bool_]) -> Bodies:
    """(n, 25) Location messages of beliefs (rows of `BELIEF_DTYPE`).

    For rows with `autopilot_location` the autopilot's own Location is used as long as it sends one.
    """
    numbers, codes = np.empty((len(NUMBERS), len(beliefs))), np.empty((len(CODES), len(beliefs)), dtype=np.uint8)
    _location_values(beliefs, utc_us(beliefs, beliefs["boot_ms"]), now, numbers, codes)
    if autopilot_location.any():
        from_autopilot = autopilot_location & is_fresh(beliefs["location_ns"], now, POSITION_TIMEOUT_NS)
        numbers[:, from_autopilot], codes[:, from_autopilot] = (
            beliefs["location_numbers"][from_autopilot].T,
            beliefs["location_codes"][from_autopilot].T,
        )
    return encode_locations(numbers, codes)


@compiled
def _location_values(beliefs: Any, utc: Ints, now: int, numbers: NDArray[np.float64], codes: NDArray[np.uint8]) -> None:
    """Fill the columns of `encode_locations`."""
    for i in range(beliefs.shape[0]):
        row = beliefs[i]
        numbers[:, i] = math.nan
        codes[:, i] = 0
        lost = (
            row.heartbeat_ns < 0
            or now - row.heartbeat_ns > HEARTBEAT_TIMEOUT_NS
            or row.position_ns < 0
            or now - row.position_ns > POSITION_TIMEOUT_NS
        )
        # a failsafe (MAV_STATE_CRITICAL) or worse of an armed aircraft is an emergency; ACTIVE is in the air
        status = _GROUND
        if row.armed == 1 and row.state >= _ACTIVE:
            status = _EMERGENCY if row.state >= _CRITICAL else _AIRBORNE
        codes[0, i] = _FAILURE if lost else status
        codes[2, i] = _accuracy(_HORIZONTAL, row.h_acc_m)
        codes[3, i] = _accuracy(_VERTICAL, row.v_acc_m)
        codes[5, i] = _accuracy(_SPEED, row.vel_acc_mps)
        codes[6, i] = 1 if utc[i] >= 0 else 0  # 0.1 s, the resolution: its clock is set by GNSS
        if row.position_ns < 0:
            continue
        numbers[0, i], numbers[1, i] = row.lat_e7 * 1e-7, row.lon_e7 * 1e-7
        numbers[2, i], numbers[4, i] = row.alt_msl_m + row.geoid_m, row.above_home_m
        speed = math.sqrt(row.vel_e * row.vel_e + row.vel_n * row.vel_n)
        numbers[5, i], numbers[6, i] = speed, -row.vel_d
        if speed >= 0.125:  # half a step of the speed: no course at rest
            degrees = elementary.atan2(row.vel_e, row.vel_n) * (180.0 / math.pi)
            numbers[7, i] = degrees + 360.0 if degrees < 0.0 else degrees
        if utc[i] >= 0:
            numbers[8, i] = (utc[i] % 3_600_000_000) * 1e-6


@compiled
def _accuracy(limits: NDArray[np.float64], error: float) -> int:
    """`values.accuracy_code`; 0 for an unknown error."""
    code = 0
    for place in range(limits.shape[0]):
        if error < limits[place]:
            code = place
    return code
