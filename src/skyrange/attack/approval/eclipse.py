"""Eclipse: a node of the hashgraph and other members do not hear each other."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.approval.hashgraph import find_peers
from skyrange.attack.tapped_links import Names


@sky.attack(
    "approval.eclipse",
    technique="T0814",
    counterfactual="mute",
    persists="acts",
    effect="the operator gets no decision: its aircraft stay on the ground, or fly within what was accepted; the "
    "others go on while they have more than two thirds of all stake",
    knowledge="the addresses of the members",
    position="all ways between the node and the members that are not let through, such as its provider",
    load="none, because it adds no load",
    content="none, because a dropped frame has no content; compare with the muted run",
    placement="the node of an operator that asks for nothing meanwhile",
)
class Eclipse(sky.OnApproval):
    """Cuts the node of an operator off from other members of a hashgraph."""

    operator: str = sky.param("Operator whose node is cut off, such as 'blue'.")
    through: Names = sky.param(
        "Operators whose nodes still reach it, such as the adversary's; default: none.", default=()
    )
    act = sky.drop()

    def build(self, context: sky.AttackContext) -> sky.Attack:
        peers = find_peers(self.operator, context, through=self.through)
        if len(self.through) == len(peers):
            raise sky.InputError.one(context.id, "through", repr(list(self.through)), "fewer than all other members")
        others = set(peers) - set(self.through)
        return self.at_service(self.operator, context, alters=f"gossip of {self.operator}", others=others)
