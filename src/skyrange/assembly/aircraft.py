"""Aircraft of a scenario: the world with their bodies, the engines that fly them, and warnings of their batteries."""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.assembly.acts.honest_arm import HonestAircraft, park
from skyrange.assembly.signing import derive_stored_key, read_signing_time
from skyrange.city.city import City
from skyrange.core.chance import Chance
from skyrange.core.ids import link_name, vehicle_id
from skyrange.kernel import EngineMount
from skyrange.radio.control_link.sik.params import SikParams
from skyrange.scenario.model.fleet import Vehicle
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.claimed_tracks import ClaimedTracks, HonestBody
from skyrange.vehicle.contract import AutopilotContext, AutopilotPlugin, VehicleSpec
from skyrange.world import Body, SensorSpec, World
from skyrange.world.sensing.geomagnetism import magnetic_field_at

_BATCHED = "builtin"
"""The autopilot whose engine flies the aircraft of several runs."""


class Aircraft(NamedTuple):
    """The aircraft of one run of a scenario, in the order of the scenario's fleet."""

    bodies: Sequence[Body]
    specs: Sequence[VehicleSpec]
    autopilots: Sequence[str]
    """The kind of each one's autopilot."""
    parked: Sequence[Body] = ()
    """The bodies of real aircraft on claimed tracks, which have the last rows of the run."""
    claimed: Sequence[HonestBody] = ()
    """What moves each of these."""


def list_aircraft(
    scenario: Scenario,
    run: int = 0,
    flown: Container[str] | None = None,
    honest: Sequence[HonestAircraft] = (),
) -> Aircraft:
    """The bodies and the vehicles of a scenario, as run number `run` of a batch; with `flown` these vehicles only.
    `honest` are the real aircraft on claimed tracks.
    """
    bodies: list[Body] = []
    specs: list[VehicleSpec] = []
    autopilots: list[str] = []
    for operator, vehicle in scenario.fleet:
        key = vehicle_id(operator.id, vehicle.id)
        if flown is not None and key not in flown:
            continue
        start = vehicle.start
        bodies.append(
            Body(
                vehicle=key,
                airframe=vehicle.airframe,
                east_m=start.east_m,
                north_m=start.north_m,
                heading_deg=start.heading_deg,
                charge=vehicle.charge,
                run=run,
                seed=scenario.seed,
            )
        )
        specs.append(
            VehicleSpec(
                vehicle=key,
                system_id=vehicle.system_id,
                network=vehicle.network,
                airframe=vehicle.airframe,
                home_enu_m=(start.east_m, start.north_m, 0.0),
                heading_deg=start.heading_deg,
                params=dict(vehicle.params),
                wind_enu_mps=scenario.wind.air.steady_enu_mps,
                signing_key=derive_stored_key(scenario, operator),
                signing_exempt=operator.signing == "exempt",
                telemetry_radio=isinstance(scenario.over_air(link_name("gcs", key)), SikParams),
                signing_time=read_signing_time(operator),
                run=run,
                seed=scenario.seed,
            )
        )
        autopilots.append(vehicle.autopilot)
    return Aircraft(bodies, specs, autopilots, *park(honest, scenario, run))


def make_aircraft(
    scenario: Scenario,
    city: City | None,
    runs: Sequence[Aircraft],
    *,
    motion: bool,
) -> tuple[World, list[EngineMount]]:
    """The world of one or more runs, and an engine for each kind of autopilot with the rows of its aircraft.

    `runs` are what `list_aircraft` lists of each run, in the order of their numbers; all are of scenarios that differ
    from `scenario` in nothing but the seed and what attacks do. `motion` is the command line's word that vehicles
    outside the range may be moved. Raises `InputError`; and `ValueError` where several runs have another autopilot than
    the builtin one.
    """
    bodies: list[Body] = []
    own_rows: list[int] = []
    parked_rows: list[int] = []
    for run in runs:
        own_rows += range(len(bodies), len(bodies) + len(run.bodies))
        bodies += run.bodies
        parked_rows += range(len(bodies), len(bodies) + len(run.parked))
        bodies += run.parked
    specs = [spec for run in runs for spec in run.specs]
    kinds = [kind for run in runs for kind in run.autopilots]
    if len(runs) > 1:
        others = sorted(set(kinds) - {_BATCHED})
        if others:
            raise ValueError(f"a batch of runs with {', '.join(others)}")
    datum = scenario.origin.datum
    true = scenario.sensors
    sensors = SensorSpec(true.noise, magnetic_field_at(datum), true.warming_k, true.instability, true.gnss)
    world = World(bodies, wind=scenario.wind.air, city=city, sensors=sensors)
    mounts = []
    for kind in dict.fromkeys(kinds):
        places = [place for place, other in enumerate(kinds) if other == kind]
        own = [specs[place] for place in places]
        chance = Chance(scenario.seed)
        context = AutopilotContext(kind, own, datum, scenario.epoch, chance, motion, city, specs)
        engine = AutopilotPlugin.find(kind)(scenario.autopilots.params_of(kind), context)
        mounts.append(EngineMount(engine, _rows_of([own_rows[place] for place in places])))
    if parked_rows:
        claimed = [body for run in runs for body in run.claimed]
        mounts.append(EngineMount(ClaimedTracks(claimed, world.quantum_ns), _rows_of(parked_rows)))
    return world, mounts


def build_aircraft(
    scenario: Scenario,
    city: City | None,
    *,
    motion: bool,
    honest: Sequence[HonestAircraft] = (),
    flown: Container[str] | None = None,
) -> tuple[World, list[EngineMount]]:
    """`make_aircraft` of one run alone; with `flown` the world has these vehicles only."""
    return make_aircraft(scenario, city, [list_aircraft(scenario, 0, flown, honest)], motion=motion)


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
        settings = _battery_settings(vehicle)
        if not settings:
            continue
        kind = vehicle.autopilot
        if kind not in reasons:
            reasons[kind] = AutopilotPlugin.find(kind).other_battery(scenario.autopilots.params_of(kind))
        if reasons[kind]:
            name = vehicle_id(operator.id, vehicle.id)
            unlike = f"the autopilot does not measure the world's battery: {reasons[kind]}"
            lines.append(f"{name}: {', '.join(settings)}, but {unlike}")
    return lines


def _battery_settings(vehicle: Vehicle) -> list[str]:
    """What a vehicle sets of its battery, as it is written in the scenario."""
    charge = [f"charge = {vehicle.charge:g}"] if vehicle.charge < 1.0 else []
    return charge + [f"{name} = {value:g}" for name, value in vehicle.params.items() if name.startswith(_PARAMETERS)]
