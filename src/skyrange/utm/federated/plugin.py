"""Flight approval by a federation as a plugin: a USS for each operator or group of operators, and a DSS."""

from __future__ import annotations

from hashlib import blake2b
from itertools import combinations
from typing import Final

from pydantic import Field

from skyrange.contracts.components import Agent
from skyrange.contracts.links import Channel, LinkSpec
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.extras import require_extra
from skyrange.core.ids import ID_PATTERN, Port, link_name
from skyrange.core.time import NS_PER_MS
from skyrange.utm.authority import AlternativeParams
from skyrange.utm.contract import AIRSPACE, DSS, ApprovalContext, ApprovalPlugin, ApprovalService

LATENCY_NS: Final = 20 * NS_PER_MS
"""Of the links between services, unless the scenario has another channel for them."""


class FederatedParams(AlternativeParams):
    """Which USS serves which operators, and limits of the alternatives that are offered."""

    services: dict[str, tuple[str, ...]] = Field(
        default_factory=dict,
        max_length=64,
        description="USSs by name, each with the operators that it serves, such as { north = ['blue', 'green'] }; an "
        "operator that none serves has a USS of its own, of its name.",
    )


def make(params: FederatedParams, context: ApprovalContext) -> ApprovalService:
    """The DSS, the USSs and their links. Raises `InputError` for services that do not fit the scenario, and
    without the packages of the extra.
    """
    services = _assign(params, context)
    require_extra("utm", context.name)
    from skyrange.utm.federated.constraint_manager import ConstraintManager
    from skyrange.utm.federated.dss.service import Dss
    from skyrange.utm.federated.exchanges import KnownPeers, Peer
    from skyrange.utm.federated.tokens import TokenChecker, TokenStore, public_of
    from skyrange.utm.federated.uss.service import Uss

    names = [DSS, *services, *([AIRSPACE] if context.constraints else [])]
    links = {
        pair: LinkSpec(
            link_name("uss", "~".join(pair)),
            context.endpoint(pair[0]),
            context.endpoint(pair[1]),
            Channel(mode="reliable", latency_ns=LATENCY_NS),
        )
        for pair in combinations(names, 2)
    }

    def port(here: str, there: str) -> Port:
        link = links.get((here, there)) or links[there, here]
        return Port(context.endpoint(here), link.name)

    def base_url(name: str) -> str:
        return f"https://{context.endpoint(name)}"

    secret = _secret(context, "authorization")
    public = public_of(secret)
    ports = [port(DSS, name) for name in names if name != DSS]

    def peers(name: str) -> KnownPeers:
        others = (other for other in names if other not in (DSS, name))
        return KnownPeers({base_url(other): Peer(other, port(name, other)) for other in others})

    checker = TokenChecker(frozenset({DSS}), (public,), context.epoch)
    agents: list[Agent] = [Dss(f"{context.name}.{DSS}", ports, checker, _secret(context, "OVN"), context.epoch)]
    for name, operators in services.items():
        agents.append(
            Uss(
                f"{context.name}.{name}",
                name,
                operators=[(operator, context.port(operator)) for operator in operators],
                dss=Peer(DSS, port(name, DSS)),
                directory=peers(name),
                base_url=base_url(name),
                tokens=TokenStore(name, secret, context.epoch),
                checker=TokenChecker(frozenset({name}), (public,), context.epoch),
                limits=params.limits,
                epoch=context.epoch,
                constraints=bool(context.constraints),
            )
        )
    if context.constraints:
        agents.append(
            ConstraintManager(
                f"{context.name}.{AIRSPACE}",
                dss=Peer(DSS, port(AIRSPACE, DSS)),
                directory=peers(AIRSPACE),
                base_url=base_url(AIRSPACE),
                tokens=TokenStore(AIRSPACE, secret, context.epoch),
                checker=TokenChecker(frozenset({AIRSPACE}), (public,), context.epoch),
                constraints=context.constraints,
                epoch=context.epoch,
            )
        )
    return ApprovalService(agents, list(links.values()))


def _assign(params: FederatedParams, context: ApprovalContext) -> dict[str, tuple[str, ...]]:
    """The USSs with their operators. Raises `InputError`."""
    known = list(context.operators)
    problems = []
    served: dict[str, str] = {}
    for name, operators in params.services.items():
        where = f"services.{name}"
        if not ID_PATTERN.fullmatch(name) or name in (DSS, AIRSPACE):
            problems.append(
                Problem(where, repr(name), f"a name of letters, digits, - and _, other than {DSS!r} and {AIRSPACE!r}")
            )
        if not operators:
            problems.append(Problem(where, "[]", "at least one operator"))
        for operator in operators:
            if operator not in known:
                expected = "an operator with this approval"
                problems.append(Problem(where, repr(operator), expected, nearest(operator, known)))
            elif operator in served:
                expected = f"an operator that no other USS serves; {served[operator]} does"
                problems.append(Problem(where, repr(operator), expected))
            served.setdefault(operator, name)
    for operator in known:
        if operator not in served and (operator in (DSS, AIRSPACE) or operator in params.services):
            expected = f"a USS for operator {operator!r}: its name is that of another service"
            problems.append(Problem("services", "none", expected, f"services = {{ uss-{operator} = ['{operator}'] }}"))
    if problems:
        raise InputError(context.name, problems)
    unserved = {operator: (operator,) for operator in known if operator not in served}
    return {**params.services, **unserved}


def _secret(context: ApprovalContext, what: str) -> bytes:
    """A key of the range, 32 bytes, which follows from the seed."""
    key = context.chance.seed.to_bytes(16, "big", signed=True)
    return blake2b(f"federated {what}".encode(), key=key, digest_size=32).digest()


FEDERATED = ApprovalPlugin(
    FederatedParams,
    make,
    "Has a USS for each operator or group of operators, and a DSS, after ASTM F3548-21; none approves, each checks "
    "against what the others share.",
)
