"""Slow gossip: a member of the hashgraph tells the others late of what it knows and has heard.

In a hashgraph nobody sends votes; they follow from who has heard what from whom. So a byzantine member influences votes
only by what it tells to whom, and when. While members with a third of all stake or more are slow, everybody waits.
"""

from __future__ import annotations

from skyrange.attack.bases.approval import OnApproval, check_member, check_others, list_peers
from skyrange.attack.bases.frame_acts import SHAM_NS
from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import attack
from skyrange.attack.presets import acts_as_member, adds_no_load
from skyrange.attack.tapped_links import Names
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param
from skyrange.contracts.verdicts import Delay, Verdicts
from skyrange.core.time import Time, from_seconds


@attack(
    "approval.slow_gossip",
    technique="T0830",
    surface=("uss",),
    persists="acts",
    effect="decisions come late for all, if the slow members have a third of all stake or more; otherwise only for "
    "the operator itself",
    threat=acts_as_member("the members of the hashgraph"),
    controls=adds_no_load(
        content="the sham: the same frames, delayed by 1 µs",
        placement="an operator without stake",
    ),
)
class SlowGossip(OnApproval):
    """A member of a hashgraph tells others late of what it knows.

    What leaves its node is delayed, in its order; the sham delays by 1 µs.
    """

    operator: str = param("Operator whose node is slow, such as 'red': the adversary.")
    members: Names = param("Operators whose nodes are told late, such as ['blue']; default: all others.", default=())
    delay_s: Number = param("By how much later they are told, in seconds.", default=2.0, gt=0, le=600)
    delay_ns: Time

    def prepare(self, context: AttackContext) -> None:
        """Convert the delay."""
        self.delay_ns = SHAM_NS if self.sham else from_seconds(self.delay_s)

    def build(self, context: AttackContext) -> Attack:
        """Taps at the node. Raises `InputError` for an operator without a node."""
        check_member(self.operator, context)
        check_others(self.members, "members", self.operator, context)
        others = self.members or list_peers(self.operator, context)
        return self.at_service(self.operator, context, alters=f"gossip of {self.operator}", others=others)

    def act(self, now: Time, frame: Frame) -> Verdicts:
        """Delay what leaves the node."""
        return (Delay(now + self.delay_ns),) if frame.src.endswith(f".{self.operator}") else ()
