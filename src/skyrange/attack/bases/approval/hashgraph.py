"""Byzantine members of a hashgraph: the base of kinds in which one acts, its peers, and its events."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from skyrange.attack.bases.approval.links import OnApproval, service_links
from skyrange.attack.contract import AttackContext
from skyrange.attack.declaration import Facts
from skyrange.core.errors import InputError, nearest
from skyrange.core.time import Time
from skyrange.utm.contract import DSS
from skyrange.utm.hashgraph.events import NO_PARENT, Event, secret_of, sign
from skyrange.utm.hashgraph.messages import EventMessage, Gossip, GossipBody, encode


class ByzantineMember(OnApproval):
    """Acts as a member of a hashgraph that does not tell others what it should.

    Nobody sends votes there: they follow from who has heard what from whom. So a member influences votes only by what
    it tells to whom, and when.
    """

    attack_facts: ClassVar[Facts] = {
        "surface": ("uss",),
        "position": "a member: an operator whose node is byzantine",
        "equipment": "a node of its own",
        "placement": "an operator without stake",
    }


def find_peers(operator: str, context: AttackContext, **params: Sequence[str]) -> list[str]:
    """The operators of the other nodes, in order.

    Raises `InputError` for an operator without a node of a hashgraph of three members at least, and for another name
    in a parameter with names of peers.
    """
    peers = sorted(peer for pair in service_links(context) if operator in pair for peer in pair if peer != operator)
    if len(peers) < 2 or DSS in (operator, *peers):
        expected = "an operator whose approval is hashgraph, with two others at least"
        raise InputError.one(context.id, "operator", repr(operator), expected)
    for key, names in params.items():
        for place, name in enumerate(names):
            if name not in peers:
                hint = nearest(name, peers)
                raise InputError.one(context.id, f"{key}.{place}", repr(name), "another member of the hashgraph", hint)
    return peers


def make_second_event(creator: str, peer: str, now: Time, transaction: bytes, seed: int) -> Event:
    """The signed event of a member that follows its own first event and that of a peer."""
    first, heard = (Event(member, NO_PARENT, NO_PARENT, 0) for member in (creator, peer))
    return sign(Event(creator, first.hash, heard.hash, now, (transaction,)), secret_of(seed, creator))


def tell(*events: Event) -> bytes:
    """The message that tells another member of events."""
    return encode(Gossip(method="POST", body=GossipBody(events=tuple(map(EventMessage.of, events)))))
