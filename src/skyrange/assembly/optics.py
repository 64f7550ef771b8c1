"""Optics of a scenario: the scanner that makes the scans of its sensors, and what is wrong with where they are."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Container, Iterator, Mapping, Sequence
from typing import Final

from skyrange.city.city import City
from skyrange.core import elementary_python
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError, Problem
from skyrange.core.ids import endpoint, vehicle_id
from skyrange.optics.mounted_sensors import MountedSensor
from skyrange.optics.ray_index import index_city
from skyrange.optics.reflectivity import make_surfaces
from skyrange.optics.scan_patterns import count_pulses
from skyrange.optics.scanner import Scanner, Scene, Shape
from skyrange.scenario.model.fleet import Vehicle
from skyrange.scenario.model.optics import OpticalSensor, Optics
from skyrange.scenario.model.radio import SightRules
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.companion.range_reports import RangeReports, ReportedSensor, can_report
from skyrange.vehicle.landing.emergency import LandingRules
from skyrange.vehicle.landing.ground_grid import FlatRules
from skyrange.vehicle.sight.air import list_extinctions
from skyrange.vehicle.sight.evidence import Rates
from skyrange.vehicle.sight.fusion import Fusion
from skyrange.vehicle.sight.witness import Sight
from skyrange.world import Body
from skyrange.world.airframes import AIRFRAMES, Airframe

_CUBE: Final = 1.05
"""Drag coefficient by which the side of an airframe's box became its drag area (`world.airframes`)."""
_CLEAR_M: Final = 0.05
"""How far outside the cylinder of the aircraft a sensor is by default."""
_DOWN_DEG: Final = -45.0
"""A sensor that looks down more than this is in front of the aircraft by default, otherwise on top. It is one for
emergency landings."""
_BYTES_PER_RAY: Final = 4
"""16 bits of the payload, and again of the table `scans`; all else of it is small once compressed."""
_WORTH_SAYING: Final = 100e6
"""Bytes of scans in a run from which on it is said before."""


def list_sensors(scenario: Scenario) -> list[MountedSensor]:
    """The sensors of all aircraft, in the order of the fleet."""
    return [
        mount_sensor(vehicle_id(operator.id, vehicle.id), vehicle, sensor, number)
        for operator, vehicle in scenario.fleet
        for number, sensor in enumerate(vehicle.sensors)
    ]


def group_sensors(scenario: Scenario) -> dict[str, list[MountedSensor]]:
    """The sensors of each aircraft that has some, by its id."""
    grouped: dict[str, list[MountedSensor]] = {}
    for sensor in list_sensors(scenario):
        grouped.setdefault(sensor.vehicle, []).append(sensor)
    return grouped


def mount_sensor(key: str, vehicle: Vehicle, sensor: OpticalSensor, number: int) -> MountedSensor:
    """A sensor of the aircraft `key`, the `number`-th that it has."""
    return _mount(key, AIRFRAMES[vehicle.airframe], sensor, number)


def read_sensors(scenario: bytes, airframes: Mapping[str, str], who: str) -> list[MountedSensor]:
    """The sensors in the text of a scenario as a run's folder has it, without the rest of the scenario, which may need
    plugins. `airframes` are the names of those of all aircraft, by id. Raises `InputError` in the name of `who`.
    """
    try:
        operators = tomllib.loads(scenario.decode()).get("operators") or []
        rows = [(vehicle_id(operator["id"], row["id"]), row) for operator in operators for row in operator["vehicles"]]
        return [
            _mount(key, AIRFRAMES[airframes[key]], OpticalSensor.model_validate(sensor), number)
            for key, row in rows
            for number, sensor in enumerate(row.get("sensors") or ())
        ]
    except (ValueError, TypeError, KeyError) as error:
        expected = "the scenario of the run, as it was written"
        raise InputError.one(who, "scenario.toml", str(error)[:80], expected) from error


def _mount(key: str, airframe: Airframe, sensor: OpticalSensor, number: int) -> MountedSensor:
    return MountedSensor(
        key,
        sensor.id,
        number,
        sensor.make(),
        sensor.place_m or _default_place(airframe, sensor),
        sensor.yaw_deg,
        sensor.pitch_deg,
        sensor.stabilised,
    )


def _default_place(airframe: Airframe, sensor: OpticalSensor) -> tuple[float, float, float]:
    if sensor.pitch_deg <= _DOWN_DEG:
        return (airframe.radius_m + _CLEAR_M, 0.0, _CLEAR_M)
    return (0.0, 0.0, airframe.height_m + _CLEAR_M)


def build_range_reports(scenario: Scenario, here: Container[str]) -> RangeReports | None:
    """What the companions that live at the endpoints `here` report to their autopilots; None if nothing."""
    reported = [
        ReportedSensor(mount_sensor(key, vehicle, sensor, number), sensor.to_autopilot, vehicle.system_id)
        for operator, vehicle in scenario.fleet
        if endpoint(key := vehicle_id(operator.id, vehicle.id), "companion") in here
        for number, sensor in enumerate(vehicle.sensors)
        if sensor.to_autopilot is not None
    ]
    return RangeReports(reported) if reported else None


def build_scanner(
    scenario: Scenario,
    city: City | None,
    parked: Sequence[Body],
    sensors: Sequence[MountedSensor],
    flown: Container[str] | None = None,
) -> Scanner:
    """The agent that makes all scans of one or more sensors.

    `parked` are the bodies that no vehicle of the scenario has. With `flown` it makes those of these vehicles only, but
    as often as that of all.
    """
    optics = scenario.optics or Optics()
    airframes = {vehicle_id(o.id, v.id): v.airframe for o, v in scenario.fleet}
    airframes |= {body.vehicle: body.airframe for body in parked}
    shapes = {key: find_shape(AIRFRAMES[name], optics.shape) for key, name in airframes.items()}
    surfaces = make_surfaces(optics.ground, optics.walls, optics.aircraft)
    scene = Scene(index_city(city), surfaces, optics.weather)
    own = [sensor for sensor in sensors if flown is None or sensor.vehicle in flown]
    period_ns = math.gcd(*(sensor.period_ns for sensor in sensors))
    return Scanner(own, shapes, scene, Chance(scenario.seed), period_ns)


def find_shape(airframe: Airframe, shape: str) -> Shape:
    """An aircraft as light meets it: the `outline` of collisions, or the `body`."""
    if shape == "outline":
        return Shape(airframe.radius_m, airframe.height_m, 0.0)
    width_m = 2.0 * airframe.gear_half_track_m
    height_m = min(airframe.drag_area_m2 / _CUBE / width_m, airframe.height_m)
    return Shape(0.5 * width_m, height_m, airframe.height_m - height_m)


def make_sight(key: str, vehicle: Vehicle) -> tuple[Sight | None, Fusion]:
    """What the companion of the aircraft `key` uses its sensors for."""
    if not vehicle.sensors:
        return None, Fusion.RADIO
    avoidance = vehicle.avoidance
    fusion = Fusion.RADIO if avoidance is None or avoidance.fusion is None else Fusion(avoidance.fusion)
    rules = SightRules() if avoidance is None or avoidance.sight is None else avoidance.sight
    sensors = [mount_sensor(key, vehicle, sensor, number) for number, sensor in enumerate(vehicle.sensors)]
    rates = Rates(rules.missed, rules.false)
    return Sight(sensors, rates, rules.sigma_m, list_extinctions(rules.air)), fusion


def make_landing(key: str, vehicle: Vehicle) -> LandingRules | None:
    """How the companion of the aircraft `key` lands in an emergency."""
    rules = vehicle.landing
    if rules is None:
        return None
    sensors = tuple(
        mount_sensor(key, vehicle, sensor, number)
        for number, sensor in enumerate(vehicle.sensors)
        if sensor.pitch_deg <= _DOWN_DEG
    )
    slope = elementary_python.tan(math.radians(rules.slope_deg))
    flat = FlatRules(rules.clear_m, rules.rough_m, slope)
    return LandingRules(sensors, flat, rules.look_m, rules.moves, looks_twice=rules.second_look)


def check_sensors(scenario: Scenario) -> Iterator[Problem]:
    """Sensors inside the cylinder of their aircraft, sensors that are missing, and reports that cannot be."""
    for operator, vehicle in scenario.fleet:
        yield from _check_reports(vehicle_id(operator.id, vehicle.id), vehicle)
        if vehicle.landing is not None and all(sensor.pitch_deg > _DOWN_DEG for sensor in vehicle.sensors):
            where = f"{vehicle_id(operator.id, vehicle.id)}.landing"
            hint = 'Add sensors = [{ model = "d435", pitch_deg = -90, stabilised = true }] to the aircraft.'
            yield Problem(where, vehicle.landing.kind, "a LiDAR or a depth camera that looks down", hint)
        airframe = AIRFRAMES[vehicle.airframe]
        fusion = None if vehicle.avoidance is None else vehicle.avoidance.fusion
        if fusion not in (None, "radio") and not vehicle.sensors:
            where = f"{vehicle_id(operator.id, vehicle.id)}.avoidance.fusion"
            hint = 'Add sensors = [{ model = "mid-360" }] to the aircraft.'
            yield Problem(where, str(fusion), "radio: the aircraft has no LiDAR and no depth camera", hint)
        for sensor in vehicle.sensors:
            if sensor.place_m is None:
                continue
            forward, left, up = sensor.place_m
            inside = forward * forward + left * left < airframe.radius_m * airframe.radius_m
            if inside and 0.0 <= up < airframe.height_m:
                where = f"{vehicle_id(operator.id, vehicle.id)}.sensors.{sensor.id}.place_m"
                expected = (
                    f"a place outside the cylinder that encloses the {vehicle.airframe}: {airframe.radius_m:.3g} m "
                    f"from its axis, or not between 0 and {airframe.height_m:.3g} m up"
                )
                yield Problem(where, f"[{forward:g}, {left:g}, {up:g}] m", expected, "Omit place_m for a usual place.")


def _check_reports(key: str, vehicle: Vehicle) -> Iterator[Problem]:
    reported = [(n, sensor) for n, sensor in enumerate(vehicle.sensors) if sensor.to_autopilot is not None]
    for number, sensor in reported:
        kind = sensor.to_autopilot
        where = f"{key}.sensors.{sensor.id}.to_autopilot"
        if kind is None or can_report(mount_sensor(key, vehicle, sensor, number), kind):
            continue
        if kind == "obstacles":
            hint = 'A single beam is reported as "distance".'
            yield Problem(where, kind, f"a sensor with more than one beam; {sensor.model} has one", hint)
        else:
            expected = "a single beam with pitch_deg -90, 90, or 0 and a yaw_deg that is a multiple of 45"
            yield Problem(where, kind, expected, 'Other sensors are reported as "obstacles".')
    around = [sensor.id for _, sensor in reported if sensor.to_autopilot == "obstacles"]
    if len(around) > 1:
        expected = "one sensor of an aircraft: each OBSTACLE_DISTANCE replaces the last one's obstacles"
        yield Problem(f"{key}.sensors.{around[1]}.to_autopilot", "obstacles", expected)


def describe_scans(scenario: Scenario, sensors: Sequence[MountedSensor]) -> list[str]:
    """A line about how much the scans of a run are, if they are much."""
    total = elementary_python.add_up(map(scan_bytes_per_s, sensors)) * float(scenario.duration_s)
    if total < _WORTH_SAYING or scenario.record.level != "full":
        return []
    number = f"{len(sensors)} sensor" + ("s" if len(sensors) > 1 else "")
    return [f"{number}: {total / 1e9:.1f} GB of scans before compression; level = 'study' in [record] keeps none"]


def scan_bytes_per_s(sensor: MountedSensor) -> float:
    """Bytes of the scans of a sensor in a second, as recorded, before compression."""
    return _BYTES_PER_RAY * count_pulses(sensor.model.pattern) * sensor.model.pattern.rate_hz
