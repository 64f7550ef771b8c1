"""Which process runs which component, and which links cross between two of them?

A component is what has an address of its own in life: a ground station, the flight approval, a companion, a proxy.
World, oracle and autopilots are one: they share every tick.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from skyrange.agent.links import LinkSpec
from skyrange.core.errors import Fault, InputError, nearest
from skyrange.core.ids import owner_of
from skyrange.vehicle.onboard import ORACLE

WORLD: Final = "world"
"""The node of world, oracle, autopilots and attackers' radios."""
Group = Literal["component", "operator", "one"]
GROUPS: Final[tuple[Group, ...]] = ("component", "operator", "one")


@dataclass(frozen=True, slots=True)
class Node:
    """One process and the endpoints that live in it."""

    name: str
    endpoints: frozenset[str]


@dataclass(frozen=True, slots=True)
class Plan:
    """All processes of a range, the world's first, and the components that somebody else plays."""

    nodes: tuple[Node, ...]
    outside: frozenset[str]

    def home(self, endpoint: str) -> str:
        """The node where an endpoint lives; "" for one outside."""
        return next((node.name for node in self.nodes if endpoint in node.endpoints), "")

    def crossing(self, links: Sequence[LinkSpec]) -> Iterator[LinkSpec]:
        """The links that need a socket."""
        homes = {endpoint: node.name for node in self.nodes for endpoint in node.endpoints}
        for spec in links:
            if homes.get(spec.a, "") != homes.get(spec.b, ""):
                yield spec


def usual_group(components: int, cores: int | None = None) -> Group:
    """Every component its own process while there are at most eight for each core, else one per operator."""
    return "component" if components <= 8 * (cores or os.cpu_count() or 1) else "operator"


def plan(links: Sequence[LinkSpec], group: Group | None = None, outside: Sequence[str] = ()) -> Plan:
    """Deal the ends of all links out to processes. `InputError` where `outside` names what is no component.

    `outside` are components (`blue.gcs`, `blue/b1.companion`) that no process is started for: their sockets are left to
    programs that the range did not start.
    """
    ends = sorted({end for spec in links for end in (spec.a, spec.b)})
    parts = {end: component_of(end) for end in ends}
    movable = sorted({part for part in parts.values() if part != WORLD})
    strangers = [
        Fault("external", name, "a component", nearest(name, movable)) for name in outside if name not in movable
    ]
    if strangers:
        raise InputError("live", strangers)
    kind = group or usual_group(len(movable) + 1)
    dealt: dict[str, set[str]] = {WORLD: {ORACLE}}
    for end in ends:
        if parts[end] not in outside:
            dealt.setdefault(_node_of(parts[end], kind), set()).add(end)
    return Plan(tuple(Node(name, frozenset(own)) for name, own in dealt.items()), frozenset(outside))


def component_of(endpoint: str) -> str:
    """The component of an endpoint: itself, or the world."""
    role = endpoint.rpartition(".")[2]
    return endpoint if role in ("gcs", "companion", "proxy", "approval") else WORLD


def _node_of(component: str, group: Group) -> str:
    if group == "one" or component == WORLD:
        return WORLD
    if group == "component" or "." not in component:
        return component
    return owner_of(component).partition("/")[0]
