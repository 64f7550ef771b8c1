"""Pre-arm checks: one table, run for an aircraft that is to be armed and for all disarmed ones once a second.

After libraries/AP_Arming/AP_Arming.cpp (`update`, `pre_arm_checks`, `check_failed`) and ArduCopter/AP_Arming_Copter.cpp
(`run_pre_arm_checks`, `mandatory_checks`). There is no radio, logger, airspeed sensor or safety switch to check here.
Each entry of `CHECKS` is one ArduPilot check: it reports its first failure only, and all entries are run. A new check
is a new entry.

Pre-arm check of the Remote ID transmitter, and the messages that it and the ground station send. After
libraries/AP_OpenDroneID/AP_OpenDroneID.cpp (`handle_msg`, `pre_arm_check`) and AP_Arming.cpp (`opendroneid_checks`):
enforced where bit 0 of DID_OPTIONS is set, as 14 CFR 89.310(c)(2) requires. The transmitter reports its status, a
ground station the identity of the aircraft and the place of its operator; here the companion sends all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from enum import IntFlag
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.core import elementwise
from skyrange.core.time import NS_PER_S, Time
from skyrange.vehicle.builtin import battery_monitor, fence, locations
from skyrange.vehicle.builtin.estimation import validity
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle
from skyrange.vehicle.builtin.modes import MANUAL_THROTTLE, REQUIRES_POSITION, Mode
from skyrange.vehicle.builtin.range_sensing.sensors import has_no_data

_ENFORCE: Final = 1  # DID_OPTIONS bit 0: EnforceArming
_MAX_AGE_NS: Final[Time] = 3 * NS_PER_S  # max_age_ms
_GOOD: Final = int(dialect.MAV_ODID_ARM_STATUS_GOOD_TO_ARM)


def on_arm_status(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """OPEN_DRONE_ID_ARM_STATUS: store the status and its error text."""
    fleet.checks["rid_ns"][vehicle.row] = max(fleet.now, 1)
    fleet.checks["rid_status"][vehicle.row] = message.status
    error = message.error
    text = error if isinstance(error, str) else bytes(error).split(b"\0")[0].decode("ascii", "replace")
    vehicle.rid_error = "".join(letter if " " <= letter <= "~" else "?" for letter in text)


def on_basic_id(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """OPEN_DRONE_ID_BASIC_ID: store its id type."""
    fleet.checks["rid_id_type"][vehicle.row] = message.id_type


def on_system(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """OPEN_DRONE_ID_SYSTEM: store whether there is an operator location."""
    _store_operator_location(fleet, vehicle, message)
    fleet.checks["rid_system_ns"][vehicle.row] = max(fleet.now, 1)


def on_system_update(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """OPEN_DRONE_ID_SYSTEM_UPDATE: a newer location, valid only after an OPEN_DRONE_ID_SYSTEM."""
    _store_operator_location(fleet, vehicle, message)
    if fleet.checks["rid_system_ns"][vehicle.row]:
        fleet.checks["rid_system_ns"][vehicle.row] = max(fleet.now, 1)


def _store_operator_location(fleet: Fleet, vehicle: Vehicle, message: Any) -> None:
    fleet.checks["rid_operator"][vehicle.row] = message.operator_latitude != 0 or message.operator_longitude != 0


def prearm_failures(
    fleet: Fleet, rows: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.bool_], str | Callable[[Vehicle], str]]]:
    """Return which of `rows` may not be armed, and why."""
    settings, watch = fleet.settings, fleet.checks
    required = settings["DID_OPTIONS"][rows].astype(np.int64) & _ENFORCE != 0
    yield required & (settings["DID_ENABLE"][rows] == 0), "OpenDroneID: DID_ENABLE must be 1"
    yield required & (watch["rid_id_type"][rows] == 0), "OpenDroneID: UA_TYPE required in BasicID"
    yield required & (watch["rid_operator"][rows] == 0), "OpenDroneID: operator location must be set"
    yield required & _is_stale(fleet, watch["rid_ns"][rows]), "OpenDroneID: ARM_STATUS not available"
    yield required & _is_stale(fleet, watch["rid_system_ns"][rows]), "OpenDroneID: SYSTEM not available"
    yield required & (watch["rid_status"][rows] != _GOOD), lambda vehicle: f"OpenDroneID: {vehicle.rid_error}"


def _is_stale(fleet: Fleet, heard_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    missing: NDArray[np.bool_] = (heard_ns == 0) | (fleet.now - heard_ns > _MAX_AGE_NS)
    return missing


Mask = NDArray[np.bool_]
Text = str | Callable[[Vehicle], str]
Failure = tuple[Mask, Text]
"""Which rows fail, and the text: a string, or a function of the aircraft that makes one."""

_DISPLAY_PERIOD_NS = 30 * NS_PER_S  # PREARM_DISPLAY_PERIOD
_URGENT_PERIOD_NS = 4 * NS_PER_S
_DISABLE_DISPLAY = 1  # ARMING_OPTIONS bit 0: DISABLE_PREARM_DISPLAY
_FIX_3D = 3
_GNSS_LOST_S = 4.0  # AP_GPS.h GPS_TIMEOUT_MS
_MAX_GPS_AHRS_ERROR_M = 10.0  # AP_ARMING_AHRS_GPS_ERROR_MAX
_MAX_ALT_DISPARITY_M = 1.0  # PREARM_MAX_ALT_DISPARITY_CM
_FIELD_MIN_MGAUSS, _FIELD_MAX_MGAUSS = 185, 875  # AP_ARMING_COMPASS_MAGFIELD_MIN, …_MAX
_PRED_POS_ABS = int(dialect.EKF_PRED_POS_HORIZ_ABS)
_PRED_POS_REL = int(dialect.EKF_PRED_POS_HORIZ_REL)
_AVOIDS_PROXIMITY = 2  # AC_AVOID_USE_PROXIMITY_SENSOR
_NEAREST_M = 0.6  # AP_Arming_Copter.cpp, proximity_checks
_HORIZONTAL_TYPES = int(fence.FenceType.CIRCLE | fence.FenceType.POLYGON)


class ArmingCheck(IntFlag):
    """ARMING_CHECK's bits that have a check here."""

    ALL = 1 << 0
    BARO = 1 << 1
    COMPASS = 1 << 2
    GPS = 1 << 3
    INS = 1 << 4
    RC = 1 << 6
    VOLTAGE = 1 << 7
    BATTERY = 1 << 8
    PARAMETERS = 1 << 5
    MISSION = 1 << 14
    RANGEFINDER = 1 << 15


class CheckInputs(NamedTuple):
    """Some rows and the inputs of the checks."""

    rows: NDArray[np.int64]
    bits: NDArray[np.int64]
    """ARMING_CHECK."""
    requires_position: Mask
    """The mode requires a position."""
    manual_throttle: Mask
    """The mode has manual throttle."""
    needs_mission: Mask
    has_position: Mask
    """There is a valid position."""
    fence_requires_position: Mask
    """A fence that requires a position is in force."""

    def check_enabled(self, bit: ArmingCheck) -> Mask:
        """Where ARMING_CHECK has a bit, or all."""
        return np.asarray(self.bits & (ArmingCheck.ALL | bit) != 0)


def gather_inputs(fleet: Fleet, rows: NDArray[np.int64]) -> CheckInputs:
    """Gather the inputs of the checks for some rows."""
    modes = fleet.modes[rows].tolist()
    kinds = fleet.fence["enabled"][rows] & fleet.settings["FENCE_TYPE"][rows].astype(np.int64)
    kinds = np.where(fleet.fence_zones["count"][rows] > 0, kinds, kinds & ~int(fence.FenceType.POLYGON))
    return CheckInputs(
        rows,
        fleet.settings["ARMING_CHECK"][rows].astype(np.int64),
        np.array([mode in REQUIRES_POSITION for mode in modes], dtype=bool),
        np.array([mode in MANUAL_THROTTLE for mode in modes], dtype=bool),
        np.array([mode == Mode.AUTO for mode in modes], dtype=bool),
        validity.has_position(fleet, rows),
        kinds & _HORIZONTAL_TYPES != 0,
    )


def _gcs_failsafe_check(fleet: Fleet, inputs: CheckInputs) -> list[Failure]:
    return [(fleet.checks["gcs_lost"][inputs.rows] != 0, "GCS failsafe on")]


def _alt_checks(fleet: Fleet, inputs: CheckInputs) -> list[Failure]:
    return [(~inputs.manual_throttle & ~validity.has_altitude(fleet, inputs.rows), "Need Alt Estimate")]


def _barometer_checks(fleet: Fleet, inputs: CheckInputs) -> list[Failure]:
    estimate, rows = fleet.estimate, inputs.rows
    status = estimate["status"][rows]
    by_baro = (status & _PRED_POS_REL == 0) & (status & _PRED_POS_ABS != 0)
    apart = np.abs(estimate["pos"][rows, 2] - estimate["baro_up"][rows]) > _MAX_ALT_DISPARITY_M
    return [(inputs.check_enabled(ArmingCheck.BARO) & by_baro & apart, "Altitude disparity")]


def _ins_checks(fleet: Fleet, inputs: CheckInputs) -> list[Failure]:
    bad = fleet.estimate["status"][inputs.rows] & validity.ATTITUDE == 0
    return [(inputs.check_enabled(ArmingCheck.INS) & bad, "EKF attitude is bad")]


def _compass_checks(fleet: Fleet, inputs: CheckInputs) -> list[Failure]:
    field = 1000.0 * elementwise.length(fleet.estimate["compass"][inputs.rows])
    odd = (field > _FIELD_MAX_MGAUSS) | (field < _FIELD_MIN_MGAUSS)

    def describe(vehicle: Vehicle) -> str:
        mgauss = 1000.0 * float(elementwise.length(fleet.estimate["compass"][vehicle.row]))
        return f"Check mag field: {mgauss:4.0f}, max {_FIELD_MAX_MGAUSS}, min {_FIELD_MIN_MGAUSS}"

    return [(inputs.check_enabled(ArmingCheck.COMPASS) & odd, describe)]


def _gps_checks(fleet: Fleet, inputs: CheckInputs) -> list[Failure]:
    """`gps_checks`: the receiver, where a position is required; then the estimate (`mandatory_gps_checks`)."""
    estimate, rows = fleet.estimate, inputs.rows
    enabled = inputs.check_enabled(ArmingCheck.GPS) & (inputs.requires_position | inputs.fence_requires_position)
    lost = (estimate["gnss_fix"][rows] < _FIX_3D) | (estimate["gnss_age_s"][rows] > _GNSS_LOST_S)
    away = estimate["pos"][rows, :2] - estimate["gnss_pos"][rows, :2]
    apart = np.sqrt((away[:, 0] * away[:, 0]) + (away[:, 1] * away[:, 1]))
    rough = estimate["gnss_hdop"][rows] * 100.0 > fleet.settings["GPS_HDOP_GOOD"][rows]

    def describe(vehicle: Vehicle) -> str:
        east, north, _ = (estimate["pos"][vehicle.row] - estimate["gnss_pos"][vehicle.row]).tolist()
        return f"GPS and AHRS differ by {elementwise.hypot(east, north):4.1f}m"

    return [
        (enabled & lost, "GPS 1: Bad fix"),
        (enabled & (fleet.checks["located"][rows] == 0), "AHRS: waiting for home"),
        (enabled & (apart > _MAX_GPS_AHRS_ERROR_M), describe),
        *_mandatory_gps_checks(fleet, inputs),
        (enabled & rough, "High GPS HDOP"),
    ]


def _mandatory_gps_checks(fleet: Fleet, inputs: CheckInputs) -> list[Failure]:
    """`mandatory_gps_checks`, also run for forced arming."""
    estimate, rows = fleet.estimate, inputs.rows
    status = estimate["status"][rows]
    most = fleet.settings["FS_EKF_THRESH"][rows]
    needed = inputs.requires_position | inputs.fence_requires_position
    ratios = {"compass": "mag_ratio", "position": "pos_ratio", "velocity": "vel_ratio", "height": "hgt_ratio"}
    return [
        (status & validity.UNINITIALIZED != 0, "AHRS: EKF3 still initialising"),
        (inputs.requires_position & ~inputs.has_position, "Need Position Estimate"),
        (inputs.fence_requires_position & ~inputs.has_position, "Fence enabled, need position estimate"),
        (needed & (status & validity.GLITCHING != 0), "GPS glitching"),
        *(
            (needed & (most > 0.0) & (estimate[field][rows] >= most), f"EKF {name} variance")
            for name, field in ratios.items()
        ),
    ]


def _battery_checks(fleet: Fleet, inputs: CheckInputs) -> list[Failure]:
    enabled = inputs.check_enabled(ArmingCheck.BATTERY)
    return [(enabled & bad, reason) for bad, reason in battery_monitor.prearm_failures(fleet, inputs.rows)]


def _battery_failsafe_check(fleet: Fleet, inputs: CheckInputs) -> list[Failure]:
    return [
        (
            inputs.check_enabled(ArmingCheck.VOLTAGE) & (fleet.battery["failsafe_triggered"][inputs.rows] != 0),
            "Battery failsafe",
        )
    ]


_REQUIRED_ITEMS: Final = {
    1: (int(dialect.MAV_CMD_NAV_LAND), "land"),
    4: (int(dialect.MAV_CMD_DO_LAND_START), "do land start"),
    8: (int(dialect.MAV_CMD_NAV_TAKEOFF), "takeoff"),
    64: (int(dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH), "RTL"),
}
"""ARMING_MIS_ITEMS: bit → command that the mission must contain."""
_REQUIRED_RALLY = 32


def _mission_checks(fleet: Fleet, inputs: CheckInputs) -> list[Failure]:
    rows = inputs.rows
    wanted = fleet.settings["ARMING_MIS_ITEMS"][rows].astype(np.int64)
    lacks, empty = np.zeros(rows.size, dtype=bool), np.zeros(rows.size, dtype=bool)
    missing: dict[int, str] = {}
    for place in np.flatnonzero(inputs.check_enabled(ArmingCheck.MISSION) & (wanted != 0)).tolist():
        row = int(rows[place])
        missing[row] = _missing_item(fleet, row, int(wanted[place]))
        lacks[place] = bool(missing[row])
    for place in np.flatnonzero(inputs.needs_mission).tolist():
        empty[place] = not fleet.vehicles[rows[place]].has_mission
    return [(lacks, lambda vehicle: missing[vehicle.row]), (empty, "Mode requires mission")]


def _missing_item(fleet: Fleet, row: int, bits: int) -> str:
    vehicle = fleet.vehicles[row]
    commands = {slot.command for slot in vehicle.mission[1:]}
    for bit, (command, name) in _REQUIRED_ITEMS.items():
        if bits & bit and command not in commands:
            return f"Missing mission item: {name}"
    if bits & _REQUIRED_RALLY and locations.nearest_rally_point(fleet, vehicle) is None:
        return "No sufficiently close rally point located"
    return ""


def _rangefinder_checks(fleet: Fleet, inputs: CheckInputs) -> list[Failure]:
    lost = np.zeros(inputs.rows.size, dtype=bool)
    for place, row in enumerate(inputs.rows.tolist()):
        sensors = fleet.range_sensors.get(row)
        if sensors is not None and sensors.rangefinder is not None:
            lost[place] = has_no_data(fleet, sensors.rangefinder.read_ns)
    return [(inputs.check_enabled(ArmingCheck.RANGEFINDER) & lost, "Rangefinder 1: No Data")]


def _proximity_checks(fleet: Fleet, inputs: CheckInputs) -> list[Failure]:
    """`proximity_checks`: a sensor that sends nothing, and an obstacle within 60 cm."""
    blind, near = np.zeros(inputs.rows.size, dtype=bool), np.zeros(inputs.rows.size, dtype=bool)
    closest_m: dict[int, float] = {}
    for place, row in enumerate(inputs.rows.tolist()):
        sensors = fleet.range_sensors.get(row)
        if sensors is None or sensors.proximity is None:
            continue
        blind[place] = has_no_data(fleet, sensors.proximity.read_ns)
        closest_m[row] = sensors.proximity.boundary.find_closest()
        avoids = int(fleet.param(fleet.vehicles[row], "AVOID_ENABLE")) & _AVOIDS_PROXIMITY
        near[place] = bool(avoids) and closest_m[row] <= _NEAREST_M

    def describe(vehicle: Vehicle) -> str:
        return f"Proximity {closest_m[vehicle.row]:4.2f}m (want > {_NEAREST_M:.1f}m)"

    return [(blind, "PRX1: No Data"), (inputs.check_enabled(ArmingCheck.PARAMETERS) & near, describe)]


def _fence_checks(fleet: Fleet, inputs: CheckInputs) -> list[Failure]:
    return list(fence.prearm_failures(fleet, inputs.rows, inputs.has_position))


def _opendroneid_checks(fleet: Fleet, inputs: CheckInputs) -> list[Failure]:
    return list(prearm_failures(fleet, inputs.rows))


CHECKS: Final[list[Callable[[Fleet, CheckInputs], Sequence[Failure]]]] = [
    _gcs_failsafe_check,
    _alt_checks,
    _barometer_checks,
    _ins_checks,
    _compass_checks,
    _gps_checks,
    _battery_checks,
    _mission_checks,
    _rangefinder_checks,
    _proximity_checks,
    _battery_failsafe_check,
    _fence_checks,
    _opendroneid_checks,
]
"""In ArduPilot's order."""

MANDATORY_CHECKS: Final[list[Callable[[Fleet, CheckInputs], Sequence[Failure]]]] = [
    _mandatory_gps_checks,
    _alt_checks,
    _opendroneid_checks,
]
"""Checks that are run even where ARMING_CHECK is 0 or arming is forced."""


def update(fleet: Fleet) -> None:
    """Check all disarmed aircraft, once a second; report failures every 30 s, or within 4 s of their beginning."""
    watch, flight = fleet.checks, fleet.flight
    watch["prearm_ok"][flight["armed"] != 0] = 1
    rows = np.flatnonzero(flight["armed"] == 0)
    if not rows.size:
        return
    inputs = gather_inputs(fleet, rows)
    every = inputs.bits != 0
    failures_by_check = _run_selected(fleet, inputs, CHECKS, every) + _run_selected(
        fleet, inputs, MANDATORY_CHECKS, ~every
    )
    failing = np.zeros(rows.size, dtype=bool)
    for reasons in failures_by_check:
        for bad, _ in reasons:
            failing |= bad
    since_report_ns = fleet.now - watch["prearm_reported_ns"][rows]
    urgent = watch["prearm_urgent"][rows] != 0
    due = (since_report_ns > _DISPLAY_PERIOD_NS) | (urgent & (since_report_ns > _URGENT_PERIOD_NS))
    watch["prearm_reported_ns"][rows[due]] = fleet.now
    watch["prearm_urgent"][rows[due]] = 0
    quiet = fleet.settings["ARMING_OPTIONS"][rows].astype(np.int64) & _DISABLE_DISPLAY != 0
    for place in np.flatnonzero(failing & due & ~quiet).tolist():
        _send_failures(fleet, fleet.vehicles[rows[place]], place, failures_by_check, "PreArm", ())
    watch["prearm_urgent"][rows[failing & (watch["prearm_ok"][rows] != 0)]] = 1
    watch["prearm_ok"][rows] = ~failing


def report_failures(fleet: Fleet, vehicle: Vehicle, causes: Causes) -> None:
    """Report what prevents arming, if anything does."""
    inputs = gather_inputs(fleet, np.array([vehicle.row]))
    failures_by_check = _run_selected(
        fleet, inputs, CHECKS if inputs.bits[0] else MANDATORY_CHECKS, np.ones(1, dtype=bool)
    )
    _send_failures(fleet, vehicle, 0, failures_by_check, "PreArm", causes)


def run_checks(fleet: Fleet, vehicle: Vehicle, causes: Causes, *, forced: bool) -> bool:
    """Run the checks for an aircraft to be armed now and report failures; if `forced`, only the mandatory ones."""
    inputs = gather_inputs(fleet, np.array([vehicle.row]))
    few = forced or inputs.bits[0] == 0
    failures_by_check = _run_selected(fleet, inputs, MANDATORY_CHECKS if few else CHECKS, np.ones(1, dtype=bool))
    failing = any(bad[0] for reasons in failures_by_check for bad, _ in reasons)
    if failing:
        _send_failures(fleet, vehicle, 0, failures_by_check, "Arm", causes)
    return not failing


def _run_selected(
    fleet: Fleet, inputs: CheckInputs, checks: Sequence[Callable[[Fleet, CheckInputs], Sequence[Failure]]], where: Mask
) -> list[list[Failure]]:
    """Return the failures that checks find, restricted to `where`."""
    if not where.any():
        return []
    return [[(bad & where, reason) for bad, reason in check(fleet, inputs)] for check in checks]


def _send_failures(
    fleet: Fleet, vehicle: Vehicle, place: int, failures_by_check: list[list[Failure]], head: str, causes: Causes
) -> None:
    """Send the first failure of every failing check as STATUSTEXT."""
    for reasons in failures_by_check:
        reason = next((reason for bad, reason in reasons if bad[place]), None)
        if reason is not None:
            text = reason if isinstance(reason, str) else reason(vehicle)
            fleet.send_text(vehicle, dialect.MAV_SEVERITY_CRITICAL, f"{head}: {text}", causes)
