"""Eclipse: a node of the hashgraph hears no other members but those that the adversary lets through, and they not it.

Its operator gets no decision. The others go on while they have more than two thirds of all stake.
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
from skyrange.contracts.params import Params
from skyrange.contracts.verdicts import Drop, Verdict
from skyrange.core.errors import InputError
from skyrange.core.time import Time

_DROP = (Drop(),)


class Eclipse(Params):
    """Whose node is cut off."""

    operator: str = Field(description="Operator whose node is cut off, such as 'blue'.")
    through: Names = Field(
        default=(), description="Operators whose nodes still reach it, such as those of the adversary; default: none."
    )


@dataclass(slots=True)
class SilentTap(ScheduledTap):
    """Lets nothing pass while the attack acts."""

    def act(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Drop it."""
        return _DROP


def make(params: Eclipse, context: AttackContext) -> Attack:
    """The attack. The sham drops the same frames, because no benign act takes a frame off a link.

    Raises `InputError` for an operator without a node.
    """
    check_member(params.operator, context)
    peers = list_peers(params.operator, context)
    check_others(params.through, "through", params.operator, context)
    if len(params.through) == len(peers):
        raise InputError.one(context.id, "through", repr(list(params.through)), "fewer than all other members")
    maker = TapMaker(SilentTap, (context.schedule,))
    taps = uss_taps(params.operator, context, maker, others=set(peers) - set(params.through))
    return Attack(taps=taps, exclusive=[Exclusive(f"gossip of {params.operator}")])


ECLIPSE = AttackPlugin(
    Eclipse,
    make,
    "Cuts the node of an operator off from other members of a hashgraph.",
    technique="T0814",
    counterfactual="mute",
    surface=("uss",),
    persists="acts",
    effect="the operator gets no decision: its aircraft stay on the ground, or fly within what was accepted; the "
    "others go on while they have more than two thirds of all stake",
    threat=ThreatModel(
        knowledge="the addresses of the members",
        position="all ways between the node and the members that are not let through, such as its provider",
        equipment="a computer that forwards the frames",
        budget="no frames of its own",
    ),
    controls=Controls(
        load="none, because it adds no load",
        content="none, because a dropped frame has no content; compare with the muted run",
        placement="the node of an operator that asks for nothing meanwhile",
    ),
)
