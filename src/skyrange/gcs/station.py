"""Who flies an operator's fleet? The ground station: one agent, a remote pilot per aircraft.

It talks on `gcs:<vehicle>` with each of its own aircraft and on `approval:<operator>` with the flight
approval, and owns no other port. Who is due next stands in a heap, so a fleet that is silent costs nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from heapq import heappop, heappush

from skyrange.agent.messages import Arrival, Inbox, Outbox, Scalar
from skyrange.core.errors import DecodeError, Fault, InputError, nearest
from skyrange.core.ids import Port, endpoint, link_name, operator_of
from skyrange.core.time import NEVER, NS_PER_MS, Epoch, Time
from skyrange.gcs.belief import Belief
from skyrange.gcs.flights import Flight, Outcome
from skyrange.gcs.lifecycle import OVER, State
from skyrange.gcs.pilot import Pilot
from skyrange.gcs.streams import PROFILES
from skyrange.utm.messages import DecisionBody, decode_response

SERVICE_NS = 20 * NS_PER_MS
MAX_SYSTEM_ID = 250
"""Above are ground stations and the like; 0 broadcasts."""


class GroundStation:
    """The ground station of one operator (endpoint `<operator>.gcs`, MAVLink 255/190 in every network).

    Aircraft are told apart by link and system id, so it serves any number of MAVLink networks.
    """

    def __init__(
        self,
        operator: str,
        flights: Sequence[Flight],
        epoch: Epoch,
        *,
        streams: str = "light",
        service_ns: Time = SERVICE_NS,
    ) -> None:
        """Plans must be free of faults (`checks.check`).

        Raises `InputError` for another operator's vehicle, a vehicle or system id given twice or out of
        range, or an unknown profile of `streams`.
        """
        _check(operator, flights, streams)
        self.name = endpoint(operator, "gcs")
        self.operator = operator
        self.service_ns = service_ns
        approval = Port(self.name, link_name("approval", operator))
        wanted = tuple(PROFILES[streams].items())
        self._pilots = [
            Pilot(flight, Port(self.name, link_name("gcs", flight.vehicle)), approval, epoch, wanted)
            for flight in flights
        ]
        self.ports: Sequence[Port] = (*(pilot.port for pilot in self._pilots), approval)
        self.bad_approvals = 0
        """Frames on the approval link that were not understood or not asked for."""
        self._approval_link = approval.link
        self._by_link = {pilot.port.link: number for number, pilot in enumerate(self._pilots)}
        self._by_intent: dict[str, int] = {}
        self._heap: list[tuple[Time, int]] = [(0, number) for number in range(len(flights))]
        self._queued: list[Time] = [0] * len(flights)

    # --- the agent -------------------------------------------------------------------------------

    def next_wakeup(self) -> Time | None:
        """When the next pilot may have something to do; `None` for a station without aircraft."""
        return self._heap[0][0] if self._heap else None

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Read the mail, then do what is due."""
        out = Outbox()
        for arrival in inbox:
            link = arrival.port.link
            if link == self._approval_link:
                self._on_approval(now, arrival, out)
                continue
            number = self._by_link[link]
            if self._pilots[number].on_frame(now, arrival, out):
                self._queue(number)
        heap = self._heap
        while heap and heap[0][0] <= now:
            _, number = heappop(heap)
            self._queued[number] = NEVER
            pilot = self._pilots[number]
            if pilot.due <= now:
                began = pilot.state is State.PLANNED
                pilot.on_time(now, out)
                if began:
                    self._by_intent[pilot.intent] = number
            self._queue(number)
        return out

    def _queue(self, number: int) -> None:
        """Have a pilot in the heap by the time it is due; earlier entries find nothing to do and are dropped."""
        due = self._pilots[number].due
        if due < self._queued[number]:
            self._queued[number] = due
            heappush(self._heap, (due, number))

    def _on_approval(self, now: Time, arrival: Arrival, out: Outbox) -> None:
        reason = ""
        try:
            response = decode_response(arrival.payload)
        except DecodeError as error:
            reason = str(error)
        else:
            body = response.body
            if not isinstance(body, DecisionBody):
                reason = f"status {response.status}: {body.message}"
            elif body.id not in self._by_intent:
                reason = f"an answer to {body.id}, which was not asked for"
            else:
                number = self._by_intent[body.id]
                self._pilots[number].on_decision(now, body, arrival.ref, out)
                self._queue(number)
                return
        self.bad_approvals += 1
        if self.bad_approvals & (self.bad_approvals - 1) == 0:
            data: dict[str, Scalar] = {"count": self.bad_approvals, "reason": reason}
            out.note("decision.bad_approval", self.operator, data, (arrival.ref,))

    # --- what it knows ---------------------------------------------------------------------------

    @property
    def finished(self) -> bool:
        """Whether every flight is complete or failed."""
        return all(pilot.state in OVER for pilot in self._pilots)

    @property
    def states(self) -> Mapping[str, State]:
        """Vehicle id → where its flight stands."""
        return {pilot.flight.vehicle: pilot.state for pilot in self._pilots}

    @property
    def outcomes(self) -> Mapping[str, Outcome]:
        """Vehicle id → how its flight ended, for those that have."""
        return {pilot.flight.vehicle: pilot.outcome for pilot in self._pilots if pilot.outcome is not None}

    def belief(self, vehicle: str) -> Belief:
        """What the station believes about one of its aircraft; `KeyError` for another's."""
        return self._pilots[self._by_link[link_name("gcs", vehicle)]].belief


def _check(operator: str, flights: Sequence[Flight], streams: str) -> None:
    faults: list[Fault] = []
    vehicles: set[str] = set()
    systems: set[tuple[int, int]] = set()
    if streams not in PROFILES:
        faults.append(Fault("streams", repr(streams), "a stream profile", nearest(streams, PROFILES)))
    for flight in flights:
        if operator_of(flight.vehicle) != operator or "/" not in flight.vehicle:
            faults.append(Fault("vehicle", repr(flight.vehicle), f"an aircraft of operator {operator!r}"))
        if flight.vehicle in vehicles:
            faults.append(Fault("vehicle", repr(flight.vehicle), "an id that occurs once"))
        address = (flight.network, flight.system_id)
        if address in systems or not 1 <= flight.system_id <= MAX_SYSTEM_ID:
            expected = f"a system id in 1…{MAX_SYSTEM_ID} that occurs once in its network"
            faults.append(Fault(f"{flight.vehicle}.system_id", str(flight.system_id), expected))
        vehicles.add(flight.vehicle)
        systems.add(address)
    if faults:
        raise InputError(f"ground station of {operator}", faults)
