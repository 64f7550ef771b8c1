"""Slow gossip: a member of the hashgraph tells the others late of what it knows and has heard.

In a hashgraph nobody sends votes; they follow from who has heard what from whom. So a byzantine member influences votes
only by what it tells to whom, and when. While members with a third of all stake or more are slow, everybody waits.
"""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.approval import check_member, check_others, list_peers
from skyrange.attack.bases.frame_acts import SHAM_NS
from skyrange.attack.tapped_links import Names


@sky.attack(
    "approval.slow_gossip",
    technique="T0830",
    persists="acts",
    effect="decisions come late for all, if the slow members have a third of all stake or more; otherwise only for the "
    "operator itself",
    knowledge="the members of the hashgraph",
    position="a member: an operator whose node is byzantine",
    equipment="a node of its own",
    load="none, because it adds no load",
    content="the sham: the same frames, delayed by 1 µs",
    placement="an operator without stake",
)
class SlowGossip(sky.OnApproval):
    """A member of a hashgraph tells others late of what it knows.

    What leaves its node is delayed, in its order; the sham delays by 1 µs.
    """

    operator: str = sky.param("Operator whose node is slow, such as 'red': the adversary.")
    members: Names = sky.param(
        "Operators whose nodes are told late, such as ['blue']; default: all others.", default=()
    )
    delay_s: sky.Number = sky.param("By how much later they are told, in seconds.", default=2.0, gt=0, le=600)
    delay_ns: sky.Time

    def prepare(self, context: sky.AttackContext) -> None:
        self.delay_ns = SHAM_NS if self.sham else sky.from_seconds(self.delay_s)

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """Taps at the node. Raises `InputError` for an operator without a node."""
        check_member(self.operator, context)
        check_others(self.members, "members", self.operator, context)
        others = self.members or list_peers(self.operator, context)
        return self.at_service(self.operator, context, alters=f"gossip of {self.operator}", others=others)

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        return (sky.Delay(now + self.delay_ns),) if frame.src.endswith(f".{self.operator}") else ()
