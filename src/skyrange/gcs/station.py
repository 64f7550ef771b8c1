"""Ground station of one operator: one agent, with a flight sequencer per aircraft.

It exchanges MAVLink with each of its own aircraft on `gcs:<vehicle>`, submits flight plans to the flight approval on
`approval:<operator>`, and receives reports of its ground receivers, if it has any, on `oracle:<operator>`. Flight
sequencers wait in a heap ordered by due time, so a silent fleet costs nothing. Telemetry is decoded in columns; a
flight sequencer reads only messages that may change its decisions (`gcs.telemetry.receiver`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from heapq import heappop, heappush
from typing import Any

import numpy as np

from skyrange.city.city import City
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.message_columns import FleetPacker, assign_sequence_numbers, pack_batches, payload_dtype
from skyrange.codec.mavlink.signing import SIGNING_TIME, SignedConnection, SignedConnections, SigningKey, SigningTime
from skyrange.contracts.alerts import Scalar
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox, Turn
from skyrange.core.chance import Chance
from skyrange.core.errors import DecodeError, InputError, Problem, nearest
from skyrange.core.ids import Port, endpoint, link_name, operator_of
from skyrange.core.time import NEVER, NS_PER_MS, Epoch, Time
from skyrange.core.whole_numbers import worth_noting
from skyrange.gcs.flight.airspace_claim import AirspaceClaim
from skyrange.gcs.flight.autopilot_dialogue import (
    AUTOPILOT_COMPONENT,
    STATION_COMPONENT,
    STATION_SYSTEM,
    AutopilotDialogue,
)
from skyrange.gcs.flight.lifecycle import ENDED, Flight, FlightOutcome, FlightState
from skyrange.gcs.flight.replanning import Replanner, Replanning
from skyrange.gcs.flight.sequencer import (
    HEARTBEAT_NS,
    LINK_TIMEOUT_NS,
    READ,
    STALE_NS,
    FlightSequencer,
)
from skyrange.gcs.plan.volumes import MARGINS, Margins
from skyrange.gcs.telemetry import Belief, BeliefTable, TelemetryReceiver
from skyrange.gcs.telemetry_streams import PROFILES
from skyrange.gcs.traffic_picture import TrafficPicture
from skyrange.remoteid.tracks import TrackTable
from skyrange.utm.messages import PATH, DecisionBody, decode_response

SERVICE_NS = 20 * NS_PER_MS
LINK_ID = 0
"""Link id in MAVLink signatures; the station has one connection with each aircraft (pymavlink's default)."""
NO_CHANCE = Chance(0)
MAX_SYSTEM_ID = 250
"""Higher ids belong to ground stations and similar systems; 0 is the broadcast id."""


class GroundStation:
    """The ground station of one operator (endpoint `<operator>.gcs`, MAVLink 255/190 in every network).

    It distinguishes aircraft by link and system id, so it serves any number of MAVLink networks.
    """

    def __init__(
        self,
        operator: str,
        flights: Sequence[Flight],
        epoch: Epoch,
        *,
        streams: str = "light",
        traffic_picture: TrafficPicture | None = None,
        key: SigningKey | None = None,
        service_ns: Time = SERVICE_NS,
        margins: Margins = MARGINS,
        city: City | None = None,
        chance: Chance = NO_CHANCE,
        replanning: Replanning | None = None,
        signing_time: SigningTime = SIGNING_TIME,
    ) -> None:
        """The plans must have no problems (`plan.checks.check`); `traffic_picture` is that of the ground receivers.

        `margins` are those of the volumes that it claims; alternatives are kept clear of the buildings of `city`;
        `chance` draws the pauses between requests for one flight; `replanning` says what flights are replanned for.

        With a `key` the station signs what it sends to aircraft, at the time that `signing_time` says, and rejects
        frames that are not signed with that key. Raises `InputError` for another operator's vehicle, for a vehicle id
        or system id that is duplicate or out of range, and for an unknown profile of `streams`.
        """
        _check(operator, flights, streams)
        self.name = endpoint(operator, "gcs")
        self.operator = operator
        self.service_ns = service_ns
        approval = Port(self.name, link_name("approval", operator))
        profile = PROFILES[streams]
        self._beliefs = BeliefTable(len(flights))
        self._sequences = np.zeros(len(flights), dtype=np.int64)
        self._sequencers = [
            FlightSequencer(
                flight,
                AutopilotDialogue(
                    flight.vehicle,
                    flight.system_id,
                    Port(self.name, link_name("gcs", flight.vehicle)),
                    FleetPacker(STATION_SYSTEM, STATION_COMPONENT, self._sequences, place),
                ),
                approval,
                profile,
                self._beliefs.of(place),
                AirspaceClaim(epoch, chance, margins, city),
            )
            for place, flight in enumerate(flights)
        ]
        self._receiver = TelemetryReceiver(
            self._beliefs, [flight.system_id for flight in flights], AUTOPILOT_COMPONENT, READ
        )
        reports = [Port(self.name, link_name("oracle", operator))] if traffic_picture is not None else []
        self.ports: Sequence[Port] = (*(sequencer.dialogue.port for sequencer in self._sequencers), approval, *reports)
        self.traffic_picture = traffic_picture
        """The traffic picture of the ground receivers; `None` without receivers."""
        self.bad_approvals = 0
        """Number of frames on the approval link that could not be decoded or that answer no request."""
        self._places = {port: place for place, port in enumerate(self.ports)}
        self._signed: SignedConnections | None = None
        if key is not None:
            ends = [
                SignedConnection(
                    sequencer.flight.vehicle, key, sequencer.dialogue.port, sequencer.dialogue.port, time=signing_time
                )
                for sequencer in self._sequencers
            ]
            self._signed = SignedConnections(self.ports, ends, LINK_ID, "decision.signature_refused")
        self._replanner: Replanner | None = None
        if replanning is not None:
            self._replanner = Replanner(replanning, self._sequencers, self._latest_status)
        self._by_intent: dict[str, int] = {}
        self._heap: list[tuple[Time, int]] = [(0, place) for place in range(len(flights))]
        self._queued: list[Time] = [0] * len(flights)
        self._beat_due: Time = 0 if flights else NEVER

    # --- the agent -------------------------------------------------------------------------------

    def next_wakeup(self) -> Time | None:
        """When the next flight sequencer or the traffic picture is due; `None` for a station without aircraft."""
        due = min(self._heap[0][0], self._beat_due) if self._heap else self._beat_due
        if self.traffic_picture is not None:
            due = min(due, self.traffic_picture.due)
        return None if due == NEVER else due

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Process what was received, then do what is due."""
        out = Outbox()
        turn = Turn(now, out)
        if len(inbox):
            self._read(turn, inbox)
        heartbeat_due = now >= self._beat_due
        if heartbeat_due:
            self._beat_due = now - now % HEARTBEAT_NS + HEARTBEAT_NS
            for place in self._beliefs.stale_rows(now, LINK_TIMEOUT_NS, STALE_NS).tolist():
                self._sequencers[place].check_telemetry_age(turn)
                self._queue(place)
            if self._replanner is not None:
                for place in self._replanner.check(turn):
                    self._queue(place)
        heap = self._heap
        while heap and heap[0][0] <= now:
            _, place = heappop(heap)
            self._queued[place] = NEVER
            sequencer = self._sequencers[place]
            if sequencer.due <= now:
                sequencer.on_time(turn)
            self._queue(place)
        if heartbeat_due:
            self._send_heartbeats(out)
        if self.traffic_picture is not None and self.traffic_picture.due <= now:
            self.traffic_picture.note_changes(now, out)
        if self._signed is not None:
            self._signed.sign_outbox(now, out)
        return out

    def _read(self, turn: Turn, inbox: Inbox) -> None:
        """Decode all received frames; frames that only refresh a belief are handled at once, the rest in order."""
        now, out = turn.now, turn.out
        table = inbox.columns(self._places)
        if self._signed is not None:
            table = self._signed.verify_inbox(now, inbox, table, out)
        (reports,) = (table.places > len(self._sequencers)).nonzero()
        if self.traffic_picture is not None and reports.size:
            self.traffic_picture.receive_reports(now, inbox, table.order[reports], out)
        rows = self._receiver.read(now, table.places, table.payloads)
        for place, arrival in zip(table.places[rows].tolist(), inbox.arrivals(table.order[rows]), strict=True):
            caused = turn.caused_by(arrival.ref)
            if place == len(self._sequencers):
                self._on_approval(caused, arrival)
            elif place < len(self._sequencers) and self._sequencers[place].on_frame(caused, arrival):
                self._queue(place)

    def _send_heartbeats(self, out: Outbox) -> None:
        """Send the station's HEARTBEAT to all aircraft."""
        places = np.arange(len(self._sequencers))
        heartbeats = np.zeros(len(places), dtype=payload_dtype(mav.MAVLINK_MSG_ID_HEARTBEAT))
        heartbeats["type"], heartbeats["autopilot"] = mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID
        heartbeats["system_status"], heartbeats["mavlink_version"] = mav.MAV_STATE_ACTIVE, 3
        sequences = np.empty_like(places)
        assign_sequence_numbers(places, self._sequences, sequences)
        frames = pack_batches(
            [(mav.MAVLINK_MSG_ID_HEARTBEAT, heartbeats, np.full_like(places, STATION_SYSTEM), sequences)],
            STATION_COMPONENT,
        )
        out.send_block(places, frames)

    def _queue(self, place: int) -> None:
        """Put a sequencer into the heap by its due time; superseded entries find nothing to do when they are popped."""
        sequencer = self._sequencers[place]
        due = sequencer.due
        if sequencer.submission is not None:
            self._by_intent[sequencer.intent] = place
        if due < self._queued[place]:
            self._queued[place] = due
            heappush(self._heap, (due, place))

    def _on_approval(self, turn: Turn, arrival: Arrival) -> None:
        reason = ""
        try:
            response = decode_response(arrival.payload)
        except DecodeError as error:
            reason = str(error)
        else:
            body = response.body
            if not isinstance(body, DecisionBody):
                reason = f"status {response.status}: {body.message}"
                place = self._by_intent.get(response.path.removeprefix(PATH))
                if place is not None:
                    self._sequencers[place].on_approval_error(reason)
            elif body.id not in self._by_intent:
                reason = f"an answer to {body.id}, which was not requested"
            else:
                place = self._by_intent[body.id]
                self._sequencers[place].on_decision(turn, body)
                self._queue(place)
                return
        self.bad_approvals += 1
        if worth_noting(self.bad_approvals):
            data: dict[str, Scalar] = {"count": self.bad_approvals, "reason": reason}
            turn.note("decision.bad_approval", self.operator, data)

    # --- state --------------------------------------------------------------------------------

    @property
    def finished(self) -> bool:
        """Whether every flight has ended."""
        return all(sequencer.state in ENDED for sequencer in self._sequencers)

    @property
    def states(self) -> Mapping[str, FlightState]:
        """Vehicle id → state of its flight."""
        return {sequencer.flight.vehicle: sequencer.state for sequencer in self._sequencers}

    @property
    def outcomes(self) -> Mapping[str, FlightOutcome]:
        """Vehicle id → outcome of its flight, for the flights that have ended."""
        return {
            sequencer.flight.vehicle: sequencer.outcome
            for sequencer in self._sequencers
            if sequencer.outcome is not None
        }

    def belief(self, vehicle: str) -> Belief:
        """The station's belief about one of its aircraft; `KeyError` for any other aircraft."""
        return self._sequencers[self._place(vehicle)].belief

    def latest(self, vehicle: str, message_id: int) -> Any:
        """The latest message of a kind from one of its aircraft as a record of its fields; `None` if there was none."""
        return self._receiver.latest(self._place(vehicle), message_id)

    def _latest_status(self, place: int) -> Any:
        return self._receiver.latest(place, mav.MAVLINK_MSG_ID_SYS_STATUS)

    @property
    def tracks(self) -> TrackTable | None:
        """The tracks of its ground receivers, one row for each receiver; `None` without receivers."""
        return None if self.traffic_picture is None else self.traffic_picture.tracks

    def _place(self, vehicle: str) -> int:
        return self._places[Port(self.name, link_name("gcs", vehicle))]


def _check(operator: str, flights: Sequence[Flight], streams: str) -> None:
    problems: list[Problem] = []
    vehicles: set[str] = set()
    systems: set[tuple[int, int]] = set()
    if streams not in PROFILES:
        problems.append(Problem("streams", repr(streams), "a stream profile", nearest(streams, PROFILES)))
    for flight in flights:
        if operator_of(flight.vehicle) != operator or "/" not in flight.vehicle:
            problems.append(Problem("vehicle", repr(flight.vehicle), f"an aircraft of operator {operator!r}"))
        if flight.vehicle in vehicles:
            problems.append(Problem("vehicle", repr(flight.vehicle), "an id that occurs once"))
        address = (flight.network, flight.system_id)
        if address in systems or not 1 <= flight.system_id <= MAX_SYSTEM_ID:
            expected = f"a system id in 1…{MAX_SYSTEM_ID} that occurs once in its network"
            problems.append(Problem(f"{flight.vehicle}.system_id", str(flight.system_id), expected))
        vehicles.add(flight.vehicle)
        systems.add(address)
    if problems:
        raise InputError(f"ground station of {operator}", problems)
