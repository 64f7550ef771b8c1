"""Slow gossip: a member of the hashgraph tells the others late of what it knows and has heard.

In a hashgraph nobody sends votes; they follow from who has heard what from whom. So a byzantine member influences votes
only by what it tells to whom, and when. While members with a third of all stake or more are slow, everybody waits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import Field

from skyrange.attack.approval.uss_links import check_member, check_others, list_peers, uss_taps
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.on_path import Names, ScheduledTap, TapMaker
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number, Params
from skyrange.contracts.verdicts import Delay, Verdict
from skyrange.core.time import NS_PER_US, Time, from_seconds

_SHAM_NS = NS_PER_US


class SlowGossip(Params):
    """Who is slow, and towards whom."""

    operator: str = Field(description="Operator whose node is slow, such as 'red': the adversary.")
    members: Names = Field(
        default=(), description="Operators whose nodes are told late, such as ['blue']; default: all others."
    )
    delay_s: Number = Field(default=2.0, gt=0, le=600, description="By how much later they are told, in seconds.")


@dataclass(slots=True)
class SlowTap(ScheduledTap):
    """Delays what leaves the node, in its order; the sham delays by 1 µs."""

    operator: str
    delay_ns: Time

    def act(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Delay it."""
        if not frame.src.endswith(f".{self.operator}"):
            return ()
        return (Delay(now + self.delay_ns),)


def make(params: SlowGossip, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for an operator without a node."""
    check_member(params.operator, context)
    peers = list_peers(params.operator, context)
    check_others(params.members, "members", params.operator, context)
    delay_ns = _SHAM_NS if context.sham else from_seconds(params.delay_s)
    maker = TapMaker(SlowTap, (context.schedule, params.operator, delay_ns))
    taps = uss_taps(params.operator, context, maker, others=params.members or peers)
    return Attack(taps=taps, exclusive=[Exclusive(f"gossip of {params.operator}")])


SLOW_GOSSIP = AttackPlugin(
    SlowGossip,
    make,
    "A member of a hashgraph tells others late of what it knows.",
    technique="T0830",
    surface=("uss",),
    persists="acts",
    effect="decisions come late for all, if the slow members have a third of all stake or more; otherwise only for "
    "the operator itself",
    threat=ThreatModel(
        knowledge="the members of the hashgraph",
        position="a member: an operator whose node is byzantine",
        equipment="a node of its own",
        budget="no frames of its own",
    ),
    controls=Controls(
        load="none, because it adds no load",
        content="the sham: the same frames, delayed by 1 µs",
        placement="an operator without stake",
    ),
)
