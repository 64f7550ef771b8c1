"""Estimator: the filters of a whole fleet, updated in every tick, and the status that they report.

The strapdown runs in every tick, the filter every 10 ms; sensors are fused when they have new data. A row's numbers
depend on its own sensors alone. No sensor value, however wrong, makes a number that is not finite.

Filter status: flags and normalised innovations. NavEKF3_core::updateFilterStatus, healthy, getVariances and
send_status_report (AP_NavEKF3_Control.cpp, AP_NavEKF3_Outputs.cpp): the contents of EKF_STATUS_REPORT, read by pre-arm
checks and failsafes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import Floats, Sensors
from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time
from skyrange.vehicle.builtin.control.shaping import clamp
from skyrange.vehicle.builtin.estimation.bad_imu import HOLD_NS
from skyrange.vehicle.builtin.estimation.compass import align_yaw, body_to_local, read_compass
from skyrange.vehicle.builtin.estimation.covariance import predict
from skyrange.vehicle.builtin.estimation.gnss import (
    check_aiding,
    claimed_accuracy,
    process_fix,
    receiver_passes,
    update_receiver_status,
)
from skyrange.vehicle.builtin.estimation.height import read_baro
from skyrange.vehicle.builtin.estimation.state import (
    ACCEL_MAX_MPS2,
    GYRO_BIAS_LIMIT_RADPS,
    HEIGHT_MAX_M,
    HISTORY_LENGTH,
    INTERVAL_MIN_NS,
    POS_LIMIT_M,
    STEP_NS,
    VEL_LIMIT_MPS,
    Aiding,
    Status,
    new_filters,
)
from skyrange.vehicle.builtin.estimation.strapdown import (
    COLUMNS,
    LANES,
    run_strapdown,
    update_output,
    update_roll_pitch,
    valid_reading,
)
from skyrange.vehicle.builtin.estimation.yaw_by_gnss import fuse_velocity, reset_on_request
from skyrange.vehicle.builtin.layout import Records
from skyrange.world.sensing.geomagnetism import magnetic_field_at

_ATTITUDE = int(Status.ATTITUDE)
_VELOCITY_HORIZ = int(Status.VELOCITY_HORIZ)
_VELOCITY_VERT = int(Status.VELOCITY_VERT)
_POS_HORIZ_REL = int(Status.POS_HORIZ_REL | Status.PRED_POS_HORIZ_REL)
_POS_HORIZ = int(Status.POS_HORIZ_REL | Status.POS_HORIZ_ABS | Status.PRED_POS_HORIZ_REL | Status.PRED_POS_HORIZ_ABS)
_POS_VERT_ABS = int(Status.POS_VERT_ABS)
_POS_VERT_AGL = int(Status.POS_VERT_AGL)
_CONST_POS = int(Status.CONST_POS_MODE)
_GLITCHING = int(Status.GPS_GLITCHING)


@compiled
def update_filter_status(e: Any, k: Any, p: Any, ranged: bool) -> None:  # noqa: FBT001
    """Update the status fields of the estimate; `ranged` is whether the rangefinder sees the ground.

    Dead reckoning is a position that has timed out while the wind is known (`doingWindRelNav`), which a copter knows
    only with EK3_DRAG_BCOEF_X or _Y. Drag is not fused here: the position is extrapolated.
    """
    e.vel_ratio = math.sqrt(k.vel_test)
    e.pos_ratio = math.sqrt(k.pos_test)
    e.hgt_ratio = math.sqrt(k.hgt_test)
    e.mag_ratio = math.sqrt(k.mag_test)
    navigating = k.aiding == _ABSOLUTE and k.pos_timeout == 0
    knows_wind = p.EK3_DRAG_BCOEF_X > 0.0 or p.EK3_DRAG_BCOEF_Y > 0.0
    reckons = k.aiding == _ABSOLUTE and k.pos_timeout == 1 and knows_wind
    e.dead_reckoning = 1 if reckons else 0
    flags = 0
    if not (k.vel_test > 1.0 and k.pos_test > 1.0 and k.hgt_test > 1.0):
        flags = _ATTITUDE
        if reckons or not (k.vel_timeout == 1 and k.pos_timeout == 1):
            flags |= _VELOCITY_HORIZ
        if k.vel_timeout == 0 or k.hgt_timeout == 0:
            flags |= _VELOCITY_VERT
        if navigating:
            flags |= _POS_HORIZ
        elif reckons:
            flags |= _POS_HORIZ_REL
        if k.hgt_timeout == 0:
            flags |= _POS_VERT_ABS
        if ranged:
            flags |= _POS_VERT_AGL
        if k.aiding == _NONE:
            flags |= _CONST_POS
    if k.aiding == _ABSOLUTE and not (k.sacc_good == 1 and k.innov_good == 1):
        flags |= _GLITCHING
    e.status = flags


Ints = NDArray[np.int64]

_ABSOLUTE = int(Aiding.ABSOLUTE)
_NONE = int(Aiding.NONE)
_VOLTS_MAX = 1000.0  # more than any flight battery: a reading stays finite
_AMPERES_MAX = 10_000.0
_ACCEL_FILTER = 0.05  # UpdateStrapdownEquationsNED: low pass of the acceleration, per step
_START_VEL_MPS = 0.1
_START_TILT_RAD = 0.01
_START_BIAS_RADPS = math.radians(0.15)  # checkGyroCalStatus: what counts as calibrated
_START_ACCEL_MPS2 = 0.1
_START_YAW_RAD = math.radians(5.0)


@compiled
def initialise_filters(  # noqa: PLR0917
    now: int,
    accel: Floats,
    position: Floats,
    velocity: Floats,
    baro: Floats,
    compass: Floats,
    accuracy: Floats,
    fix: Ints,
    satellites: Ints,
    time: Ints,
    field: Floats,
    estimate: Records,
    filters: Records,
    set_index: Ints,
    settings: Records,
) -> None:
    """Initialise every row as long after boot: at rest, aligned, receiver checks passed if they pass now.

    Tilt is from the accelerometers, yaw from the compass (without one, as given in the estimate), position from the fix
    (without one, as given), height from the barometer.
    """
    for i in range(estimate.shape[0]):
        e: Any = estimate[i]
        k: Any = filters[i]
        p: Any = settings[set_index[i]]
        heading = e.yaw
        for axis in range(3):
            k.force[axis] = valid_reading(accel[i, axis], 0.0, ACCEL_MAX_MPS2)
        a, b, c = k.force[0], k.force[1], k.force[2]
        pitch = elementary.atan2(-a, math.sqrt(b * b + c * c)) if a * a + b * b + c * c > 1.0 else 0.0
        roll = elementary.atan2(b, c) if b * b + c * c > 1.0 else 0.0
        cr, sr, cp, sp = (
            elementary.cos(0.5 * roll),
            elementary.sin(0.5 * roll),
            elementary.cos(0.5 * pitch),
            elementary.sin(0.5 * pitch),
        )
        e.quat[0], e.quat[1], e.quat[2], e.quat[3] = cr * cp, sr * cp, cr * sp, -sr * sp
        east, north, _ = body_to_local(e, compass[i, 0], compass[i, 1], compass[i, 2])
        level = field[0] * field[0] + field[1] * field[1]
        if level > 0.0 and east * east + north * north > 1e-4:
            align_yaw(e, k, elementary.atan2(east * field[1] - north * field[0], east * field[0] + north * field[1]))
        else:
            align_yaw(e, k, heading)
        k.reset_delta_yaw = 0.0
        update_output(e, k)
        update_roll_pitch(e)
        k.cov_yaw[0], k.cov_yaw[1], k.cov_yaw[2] = (
            _START_YAW_RAD * _START_YAW_RAD,
            0.0,
            _START_BIAS_RADPS * _START_BIAS_RADPS,
        )

        h_acc, v_acc = claimed_accuracy(accuracy[i, 0], 100.0), claimed_accuracy(accuracy[i, 1], 100.0)
        s_acc = claimed_accuracy(accuracy[i, 2], 50.0)
        k.pos_acc = max(h_acc, p.EK3_POSNE_M_NSE)
        k.spd_acc = max(s_acc, p.EK3_VELNE_M_NSE)
        usable = fix[i] >= 3
        for axis in range(3):
            usable = usable and abs(position[i, axis]) <= POS_LIMIT_M and abs(velocity[i, axis]) <= VEL_LIMIT_MPS
            k.pos[axis] = e.pos[axis]
        k.check_fail = now
        k.check_pass = now
        if usable and receiver_passes(k, p, h_acc, v_acc, 1.0, satellites[i], 0.01 * p.EK3_CHECK_SCALE):
            k.gps_good_to_align = 1
            k.aiding = _ABSOLUTE
            for axis in range(2):
                k.pos[axis] = position[i, axis]
        else:
            k.aiding = _NONE
            k.pos_timeout = 1
            k.vel_timeout = 1
        k.last_known_pos[0], k.last_known_pos[1] = k.pos[0], k.pos[1]
        if abs(baro[i]) < 1e4:
            k.pos[2] = baro[i]
        k.cov_horizontal[0] = k.pos_acc * k.pos_acc
        k.cov_horizontal[4] = _START_VEL_MPS * _START_VEL_MPS
        k.cov_horizontal[7] = _START_TILT_RAD * _START_TILT_RAD
        k.cov_horizontal[9] = _START_BIAS_RADPS * _START_BIAS_RADPS
        k.cov_vertical[0] = 1.0
        k.cov_vertical[3] = _START_VEL_MPS * _START_VEL_MPS
        k.cov_vertical[5] = _START_ACCEL_MPS2 * _START_ACCEL_MPS2
        k.pos_pass = k.vel_pass = k.hgt_pass = k.mag_pass = now
        k.innov_pass = k.innov_fail = now
        k.innov_good = k.sacc_good = 1
        k.vel_aiding = 1
        k.bad_imu_at = now - 3 * HOLD_NS  # long past
        k.good_imu_at = now
        k.fix_time = time[i]
        k.fix_at = now
        k.baro_at = k.compass_at = now - STEP_NS
        e.gnss_fix = min(max(fix[i], 0), 8)
        e.gnss_sats = min(max(satellites[i], 0), 255)
        e.gnss_hdop = 1.0
        e.gnss_acc[0], e.gnss_acc[1], e.gnss_acc[2] = h_acc, v_acc, s_acc
        for axis in range(3):
            e.gnss_pos[axis] = position[i, axis] if usable else k.pos[axis]
            e.gnss_vel[axis] = velocity[i, axis] if usable else 0.0


@compiled
def step_strapdown(gyro: Floats, accel: Floats, dt_s: float, estimate: Records, filters: Records) -> None:
    """Run one tick of every row that is no filter step."""
    _run_strapdowns(gyro, accel, dt_s, shown=True, estimate=estimate, filters=filters)


@compiled
def _run_strapdowns(gyro: Floats, accel: Floats, dt_s: float, shown: bool, estimate: Records, filters: Records) -> None:  # noqa: FBT001
    count = estimate.shape[0]
    lanes = np.zeros(COLUMNS)
    for first in range(0, count, LANES):
        run_strapdown(lanes, first, min(LANES, count - first), gyro, accel, dt_s, shown, estimate, filters)


@compiled
def step_filters(  # noqa: PLR0917
    now: int,
    dt_s: float,
    step_s: float,
    slot: int,
    gyro: Floats,
    accel: Floats,
    position: Floats,
    velocity: Floats,
    baro: Floats,
    rangefinder: Floats,
    compass: Floats,
    accuracy: Floats,
    fix: Ints,
    satellites: Ints,
    time: Ints,
    volts: Floats,
    amperes: Floats,
    field: Floats,
    room: Floats,
    armed: Ints,
    history: Floats,
    estimate: Records,
    filters: Records,
    set_index: Ints,
    settings: Records,
) -> int:
    """Run one tick of every row; if `step_s` is not 0, also a filter step of that length, number `slot`.

    Returns how many rows have new events.
    """
    news = 0
    earth = (field[0], field[1], field[2])
    _run_strapdowns(gyro, accel, dt_s, step_s <= 0.0, estimate, filters)
    if step_s <= 0.0:
        return news
    for i in range(estimate.shape[0]):
        e: Any = estimate[i]
        k: Any = filters[i]
        p: Any = settings[set_index[i]]
        on = armed[i] != 0
        here = slot & (HISTORY_LENGTH - 1)
        for axis in range(3):
            history[i, here, axis] = k.pos[axis] - k.corrected_pos[axis]
            history[i, here, 3 + axis] = k.vel[axis] - k.corrected_vel[axis]
            k.accel_slow[axis] += _ACCEL_FILTER * (e.accel[axis] - k.accel_slow[axis])
        check_aiding(k, p, now)
        predict(k, p, step_s)
        read_compass(e, k, p, now, (compass[i, 0], compass[i, 1], compass[i, 2]), earth, on)
        update_receiver_status(e, k, now, fix[i], satellites[i])
        if time[i] != k.fix_time and now - k.fix_at >= INTERVAL_MIN_NS:
            process_fix(
                e, k, p, now, fix[i], satellites[i], time[i], position, velocity, accuracy, history, i, slot, room
            )
            if k.fix_at == now:
                fuse_velocity(k, time[i], history, i, slot, now, on)
        reset_on_request(e, k, p, now)
        read_baro(e, k, p, now, baro[i], on)
        _finish_step(e, k, p, step_s)
        seen = rangefinder[i]
        ranged = math.isfinite(seen) and seen >= 0.0
        e.height = min(seen, HEIGHT_MAX_M) if ranged else k.pos[2]
        update_filter_status(e, k, p, ranged)
        e.battery_v = valid_reading(volts[i], e.battery_v, _VOLTS_MAX)
        e.battery_a = valid_reading(amperes[i], e.battery_a, _AMPERES_MAX)
        if k.events != 0:
            news += 1
        update_output(e, k)
    return news


@compiled
def _finish_step(e: Any, k: Any, p: Any, step_s: float) -> None:
    """After a filter step, apply corrections over EK3_TAU_OUTPUT, normalise the attitude and limit the biases."""
    keep = 1.0 - step_s / max(clamp(0.01 * p.EK3_TAU_OUTPUT, 0.1, 0.5), step_s)
    w, x, y, z = e.quat[0], e.quat[1], e.quat[2], e.quat[3]
    norm = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    for part in range(4):
        e.quat[part] *= norm
    for axis in range(3):
        k.pending_pos[axis] *= keep
        k.pending_vel[axis] *= keep
        k.gyro_bias[axis] = clamp(k.gyro_bias[axis], -GYRO_BIAS_LIMIT_RADPS, GYRO_BIAS_LIMIT_RADPS)
        e.imu_accel[axis] = k.force[axis]
    update_roll_pitch(e)


class Estimator:
    """The filters of one engine's aircraft. A deep copy continues identically."""

    def __init__(self, count: int, origin: Origin) -> None:
        """`origin` gives the magnetic field where the fleet flies."""
        self.filters, self._history = new_filters(count)
        self._field = np.array(magnetic_field_at(origin), dtype=np.float64)
        self._buffer = np.zeros(6)
        self._slot = 0
        self._last_step: Time | None = None

    def update(
        self,
        now: Time,
        dt_s: float,
        sensors: Sensors,
        estimate: Records,
        *,
        armed: Ints,
        set_index: Ints,
        settings: Records,
    ) -> int:
        """Process one tick's sensors, `dt_s` after the last; `estimate` then holds the estimated state.

        At the first call `estimate` holds the known initial position and yaw of each aircraft. `armed` is (n,), not 0
        where motors may turn; `set_index` (n,) the row in `settings` of each. Returns how many aircraft have new events
        (`filters["events"]`), which stay until they are cleared.
        """
        s = sensors
        fix = (s.gnss_fix, s.gnss_satellites, s.gnss_time_ns)
        if self._last_step is None:
            initialise_filters(
                now, s.accel_mps2, s.gnss_enu_m, s.gnss_vel_enu_mps, s.baro_up_m, s.compass_gauss, s.gnss_accuracy,
                *fix, self._field, estimate, self.filters, set_index, settings,
            )  # fmt: skip
            self._last_step = now - STEP_NS
            dt_s = 0.0
        step_s = 0.0
        if now // STEP_NS != self._last_step // STEP_NS:
            step_s = (now - self._last_step) / NS_PER_S
            self._last_step = now
            self._slot += 1
        return step_filters(
            now, dt_s, step_s, self._slot, s.gyro_radps, s.accel_mps2, s.gnss_enu_m, s.gnss_vel_enu_mps, s.baro_up_m,
            s.rangefinder_m, s.compass_gauss, s.gnss_accuracy, *fix, s.battery_v, s.battery_a, self._field,
            self._buffer, armed, self._history, estimate, self.filters, set_index, settings,
        )  # fmt: skip
