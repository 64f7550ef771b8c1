"""Links of one service of a flight approval to the others, and a tap at its end of each."""

from __future__ import annotations

from collections.abc import Callable

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


def check_constraint_manager(context: AttackContext) -> None:
    """Raise `InputError` for a scenario without a constraint manager."""
    if (DSS, AIRSPACE) not in _pairs(context):
        hint = 'Add [[constraints]], and set approval = "federated" for an operator.'
        raise InputError.one(context.id, "kind", "approval.poisoned_constraint", "a scenario with constraints", hint)


def list_peers(service: str, context: AttackContext) -> list[str]:
    """The services to which one has links, in order."""
    return sorted(one for pair in _pairs(context) if service in pair for one in pair if one != service)


def uss_taps(service: str, context: AttackContext, make: Callable[[str], Tap]) -> list[TapPlacement]:
    """A tap at the service's end of each of its links."""
    own = [pair for pair in _pairs(context) if service in pair]
    return [TapPlacement(f"{USS}:{one}~{other}", service, make) for one, other in own]
