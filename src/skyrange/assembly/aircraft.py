"""Aircraft of a scenario: the world with their bodies, the engines that fly them, and warnings of their batteries."""

from __future__ import annotations

from collections.abc import Container, Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.assembly.acts.honest_arm import HonestAircraft, mount, park
from skyrange.assembly.signing import derive_keys
from skyrange.city.city import City
from skyrange.core.chance import Chance
from skyrange.core.ids import vehicle_id
from skyrange.kernel import EngineMount
from skyrange.scenario.model.fleet import Vehicle
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.contract import AutopilotContext, AutopilotPlugin, VehicleSpec
from skyrange.world import Body, SensorSpec, World
from skyrange.world.sensing.geomagnetism import magnetic_field_at


def build_aircraft(
    scenario: Scenario,
    city: City | None,
    chance: Chance,
    *,
    motion: bool,
    honest: Sequence[HonestAircraft] = (),
    flown: Container[str] | None = None,
) -> tuple[World, list[EngineMount]]:
    """The world, and an engine for each kind of autopilot with the rows of its aircraft. Raises `InputError`.

    `motion` is the command line's word that vehicles outside the range may be moved. `honest` are
    the real aircraft on claimed tracks; they have the last rows. With `flown` the world has these vehicles only.
    """
    bodies: list[Body] = []
    specs: dict[str, list[tuple[int, VehicleSpec]]] = {}
    for operator, vehicle in scenario.fleet:
        key = vehicle_id(operator.id, vehicle.id)
        if flown is not None and key not in flown:
            continue
        row = len(bodies)
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
            signing_key=derive_keys(scenario, operator).aircraft,
            signing_exempt=operator.signing == "exempt",
        )
        specs.setdefault(vehicle.autopilot, []).append((row, spec))
    fleet = len(bodies)
    bodies += park(honest, scenario)
    datum = scenario.origin.datum
    true = scenario.sensors
    sensors = SensorSpec(true.noise, magnetic_field_at(datum), chance, true.warming_k, true.instability, true.gnss)
    world = World(bodies, wind=scenario.wind.air, city=city, chance=chance, sensors=sensors)
    mounts = []
    everyone = [spec for _, spec in sorted(chain.from_iterable(specs.values()), key=lambda member: member[0])]
    for kind, members in specs.items():
        own = [spec for _, spec in members]
        context = AutopilotContext(kind, own, datum, scenario.epoch, chance, motion, city, everyone)
        engine = AutopilotPlugin.find(kind)(scenario.autopilots.params_of(kind), context)
        mounts.append(EngineMount(engine, _rows_of([row for row, _ in members])))
    if honest:
        mounts.append(mount(honest, slice(fleet, len(bodies)), world.quantum_ns))
    return world, mounts


def _rows_of(places: Sequence[int]) -> slice | NDArray[np.int64]:
    """World rows in ascending order: a slice where none is left out, because the engine then gets views, not copies."""
    if places[-1] - places[0] + 1 == len(places):
        return slice(places[0], places[-1] + 1)
    return np.array(places, dtype=np.int64)


def describe_engines(mounts: Sequence[EngineMount]) -> list[dict[str, Any]]:
    """What the manifest says of the autopilots' engines: whether a run repeats to the byte or in its outcome alone, and
    the program that each runs, if it is one.
    """
    return [
        {"kind": mount.engine.name, "repeatable": mount.engine.repeatable, **mount.engine.manifest} for mount in mounts
    ]


_PARAMETERS = ("BATT_FS_", "BATT_LOW_", "BATT_CRT_", "BATT_ARM_")
"""Beginnings of the parameters of battery failsafes and checks (AP_BattMonitor_Params.cpp)."""


def list_battery_warnings(scenario: Scenario) -> list[str]:
    """One line for each aircraft that sets its charge or battery failsafes, and whose autopilot measures another
    battery: what is without effect, and why.

    Raises `InputError` if that depends on a program that cannot be found.
    """
    lines = []
    reasons: dict[str, str] = {}
    for operator, vehicle in scenario.fleet:
        asked = _asked(vehicle)
        if not asked:
            continue
        kind = vehicle.autopilot
        if kind not in reasons:
            reasons[kind] = AutopilotPlugin.find(kind).other_battery(scenario.autopilots.params_of(kind))
        if reasons[kind]:
            name = vehicle_id(operator.id, vehicle.id)
            unlike = f"the autopilot does not measure the world's battery: {reasons[kind]}"
            lines.append(f"{name}: {', '.join(asked)}, but {unlike}")
    return lines


def _asked(vehicle: Vehicle) -> list[str]:
    """What a vehicle sets of its battery, as it is written in the scenario."""
    charge = [f"charge = {vehicle.charge:g}"] if vehicle.charge < 1.0 else []
    return charge + [f"{name} = {value:g}" for name, value in vehicle.params.items() if name.startswith(_PARAMETERS)]
