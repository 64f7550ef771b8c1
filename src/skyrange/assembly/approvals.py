"""Flight approvals of a scenario: one service for each kind, with the links that it brings along."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from skyrange.assembly.network import apply_link_rules
from skyrange.city.city import City
from skyrange.contracts.links import LinkSpec
from skyrange.core.chance import Chance
from skyrange.core.errors import ComponentError, InputError, Problem
from skyrange.core.ids import APPROVAL
from skyrange.core.time import from_seconds
from skyrange.core.volumes import Volume4D
from skyrange.scenario.model.scenario import Scenario
from skyrange.utm.airspace.solids import find_invalid
from skyrange.utm.contract import ApprovalContext, ApprovalPlugin, ApprovalService, Constraint


def build_approvals(scenario: Scenario, city: City | None) -> list[ApprovalService]:
    """The services, in the order in which operators name them; their links with the channels of the scenario's rules.

    Raises `InputError` for parameters that do not fit the scenario, and `ComponentError` for a service that leaves an
    operator without an agent.
    """
    kinds: dict[str, list[str]] = {}
    for operator in scenario.operators:
        kinds.setdefault(operator.approval, []).append(operator.id)
    constraints = _constraints(scenario)
    services = []
    for kind, operators in kinds.items():
        context = ApprovalContext(
            f"{APPROVAL}.{kind}",
            operators,
            scenario.origin.datum,
            scenario.epoch,
            Chance(scenario.seed),
            city,
            constraints,
        )
        try:
            service = ApprovalPlugin.find(kind)(scenario.approval_params(kind), context)
        except InputError as error:
            problems = [Problem(f"approvals.{kind}.{f.where}", f.value, f.expected, f.hint) for f in error.problems]
            raise InputError(f"scenario {scenario.name}", problems) from error
        _check_ports(service, context)
        links: Sequence[LinkSpec] = [apply_link_rules(scenario, spec) for spec in service.links]
        services.append(replace(service, links=links))
    return services


def _constraints(scenario: Scenario) -> list[Constraint]:
    """The areas that are closed, on the ellipsoid and on the scenario's clock. Raises `InputError`."""
    origin = scenario.origin.datum
    ground_m = origin.ellipsoid_of(origin.alt_msl_m)
    constraints = []
    for number, table in enumerate(scenario.constraints):
        outline = tuple(
            (float(lat), float(lon))
            for lat, lon in (origin.geodetic_of(east, north) for east, north in table.corners_m)
        )
        times = from_seconds(table.start_s), from_seconds(table.end_s)
        volume = Volume4D(outline, ground_m + table.lower_m, ground_m + table.upper_m, *times)
        if find_invalid([volume]) is not None:
            where = f"constraints.{number}.corners_m"
            expected = "corners of an area, in order around it"
            raise InputError.one(f"scenario {scenario.name}", where, "corners whose edges cross", expected)
        constraints.append(Constraint(table.id, volume, from_seconds(table.published_s)))
    return constraints


def _check_ports(service: ApprovalService, context: ApprovalContext) -> None:
    served = [port for agent in service.agents for port in agent.ports]
    for operator in context.operators:
        count = served.count(context.port(operator))
        if count != 1:
            problem = f"{count} of its agents have the port {context.port(operator)}, one has to"
            raise ComponentError(context.name, problem, "Use ApprovalContext.port")
