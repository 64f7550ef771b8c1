"""Node of a hashgraph: the flight approval of one operator, which decides with all others without a server.

A request of its operator becomes a transaction of the node's next event. Nodes gossip about events; each applies the
requests in consensus order, at their consensus times, to an authority of its own. Because all do so in the same order,
all come to the same decisions; the operator is answered when the order of its request is final.

A node calls others only while it knows of a request whose order is not final, so that a silent airspace costs nothing.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from skyrange.contracts.alerts import Scalar
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox, Turn
from skyrange.core.chance import Chance
from skyrange.core.errors import DecodeError
from skyrange.core.ids import Port, hash64, operator_of
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch, Time, to_seconds
from skyrange.core.whole_numbers import worth_noting
from skyrange.utm.approval_service import answer_end, apply_constraint, decide_request, tell_overruled
from skyrange.utm.authority import Authority
from skyrange.utm.contract import Constraint, Publication
from skyrange.utm.hashgraph.events import NO_PARENT, Event, is_signed, public_of, sign
from skyrange.utm.hashgraph.graph import GraphError, Hashgraph, UnknownParentError
from skyrange.utm.hashgraph.messages import (
    MAX_EVENTS,
    MAX_FRAME_BYTES,
    MAX_KNOWN,
    MAX_TRANSACTIONS,
    EventMessage,
    Gossip,
    GossipBody,
    decode,
    encode,
)
from skyrange.utm.messages import EndBody, decode_request
from skyrange.utm.request_book import OpenRequest, RequestBook

SERVICE_NS: Final = 10 * NS_PER_MS
STREAM: Final = "utm.hashgraph.gossip"
RESENT_NS: Final = NS_PER_S
"""After which an event is sent again to a member that does not tell that it knows it: a message may have been lost."""
EVENT_BYTES: Final = MAX_FRAME_BYTES // 4
"""Most bytes of the requests of an event of more than one: a frame has room for it in base 64."""
GOSSIP_BYTES: Final = MAX_FRAME_BYTES // 2
"""Most bytes of the events of a message of more than one, as for an event."""
OVERHEAD_BYTES: Final = 1_024
"""More than an event takes besides its requests."""


@dataclass(frozen=True, slots=True)
class Membership:
    """What all nodes know of each other from the beginning."""

    stakes: Mapping[str, int]
    keys: Mapping[str, bytes]
    """Public keys."""


class HashgraphNode:
    """The approval of one operator.

    Notes: those of `FlightApproval`; `decision.consensus` about the vehicle of each request of its own whose order is
    final, {rank, round, after_s}; `decision.fork_found` about a member that has signed two events with one self-parent,
    once; `decision.bad_gossip` about the node, counted.
    """

    def __init__(
        self,
        name: str,
        operator: str,
        *,
        approval: Port,
        peers: Mapping[str, Port],
        membership: Membership,
        secret: bytes,
        authority: Authority,
        epoch: Epoch,
        chance: Chance,
        gossip_ns: Time,
        constraints: Sequence[Constraint] = (),
    ) -> None:
        """`peers`: the port to each other member."""
        self.name = name
        self.operator = operator
        self.service_ns = SERVICE_NS
        self.ports: Sequence[Port] = (approval, *(peers[peer] for peer in sorted(peers)))
        self.bad_gossip = 0
        """Frames of other members that were not understood, or whose events were not signed by their creators."""
        self._approval = approval
        self._peers = dict(sorted(peers.items()))
        self._peer_of = {port.link: peer for peer, port in self._peers.items()}
        self._membership = membership
        self._secret = secret
        self._authority = authority
        self._epoch = epoch
        self._chance = chance
        self._gossip_ns = gossip_ns
        self._graph = Hashgraph(membership.stakes)
        for member in sorted(membership.stakes):
            # every member's first event is empty and known to all
            self._graph.add(Event(member, NO_PARENT, NO_PARENT, 0))
        self._book = RequestBook([(operator, approval)])
        self._waiting: list[tuple[OpenRequest, Time]] = []
        """Requests that are in no event yet, and when they arrived."""
        self._sent: dict[bytes, tuple[OpenRequest, Time]] = {}
        """Requests that are in an event, by their bytes, and when they arrived."""
        self._shared: dict[str, dict[bytes, Time]] = {peer: {} for peer in self._peers}
        """Events that were sent to each member lately, or came from it, and when."""
        self._undecided = 0
        """Transactions in events whose order is not final."""
        self._applied = 0
        self._clock: Time = 0
        self._due: Time | None = None
        self._noted_forks: set[str] = set()
        self._publication = Publication(constraints)

    # --- the agent -----------------------------------------------------------------------------------------

    def next_wakeup(self) -> Time | None:
        """When it calls another member next, or a constraint is published."""
        return self._publication.due if self._due is None else self._due

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Read requests and gossip, call a member if it is time, and answer what is decided."""
        out = Outbox()
        for arrival in inbox:
            if arrival.port.link == self._approval.link:
                open_request = self._book.read(arrival, out)
                if open_request is not None:
                    self._waiting.append((open_request, now))
            else:
                self._on_gossip(Turn(now, out, (arrival.ref,)), arrival)
        if self._is_busy(now):
            if self._due is None:
                self._due = now
        else:
            self._due = None
        if self._due is not None and now >= self._due:
            self._request_gossip(Turn(now, out))
            self._due = now + self._gossip_ns
        return out

    def _is_busy(self, now: Time) -> bool:
        """Whether the order of a request is not final, or the consensus time has not reached a published constraint."""
        published = self._publication.due
        return bool(self._waiting) or self._undecided > 0 or (published is not None and published <= now)

    # --- gossip --------------------------------------------------------------------------------------------

    def _request_gossip(self, turn: Turn) -> None:
        """Ask a member, drawn by chance, for what it knows."""
        peers = list(self._peers)
        draw = self._chance.uniform4(STREAM, hash64(self.name), turn.now, 0)[0]
        peer = peers[min(int(draw * len(peers)), len(peers) - 1)]
        self._send(turn, peer, Gossip(method="GET", body=GossipBody(known=self._list_known_hashes())))

    def _on_gossip(self, turn: Turn, arrival: Arrival) -> None:
        peer = self._peer_of[arrival.port.link]
        try:
            message = decode(arrival.payload)
            self._add_events(turn.now, peer, message.body.events)
        except (DecodeError, GraphError) as error:
            self.bad_gossip += 1
            if worth_noting(self.bad_gossip):
                data: dict[str, Scalar] = {"count": self.bad_gossip, "reason": str(error)[:200], "peer": peer}
                turn.note("decision.bad_gossip", self.name, data)
            return
        if message.method == "GET":
            body = GossipBody(
                known=self._list_known_hashes(), events=self._list_missing_events(turn.now, peer, message.body.known)
            )
            self._send(turn, peer, Gossip(status=200, body=body))
        elif message.status is not None:
            self._create_event(turn.now, peer)
            body = GossipBody(events=self._list_missing_events(turn.now, peer, message.body.known))
            self._send(turn, peer, Gossip(method="POST", body=body))
        self._apply_ordered_events(turn)

    def _list_known_hashes(self) -> tuple[str, ...]:
        return tuple(digest.hex() for digest in itertools.islice(self._graph.known, MAX_KNOWN))

    def _list_missing_events(self, now: Time, peer: str, known: Sequence[str]) -> tuple[EventMessage, ...]:
        """What a member that knows these events lacks, without what is on its way to it, or has just come from it."""
        shared = self._shared[peer]
        for stale in [digest for digest, since in shared.items() if since + RESENT_NS <= now]:
            del shared[stale]
        events = self._graph.missing([bytes.fromhex(digest) for digest in known])
        sent, size = list[Event](), 0
        for event in events:
            if event.hash in shared:
                continue
            size += sum(map(len, event.transactions)) + OVERHEAD_BYTES
            if sent and (size > GOSSIP_BYTES or len(sent) == MAX_EVENTS):
                break  # it is told next time
            sent.append(event)
        shared.update((event.hash, now) for event in sent)
        return tuple(EventMessage.of(event) for event in sent)

    def _send(self, turn: Turn, peer: str, message: Gossip) -> None:
        turn.send(self._peers[peer], encode(message))

    def _add_events(self, now: Time, peer: str, messages: Sequence[EventMessage]) -> None:
        """Add the events of a message, up to one whose parents have not arrived. Raises `GraphError`, `DecodeError`."""
        shared = self._shared[peer]
        for message in messages:
            event = message.event()
            try:
                self._add_event(event)
            except UnknownParentError:
                return  # they are sent again
            shared[event.hash] = now

    def _add_event(self, event: Event) -> None:
        """Add an event of another member. Raises `GraphError`."""
        if event.hash in self._graph:
            return
        key = self._membership.keys.get(event.creator)
        if key is None or not is_signed(event, key):
            raise GraphError(f"an event of {event.creator} is not signed by it")
        if self._graph.add(event):
            self._undecided += len(event.transactions)

    def _create_event(self, now: Time, peer: str) -> None:
        """Create an event with the requests that wait, after hearing from `peer`."""
        own_event, peer_event = self._graph.latest(self.operator), self._graph.latest(peer)
        assert own_event is not None  # every member's first event is known from the beginning
        assert peer_event is not None
        payloads: list[bytes] = []
        while self._waiting and len(payloads) < MAX_TRANSACTIONS:
            open_request, since = self._waiting[0]
            if payloads and sum(map(len, payloads)) + len(open_request.payload) > EVENT_BYTES:
                break  # the next event takes it
            payloads.append(open_request.payload)
            self._sent[open_request.payload] = open_request, since
            del self._waiting[0]
        event = sign(Event(self.operator, own_event.hash, peer_event.hash, now, tuple(payloads)), self._secret)
        self._graph.add(event)
        self._undecided += len(payloads)

    # --- decisions -----------------------------------------------------------------------------------------

    def _apply_ordered_events(self, turn: Turn) -> None:
        """Decide on the requests whose order is final."""
        ordered = self._graph.ordered
        while self._applied < len(ordered):
            event, round_, time = ordered[self._applied]
            self._applied += 1
            self._clock = max(self._clock, time)
            for constraint in self._publication.take(self._clock):
                apply_constraint(
                    Turn(self._clock, turn.out), self.name, constraint, self._authority, self._book, self._epoch
                )
            for payload in event.transactions:
                self._undecided -= 1
                self._decide_request(turn, event.creator, payload, round_)
        for fork in self._graph.forks:
            if fork.member not in self._noted_forks:
                self._noted_forks.add(fork.member)
                data: dict[str, Scalar] = {
                    "time_s": to_seconds(fork.first.time),
                    "other_time_s": to_seconds(fork.second.time),
                }
                turn.note("decision.fork_found", fork.member, data)

    def _decide_request(self, turn: Turn, creator: str, payload: bytes, round_: int) -> None:
        """Apply a request, its own or another member's; what is no request of its creator changes nothing, for all."""
        sent = self._sent.pop(payload, None) if creator == self.operator else None
        if sent is not None:
            open_request, since = sent
            data: dict[str, Scalar] = {"rank": self._applied, "round": round_, "after_s": to_seconds(turn.now - since)}
            turn.caused_by(open_request.cause).note("decision.consensus", open_request.request.body.vehicle, data)
            body = open_request.request.body
            if isinstance(body, EndBody) and self._authority.owner_of(body.id) != creator:
                answer_end(turn, open_request, self._book)  # it ends nothing, as other members find too
            else:
                decide_request(Turn(self._clock, turn.out), open_request, self._authority, self._book, self._epoch)
            return
        try:
            request = decode_request(payload)
        except DecodeError:
            return
        body = request.body
        if body.operator != creator or operator_of(body.vehicle) != creator:
            return
        if isinstance(body, EndBody):
            if self._authority.owner_of(body.id) == creator:
                self._authority.end(self._clock, body.id)
            return
        decision = self._authority.follow(self._clock, request.intent(self._epoch))
        tell_overruled(turn, decision, self._book, self._epoch)


def make_membership(stakes: Mapping[str, int], secrets: Mapping[str, bytes]) -> Membership:
    """The membership of members with these stakes and private keys."""
    return Membership(dict(stakes), {member: public_of(secret) for member, secret in secrets.items()})
