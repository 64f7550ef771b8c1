"""Equivocation: an operator's node of the hashgraph tells half of the others of one claim, and half of another one.

Both claims are in events that name the same event before them, so that each half takes its own for the operator's next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from skyrange.attack.approval.claims import Corridor, check_operator, make_intent
from skyrange.attack.approval.uss_links import check_member, list_peers, uss_taps
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.on_path import InjectingTap, RepeatedSource, Repetition
from skyrange.contracts.verdicts import Direction
from skyrange.core.time import NS_PER_S, Time
from skyrange.utm.hashgraph.events import NO_PARENT, Event
from skyrange.utm.hashgraph.messages import EventMessage, Gossip, GossipBody, encode
from skyrange.utm.hashgraph.signatures import secret_of, sign
from skyrange.utm.messages import Request
from skyrange.utm.messages import encode as encode_request

_FLIGHTS: Final = ("twin-a", "twin-b")


@dataclass(slots=True)
class Equivocation(RepeatedSource):
    """One of the two events, which one member is told, once."""

    peer: str
    params: Corridor
    context: AttackContext
    members: tuple[str, ...]
    """Operators of the other nodes, in order: every second one is told of the second event."""

    def make(self, now: Time) -> Sequence[tuple[Direction, bytes]]:
        """The message."""
        if not self.when.take(now):
            return ()
        # the first end of a link is the one whose name comes first
        way: Direction = "fwd" if self.params.operator < self.peer else "rev"
        return [(way, self._message(now, self.members.index(self.peer) % 2))]

    def _message(self, now: Time, which: int) -> bytes:
        """The second event after the member's first; of the sham one that is known, as long as the other."""
        intent = make_intent(self.params, self.context, _FLIGHTS[which], now)
        payload = encode_request(Request.of(intent, self.context.epoch))
        mine = Event(self.params.operator, NO_PARENT, NO_PARENT, 0)
        theirs = Event(self.members[0], NO_PARENT, NO_PARENT, 0)
        secret = secret_of(self.context.chance.seed, self.params.operator)
        event = sign(Event(self.params.operator, mine.hash, theirs.hash, now, (payload,)), secret)
        message = encode(Gossip(method="POST", body=GossipBody(events=(EventMessage.of(event),))))
        if not self.context.sham:
            return message
        return encode(Gossip(method="POST", body=GossipBody())).ljust(len(message))


@dataclass(frozen=True, slots=True)
class _Maker:
    """Makes the tap of each link, with a clock of its own."""

    params: Corridor
    context: AttackContext
    members: tuple[str, ...]

    def __call__(self, link: str) -> InjectingTap:
        one, _, other = link.partition(":")[2].partition("~")
        peer = other if one == self.params.operator else one
        when = Repetition(self.context.schedule, NS_PER_S, times=1)
        return InjectingTap(link, Equivocation(when, peer, self.params, self.context, self.members))


def make(params: Corridor, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for an operator without a node."""
    check_operator(params, context)
    check_member(params.operator, context)
    members = tuple(list_peers(params.operator, context))
    taps = uss_taps(params.operator, context, _Maker(params, context, members))
    return Attack(taps=taps, exclusive=[Exclusive(f"events of {params.operator}")])


EQUIVOCATE = AttackPlugin(
    Corridor,
    make,
    "Books a corridor twice: tells half of the nodes of a hashgraph of one claim, and half of another.",
    technique="T0856",
    surface=("uss",),
    persists="flight",
    effect="nodes that decide on different claims for one corridor, if a third of all stake or more is byzantine; "
    "otherwise at most one of the claims is accepted, and the pair of events is a proof",
    threat=ThreatModel(
        knowledge="the keys of its own node, the members of the hashgraph",
        position="a member: an operator whose node is byzantine",
        equipment="a node of its own",
        budget="one message of about 3 kB to each other node",
    ),
    controls=Controls(
        load="the sham: as many messages of the same length, without an event",
        content="one claim, told to all",
        placement="an operator without stake",
    ),
)
