"""Header of a run: what the manifest and the folder say of a scenario before it is flown."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from skyrange.assembly.placement.flight_plans import name_flight_plan
from skyrange.assembly.radio import uas_id_of
from skyrange.city.building_files import files_of
from skyrange.city.city import City
from skyrange.city.geojson import MAX_FILE_BYTES as MAX_CITY_BYTES
from skyrange.codec.f3411 import printable_id
from skyrange.codec.mission import Mission, format_plan, format_waypoints, read_mission
from skyrange.codec.mission.differences import LOCATED, MSL_FRAMES
from skyrange.codec.mission.items import MAX_FILE_BYTES
from skyrange.contracts.links import LinkSpec
from skyrange.contracts.plugins.registry import loaded_sources
from skyrange.core.errors import InputError
from skyrange.core.files import MAX_RECORD_BYTES, read_input
from skyrange.core.ids import vehicle_id
from skyrange.gcs.plan.plans import FlightPlan
from skyrange.radio.propagation.loss_table_file import MAX_BYTES as MAX_TABLE_BYTES
from skyrange.record.folder import GIVEN_FILES, LOSS_TABLE, PLUGINS, plain_name
from skyrange.scenario.model.plan import Plan
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.named_files import list_named_files
from skyrange.scenario.toml_files import to_toml


def make_header(
    scenario: Scenario, city: City | None, links: list[LinkSpec], moves: Sequence[Mapping[str, Any]] = ()
) -> dict[str, Any]:
    """The manifest's part that follows from the scenario and its links; `moves` is what placing moved."""
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
                "uas_id": printable_id(uas_id_of(vehicle_id(operator.id, vehicle.id), vehicle, scenario)),
                "color": colors[operator.id],
                "autopilot": vehicle.autopilot,
                "airframe": vehicle.airframe,
                "network": vehicle.network,
                "system_id": vehicle.system_id,
                "home_enu_m": [vehicle.start.east_m, vehicle.start.north_m, 0.0],
                "plan": name_flight_plan(vehicle),
                **_describe_expectation(vehicle.plan),
            }
            for operator, vehicle in scenario.fleet
        ],
        "links": [
            {
                "name": spec.name,
                "a": spec.a,
                "b": spec.b,
                "channel": dict(spec.channel.describe()),
            }
            for spec in links
        ],
        "receivers": [
            {"id": receiver.id, "operator": receiver.operator, "kind": receiver.kind, "at_enu_m": list(receiver.place)}
            for receiver in (scenario.radio.receivers if scenario.radio is not None else ())
        ],
        "constraints": [table.model_dump(mode="json") for table in scenario.constraints],
        "city": _describe_city(city) if city is not None else None,
        **_describe_mission_files(scenario),
        **({"placing": list(moves)} if moves else {}),
    }


def _describe_mission_files(scenario: Scenario) -> dict[str, Any]:
    """What was used of each mission file, and what it says that no flight uses; nothing without mission files.

    A file that cannot be read is left out: the core whose aircraft flies it raises the error.
    """
    rows = []
    for file in dict.fromkeys(vehicle.plan.file for _, vehicle in scenario.fleet if vehicle.plan.file is not None):
        with suppress(InputError):
            mission = read_mission(file)
            used = {"items": len(mission.items), "fence": len(mission.fence), "rally": len(mission.rally)}
            rows.append(
                {
                    "file": mission.source,
                    **used,
                    **_describe_planned_home(mission, scenario.origin.alt_msl_m),
                    "ignored": [ignored.to_dict() for ignored in mission.ignored],
                }
            )
    return {"mission_files": rows} if rows else {}


_HOME_TOLERANCE_M: Final = 10.0
"""Between heights of the ground by two sources, such as a map and a receiver."""


def _describe_planned_home(mission: Mission, ground_msl_m: float) -> dict[str, float]:
    """How far the home for which a mission was planned is above the ground, where its altitudes depend on that."""
    absolute = any(item.command in LOCATED and item.frame in MSL_FRAMES for item in mission.items)
    above_m = mission.home[2] - ground_msl_m if mission.home is not None and absolute else 0.0
    return {"planned_home_above_ground_m": round(above_m, 2)} if abs(above_m) > _HOME_TOLERANCE_M else {}


def _describe_expectation(plan: Plan) -> dict[str, str]:
    """What the plan expects of its mission, if it does (`study.failed_missions`)."""
    expected = "failure" if plan.failure_expected else "rejection" if plan.rejection_expected else ""
    return {"expected": expected} if expected else {}


def _describe_city(city: City) -> dict[str, Any]:
    """The city in the manifest: its source, its number of buildings, and what became of its file's features."""
    description = {"source": city.source, "buildings": len(city.buildings)}
    return description | ({"reading": city.reading.to_dict()} if city.reading is not None else {})


def _name_copy(file: Path) -> str:
    """The name of a file of buildings in the run's folder, in which `city.json` is another file."""
    suffix = file.suffix.lower()
    return "city.geojson" if suffix == ".json" else f"city{suffix}"


def make_attachments(scenario: Scenario, city: City | None) -> dict[str, bytes]:
    """The scenario with all files it names, so that the folder alone repeats the run, the city, and the plugin files
    that were loaded.
    """
    copies: dict[str, str] = {}
    files: dict[str, bytes] = {}
    for _, vehicle in scenario.fleet:
        given = vehicle.plan.file
        if given is not None and given not in copies:
            copies[given] = f"missions/given/{len(copies) + 1}-{plain_name(Path(given).name)}"
            files[copies[given]] = read_input(Path(given), "mission", max_bytes=MAX_FILE_BYTES)
    if scenario.city is not None and scenario.city.buildings is not None:
        buildings = Path(scenario.city.buildings)
        copies[scenario.city.buildings] = _name_copy(buildings)
        files |= {
            _name_copy(file): read_input(file, "buildings", max_bytes=MAX_CITY_BYTES) for file in files_of(buildings)
        }
    if scenario.radio is not None and scenario.radio.table is not None:
        copies[scenario.radio.table] = LOSS_TABLE
        files[LOSS_TABLE] = read_input(Path(scenario.radio.table), "loss table", max_bytes=MAX_TABLE_BYTES)
    for _, given in list_named_files(scenario.data()):  # of parameters of plugins
        if given not in copies:
            copies[given] = f"{GIVEN_FILES}/{len(copies) + 1}-{plain_name(Path(given).name)}"
            files[copies[given]] = read_input(Path(given), "scenario", max_bytes=MAX_RECORD_BYTES)
    for number, (name, source) in enumerate(loaded_sources(), 1):
        files[f"{PLUGINS}/{number:02}-{plain_name(name)}"] = source
    files["scenario.toml"] = to_toml(scenario, copies).encode()
    if city is not None:
        files["city.json"] = json.dumps(city.to_json_rows(), separators=(",", ":")).encode()
    return files


def make_mission_files(plans: Mapping[str, FlightPlan]) -> dict[str, bytes]:
    """The missions of vehicles as they fly them, in a folder for each operator; as a plan too where it has more."""
    files = {
        f"missions/flown/{name}.waypoints": format_waypoints(plan.mission).encode()
        for name, plan in plans.items()
        if plan.mission is not None
    }
    for name, plan in plans.items():
        if plan.fence or plan.rally:
            home = plan.origin.geodetic_of(plan.home_enu_m.east_m, plan.home_enu_m.north_m)
            settings = plan.mission.settings if plan.mission is not None else None
            above_m = plan.origin.alt_msl_m + plan.home_enu_m.up_m
            whole = Mission(plan.items, (*home, above_m), plan.fence, plan.rally, settings=settings)
            files[f"missions/flown/{name}.plan"] = format_plan(whole).encode()
    return files
