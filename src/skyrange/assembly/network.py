"""Links, routes and processing limits of a scenario: what every operator, aircraft and radio has, by its rules."""

from __future__ import annotations

from collections.abc import Mapping

from skyrange.contracts.links import Channel, LinkSpec, ProcessingLimit, Route, VariableChannel
from skyrange.core.ids import APPROVAL, endpoint, link_name, vehicle_id
from skyrange.core.time import NS_PER_MS
from skyrange.radio.oracle import ENDPOINT
from skyrange.scenario.model.links import endpoint_names, find_matches
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.onboard_network import onboard_links, onboard_routes, oracle_links, scan_link

APPROVAL_CHANNEL = Channel(mode="reliable", latency_ns=25 * NS_PER_MS)
"""A web service some tens of milliseconds away."""
ORACLE_CHANNEL = Channel(mode="reliable", latency_ns=NS_PER_MS)
"""Run control and what ground receivers hear: a message queue within one computing centre."""


def build_network(scenario: Scenario, over_air: Mapping[str, VariableChannel]) -> tuple[list[LinkSpec], list[Route]]:
    """All links and routes, without those that attacks and approvals bring along; `over_air` has channels by link."""
    links: list[LinkSpec] = []
    all_routes: list[Route] = []
    for operator in scenario.operators:
        station = endpoint(operator.id, "gcs")
        name = link_name(APPROVAL, operator.id)
        links.append(LinkSpec(name, station, APPROVAL, scenario.channel(name, APPROVAL_CHANNEL)))
        for vehicle in operator.vehicles:
            key = vehicle_id(operator.id, vehicle.id)
            for spec in onboard_links(key, operator.id):
                channel = over_air.get(spec.name)
                links.append(
                    apply_link_rules(scenario, spec)
                    if channel is None
                    else LinkSpec(spec.name, spec.a, spec.b, channel)
                )
            all_routes += onboard_routes(key)
    scans = [scan_link(vehicle_id(operator.id, v.id)) for operator, v in scenario.fleet if v.sensors]
    return [*links, *_air_links(scenario), *(apply_link_rules(scenario, spec) for spec in scans)], all_routes


def list_processing_limits(scenario: Scenario) -> list[ProcessingLimit]:
    """The limit of each endpoint that has one."""
    names = list(endpoint_names(scenario.operators))
    return [
        ProcessingLimit(name, table.frames_per_s, table.queue_frames)
        for table in scenario.processing
        for name in find_matches(table, names)
    ]


def apply_link_rules(scenario: Scenario, spec: LinkSpec) -> LinkSpec:
    """A link with the channel that the scenario's rules make of its own."""
    if not isinstance(spec.channel, Channel):
        return spec
    return LinkSpec(spec.name, spec.a, spec.b, scenario.channel(spec.name, spec.channel))


def _air_links(scenario: Scenario) -> list[LinkSpec]:
    """The links to and from the oracle, without those of attackers."""
    if scenario.radio is None:
        return []
    links = [spec for operator, v in scenario.fleet for spec in oracle_links(vehicle_id(operator.id, v.id))]
    listeners = dict.fromkeys(receiver.operator for receiver in scenario.radio.receivers)
    links += [LinkSpec(link_name("oracle", o), endpoint(o, "gcs"), ENDPOINT, ORACLE_CHANNEL) for o in listeners]
    return [apply_link_rules(scenario, spec) for spec in links]
