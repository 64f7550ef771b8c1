"""Links of one service of a flight approval to the others, and a tap at its end of each."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

from skyrange.attack.contract import AttackContext
from skyrange.attack.on_path import USS
from skyrange.contracts.components import Tap
from skyrange.contracts.links import TapPlacement
from skyrange.core.errors import InputError, nearest
from skyrange.utm.federated.names import AIRSPACE, DSS


def _pairs(context: AttackContext) -> list[tuple[str, str]]:
    names = [name.partition(":")[2] for name in context.links if name.startswith(f"{USS}:")]
    return [(one, other) for one, _, other in (name.partition("~") for name in names)]


def check_uss(uss: str, context: AttackContext) -> None:
    """Raise `InputError` for a USS that the scenario does not have."""
    known = sorted({other for one, other in _pairs(context) if one == DSS and other != AIRSPACE})
    if uss not in known:
        hint = nearest(uss, known) or 'Set approval = "federated" for its operator.'
        raise InputError.one(context.id, "uss", repr(uss), "a USS of the scenario", hint)


def check_member(operator: str, context: AttackContext) -> None:
    """Raise `InputError` for an operator without a node of a hashgraph of three members at least."""
    peers = list_peers(operator, context)
    if len(peers) < 2 or DSS in (operator, *peers):
        expected = "an operator whose approval is hashgraph, with two others at least"
        raise InputError.one(context.id, "operator", repr(operator), expected)


def check_others(names: Sequence[str], key: str, operator: str, context: AttackContext) -> None:
    """Raise `InputError` for a name, of those of the parameter `key`, that is no other member of the hashgraph."""
    peers = list_peers(operator, context)
    for place, name in enumerate(names):
        if name not in peers:
            hint = nearest(name, peers)
            raise InputError.one(context.id, f"{key}.{place}", repr(name), "another member of the hashgraph", hint)


def check_constraint_manager(context: AttackContext) -> None:
    """Raise `InputError` for a scenario without a constraint manager."""
    if (DSS, AIRSPACE) not in _pairs(context):
        hint = 'Add [[constraints]], and set approval = "federated" for an operator.'
        raise InputError.one(context.id, "kind", "approval.poisoned_constraint", "a scenario with constraints", hint)


def list_peers(service: str, context: AttackContext) -> list[str]:
    """The services to which one has links, in order."""
    return sorted(one for pair in _pairs(context) if service in pair for one in pair if one != service)


def uss_taps(
    service: str, context: AttackContext, make: Callable[[str], Tap], others: Collection[str] | None = None
) -> list[TapPlacement]:
    """A tap at the service's end of each of its links, or of those to some `others`."""
    own = [pair for pair in _pairs(context) if service in pair and (others is None or not set(pair).isdisjoint(others))]
    return [TapPlacement(f"{USS}:{one}~{other}", service, make) for one, other in own]
