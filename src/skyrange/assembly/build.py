"""Building a scenario: placed, checked, and every part made and connected, ready for a kernel."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

from skyrange.assembly.acts.attacks import MadeAttacks, check_transmitters, make_attack_context, make_attacks
from skyrange.assembly.acts.conflicts import list_own_sensors
from skyrange.assembly.acts.defences import MadeDefences, make_defences
from skyrange.assembly.acts.honest_arm import HonestAircraft, describe_aircraft, park
from skyrange.assembly.acts.overlaps import Overlaps
from skyrange.assembly.aircraft import build_aircraft, describe_engines
from skyrange.assembly.approvals import build_approvals
from skyrange.assembly.city import build_city
from skyrange.assembly.control_links import (
    LinksOverAir,
    build_control_links,
    check_links_over_air,
    make_links_over_air,
    place_foreign_radios,
)
from skyrange.assembly.detectors import build_detectors, describe_monitor
from skyrange.assembly.network import build_network, list_processing_limits
from skyrange.assembly.optics import build_range_reports, build_scanner, check_sensors, list_sensors
from skyrange.assembly.placement.clear_placing import apply_placing
from skyrange.assembly.placement.flight_plans import make_flight_plans, plan_routes
from skyrange.assembly.placement.moved_places import describe_moves
from skyrange.assembly.placement.start_checks import check_starts
from skyrange.assembly.radio import LiveMedium, build_radio, check_radios, describe_medium, make_lookout
from skyrange.assembly.run_header import make_attachments, make_header, make_mission_files
from skyrange.assembly.signing import check_signing, derive_keys, place_gateways, read_signing_time
from skyrange.assembly.warnings import list_warnings
from skyrange.city.city import City
from skyrange.contracts.components import Agent, Observer
from skyrange.contracts.links import Act, LinkSpec, TapPlacement
from skyrange.contracts.monitors import MonitorPlacement
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.ids import APPROVAL, endpoint, link_name, vehicle_id
from skyrange.core.time import NEVER, Time, from_seconds
from skyrange.gcs.flight.lifecycle import Flight
from skyrange.gcs.flight.replanning import Replanning
from skyrange.gcs.plan.plans import FlightPlan
from skyrange.gcs.plan.volumes import Margins
from skyrange.gcs.station import GroundStation
from skyrange.kernel import Wiring
from skyrange.optics.scanner import Scanner
from skyrange.radio.control_link.sik.status import place_reporters
from skyrange.radio.oracle import ENDPOINT, Oracle
from skyrange.scenario.model.operators import ReplanningRules
from skyrange.scenario.model.scenario import Scenario


@dataclass(frozen=True, slots=True)
class Additions:
    """What is placed in a run from Python, beside what its scenario declares."""

    taps: Sequence[TapPlacement] = ()
    """Placed on its links by name or pattern."""
    acts: Sequence[Act] = ()
    """The acts that the taps belong to."""
    monitors: Sequence[MonitorPlacement] = ()
    """They listen at ends of links."""
    observers: Sequence[Observer] = ()
    """They see everything beside the recorder, and alter nothing."""


NOTHING_MORE: Final = Additions()


class _Everywhere:
    """All endpoints."""

    def __contains__(self, endpoint: object) -> bool:
        return True


@dataclass(slots=True)
class BuiltScenario:
    """A scenario ready to run: the wiring, and what the run folder says of it."""

    scenario: Scenario
    wiring: Wiring
    city: City | None
    duration_ns: Time
    header: dict[str, Any]
    """The manifest's part that is known before the run."""
    attachments: dict[str, bytes]
    """Files of the run folder by name: the scenario and what it names, and the city as flown."""
    missions: dict[str, bytes]
    """The missions of the vehicles that are built, as they fly them, as further files."""
    oracle: Oracle | None
    """The one that owns the radio medium, if there is one."""
    scanner: Scanner | None
    """The one that makes the scans of sensors, if there are any."""
    overlaps: Overlaps
    """What its acts alter or decide as the only ones."""
    honest: Sequence[HonestAircraft] = ()
    """The real aircraft on claimed tracks."""

    @property
    def files(self) -> dict[str, bytes]:
        """All files of the run folder by name."""
        return self.attachments | self.missions

    def close(self) -> None:
        """End the medium's program, if it is one; the kernel ends those of the engines. Again does nothing."""
        if self.oracle is not None:
            self.oracle.close()


def _request_s(ahead_s: float | None, depart_s: float) -> float:
    """When a flight is requested, in seconds of simulated time."""
    return 0.0 if ahead_s is None else max(depart_s - ahead_s, 0.0)


def build(
    scenario: Scenario,
    additions: Additions = NOTHING_MORE,
    *,
    local: Container[str] | None = None,
    flown: Container[str] | None = None,
    attached: bool = True,
    motion: bool = False,
    live: LiveMedium | None = None,
    aircraft: bool = True,
) -> BuiltScenario:
    """Build everything. Raises `InputError` with all that is wrong, before anything is written or started.

    `additions` are placed beside what the scenario declares, but for the observers: they are told by a kernel. With
    `local` only what lives at these endpoints is built, as a process needs it that runs a part of the range: world,
    oracle and autopilots where `oracle` is among them. With `flown` only these vehicles are built, and their starts and
    plans checked, whose operators have to be the ones of `local`; other processes check the rest.
    Without `attached` there are no `attachments`. `motion` is the command line's word that vehicles outside may be
    moved; the scenario's is needed too. `live` says what a live range does about a dead radio engine. Without
    `aircraft` there is neither a world nor an engine: the caller gives it a part of those of a batch.
    """
    city = build_city(scenario)
    declared = plan_routes(scenario, city)
    scenario = apply_placing(declared, city)
    over_air = make_links_over_air(scenario)
    links, all_routes = build_network(scenario, over_air.channels)
    approvals = build_approvals(scenario, city)
    between = [spec for service in approvals for spec in service.links]
    own_sensors = list_own_sensors(scenario)
    made, defences = _make_acts(scenario, [*links, *between], city, over_air, own_sensors)
    made_plans = make_flight_plans(scenario, flown)
    problems = [
        *check_starts(scenario, city, made_plans),
        *made.problems,
        *defences.problems,
        *check_signing(scenario),
        *check_radios(scenario, made.radios, city),
        *check_links_over_air(scenario, city, over_air),
        *check_sensors(scenario),
    ]
    problems += check_transmitters(made, city)
    if problems:
        raise InputError(f"scenario {scenario.name}", problems)
    links += [*made.links, *between]
    detectors, rows = build_detectors(scenario, links)
    rows += map(describe_monitor, additions.monitors)
    here: Container[str] = _Everywhere() if local is None else local
    whole = ENDPOINT in here
    air = build_radio(
        scenario,
        city,
        Chance(scenario.seed),
        made.radios,
        here=here,
        live=live,
        spectrum=over_air.spectrum if over_air else None,
        reports=build_range_reports(scenario, here),
    )
    epoch, chance = scenario.epoch, Chance(scenario.seed)
    plans = {vehicle: plan for vehicle, plan in made_plans.items() if isinstance(plan, FlightPlan)}
    world, engines = (
        build_aircraft(scenario, city, motion=motion, honest=made.aircraft, flown=flown)
        if whole and aircraft
        else (None, [])
    )
    sensors = list_sensors(scenario)
    scanner = None
    if whole and sensors:
        scanner = build_scanner(scenario, city, park(made.aircraft, scenario, 0)[0], sensors, flown)
    agents: list[Agent] = [a for service in approvals for a in service.agents] if APPROVAL in here else []
    over_sik = {link.name for link in over_air.sik}
    for operator in scenario.operators:
        if endpoint(operator.id, "gcs") not in here:
            continue
        flights = [
            Flight(
                vehicle=vehicle_id(operator.id, vehicle.id),
                system_id=vehicle.system_id,
                network=vehicle.network,
                plan=plans[vehicle_id(operator.id, vehicle.id)],
                depart_s=vehicle.depart_s,
                request_s=_request_s(operator.request_ahead_s, vehicle.depart_s),
                telemetry_radio=link_name("gcs", vehicle_id(operator.id, vehicle.id)) in over_sik,
            )
            for vehicle in operator.vehicles
        ]
        traffic_picture = make_lookout(operator.id, scenario)
        key = derive_keys(scenario, operator).station
        agents.append(
            GroundStation(
                operator.id,
                flights,
                epoch,
                streams=operator.streams,
                traffic_picture=traffic_picture,
                key=key,
                margins=Margins(**operator.margins.model_dump()),
                city=city,
                chance=chance,
                replanning=_replanning_of(operator.replan),
                signing_time=read_signing_time(operator, station=True),
            )
        )
    taps = [*place_gateways(scenario), *defences.taps, *made.taps, *additions.taps, *place_reporters(over_air.sik)]
    placed = place_foreign_radios(taps, over_air)
    control_links = build_control_links(scenario, city, chance, over_air) if whole else None
    if control_links is not None:
        agents.append(control_links)
    processing = list_processing_limits(scenario)
    warnings = list_warnings(scenario)
    wiring = Wiring(
        seed=scenario.seed,
        links=links,
        routes=[route for route in all_routes if route.endpoint in here],
        agents=[*agents, *air.agents],
        truth_subscribers=[*air.truth_subscribers, *([] if scanner is None else [scanner])],
        taps=placed,
        acts=[plan if whole else _elsewhere(plan) for plan in (*made.plans, *additions.acts, *defences.plans)],
        manual_acts=[act.manual_act for act in scenario.manual_acts],
        monitors=[*detectors, *additions.monitors],
        processing=processing,
        world=world,
        engines=engines,
        local=local,
        wall_deadline_s=scenario.autopilots.deadline_s,
        on_silent=scenario.autopilots.on_silent,
        on_unready=scenario.autopilots.on_unready,
    )
    return BuiltScenario(
        scenario,
        wiring,
        city,
        from_seconds(scenario.duration_s),
        make_header(scenario, city, links, describe_moves(declared, scenario))
        | {"attacks": made.rows, "engines": describe_engines(engines), **describe_medium(scenario, air.oracle)}
        | ({"processing": [asdict(limit) for limit in processing]} if processing else {})
        | ({"faults": made.fault_rows} if made.fault_rows else {})
        | ({"honest": describe_aircraft(made.aircraft, scenario)} if made.aircraft else {})
        | ({"defences": defences.rows} if defences.rows else {})
        | ({"detectors": rows} if rows else {})
        | ({"warnings": warnings} if warnings else {}),
        make_attachments(scenario, city) if attached else {},
        make_mission_files(plans),
        air.oracle,
        scanner,
        Overlaps(
            made.exclusive,
            defences.exclusive,
            defences.declared,
            [o.id for o in scenario.operators if o.signing != "off"],
        ),
        made.aircraft,
    )


def _make_acts(
    scenario: Scenario,
    links: Sequence[LinkSpec],
    city: City | None,
    over_air: LinksOverAir,
    own_sensors: Sequence[str],
) -> tuple[MadeAttacks, MadeDefences]:
    """The attacks, faults and defences of a scenario whose links without those of attacks are `links`."""
    context = make_attack_context(scenario, links, city)
    made = make_attacks(scenario, context, own_sensors)
    return made, make_defences(scenario, context, over_air, own_sensors)


@dataclass(frozen=True, slots=True)
class Acts:
    """All that acts or listens in a scenario beside its own parts, and the links that these are on."""

    plans: Sequence[Act]
    taps: Sequence[TapPlacement]
    monitors: Sequence[MonitorPlacement]
    links: Sequence[LinkSpec]


def list_acts(scenario: Scenario) -> Acts:
    """The attacks, faults, defences and detectors of a scenario, made but not checked against each other."""
    city = build_city(scenario)
    scenario = apply_placing(plan_routes(scenario, city), city)
    over_air = make_links_over_air(scenario)
    links, _ = build_network(scenario, over_air.channels)
    links += [spec for service in build_approvals(scenario, city) for spec in service.links]
    made, defences = _make_acts(scenario, links, city, over_air, list_own_sensors(scenario))
    links += made.links
    plans, taps = [*made.plans, *defences.plans], [*defences.taps, *made.taps]
    return Acts(plans, taps, build_detectors(scenario, links)[0], links)


def stay_elsewhere(plan: Act) -> Act:
    """An attack as a process has it in which only some of its taps are; another one notes when it begins and ends."""
    return replace(plan, agents=(), sensor_hooks=(), body_hooks=(), scan_hooks=(), noted=False)


def _elsewhere(plan: Act) -> Act:
    """An attack as a process has it without the world: taps alone, and of its trigger it is told (`Kernel.begin`)."""
    start = NEVER if plan.trigger is not None or plan.manual else plan.start_ns
    return replace(
        plan, agents=(), sensor_hooks=(), body_hooks=(), scan_hooks=(), trigger=None, manual=False, start_ns=start
    )


def _replanning_of(rules: ReplanningRules | None) -> Replanning | None:
    if rules is None:
        return None
    return Replanning(rules.battery_reserve, rules.jammed_radius_m, from_seconds(rules.jammed_s))
