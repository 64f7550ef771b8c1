"""Flight approval by hashgraph consensus as a plugin: a node for each operator, and a link between any two."""

from __future__ import annotations

from itertools import combinations
from typing import Annotated

from pydantic import Field

from skyrange.contracts.links import Channel, LinkSpec
from skyrange.contracts.params import Number
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.ids import Port, link_name
from skyrange.core.time import NS_PER_MS, from_seconds
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.authority import AlternativeParams, Authority
from skyrange.utm.contract import ApprovalContext, ApprovalPlugin, ApprovalService

LATENCY_NS = 20 * NS_PER_MS
"""Of the links between nodes, unless the scenario has another channel for them."""


class HashgraphParams(AlternativeParams):
    """Gossip and stakes, and limits of the alternatives that are offered."""

    gossip_s: Number = Field(
        default=0.05, ge=0.01, le=60, description="Time between two calls of a node to another, in seconds."
    )
    stakes: dict[str, Annotated[int, Field(ge=0, le=1_000_000)]] = Field(
        default_factory=dict,
        description="Stakes of operators, by id; 1 for each that is not named. An operator whose stake was slashed, "
        "because it equivocated in an earlier run, has 0. Decisions are safe while less than a third of all stake is "
        "byzantine.",
    )


def make(params: HashgraphParams, context: ApprovalContext) -> ApprovalService:
    """The nodes. Raises `InputError` for stakes of unknown operators, or none at all."""
    operators = list(context.operators)
    problems = [
        Problem(f"stakes.{name}", str(stake), "an operator with this approval", nearest(name, operators))
        for name, stake in params.stakes.items()
        if name not in operators
    ]
    stakes = {operator: params.stakes.get(operator, 1) for operator in operators}
    if not problems and not any(stakes.values()):
        problems.append(Problem("stakes", "0 in all", "a stake above 0 of one operator at least"))
    if problems:
        raise InputError(context.name, problems)
    if len(operators) == 1:
        authority = Authority(params)
        agent = FlightApproval(operators, context.epoch, authority, name=context.name, constraints=context.constraints)
        return ApprovalService([agent])
    from skyrange.utm.hashgraph.events import secret_of
    from skyrange.utm.hashgraph.node import HashgraphNode, make_membership

    links = [
        LinkSpec(
            link_name("uss", f"{first}~{second}"),
            context.endpoint(first),
            context.endpoint(second),
            Channel(mode="reliable", latency_ns=LATENCY_NS),
        )
        for first, second in combinations(sorted(operators), 2)
    ]
    secrets = {operator: secret_of(context.chance.seed, operator) for operator in operators}
    membership = make_membership(stakes, secrets)
    nodes = []
    for operator in operators:
        here = context.endpoint(operator)
        peers = {}
        for link in links:
            if here in (link.a, link.b):
                other = link.b if link.a == here else link.a
                peers[other.partition(".")[2]] = Port(here, link.name)
        nodes.append(
            HashgraphNode(
                f"{context.name}.{operator}",
                operator,
                approval=context.port(operator),
                peers=peers,
                membership=membership,
                secret=secrets[operator],
                authority=Authority(params),
                epoch=context.epoch,
                chance=context.chance,
                gossip_ns=from_seconds(params.gossip_s),
                constraints=context.constraints,
            )
        )
    return ApprovalService(nodes, links)


HASHGRAPH = ApprovalPlugin(
    HashgraphParams,
    make,
    "Has a node for each operator; nodes order all requests by hashgraph consensus and decide on them alike.",
)
