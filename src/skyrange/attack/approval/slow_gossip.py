"""Slow gossip: a member of the hashgraph tells the others late of what it knows and has heard."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.approval.hashgraph import ByzantineMember, find_peers
from skyrange.attack.bases.frame_acts import SHAM_NS
from skyrange.attack.tapped_links import Names


@sky.attack(
    "approval.slow_gossip",
    technique="T0830",
    persists="acts",
    effect="decisions come late for all, if the slow members have a third of all stake or more; otherwise only for the "
    "operator itself",
    knowledge="the members of the hashgraph",
    load="none, because it adds no load",
    content="the sham: the same frames, delayed by 1 µs",
)
class SlowGossip(ByzantineMember):
    """A member of a hashgraph tells others late of what it knows.

    What leaves its node is delayed, in its order; the sham delays by 1 µs.
    """

    operator: str = sky.param("Operator whose node is slow, such as 'red': the adversary.")
    members: Names = sky.param("Operators who are told late, such as ['blue']; default: all others.", default=())
    delay_s: sky.Number = sky.param("By how much later they are told, in seconds.", default=2.0, gt=0, le=600)
    delay_ns: sky.Time

    def build(self, context: sky.AttackContext) -> sky.Attack:
        self.delay_ns = SHAM_NS if self.sham else sky.from_seconds(self.delay_s)
        peers = find_peers(self.operator, context, members=self.members)
        gossip = f"gossip of {self.operator}"
        return self.at_service(self.operator, context, alters=gossip, others=self.members or peers)

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        return (sky.Delay(now + self.delay_ns),) if self.leaves(frame) else ()
