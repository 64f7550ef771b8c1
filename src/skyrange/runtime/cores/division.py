"""Division of a scenario's operators among cores, and the reasons for which a scenario cannot be divided.

The taps of an attack act each on its link alone, unless they share state or a trigger starts them: they may be on any
core. All else is on the first core, with the operators whose links, sensors, bodies or positions it has to do with.
Agents of attacks are there too, and reach the others over links.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from skyrange.assembly.build import Acts, list_acts, stay_elsewhere
from skyrange.contracts.links import Act, LinkSpec, TapPlacement
from skyrange.contracts.monitors import find_ends
from skyrange.core.ids import Port, endpoint, operator_of, owner_of, vehicle_id
from skyrange.core.time import Time
from skyrange.kernel import Wiring
from skyrange.radio.contract import BUILTIN
from skyrange.radio.oracle import ENDPOINT as ORACLE
from skyrange.scenario.model.fleet import Vehicle
from skyrange.scenario.model.scenario import Scenario


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
    alone = plan.trigger is None and not plan.manual and not plan.one_process and not plan.is_defence
    hooked = plan.sensor_hooks or plan.body_hooks or plan.scan_hooks
    return alone and not hooked and all(tap.side != ORACLE for tap in taps)


def _list_vehicles(plan: Act) -> Iterator[str]:
    """The vehicles that an attack has to do with beside its taps."""
    for fault in plan.sensor_hooks:
        yield from fault.vehicles
    for body_fault in plan.body_hooks:
        yield from body_fault.vehicles
    for scan_hook in plan.scan_hooks:
        yield from scan_hook.vehicles
    if plan.trigger is not None:
        yield from plan.trigger.vehicles


def _list_tapped(taps: Sequence[TapPlacement], links: Sequence[LinkSpec]) -> Iterator[str]:
    """The owners of the ends at which taps are; of an end at the oracle, which all share, the owner of the link."""
    for spec in links:
        for end in (end for tap in taps for end in tap.find_ends(spec)):
            yield spec.name.split(":", 1)[1] if end == ORACLE else owner_of(end)


_ROLES = ("companion", "proxy", "autopilot")
MIN_VEHICLES = 50
"""Aircraft on each core below which a division costs more than it gains, as measured: docs/data/cores.json."""
MIN_ON_AIR = 200
"""The same where they broadcast Remote ID: each core computes the medium for all."""


@dataclass(frozen=True, slots=True)
class Division:
    """Which operators are on which core, and why there are fewer cores than asked for, or ""."""

    operators: tuple[tuple[str, ...], ...]
    reason: str = ""
    binding: Binding = UNBOUND

    @property
    def cores(self) -> int:
        """The number of cores."""
        return len(self.operators)

    def vehicles(self, scenario: Scenario, core: int) -> list[str]:
        """The aircraft on a core, in the order of the scenario."""
        own_operators = frozenset(self.operators[core])
        return [
            vehicle_id(operator.id, vehicle.id) for operator, vehicle in scenario.fleet if operator.id in own_operators
        ]

    def endpoints(self, scenario: Scenario, core: int) -> Endpoints:
        """The endpoints on a core. All have the oracle; the first has all that belongs to no operator."""
        owned = {
            end: number
            for number, operators in enumerate(self.operators)
            for end in (
                *(endpoint(operator, "gcs") for operator in operators),
                *(endpoint(vehicle, role) for vehicle in self.vehicles(scenario, number) for role in _ROLES),
            )
        }
        return Endpoints(core, owned)


_PROGRAM = 25
_IN_COMMON = "may have to do with all operators in common"


class Endpoints:
    """The endpoints on one core."""

    def __init__(self, core: int, owned: Mapping[str, int]) -> None:
        """`owned` has the core of each endpoint that belongs to an operator."""
        self._core = core
        self._owned = owned

    def __contains__(self, name: object) -> bool:
        return name == ORACLE or self.core_of(name) == self._core

    def core_of(self, name: object) -> int:
        """The core of an endpoint, apart from the oracle."""
        return self._owned.get(name, 0) if isinstance(name, str) else 0


def divide(scenario: Scenario, cores: int) -> Division:
    """Divide the operators among at most `cores` cores, so that each has about as many aircraft.

    An operator's ground station and its MAVLink networks stay together. Raises `InputError` for attacks, faults,
    defences and detectors that cannot be made.
    """
    everyone = tuple(operator.id for operator in scenario.operators)
    if cores <= 1:
        return Division((everyone,))
    weights = {operator.id: sum(map(_weigh, operator.vehicles)) for operator in scenario.operators}
    reason = next(_find_obstacles(scenario), "")
    if reason:
        return Division((everyone,), reason)
    least = MIN_VEHICLES if scenario.radio is None else MIN_ON_AIR
    cpus = len(available_cpus())
    count = min(cores, cpus, len(everyone), max(sum(weights.values()) // least, 1))
    if count < min(cores, cpus, len(everyone)):
        air = "" if scenario.radio is None else " that broadcast"
        reason = f"a core pays for {least} aircraft{air} or more{_count_aircraft(scenario)}"
    elif count < min(cores, len(everyone)):
        reason = f"this process may use {cpus} CPUs"
    elif count < cores:
        reason = f"operators are divided among the cores, and there are {len(everyone)}"
    if count == 1:
        return Division((everyone,), reason)
    binding = _bind(scenario)
    free = len(everyone) - len(binding.operators)
    if free < count - bool(binding.operators):
        count = free + bool(binding.operators)
        kept = f"keeps {len(binding.operators)} operators on one core" if free else _IN_COMMON
        reason = f"{_quote(binding.operators.values())} {kept}"
    if count == 1:
        return Division((everyone,), reason)
    dealt: list[list[str]] = [[] for _ in range(count)]
    loads = [0] * count
    for operator in sorted(everyone, key=lambda candidate: (candidate not in binding.operators, -weights[candidate])):
        core = 0 if operator in binding.operators else loads.index(min(loads))
        dealt[core].append(operator)
        loads[core] += weights[operator]
    return Division(tuple(tuple(sorted(part, key=everyone.index)) for part in dealt), reason, binding)


def available_cpus() -> list[int]:
    """The CPUs that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def _weigh(vehicle: Vehicle) -> int:
    """What an aircraft costs, in aircraft with the builtin autopilot: a program of its own much more."""
    return 1 if vehicle.autopilot == "builtin" else _PROGRAM


def _count_aircraft(scenario: Scenario) -> str:
    vehicles = [vehicle for _, vehicle in scenario.fleet]
    programs = any(_weigh(vehicle) > 1 for vehicle in vehicles)
    return f", and there are {len(vehicles)}" + (f"; an autopilot program counts as {_PROGRAM}" if programs else "")


def _bind(scenario: Scenario) -> Binding:
    if not any((scenario.acts, scenario.defences, scenario.detectors)):
        return UNBOUND
    return bind_operators(list_acts(scenario), {operator.id for operator in scenario.operators})


def _quote(ids: Iterable[str]) -> str:
    return ", ".join(repr(name) for name in dict.fromkeys(ids))


def _find_obstacles(scenario: Scenario) -> Iterator[str]:
    """Why a scenario cannot be divided."""
    if any(attack.honest for attack in scenario.attacks):
        yield "real aircraft fly on the tracks that an attack claims"
    if scenario.radio is not None and scenario.radio.plugin is not BUILTIN:
        yield f"the radio engine {scenario.radio.engine} is one program"
    if any(scenario.over_air(f"gcs:{vehicle_id(operator.id, v.id)}") is not None for operator, v in scenario.fleet):
        yield "control links over the air share one spectrum"
    for kind in sorted({vehicle.autopilot for _, vehicle in scenario.fleet}):
        if kind == "external" or getattr(scenario.autopilots.params_of(kind), "physics", "") == "native":
            yield f"{kind} autopilots run on the machine's clock"
    if len(scenario.operators) < 2:
        yield "all aircraft belong to one operator, whose ground station is one program"
    if "fork" not in multiprocessing.get_all_start_methods():
        yield "this system cannot fork processes"


def find_service_times(wiring: Wiring) -> dict[Port, Time]:
    """How often the owner of each agent's port is served."""
    agents = [*wiring.agents, *(agent for plan in wiring.acts for agent in plan.agents)]
    return {port: agent.service_ns for agent in agents for port in agent.ports}


class Crossing(NamedTuple):
    """A link between cores in one direction: its shortest delay, and how often its sender is served."""

    latency_ns: Time
    service_ns: Time


class Barriers(NamedTuple):
    """When cores exchange what crosses between them."""

    period_ns: Time
    lag: int
    """How many barriers later a core needs what others posted at one: 0, then all wait for the slowest at every
    barrier, or 1, then none waits for one that is less than a period behind.
    """


def find_barriers(crossings: Iterable[Crossing], quantum_ns: Time, at_most_ns: Time) -> Barriers:
    """The longest time between two barriers, in whole ticks, at which no frame arrives late on another core.

    A frame may be sent at any multiple of its sender's service time. It is posted at the next barrier, at or after it
    was sent, passed on `lag` barriers later, and arrives at least a latency after it was sent. It is in time if its
    arrival is later than that: either `lag + 1` periods are at most the latency, or the sender is served only at
    barriers, and `lag` periods are less than the latency. The lag is 1, unless that would need barriers more than
    twice as often as 0.
    """
    links = list(crossings)
    steps = range(at_most_ns - at_most_ns % quantum_ns, 0, -quantum_ns)
    at_once, lagging = (
        next((step for step in steps if all(_is_in_time(link, step, lag) for link in links)), 0) for lag in (0, 1)
    )
    return Barriers(lagging, 1) if 2 * lagging >= max(at_once, 1) else Barriers(at_once or quantum_ns, 0)


def _is_in_time(link: Crossing, step: Time, lag: int) -> bool:
    served_at_barriers = link.service_ns > 0 and link.service_ns % step == 0
    return link.latency_ns >= (lag + 1) * step or (served_at_barriers and link.latency_ns > lag * step)
