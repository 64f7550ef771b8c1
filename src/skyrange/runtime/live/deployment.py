"""Assignment of a scenario's components to processes and machines, and the links between two processes.

A component has an address of its own in life: a ground station, the flight approval, a companion, a proxy.
World, oracle and autopilots are one component: they share every tick. The other machines join the one that runs it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from ipaddress import ip_address
from typing import Final, Literal

from skyrange.contracts.links import LinkSpec
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.ids import APPROVAL, owner_of
from skyrange.vehicle.onboard_network import ORACLE

WORLD: Final = "world"
"""The node with world, oracle, autopilots and attackers' radios."""
LOOPBACK: Final = "127.0.0.1"
Group = Literal["component", "operator", "host", "one"]


@dataclass(frozen=True, slots=True)
class Node:
    """One process, the endpoints in it, and the address of the machine on which it runs."""

    name: str
    endpoints: frozenset[str]
    host: str = LOOPBACK


@dataclass(frozen=True, slots=True)
class Deployment:
    """All processes of a range, the world's first, the components outside the range, and the machine of each."""

    nodes: tuple[Node, ...]
    outside: frozenset[str]
    hosts: Mapping[str, str]
    """Addresses of machines, by component."""

    @property
    def base(self) -> str:
        """The address of the machine on which the world and the supervisor run."""
        return self.nodes[0].host

    @property
    def others(self) -> tuple[str, ...]:
        """The addresses of the other machines, in order."""
        return tuple(sorted({node.host for node in self.nodes} - {self.base}))

    def node(self, name: str) -> Node:
        """The node of that name."""
        return next(node for node in self.nodes if node.name == name)

    def home(self, endpoint: str) -> str:
        """The name of the node that has an endpoint; "" for one outside the range."""
        return next((node.name for node in self.nodes if endpoint in node.endpoints), "")

    def host(self, endpoint: str) -> str:
        """The address of the machine of an endpoint, also for one outside the range."""
        return self.hosts[component_of(endpoint)]

    def crossing(self, links: Sequence[LinkSpec]) -> Iterator[LinkSpec]:
        """The links between two processes, which need a socket."""
        homes = {endpoint: node.name for node in self.nodes for endpoint in node.endpoints}
        for spec in links:
            if homes.get(spec.a, "") != homes.get(spec.b, ""):
                yield spec


def usual_group(components: int, cores: int | None = None) -> Group:
    """A process for each component while there are at most eight for each core, else one per operator."""
    return "component" if components <= 8 * (cores or os.cpu_count() or 1) else "operator"


def assign_components(
    links: Sequence[LinkSpec],
    group: Group | None = None,
    outside: Sequence[str] = (),
    hosts: Mapping[str, str] | None = None,
) -> Deployment:
    """Assign the ends of all links to processes, each of which is on one of `hosts` (see `scenario.hosts`).

    `outside` are components (`blue.gcs`, `blue/b1.companion`) for which no process is started: their sockets are left
    to programs that the range did not start. Raises `InputError` if it or `hosts` name something that is no component.
    """
    ends = sorted({end for spec in links for end in (spec.a, spec.b)})
    parts = {end: component_of(end) for end in ends}
    components = sorted({WORLD, *parts.values()})
    movable = [part for part in components if part != WORLD]
    problems = [
        Problem("external", name, "a component", nearest(name, movable)) for name in outside if name not in movable
    ]
    where, wrong = _placed(components, hosts or {})
    if group == "one" and len(set(where.values())) > 1:
        problems.append(Problem("group", "one", "as many processes as hosts at least", "Choose --group host."))
    if problems or wrong:
        raise InputError("live", [*problems, *wrong])
    kind = group or usual_group(len(components))
    dealt: dict[tuple[str, str], set[str]] = {(WORLD, where[WORLD]): {ORACLE}}
    for end in ends:
        part = parts[end]
        if part not in outside:
            dealt.setdefault((_node_of(part, kind, where), where[part]), set()).add(end)
    nodes = tuple(Node(name, frozenset(endpoints), host) for (name, host), endpoints in dealt.items())
    return Deployment(nodes, frozenset(outside), where)


def component_of(endpoint: str) -> str:
    """The component of an endpoint: itself, or the world."""
    if endpoint.startswith(f"{APPROVAL}."):  # one of several agents of the approval
        return APPROVAL
    role = endpoint.rpartition(".")[2]
    return endpoint if role in ("gcs", "companion", "proxy", "approval") else WORLD


def _placed(components: Sequence[str], hosts: Mapping[str, str]) -> tuple[dict[str, str], list[Problem]]:
    """The address of each component, and what is wrong with `hosts`."""
    problems = []
    base = LOOPBACK
    for pattern, address in hosts.items():
        if not any(fnmatchcase(part, pattern) for part in components):
            problems.append(Problem("hosts", pattern, "a component of the scenario", nearest(pattern, components)))
        if fnmatchcase(WORLD, pattern):
            base = address
    where = {}
    for part in components:
        fitting = [address for pattern, address in hosts.items() if fnmatchcase(part, pattern)]
        where[part] = fitting[-1] if fitting else base
    if ip_address(base).is_loopback and not all(ip_address(address).is_loopback for address in where.values()):
        hint = 'Say at which address the others reach this machine: hosts.world = "ADDRESS".'
        problems.append(Problem("hosts.world", base, "an address that other machines reach", hint))
    return where, problems


def _node_of(component: str, group: Group, where: Mapping[str, str]) -> str:
    """The name of a component's process, with the machine if it holds several and is not on the world's."""
    host = where[component]
    at_base = host == where[WORLD]
    if component == WORLD or (at_base and group in ("one", "host")):
        return WORLD
    if group == "host":
        return host
    if group == "component" or "." not in component:
        return component
    operator = owner_of(component).partition("/")[0]
    return operator if at_base else f"{operator}@{host}"
