"""Range sensors of one aircraft: DISTANCE_SENSOR and OBSTACLE_DISTANCE as rangefinder and proximity sensor take them.

After libraries/AP_RangeFinder/AP_RangeFinder_MAVLink.cpp and libraries/AP_Proximity/AP_Proximity_MAV.cpp. As in
ArduPilot, a sensor is there from boot on, by its type: RNGFND1_TYPE 10, PRX1_TYPE 2. There is one of each.
"""

from __future__ import annotations

from typing import Any, Final

from skyrange.codec.mavlink import dialect as mav
from skyrange.core.time import NS_PER_MS, Time
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle
from skyrange.vehicle.builtin.range_readings.boundary import SECTORS, find_sector
from skyrange.vehicle.builtin.range_readings.readings import TIMEOUT_NS, Proximity, Rangefinder, RangeSensors

RANGEFINDER_MAVLINK: Final = 10
PROXIMITY_MAVLINK: Final = 2
_SAME_SCAN_NS: Final[Time] = 50 * NS_PER_MS  # PROXIMITY_TIMESTAMP_MSG_TIMEOUT_MS
_MAX_DISTANCES: Final = 72
_LEVEL: Final = int(mav.MAV_SENSOR_ROTATION_YAW_315)
"""The last of the level orientations."""


def start_sensors(fleet: Fleet, vehicle: Vehicle) -> None:
    """Find the sensors at boot."""
    rangefinder = Rangefinder() if fleet.param(vehicle, "RNGFND1_TYPE") == RANGEFINDER_MAVLINK else None
    proximity = Proximity() if fleet.param(vehicle, "PRX1_TYPE") == PROXIMITY_MAVLINK else None
    if rangefinder is None and proximity is None:
        fleet.range_sensors.pop(vehicle.row, None)
    else:
        fleet.range_sensors[vehicle.row] = RangeSensors(rangefinder, proximity)


def on_distance_sensor(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """DISTANCE_SENSOR: for the rangefinder, if it has its orientation, and for the proximity sensor, if it is level."""
    sensors = fleet.range_sensors.get(vehicle.row)
    if sensors is None:
        return
    finder, proximity = sensors.rangefinder, sensors.proximity
    distance_m = message.current_distance * 0.01
    min_m, max_m = message.min_distance * 0.01, message.max_distance * 0.01
    if finder is not None and message.orientation == int(fleet.param(vehicle, "RNGFND1_ORIENT")):
        finder.read_ns, finder.distance_m, finder.min_m, finder.max_m = fleet.now, distance_m, min_m, max_m
    if proximity is None or message.orientation > _LEVEL:
        return
    since_ns, proximity.read_ns = fleet.now - proximity.read_ns, fleet.now
    if message.time_boot_ms != proximity.boot_ms or since_ns > _SAME_SCAN_NS:
        filter_hz = fleet.param(vehicle, "PRX_FILT")
        for sector in range(SECTORS):
            if sector in proximity.waiting_m:
                proximity.boundary.set_distance(fleet.now, sector, proximity.waiting_m[sector], filter_hz)
        proximity.waiting_m.clear()
    proximity.boot_ms = message.time_boot_ms
    if min_m <= distance_m <= max_m and _is_used(fleet, vehicle, distance_m):
        sector = int(message.orientation)
        proximity.waiting_m[sector] = min(proximity.waiting_m.get(sector, distance_m), distance_m)


def on_obstacle_distance(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """OBSTACLE_DISTANCE: the nearest distance of each sector, in the order of the message.

    Where the message begins and ends in one sector, ArduPilot sets that twice, and so does this.
    """
    sensors = fleet.range_sensors.get(vehicle.row)
    proximity = None if sensors is None else sensors.proximity
    increment_deg = message.increment_f or float(message.increment)
    if proximity is None or not 1e-6 < abs(increment_deg) <= 360.0:
        return
    proximity.read_ns = fleet.now
    boundary, filter_hz = proximity.boundary, fleet.param(vehicle, "PRX_FILT")
    boundary.clear()
    count = min(int(360.0 / abs(increment_deg) + 0.5), _MAX_DISTANCES)
    offset_deg = message.angle_offset if abs(message.angle_offset) <= 360.0 else 0.0
    nearest: tuple[int, float] | None = None
    for place in range(count):
        distance_cm = message.distances[place]
        if distance_cm in (0, 65535) or not message.min_distance <= distance_cm <= message.max_distance:
            continue
        if not _is_used(fleet, vehicle, distance_cm * 0.01):
            continue
        sector = find_sector(place * increment_deg + offset_deg)
        if nearest is not None and nearest[0] == sector:
            nearest = (sector, min(nearest[1], distance_cm * 0.01))
            continue
        if nearest is not None:
            boundary.set_distance(fleet.now, nearest[0], nearest[1], filter_hz)
        nearest = (sector, distance_cm * 0.01)
    if nearest is not None:
        boundary.set_distance(fleet.now, nearest[0], nearest[1], filter_hz)


def _is_used(fleet: Fleet, vehicle: Vehicle, distance_m: float) -> bool:
    """Whether an obstacle is within PRX1_MIN and PRX1_MAX, where these are set (`ignore_reading`)."""
    least, most = fleet.param(vehicle, "PRX1_MIN"), fleet.param(vehicle, "PRX1_MAX")
    return not ((most != 0.0 and distance_m > most) or (least != 0.0 and distance_m < least))


def has_no_data(fleet: Fleet, read_ns: Time) -> bool:
    """Whether a sensor was silent for half a second."""
    return fleet.now - read_ns > TIMEOUT_NS


def measure_height(fleet: Fleet, vehicle: Vehicle) -> float | None:
    """The height that a rangefinder that looks down measures, m; None if it is silent or out of its range.

    The distance times the cosine of the lean, no less than 0.707 (ArduCopter/surface_tracking, rangefinder_state).
    """
    sensors = fleet.range_sensors.get(vehicle.row)
    finder = None if sensors is None else sensors.rangefinder
    if finder is None or has_no_data(fleet, finder.read_ns):
        return None
    least, most = fleet.param(vehicle, "RNGFND1_MIN_CM") * 0.01, fleet.param(vehicle, "RNGFND1_MAX_CM") * 0.01
    if finder.min_m != 0.0 or finder.max_m != 0.0:
        least, most = max(least, finder.min_m), min(most, finder.max_m)
    down = int(fleet.param(vehicle, "RNGFND1_ORIENT")) == mav.MAV_SENSOR_ROTATION_PITCH_270
    if not down or not least <= finder.distance_m <= most:
        return None
    _, x, y, _ = fleet.estimate["quat"][vehicle.row].tolist()
    cosine: float = 1.0 - 2.0 * (x * x + y * y)
    return finder.distance_m * max(cosine, 0.707)
