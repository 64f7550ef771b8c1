"""Equivocation: an operator's node of the hashgraph tells half of the others of one claim, and half of another one.

Both claims are in events that name the same event before them, so that each half takes its own for the operator's next.
"""

from __future__ import annotations

from typing import Final

import skyrange.plugin as sky
from skyrange.attack.bases.approval import check_member, list_peers
from skyrange.attack.bases.corridor import CorridorClaim
from skyrange.utm.hashgraph.events import NO_PARENT, Event
from skyrange.utm.hashgraph.messages import EventMessage, Gossip, GossipBody, encode
from skyrange.utm.hashgraph.signatures import secret_of, sign

_FLIGHTS: Final = ("twin-a", "twin-b")


@sky.attack(
    "approval.equivocate",
    technique="T0856",
    surface=("uss",),
    effect="nodes that decide on different claims for one corridor, if a third of all stake or more is byzantine; "
    "otherwise at most one of the claims is accepted, and the pair of events is a proof",
    knowledge="the keys of its own node, the members of the hashgraph",
    position="a member: an operator whose node is byzantine",
    equipment="a node of its own",
    budget="one message of about 3 kB to each other node",
    load="the sham: as many messages of the same length, without an event",
    content="one claim, told to all",
    placement="an operator without stake",
)
class Corridor(CorridorClaim):
    """Books a corridor twice: tells half of the nodes of a hashgraph of one claim, and half of another."""

    members: tuple[str, ...]
    """Operators of the other nodes, in order: every second one is told of the second event."""
    flight: str
    """Of a tap: the flight of which its member is told."""

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """Taps at the node. Raises `InputError` for an operator without a node."""
        check_member(self.operator, context)
        self.members = tuple(list_peers(self.operator, context))
        self.when = sky.Repetition(self.schedule, sky.NS_PER_S, times=1)
        return self.at_service(self.operator, context, alters=f"events of {self.operator}")

    def begin(self) -> None:
        first, _, second = self.link.partition(":")[2].partition("~")
        self.way, peer = ("fwd", second) if first == self.operator else ("rev", first)
        self.flight = _FLIGHTS[self.members.index(peer) % 2]

    def send(self, now: sky.Time, turn: int) -> bytes:
        """The second event after the member's first; of the sham one that is known, as long as the other."""
        payload = self.make_request(self.make_intent(self.flight, now))
        mine = Event(self.operator, NO_PARENT, NO_PARENT, 0)
        theirs = Event(self.members[0], NO_PARENT, NO_PARENT, 0)
        secret = secret_of(self.chance.seed, self.operator)
        event = sign(Event(self.operator, mine.hash, theirs.hash, now, (payload,)), secret)
        message = encode(Gossip(method="POST", body=GossipBody(events=(EventMessage.of(event),))))
        if not self.sham:
            return message
        return encode(Gossip(method="POST", body=GossipBody())).ljust(len(message))
