"""Equivocation: an operator's node of the hashgraph tells half of the others of one claim, and half of another one."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.approval.hashgraph import ByzantineMember, find_peers, make_second_event, tell
from skyrange.attack.bases.approval.links import CorridorClaim


@sky.attack(
    "approval.equivocate",
    technique="T0856",
    effect="nodes that decide on different claims for one corridor, if a third of all stake or more is byzantine; "
    "otherwise at most one of the claims is accepted, and the pair of events is a proof",
    knowledge="the keys of its own node, the members of the hashgraph",
    budget="one message of about 3 kB to each other node",
    load="the sham: as many messages of the same length, without an event",
    content="one claim, told to all",
)
class Corridor(ByzantineMember, CorridorClaim):
    """Books a corridor twice: tells half of the nodes of a hashgraph of one claim, and half of another.

    Both claims are in events that name the same event before them, so that each half takes its own for the operator's
    next.
    """

    every_s: float = 1.0
    times: int = 1
    members: tuple[str, ...]
    """Operators of the other nodes, in order: every second one is told of the second event."""
    flight: str
    """Of a tap: the flight of which its member is told."""

    def build(self, context: sky.AttackContext) -> sky.Attack:
        self.members = tuple(find_peers(self.operator, context))
        return self.at_service(self.operator, context, alters=f"events of {self.operator}")

    def begin(self) -> None:
        first, _, second = self.link.partition(":")[2].partition("~")
        self.way, peer = ("fwd", second) if first == self.operator else ("rev", first)
        self.flight = ("twin-a", "twin-b")[self.members.index(peer) % 2]
        super().begin()

    def send(self, now: sky.Time) -> sky.Verdicts:
        """The second event after the member's first; the sham tells of none, with as many bytes."""
        request = self.make_request(self.make_intent(self.flight, now))
        payload = tell(make_second_event(self.operator, self.members[0], now, request, self.chance.seed))
        return [self.inject(tell().ljust(len(payload)) if self.sham else payload)]
