"""Eclipse: a node of the hashgraph hears no other members but those that the adversary lets through, and they not it.

Its operator gets no decision. The others go on while they have more than two thirds of all stake.
"""

from __future__ import annotations

from skyrange.attack.bases.approval import OnApproval, check_member, check_others, list_peers
from skyrange.attack.bases.frame_acts import drop
from skyrange.attack.contract import Attack, AttackContext, ThreatModel
from skyrange.attack.declaration import attack
from skyrange.attack.presets import adds_no_load
from skyrange.attack.tapped_links import Names
from skyrange.contracts.plugins.fields import param
from skyrange.core.errors import InputError


@attack(
    "approval.eclipse",
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
    controls=adds_no_load(
        content="none, because a dropped frame has no content; compare with the muted run",
        placement="the node of an operator that asks for nothing meanwhile",
    ),
)
class Eclipse(OnApproval):
    """Cuts the node of an operator off from other members of a hashgraph."""

    operator: str = param("Operator whose node is cut off, such as 'blue'.")
    through: Names = param(
        "Operators whose nodes still reach it, such as those of the adversary; default: none.", default=()
    )

    def build(self, context: AttackContext) -> Attack:
        """Taps at the node. Raises `InputError` for an operator without a node."""
        check_member(self.operator, context)
        peers = list_peers(self.operator, context)
        check_others(self.through, "through", self.operator, context)
        if len(self.through) == len(peers):
            raise InputError.one(context.id, "through", repr(list(self.through)), "fewer than all other members")
        others = set(peers) - set(self.through)
        return self.at_service(self.operator, context, alters=f"gossip of {self.operator}", others=others)

    act = drop()
