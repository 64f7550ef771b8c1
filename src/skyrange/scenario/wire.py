"""How does a scenario become something a kernel can run? Placed, checked, and every part built and connected."""

from __future__ import annotations

import json
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from skyrange.agent.contracts import Agent
from skyrange.agent.links import AttackPlan, Channel, LinkSpec, Route, Schedule, TapPlacement
from skyrange.agent.monitors import MonitorPlacement
from skyrange.agent.plugins import APPROVALS, AUTOPILOTS, find
from skyrange.attack.contract import Aircraft, Setting
from skyrange.city.city import City
from skyrange.codec.missions import format_waypoints
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.ids import APPROVAL, endpoint, link_name, vehicle_id
from skyrange.core.time import NEVER, NS_PER_MS, Time, from_seconds
from skyrange.gcs.flights import Flight
from skyrange.gcs.plans import FlightPlan
from skyrange.gcs.station import GroundStation
from skyrange.kernel import EngineMount, Wiring
from skyrange.radio.oracle import ENDPOINT, Oracle
from skyrange.remoteid.profiles import serial_number
from skyrange.scenario.air import RemoteId
from skyrange.scenario.attacks import make_attacks, radio_faults
from skyrange.scenario.check import check
from skyrange.scenario.emit import to_toml
from skyrange.scenario.flight import flight_plan
from skyrange.scenario.medium import air_faults, air_network, lookout_of, on_air
from skyrange.scenario.placing import placed
from skyrange.scenario.schema import Scenario
from skyrange.scenario.signing import keys_of, signing_faults
from skyrange.scenario.surroundings import build_city
from skyrange.utm.service import FlightApproval
from skyrange.vehicle.onboard import links as vehicle_links
from skyrange.vehicle.onboard import routes
from skyrange.vehicle.spec import VehicleSpec
from skyrange.world import Body, SensorSpec, World
from skyrange.world.magnetism import field_at

APPROVAL_CHANNEL = Channel(mode="reliable", latency_ns=25 * NS_PER_MS)
"""A web service some tens of milliseconds away."""


class _Everywhere:
    """All endpoints."""

    def __contains__(self, endpoint: object) -> bool:
        return True


@dataclass(slots=True)
class Rig:
    """A scenario ready to run: the wiring, and what the run folder says of it."""

    scenario: Scenario
    wiring: Wiring
    city: City | None
    duration_ns: Time
    header: dict[str, Any]
    """The manifest's part that is known before the run."""
    attachments: dict[str, bytes]
    """Files of the run folder by name: the scenario, the missions and the city as flown."""
    oracle: Oracle | None
    """The one that owns the radio medium, if there is one."""


def wire(
    scenario: Scenario,
    *,
    taps: Sequence[TapPlacement] = (),
    attacks: Sequence[AttackPlan] = (),
    monitors: Sequence[MonitorPlacement] = (),
    local: Container[str] | None = None,
    motion: bool = False,
) -> Rig:
    """Build everything. Raises `InputError` with all that is wrong, before anything is written or started.

    `taps`, `attacks` and `monitors` are placed on the scenario's links, by name or pattern. With `local` only what
    lives at these endpoints is built, as a process needs it that runs a part of the range: world, oracle and autopilots
    where `oracle` is among them. `motion` is the command line's word that vehicles outside may be moved; the
    scenario's is needed too.
    """
    city = build_city(scenario)
    scenario = placed(scenario, city)
    links, all_routes = _network(scenario)
    made = make_attacks(scenario.attacks, setting_of(scenario, links, city))
    faults = [*check(scenario, city), *made.faults, *signing_faults(scenario), *air_faults(scenario, made.radios, city)]
    faults += radio_faults(made.radios, city)
    if faults:
        raise InputError(f"scenario {scenario.name}", faults)
    links += made.links
    here: Container[str] = _Everywhere() if local is None else local
    whole = ENDPOINT in here
    air = on_air(scenario, city, Chance(scenario.seed), made.radios, here)
    origin, epoch, chance = scenario.origin.datum, scenario.epoch, Chance(scenario.seed)
    plans = {vehicle_id(operator.id, vehicle.id): flight_plan(origin, vehicle) for operator, vehicle in scenario.fleet}
    world, engines = _aircraft(scenario, city, chance, motion) if whole else (None, [])
    agents: list[Agent] = [*_approvals(scenario)] if APPROVAL in here else []
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
            )
            for vehicle in operator.vehicles
        ]
        lookout = lookout_of(operator.id, scenario)
        key = keys_of(scenario, operator).station
        agents.append(GroundStation(operator.id, flights, epoch, streams=operator.streams, lookout=lookout, key=key))
    wiring = Wiring(
        seed=scenario.seed,
        links=links,
        routes=[route for route in all_routes if route.endpoint in here],
        agents=[*agents, *air.agents],
        watchers=air.watchers,
        taps=[*made.taps, *taps],
        attacks=[plan if whole else _elsewhere(plan) for plan in (*made.plans, *attacks)],
        monitors=monitors,
        world=world,
        engines=engines,
        local=local,
        wall_deadline_s=scenario.autopilots.deadline_s,
        on_silent=scenario.autopilots.on_silent,
        on_unready=scenario.autopilots.on_unready,
    )
    return Rig(
        scenario,
        wiring,
        city,
        from_seconds(scenario.duration_s),
        _header(scenario, city, links, plans)
        | {"attacks": made.rows, "engines": engines_told(engines)}
        | ({"detectors": [_detector_row(placement) for placement in monitors]} if monitors else {}),
        _attachments(scenario, plans, city),
        air.oracle,
    )


def _detector_row(placement: MonitorPlacement) -> dict[str, Any]:
    """What the manifest says of a detector."""
    return {"id": placement.id, "links": list(placement.links), "side": placement.side}


def _elsewhere(plan: AttackPlan) -> AttackPlan:
    """An attack as a process has it without the world: taps alone, and of its trigger it is told (`Kernel.begin`)."""
    start = plan.start_ns if plan.trigger is None else NEVER
    return replace(plan, agents=(), faults=(), trigger=None, start_ns=start)


def setting_of(scenario: Scenario, links: Sequence[LinkSpec], city: City | None) -> Setting:
    """What attacks are told; the id, schedule and sham of each are its own."""
    vehicles = {}
    for operator, vehicle in scenario.fleet:
        key, start = vehicle_id(operator.id, vehicle.id), vehicle.start
        uas_id = (vehicle.remote_id or RemoteId()).uas_id or serial_number(key)
        vehicles[key] = Aircraft((start.east_m, start.north_m, 0.0), uas_id)
    return Setting(
        id="",
        vehicles=vehicles,
        links=[spec.name for spec in links],
        origin=scenario.origin.datum,
        epoch=scenario.epoch,
        chance=Chance(scenario.seed),
        duration_ns=from_seconds(scenario.duration_s),
        schedule=Schedule(),
        city=city,
    )


def _network(scenario: Scenario) -> tuple[list[LinkSpec], list[Route]]:
    links: list[LinkSpec] = []
    all_routes: list[Route] = []
    for operator in scenario.operators:
        station = endpoint(operator.id, "gcs")
        name = link_name(APPROVAL, operator.id)
        links.append(LinkSpec(name, station, APPROVAL, scenario.channel(name, APPROVAL_CHANNEL)))
        for vehicle in operator.vehicles:
            key = vehicle_id(operator.id, vehicle.id)
            links += [
                LinkSpec(spec.name, spec.a, spec.b, scenario.channel(spec.name, spec.channel))
                for spec in vehicle_links(key, operator.id)
            ]
            all_routes += routes(key)
    return [*links, *air_network(scenario)], all_routes


def _aircraft(scenario: Scenario, city: City | None, chance: Chance, motion: bool) -> tuple[World, list[EngineMount]]:
    bodies = []
    specs: dict[str, list[tuple[int, VehicleSpec]]] = {}
    for row, (operator, vehicle) in enumerate(scenario.fleet):
        key = vehicle_id(operator.id, vehicle.id)
        start = vehicle.start
        bodies.append(Body(key, vehicle.airframe, start.east_m, start.north_m, 0.0, start.heading_deg, vehicle.charge))
        spec = VehicleSpec(
            vehicle=key,
            system_id=vehicle.system_id,
            network=vehicle.network,
            airframe=vehicle.airframe,
            home_enu_m=(start.east_m, start.north_m, 0.0),
            heading_deg=start.heading_deg,
            params=dict(vehicle.params),
            wind_enu_mps=scenario.wind.air.steady_enu_mps,
            signing_key=keys_of(scenario, operator).aircraft,
        )
        specs.setdefault(vehicle.autopilot, []).append((row, spec))
    datum = scenario.origin.datum
    sensors = SensorSpec(scenario.sensors.noise, field_at(datum), chance)
    world = World(bodies, wind=scenario.wind.air, city=city, chance=chance, sensors=sensors)
    mounts = []
    for kind, members in specs.items():
        rows: slice | np.ndarray[Any, np.dtype[np.int64]] = np.array([row for row, _ in members], dtype=np.int64)
        if len(members) == len(bodies):
            rows = slice(None)  # views instead of copies
        factory, made = find(AUTOPILOTS, kind), scenario.autopilots.made(kind)
        if getattr(factory, "guards_motion", False):
            made["motion"] = motion
        engine = factory(kind, [spec for _, spec in members], datum, scenario.epoch, chance, **made)
        mounts.append(EngineMount(engine, rows))
    return world, mounts


def engines_told(mounts: Sequence[EngineMount]) -> list[dict[str, Any]]:
    """What the manifest says of the autopilots' engines, with the program that each runs, if it is one."""
    return [{"kind": mount.engine.name, **getattr(mount.engine, "manifest", {})} for mount in mounts]


def _approvals(scenario: Scenario) -> list[FlightApproval]:
    kinds: dict[str, list[str]] = {}
    for operator in scenario.operators:
        kinds.setdefault(operator.approval, []).append(operator.id)
    services = []
    for kind, operators in kinds.items():
        service = FlightApproval(operators, scenario.epoch, find(APPROVALS, kind)())
        service.name = f"{APPROVAL}.{kind}"
        services.append(service)
    return services


def _header(
    scenario: Scenario, city: City | None, links: list[LinkSpec], plans: Mapping[str, FlightPlan]
) -> dict[str, Any]:
    colors = {operator.id: operator.color for operator in scenario.operators}
    return {
        "name": scenario.name,
        "seed": scenario.seed,
        "start_utc": scenario.epoch.iso(0),
        "start_unix_ns": scenario.epoch.unix_ns,
        "duration_s": scenario.duration_s,
        "origin": {
            "lat_deg": scenario.origin.lat,
            "lon_deg": scenario.origin.lon,
            "alt_msl_m": scenario.origin.alt_msl_m,
            "geoid_m": scenario.origin.geoid_m,
        },
        "operators": [
            {"id": operator.id, "color": operator.color, "approval": operator.approval}
            for operator in scenario.operators
        ],
        "vehicles": [
            {
                "id": vehicle_id(operator.id, vehicle.id),
                "operator": operator.id,
                "color": colors[operator.id],
                "autopilot": vehicle.autopilot,
                "airframe": vehicle.airframe,
                "network": vehicle.network,
                "system_id": vehicle.system_id,
                "home_enu_m": [vehicle.start.east_m, vehicle.start.north_m, 0.0],
                "plan": plans[vehicle_id(operator.id, vehicle.id)].name,
            }
            for operator, vehicle in scenario.fleet
        ],
        "links": [
            {
                "name": spec.name,
                "a": spec.a,
                "b": spec.b,
                "channel": {name: getattr(spec.channel, name) for name in spec.channel.__slots__},
            }
            for spec in links
        ],
        "receivers": [
            {"id": receiver.id, "operator": receiver.operator, "kind": receiver.kind, "at_enu_m": list(receiver.place)}
            for receiver in (scenario.radio.receivers if scenario.radio is not None else ())
        ],
        "city": {"source": city.source, "buildings": len(city.buildings)} if city is not None else None,
    }


def _attachments(scenario: Scenario, plans: Mapping[str, FlightPlan], city: City | None) -> dict[str, bytes]:
    """The scenario with all files it names, so that the folder alone repeats the run, and what was flown of them."""
    copies: dict[str, str] = {}
    files: dict[str, bytes] = {}
    for _, vehicle in scenario.fleet:
        given = vehicle.plan.file
        if given is not None and given not in copies:
            copies[given] = f"missions/given/{len(copies) + 1}-{Path(given).name}"
            files[copies[given]] = Path(given).read_bytes()
    if scenario.city is not None and scenario.city.buildings is not None:
        copies[scenario.city.buildings] = "city.geojson"
        files["city.geojson"] = Path(scenario.city.buildings).read_bytes()
    files["scenario.toml"] = to_toml(scenario, copies).encode()
    if city is not None:
        files["city.json"] = json.dumps(city.to_json_rows(), separators=(",", ":")).encode()
    for name, plan in plans.items():
        if plan.mission is not None:
            files[f"missions/{name.replace('/', '-')}.waypoints"] = format_waypoints(plan.mission).encode()
    return files
