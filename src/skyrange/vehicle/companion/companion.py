"""Companion computers of many aircraft as one agent: it broadcasts, receives and avoids.

It receives `rid_data` (the autopilot's reports) and `rid_down` (broadcasts of others), broadcasts on `rid_up`, and
commands its autopilot on `log`, where it only sends: frames between ground station and autopilot are forwarded there
by a route.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.f3411 import printable_id
from skyrange.codec.f3411.columns import decode_locations
from skyrange.codec.mavlink import Message, Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import SignedConnection, SignedConnections, SigningKey
from skyrange.codec.remote_id.link_payload import RidHeader, pack, unpack_rows
from skyrange.codec.remote_id.open_drone_id import to_mavlink
from skyrange.contracts.alerts import Scalar
from skyrange.contracts.frames import Ints, Payloads
from skyrange.contracts.mailboxes import Columns, Inbox, Outbox
from skyrange.contracts.references import FrameRefTable
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.ids import FrameId, Port, endpoint, link_name
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.core.whole_numbers import has_one_worth_noting
from skyrange.remoteid.autopilot_belief import Beliefs, clock_us, is_fresh
from skyrange.remoteid.broadcast_profiles import Broadcast
from skyrange.remoteid.broadcaster import (
    ARM_STATUS_TEXTS,
    HEARTBEAT_TIMEOUT_NS,
    LEAD_NS,
    POSITION_TIMEOUT_NS,
    Broadcaster,
)
from skyrange.remoteid.tracks import ReceivedBroadcasts, TrackSnapshot, TrackTable
from skyrange.vehicle.avoidance.conflicts import detect_conflicts
from skyrange.vehicle.avoidance.contract import Avoidance, AvoidanceDecision, Own, Tracks, Vector
from skyrange.vehicle.avoidance.none import NoAvoidance
from skyrange.vehicle.companion import autopilot_commands
from skyrange.vehicle.companion.autopilot_commands import MessageRequests
from skyrange.vehicle.companion.control_handover import CompanionCommand, ControlHandover, ControlState
from skyrange.vehicle.companion.range_reports import RangeReports
from skyrange.vehicle.landing.emergency import LandingRules
from skyrange.vehicle.landing.landings import EmergencyLandings
from skyrange.vehicle.sight.fusion import AircraftSight, Fusion
from skyrange.vehicle.sight.scan_reader import ScanReader
from skyrange.vehicle.sight.witness import Sight

if TYPE_CHECKING:  # its imports are slow, and only receivers that verify need them
    from skyrange.remoteid.drip.verification.verdicts import Verification
if TYPE_CHECKING:  # its imports are slow, and only receivers that verify need them
    from skyrange.optics.ray_index import RayIndex
    from skyrange.remoteid.drip.verification.verifier import Verifier


@dataclass(frozen=True, slots=True)
class CompanionSpec:
    """One aircraft: its MAVLink system id, what it broadcasts, and how it avoids others (None: not at all)."""

    vehicle: str
    system_id: int
    broadcast: Broadcast
    avoidance: Avoidance | None = None
    cruise_mps: float = 10.0
    """The mission's ground speed, kept during and after avoidance."""
    signing_key: SigningKey | None = field(default=None, repr=False)
    """The autopilot's key, if its MAVLink is signed: the companion signs its commands and verifies what it receives."""
    verification: Verification | None = None
    """How it verifies the Remote ID of others; None: not at all."""
    sight: Sight | None = None
    """Its sensors, whose scans it receives; None without any."""
    fusion: Fusion = Fusion.RADIO
    """What it avoids."""
    landing: LandingRules | None = None
    """How it lands in an emergency; None: as its autopilot does."""


SERVICE_NS: Final[Time] = LEAD_NS
"""Its own program runs at 20 Hz; what it forwards is handled by a route, more often."""
CHECK_NS: Final[Time] = 250 * NS_PER_MS
"""Interval of the search for conflicts."""
MIN_HEIGHT_M: Final = 5.0
"""Below this height above home, during take-off and landing, it does not interfere."""
GOAL_TIMEOUT_NS: Final[Time] = 5 * NS_PER_S
"""A goal that was not reported again for this long is dropped."""
LINK_ID: Final = 0
"""Link id of its signatures: it has one MAVLink connection."""
_SIDES: Final = 3  # rid_data, rid_up, rid_down
_COUNTS: Final = ("event.tracks_refused", "event.tracks_displaced", "event.tracks_impossible", "event.bad_frame")
"""What is counted, and noted at 1, 2, 4, 8 …, so that a flood does not fill the record."""


class Companion:
    """The agent (contract: `contracts.components.Agent`). Deep copies continue alike."""

    service_ns: Time = SERVICE_NS

    def __init__(
        self,
        name: str,
        specs: Sequence[CompanionSpec],
        origin: Origin,
        chance: Chance,
        city: RayIndex | None = None,
        range_reports: RangeReports | None = None,
    ) -> None:
        """`chance` spreads the broadcasts of different aircraft within the second, and is used for nothing else.

        `city` is the map by which sensors are told what is a building; it is needed with sensors. `range_reports`
        are what it tells the autopilots of them.
        """
        self.name = name
        self.specs = tuple(specs)
        count = len(self.specs)
        ports = [
            Port(endpoint(spec.vehicle, "companion"), link_name(kind, spec.vehicle))
            for spec in self.specs
            for kind in ("rid_data", "rid_up", "rid_down")
        ]
        self._range_reports = range_reports
        self._scan_rows = [row for row, spec in enumerate(self.specs) if spec.sight is not None]
        scanned = [self.specs[row].vehicle for row in self._scan_rows]
        self.ports: Sequence[Port] = [
            *ports,
            *(Port(endpoint(vehicle, "companion"), link_name("scan", vehicle)) for vehicle in scanned),
        ]
        self.originates: Sequence[Port] = [
            Port(endpoint(s.vehicle, "companion"), link_name("log", s.vehicle)) for s in self.specs
        ]
        """Ports on which it sends without receiving."""
        self._places = {port: place for place, port in enumerate(self.ports)}
        signed = [
            SignedConnection(spec.vehicle, spec.signing_key, self.ports[place * _SIDES], self.originates[place])
            for place, spec in enumerate(self.specs)
            if spec.signing_key is not None
        ]
        self._signed = SignedConnections(self.ports, signed, LINK_ID, "event.signature_refused") if signed else None
        self._origin = origin
        self._packers = [Packer(spec.system_id, autopilot_commands.COMPONENT) for spec in self.specs]
        self._beliefs = Beliefs(np.array([spec.system_id for spec in self.specs], dtype=np.int64), origin.geoid_m)
        self._broadcaster = Broadcaster([spec.broadcast for spec in self.specs], chance)
        self.tracks = TrackTable(count, origin)
        self._refs = FrameRefTable()
        self._own_addresses = [address.tobytes() for address in self._broadcaster.addresses]
        self._own_ids = [spec.broadcast.id.encode("latin-1") for spec in self.specs]
        self.verifier = _verifier(self.specs)
        """Verdicts on senders; None if no aircraft verifies."""
        avoids = [spec.avoidance is not None and not isinstance(spec.avoidance, NoAvoidance) for spec in self.specs]
        self._avoids = np.array(avoids, dtype=np.bool_)
        self._limits = np.array(
            [
                (0.0, 0.0, 0.0)
                if spec.avoidance is None
                else (
                    spec.avoidance.limits.protected_m,
                    spec.avoidance.limits.protected_up_m,
                    spec.avoidance.limits.look_ahead_s,
                )
                for spec in self.specs
            ]
        ).reshape(count, 3)
        self._sight = {
            row: AircraftSight(spec.vehicle, spec.sight, spec.fusion, city, row)
            for row, spec in enumerate(self.specs)
            if spec.sight is not None and city is not None
        }
        self._scans = ScanReader({spec.vehicle: spec.sight.sensors for spec in self.specs if spec.sight is not None})
        self._landings = EmergencyLandings({k: s.landing for k, s in enumerate(self.specs) if s.landing is not None})
        self._requests = MessageRequests(self._avoids)
        self._handovers: dict[int, ControlHandover] = {}
        self._counts = np.zeros((count, len(_COUNTS)), dtype=np.int64)
        self._bad = np.zeros(count, dtype=np.int64)
        self._arm_status = np.full(count, -1, dtype=np.int64)
        self._check_ns: Time = CHECK_NS
        self._second_ns: Time = NS_PER_S

    def next_wakeup(self) -> Time | None:
        """The next broadcast, search for conflicts or full second."""
        times = [self._second_ns]
        if self._avoids.any() or self._landings:
            times.append(self._check_ns)
        due = self._broadcaster.next_due()
        return min(times) if due is None else min(*times, due)

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Take in what arrived, then do what is due."""
        out = Outbox()
        if len(inbox):
            self._receive(now, inbox, out)
        if now >= self._check_ns:
            self._check_ns = now - now % CHECK_NS + CHECK_NS
            if self._avoids.any():
                self._check_conflicts(now, out)
            if self._landings:
                self._check_landings(now, out)
        if now >= self._second_ns:
            self._second_ns = now - now % NS_PER_S + NS_PER_S
            self._each_second(now, out)
        if self.verifier is not None:
            for change in self.verifier.changes():
                causes = () if change.cause is None else (change.cause,)
                out.note("event.remote_id_trust", self.specs[change.row].vehicle, change.data, causes)
        sent = self._broadcaster.send(now, self._beliefs)
        if sent is not None:
            out.send_block(sent[0] * _SIDES + 1, sent[1])
        if self._signed is not None:
            self._signed.sign_outbox(now, out)
        return out

    # --- what comes in -------------------------------------------------------------------------

    def _receive(self, now: Time, inbox: Inbox, out: Outbox) -> None:
        mail = inbox.columns(self._places)
        if self._signed is not None:
            mail = self._signed.verify_inbox(now, inbox, mail, out)
        if self._sight:
            mail = self._receive_scans(now, inbox, mail, out)
        side, vehicle = mail.places % _SIDES, mail.places // _SIDES
        data = np.flatnonzero(side == 0)
        if data.size:
            self._beliefs.update(vehicle[data], mail.at_ns[data], mail.payloads.take(data))
        heard = np.flatnonzero(side == _SIDES - 1)
        if heard.size:
            self._receive_broadcasts(inbox, mail, vehicle, heard)

    def _receive_scans(self, now: Time, inbox: Inbox, mail: Columns, out: Outbox) -> Columns:
        """Take in the scans among the mail; returns the rest."""
        first = len(self.specs) * _SIDES
        scans = np.flatnonzero(mail.places >= first)
        if not scans.size:
            return mail
        places, velocities = self._own_motion(now)
        placed = is_fresh(self._beliefs.table["position_ns"], now, POSITION_TIMEOUT_NS)
        for number in scans.tolist():
            row = self._scan_rows[mail.places.item(number) - first]
            cause = inbox.arrival(mail.order.item(number)).ref
            vehicle = self.specs[row].vehicle
            scan = self._scans.read_or_note(vehicle, bytes(mail.payloads[number]), cause, out)
            if scan is None:
                continue
            if self._range_reports is not None:
                self._range_reports.receive(now, vehicle, scan, cause, out)
            if placed[row]:
                motion = (places[row], velocities[row])
                self._sight[row].receive(now, scan, motion, self.tracks, out, cause=cause)
                self._landings.see(now, row, scan, motion, cause)
        return mail.take(np.flatnonzero(mail.places < first))

    def _receive_broadcasts(self, inbox: Inbox, mail: Columns, vehicle: Ints, heard: Ints) -> None:
        rid = unpack_rows(mail.payloads.take(heard))
        locations = decode_locations(rid.bodies)
        ref, serial = self._refs.read(inbox, mail.order[heard])
        np.add.at(self._bad, vehicle[heard[~locations.valid]], 1)  # a payload that is no frame has no valid body either
        received = ReceivedBroadcasts(vehicle[heard], mail.at_ns[heard], rid, locations, ref, serial)
        released: list[ReceivedBroadcasts] = []
        if self.verifier is not None:
            received, released = self._verify(self.verifier, received)
        self.tracks.update(received)
        for broadcasts in released:
            self.tracks.update(broadcasts)

    def _verify(
        self, verifier: Verifier, heard: ReceivedBroadcasts
    ) -> tuple[ReceivedBroadcasts, list[ReceivedBroadcasts]]:
        """Verify what aircraft heard that do so: what they may act on now, and older Locations that are verified by it.

        An aircraft does not receive itself, so what has its own address or identifier is a copy or a lie.
        """
        rid, kept = heard.rid, heard.rid.valid.copy()
        released: list[ReceivedBroadcasts] = []
        for place in np.flatnonzero(np.isin(heard.receiver, verifier.rows) & rid.valid).tolist():
            row, at_ns, address = heard.receiver.item(place), heard.at_ns.item(place), rid.address[place].tobytes()
            judged = verifier.receive(
                row,
                at_ns,
                address,
                rid.counter.item(place),
                rid.bodies[place],
                self._refs.id(heard.ref.item(place), heard.serial.item(place)),
            )
            if not verifier.filters(row):
                continue
            if address == self._own_addresses[row] or heard.said.uas_id[place] == self._own_ids[row]:
                kept[place] = False
                continue
            kept[place] = verifier.acts_on(row, int.from_bytes(address, "big"), at_ns, judged)
            for verified, heard_ns in verifier.release(row, at_ns, judged):
                sender = verified.address.to_bytes(6, "big")
                if sender == self._own_addresses[row]:
                    continue
                header = RidHeader(rid.transport.item(place), address=sender)
                rows = unpack_rows(Payloads.of([pack(header, verified.body)]))
                single_row = slice(place, place + 1)
                released.append(
                    ReceivedBroadcasts(
                        heard.receiver[single_row],
                        np.array([heard_ns], dtype=np.int64),
                        rows,
                        decode_locations(rows.bodies),
                        heard.ref[single_row],
                        heard.serial[single_row],
                    )
                )
        return heard._replace(rid=rid._replace(valid=kept)), released

    # --- detect and avoid ------------------------------------------------------------------------

    def _check_conflicts(self, now: Time, out: Outbox) -> None:
        """Find conflicts, and decide for each aircraft that has one or is avoiding."""
        table = self._beliefs.table
        placed = is_fresh(table["position_ns"], now, POSITION_TIMEOUT_NS) & is_fresh(
            table["heartbeat_ns"], now, HEARTBEAT_TIMEOUT_NS
        )
        flying = placed & (table["armed"] == 1) & (table["state"] >= mav.MAV_STATE_ACTIVE)
        free = (
            self._avoids
            & flying
            & (table["mode"] == autopilot_commands.AUTO)
            & (table["state"] == mav.MAV_STATE_ACTIVE)
        )
        free &= table["above_home_m"] >= MIN_HEIGHT_M
        places, velocities = self._own_motion(now)
        if self.verifier is not None:
            for row in filter(self.verifier.filters, self.verifier.rows):
                self.tracks.ignore(row, partial(self.verifier.disbelieves, row, now))
        for row, sight in self._sight.items():
            verifies = self.verifier is not None and self.verifier.filters(row)
            sight.apply(now, self.tracks, keep=verifies)
        in_conflict = detect_conflicts(self.tracks, now, places, velocities, self._limits, free)
        for row in sorted({*np.flatnonzero(in_conflict).tolist(), *self._handovers}):
            handover = self._handovers.get(row) or ControlHandover()
            mode, heartbeat_ns = int(table["mode"][row]), int(table["heartbeat_ns"][row])
            failsafe = int(table["state"][row]) >= mav.MAV_STATE_CRITICAL
            command = handover.observe(now, mode, heartbeat_ns, flying=bool(flying[row]), failsafe=failsafe)
            if command is not None:
                self._carry_out(now, row, command, None, (), out)
            may_decide = handover.engaged or (bool(free[row]) and now >= handover.quiet_until_ns)
            if may_decide and not (handover.control is ControlState.RETURNING and not in_conflict[row]):
                own = self._own_state(now, row, handover, places, velocities)
                self._decide(now, row, handover, own, out)
            if handover.engaged or now < max(handover.quiet_until_ns, handover.left_ns + GOAL_TIMEOUT_NS):
                self._handovers[row] = handover
            else:
                self._handovers.pop(row, None)

    def _own_motion(self, now: Time) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n, 3) current positions and velocities, as believed, in the local frame."""
        table = self._beliefs.table
        velocity = np.column_stack((table["vel_e"], table["vel_n"], -table["vel_d"]))
        east, north = self._origin.to_enu(table["lat_e7"] * 1e-7, table["lon_e7"] * 1e-7)
        up = table["alt_msl_m"] - self._origin.alt_msl_m
        age_s = np.clip((now - table["position_ns"]) / NS_PER_S, 0.0, POSITION_TIMEOUT_NS / NS_PER_S)
        return np.column_stack((east, north, up)) + velocity * age_s[:, None], velocity

    def _own_state(
        self,
        now: Time,
        row: int,
        handover: ControlHandover,
        places: NDArray[np.float64],
        velocities: NDArray[np.float64],
    ) -> Own:
        """The aircraft's own believed state, with the goal of the mission that it flies or has left."""
        (x, y, z), (u, v, w) = places[row].tolist(), velocities[row].tolist()
        goal = handover.goal_enu_m if handover.engaged else self._goal(now, row, handover)
        if goal is None:
            ahead_s = self._limits.item(row, 2)
            goal = (x + u * ahead_s, y + v * ahead_s, z + w * ahead_s)
        return Own((x, y, z), (u, v, w), goal, self.specs[row].cruise_mps)

    def _goal(self, now: Time, row: int, handover: ControlHandover) -> Vector | None:
        """The mission's goal, if reported in AUTO and recently; shortly after an avoidance still the one from before
        it.
        """
        belief = self._beliefs.table[row]
        if belief["goal_ns"] <= handover.left_ns + NS_PER_S // 2 and handover.goal_enu_m is not None:
            return handover.goal_enu_m
        if belief["goal_ns"] < 0 or now - belief["goal_ns"] > GOAL_TIMEOUT_NS:
            return None
        east, north = self._origin.enu_of(belief["goal_lat_e7"] * 1e-7, belief["goal_lon_e7"] * 1e-7)
        up = float(belief["goal_msl_m"]) - self._origin.alt_msl_m
        near = math.isfinite(up) and max(abs(east), abs(north), abs(up)) < 1e5
        return (east, north, up) if near else None

    def _decide(self, now: Time, row: int, handover: ControlHandover, own: Own, out: Outbox) -> None:
        avoidance = self.specs[row].avoidance
        assert avoidance is not None
        heard_tracks = self.tracks.snapshot(row, now, grounded=False)
        decision = avoidance.decide(
            now, own, Tracks(heard_tracks.pos_enu_m, heard_tracks.vel_enu_mps), handover.episode
        )
        command = handover.follow(now, decision, own.goal_enu_m)
        if command is not None:
            causes = self._causes(row, heard_tracks, decision) or handover.causes
            handover.causes = causes
            self._carry_out(now, row, command, (heard_tracks, decision), causes, out)

    def _causes(self, row: int, heard_tracks: TrackSnapshot, decision: AvoidanceDecision) -> tuple[FrameId, ...]:
        """The frames that wrote the tracks which a decision is about, then of those that shaped it."""
        rows = self.tracks.rows[row]
        places = [int(heard_tracks.slot[track]) for track in (*decision.tracks, *decision.considered)]
        frames = [self._refs.id(int(rows["ref"][place]), int(rows["serial"][place])) for place in places]
        return tuple(dict.fromkeys(ref for ref in frames if ref is not None))

    def _carry_out(
        self,
        now: Time,
        row: int,
        command: CompanionCommand,
        why: tuple[TrackSnapshot, AvoidanceDecision] | None,
        causes: tuple[FrameId, ...],
        out: Outbox,
    ) -> None:
        """Send the commands of an order, and note it."""
        spec, boot_ms = self.specs[row], int(self._beliefs.table["boot_ms"][row])
        if command.note:
            data: dict[str, Scalar] = {"mode": int(self._beliefs.table["mode"][row])}
            if why is not None:
                heard_tracks, decision = why
                data = {"action": str(decision.action), "tracks": len(decision.tracks)}
                if decision.tracks:
                    first = decision.tracks[0]
                    data["track"] = printable_id(bytes(heard_tracks.uas_id[first]).decode("latin-1"))
                    data["address"] = f"{int(heard_tracks.address[first]):012x}"
                if decision.waypoint_enu_m is not None:
                    data |= dict(zip(("east_m", "north_m", "up_m"), decision.waypoint_enu_m, strict=True))
            out.note(command.note, spec.vehicle, data, causes)
        if command.mode is not None:
            self._send_command(row, autopilot_commands.set_mode(spec.system_id, command.mode), causes, out)
            if command.mode != autopilot_commands.RTL:
                self._send_command(row, autopilot_commands.set_speed(spec.system_id, spec.cruise_mps), causes, out)
        if command.place is not None:
            self._send_command(
                row, autopilot_commands.go_to(spec.system_id, boot_ms, self._origin, command.place), causes, out
            )
        elif command.stop:
            self._send_command(row, autopilot_commands.hold(spec.system_id, boot_ms), causes, out)

    # --- emergency landings ----------------------------------------------------------------------

    def _check_landings(self, now: Time, out: Outbox) -> None:
        """Carry out what emergency landings order."""
        places, velocities = self._own_motion(now)
        for row, order, causes in self._landings.check(now, self._beliefs.table, places, velocities):
            command = CompanionCommand(order.mode, order.place)
            if order.note:
                out.note(order.note, self.specs[row].vehicle, order.data, causes)
            self._carry_out(now, row, command, None, causes, out)

    # --- once a second ---------------------------------------------------------------------------

    def _each_second(self, now: Time, out: Outbox) -> None:
        """Request what is missing, report the status of Remote ID, and note counters."""
        table = self._beliefs.table
        if self.verifier is not None:
            clocks_us = clock_us(table, now)
            for row in self.verifier.rows:
                self.verifier.set_clock(row, now, clocks_us.item(row))
            self.verifier.review(now)
        for row, request in self._requests.due(now, table, autopilot_commands.AUTO):
            interval_us = request.interval_ns // 1000
            self._send_command(
                row, autopilot_commands.set_interval(self.specs[row].system_id, request.message, interval_us), (), out
            )
        arm_statuses = self._broadcaster.arm_status(now, self._beliefs)
        beating = table["heartbeat_ns"] >= 0
        changed = beating & (arm_statuses != self._arm_status)
        self._arm_status[changed] = arm_statuses[changed]
        for row in np.flatnonzero(changed).tolist():
            text = ARM_STATUS_TEXTS[arm_statuses.item(row)]
            out.note("event.remote_id", self.specs[row].vehicle, {"serviceable": not text, "trouble": text})
        rows = np.flatnonzero(beating & self._broadcaster.autopilot_location)
        if rows.size:
            self._send_identity(now, rows, out)
        # before take-off every second, as a transmitter does; in flight on a change, always to one with ODID
        needs_status = changed | (table["armed"] == 0) | self._broadcaster.autopilot_location
        for row in np.flatnonzero(beating & needs_status).tolist():
            self._send_command(row, autopilot_commands.arm_status(ARM_STATUS_TEXTS[arm_statuses.item(row)]), (), out)
        counts = np.column_stack((self.tracks.counts, self._bad + table["bad"]))
        for row, column in np.argwhere(counts != self._counts).tolist():
            count = counts.item(row, column)
            if has_one_worth_noting(self._counts.item(row, column), count):
                out.note(_COUNTS[column], self.specs[row].vehicle, {"count": count})
        self._counts = counts

    def _send_identity(self, now: Time, rows: Ints, out: Outbox) -> None:
        """Send autopilots with Open Drone ID their identity and the operator's location, as a ground station would."""
        for row, messages in zip(
            rows.tolist(), self._broadcaster.identity_messages(rows, now, self._beliefs), strict=True
        ):
            target = (self.specs[row].system_id, autopilot_commands.AUTOPILOT)
            for message in messages:
                self._send_command(row, to_mavlink(message, target=target), (), out)

    def _send_command(self, row: int, message: Message, causes: tuple[FrameId, ...], out: Outbox) -> None:
        out.send(self.originates[row], self._packers[row].pack(message), causes)


def _verifier(specs: Sequence[CompanionSpec]) -> Verifier | None:
    if all(spec.verification is None for spec in specs):
        return None
    from skyrange.remoteid.drip.verification.verifier import Verifier

    return Verifier([spec.verification for spec in specs])
