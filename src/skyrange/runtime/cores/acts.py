"""Attacks, faults, defences and detectors on several cores: what of them has to be on the first core.

The taps of an attack act each on its link alone, unless they share state or a trigger starts them: they may be on any
core. All else is on the first core, with the operators whose links, sensors, bodies or positions it has to do with.
Agents of attacks are there too, and reach the others over links.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from skyrange.assembly.build import Acts, stay_elsewhere
from skyrange.contracts.links import Act, LinkSpec, TapPlacement
from skyrange.contracts.monitors import find_ends
from skyrange.core.ids import operator_of, owner_of
from skyrange.kernel import Wiring
from skyrange.radio.oracle import ENDPOINT as ORACLE


@dataclass(frozen=True, slots=True)
class Binding:
    """What is on the first core because of attacks, faults, defences and detectors."""

    operators: Mapping[str, str]
    """Operators, each with the id of what keeps it there."""
    divisible: frozenset[str]
    """Ids of those whose taps may be on any core."""


UNBOUND = Binding({}, frozenset())


def bind_operators(acts: Acts, operators: Container[str]) -> Binding:
    """Find which `operators` have to be on the first core."""
    bound: dict[str, str] = {}
    divisible = set()
    for plan in acts.plans:
        taps = [tap for tap in acts.taps if tap.attack == plan.id]
        if _is_divisible(plan, taps):
            divisible.add(plan.id)
            continue
        for name in (*_list_vehicles(plan), *_list_tapped(taps, acts.links)):
            if operator_of(name) in operators:
                bound.setdefault(operator_of(name), plan.id)
    ends = [(spec.name, spec.a, spec.b) for spec in acts.links]
    for placement in acts.monitors:
        for port in find_ends(placement, ends):
            operator = operator_of(owner_of(port.endpoint))
            if operator in operators:
                bound.setdefault(operator, placement.id)
    return Binding(bound, frozenset(divisible))


def keep_own_acts(wiring: Wiring, divisible: Container[str]) -> Wiring:
    """What another core than the first has of a wiring: the taps of the attacks `divisible`, and no detectors."""
    return replace(
        wiring,
        acts=[stay_elsewhere(plan) for plan in wiring.acts if plan.id in divisible],
        taps=[tap for tap in wiring.taps if tap.attack in divisible],
        monitors=[],
    )


def _is_divisible(plan: Act, taps: Sequence[TapPlacement]) -> bool:
    alone = plan.trigger is None and not plan.one_process and not plan.is_defence
    return alone and not plan.sensor_hooks and not plan.body_hooks and all(tap.side != ORACLE for tap in taps)


def _list_vehicles(plan: Act) -> Iterator[str]:
    """The vehicles that an attack has to do with beside its taps."""
    for fault in plan.sensor_hooks:
        yield from fault.vehicles
    for body_fault in plan.body_hooks:
        yield from body_fault.vehicles
    if plan.trigger is not None:
        yield from plan.trigger.vehicles


def _list_tapped(taps: Sequence[TapPlacement], links: Sequence[LinkSpec]) -> Iterator[str]:
    """The owners of the ends at which taps are; of an end at the oracle, which all share, the owner of the link."""
    for spec in links:
        for end in (end for tap in taps for end in tap.find_ends(spec)):
            yield spec.name.split(":", 1)[1] if end == ORACLE else owner_of(end)
