"""Multirotor dynamics over one quantum: rigid body, lagging rotors, drag, wind, and ground contact.

One numba kernel over all aircraft, scalar code per aircraft: no sum crosses vehicles and only + - * / and sqrt touch
the state, all correctly rounded by IEEE 754, so an aircraft's numbers do not depend on how many others share the
arrays.

Model (Mahony, Kumar & Corke, "Multirotor Aerial Vehicles", IEEE RAM 19(3), 2012): thrust k·ω² along body up, drag
torque `arm`·thrust against each rotor's spin, rotor drag in the rotor's plane, quadratic body drag, gravity, Euler's
equation with a diagonal inertia. Rotational drag: about each axis as if the body's drag area were at the rotors,
½·ρ·area·arm³·|Ω|·Ω; negligible in flight, it limits the rate of a tumble, for the Iris near 60 rad/s, where its arms'
ends move as fast as the pitch of its propellers. Left out: rotor inertia, loss of thrust with inflow, ground effect,
blade flapping moments.

Integration. Rotor speed: the exact solution of the first-order lag for a command held over the quantum. Velocity:
forces at the attitude of the quantum's start; position: the mean of old and new velocity, which makes constant
acceleration exact. Rates: the midpoint rule, whose energy error in free rotation is of fourth order per step
(symplectic Euler's is of second). Attitude: rotation by the mean rate with the quaternion exponential's series to
fourth order, normalised. At 2.5 ms a rotor's time constant is five steps, and the closed forms of tests/validation are
met to a thousandth or better; RK4 over the whole state would evaluate the forces four times as often for digits that
the parameters do not have.

Ground: a plane at the height of the `floor` below each aircraft, hit without bounce. The normal impulse stops the
fall; friction removes at most `friction` times it from the sliding speed; the gear removes at most its lever arm times
it from roll and pitch rates and brings the aircraft level, so a take-off with enough torque does tip over. If the
aircraft tilts beyond the tip angle on the ground, the propellers strike and break: it has crashed and stays down. The
same happens after a touchdown faster than `MAX_TOUCHDOWN_MPS`.
"""

from __future__ import annotations

import math

import numpy as np

from skyrange.core import elementary
from skyrange.core.compiled import compiled, inlined
from skyrange.world.airframes import AIR_DENSITY_KGM3, GRAVITY_MPS2, MOTORS, Airframe
from skyrange.world.body_state import BodyArrays, BodyState, Floats, Marks

ALOFT, ON_GROUND, CRASHED, EVENTS = 0, 1, 2, 3
"""Columns of the flags table: zero or one; EVENTS holds the bits of what happened since it was cleared."""
TOUCHED, TIPPED, BROKEN, JUMPED = 1, 2, 4, 8
"""Bits of EVENTS: a touchdown; tipping over on the ground; a touchdown too hard to survive; an
imposed pose far away."""
IMPOSED, SIMULATED = 1, 2
"""Values of `is_imposed`: an engine imposes the pose, and nothing in the world alters the body; a simulator moves the
body under the world's forces, so that its rotors and battery are the world's."""
MAX_TOUCHDOWN_MPS = 3.117
"""A faster touchdown breaks the aircraft: sqrt(2·g·h) of the reserve energy drop test, one and a half times 13 inches
(14 CFR 27.727, 27.725), the most that a rotorcraft's landing gear has to withstand."""
REARM_M = 0.05  # height to climb before a touchdown counts as another one
_LEVEL_TAU_S = 0.1  # how fast the gear brings a standing aircraft level
_NEGLIGIBLE = 1e-6  # a decay ends here (rad/s, rad), because subnormal numbers would be ten times slower

_ROUND = 1e-8  # its square is below a double's precision

_MASS, _PER_MASS, _JX, _JY, _JZ, _PER_JX, _PER_JY, _PER_JZ, _THRUST, _ARM = range(10)
_ROTOR_DRAG, _BODY_DRAG, _STANCE, TIP_COS, _FRICTION, _SPIN_DRAG, _LEFT = range(10, 17)
_FORWARD, _SPIN = _LEFT + MOTORS, _LEFT + 2 * MOTORS  # blocks of one number per rotor, as _LEFT
_NUMBERS = _LEFT + 3 * MOTORS

LANES = 16
"""Aircraft that are computed together, in vector registers."""
# where the lanes of each column begin: first the airframe's numbers, then the state before the quantum, and after it
(
    _PX, _PY, _PZ, _VX, _VY, _VZ, _QW, _QX, _QY, _QZ, _WX, _WY, _WZ, _UX, _UY, _UZ,
    _WORK, _NX, _NY, _NZ, _NVX, _NVY, _NVZ, _AX, _AY, _AZ, _NWX, _NWY, _NWZ, _NQW, _NQX, _NQY, _NQZ, _SPEED,
) = range(_NUMBERS * LANES, (_NUMBERS + 34) * LANES, LANES)  # fmt: skip
_COLUMNS = _SPEED + MOTORS * LANES


def motor_rows(airframe: Airframe, step_s: float) -> tuple[float, float, float]:
    """What `spin_rotors` reads of a motor: thrust curve, and the lag's share per quantum of `step_s`, speeding up and
    slowing down.
    """
    up, down = -elementary.expm1(-step_s / airframe.tau_up_s), -elementary.expm1(-step_s / airframe.tau_down_s)
    return airframe.thrust_expo, up, down


def parameter_row(airframe: Airframe) -> list[float]:
    """An airframe's numbers as the kernel reads them."""
    return [
        airframe.mass_kg,
        1.0 / airframe.mass_kg,
        *airframe.inertia_kgm2,
        *(1.0 / moment for moment in airframe.inertia_kgm2),
        airframe.thrust_ns2,
        airframe.torque_arm_m,
        airframe.rotor_drag_ns2,
        0.5 * AIR_DENSITY_KGM3 * airframe.drag_area_m2,
        airframe.gear_half_track_m,
        elementary.cos(airframe.tip_angle_rad),
        airframe.friction,
        0.5 * AIR_DENSITY_KGM3 * airframe.drag_area_m2 * (airframe.arm_m * airframe.arm_m * airframe.arm_m),
        *(rotor.left_m for rotor in airframe.rotors),
        *(rotor.forward_m for rotor in airframe.rotors),
        *(rotor.spin for rotor in airframe.rotors),
    ]


@compiled
def _toward(rate: float, target: float, limit: float) -> float:
    """`rate` moved towards `target` by at most `limit`."""
    change = target - rate
    if change > limit:
        change = limit
    elif change < -limit:
        change = -limit
    return rate + change


@compiled
def spin_rotors(
    expo: Floats, lag_up: Floats, lag_down: Floats, limit: Floats, commands: Floats, rotor_radps: Floats
) -> None:
    """Rotor speeds of all motors after a quantum; flat arrays, one number per motor. Straight-line code, so it is
    vectorised.
    """
    for k in range(rotor_radps.shape[0]):
        command = commands[k]
        command = command if command > 0.0 else 0.0  # a NaN is no thrust
        command = command if command < 1.0 else 1.0
        share = max(command * (1.0 - expo[k] + expo[k] * command), 0.0)  # a root that may fail is not vectorised
        target = limit[k] * math.sqrt(share)
        speed = rotor_radps[k]
        speed += (target - speed) * (lag_up[k] if target > speed else lag_down[k])
        rotor_radps[k] = speed if speed >= _NEGLIGIBLE else 0.0


@inlined
def rotate_attitude(  # noqa: PLR0917
    qw: float, qx: float, qy: float, qz: float, tx: float, ty: float, tz: float
) -> tuple[float, float, float, float]:
    """An attitude rotated by a body vector: the quaternion exponential's series to fourth order, normalised."""
    t2 = tx * tx + ty * ty + tz * tz
    c = 1.0 - t2 * (1.0 / 8.0 - t2 / 384.0)
    s = 0.5 - t2 / 48.0
    tx *= s
    ty *= s
    tz *= s
    nw = qw * c - qx * tx - qy * ty - qz * tz
    nx = qx * c + qw * tx + qy * tz - qz * ty
    ny = qy * c + qw * ty + qz * tx - qx * tz
    nz = qz * c + qw * tz + qx * ty - qy * tx
    # 1/sqrt(1 + x) is 1 - x/2, since x is only rounding and the truncation of the series
    square = nw * nw + nx * nx + ny * ny + nz * nz
    norm = 1.5 - 0.5 * square if abs(square - 1.0) < _ROUND else 1.0 / math.sqrt(square)
    return nw * norm, nx * norm, ny * norm, nz * norm


@compiled
def _land(  # arrays and not a `BodyState`: each that is taken out of one is counted, here too often  # noqa: PLR0917
    i: int,
    step_s: float,
    p: Floats,
    ground: float,
    nvx: float,
    nvy: float,
    nvz: float,
    nwx: float,
    nwy: float,
    nwz: float,
    position: Floats,
    velocity: Floats,
    attitude: Floats,
    rates: Floats,
    accel: Floats,
    limit: Floats,
    alive: Marks,
    flags: Marks,
    impact_mps: Floats,
) -> int:
    """Finish the quantum of an aircraft whose new velocity and rates take it into the ground; returns the number of
    events.
    """
    events = 0
    vx, vy, vz = velocity[i, 0], velocity[i, 1], velocity[i, 2]
    qw, qx, qy, qz = attitude[i, 0], attitude[i, 1], attitude[i, 2], attitude[i, 3]
    flags[i, ON_GROUND] = 1
    broken = False
    if flags[i, ALOFT]:
        flags[i, ALOFT] = 0
        flags[i, EVENTS] |= TOUCHED
        impact_mps[i] = math.sqrt(nvx * nvx + nvy * nvy + nvz * nvz)
        events += 1
        if impact_mps[i] > MAX_TOUCHDOWN_MPS and not flags[i, CRASHED]:
            flags[i, EVENTS] |= BROKEN
            broken = True
    impulse = -nvz  # of the ground, per mass
    slide = math.sqrt(nvx * nvx + nvy * nvy)
    grip = p[_FRICTION] * impulse
    keep = 1.0 - grip / slide if slide > grip else 0.0
    nvx *= keep
    nvy *= keep
    # the accelerometer measures the force of the ground
    gx = (nvx - vx) / step_s
    gy = (nvy - vy) / step_s
    gz = -vz / step_s + GRAVITY_MPS2
    r20 = 2.0 * (qx * qz - qw * qy)
    r21 = 2.0 * (qy * qz + qw * qx)
    r22 = 1.0 - 2.0 * (qx * qx + qy * qy)
    accel[i, 0] = (1.0 - 2.0 * (qy * qy + qz * qz)) * gx + 2.0 * (qx * qy + qw * qz) * gy + r20 * gz
    accel[i, 1] = 2.0 * (qx * qy - qw * qz) * gx + (1.0 - 2.0 * (qx * qx + qz * qz)) * gy + r21 * gz
    accel[i, 2] = 2.0 * (qx * qz + qw * qy) * gx + 2.0 * (qy * qz - qw * qx) * gy + r22 * gz
    position[i, 0] += 0.5 * (vx + nvx) * step_s
    position[i, 1] += 0.5 * (vy + nvy) * step_s
    position[i, 2] = ground
    velocity[i, 0], velocity[i, 1], velocity[i, 2] = nvx, nvy, 0.0
    if impulse > 0.0:
        level_x = 0.0
        level_y = 0.0
        if r22 < p[TIP_COS]:
            if not flags[i, CRASHED] and not broken:
                flags[i, EVENTS] |= TIPPED
                broken = True
                events += 1
        elif r20 * r20 + r21 * r21 > _NEGLIGIBLE * _NEGLIGIBLE and not flags[i, CRASHED] and not broken:
            level_x = -r21 / _LEVEL_TAU_S
            level_y = r20 / _LEVEL_TAU_S
        hold = p[_MASS] * impulse * p[_STANCE]
        nwx = _toward(nwx, level_x, hold * p[_PER_JX])
        nwy = _toward(nwy, level_y, hold * p[_PER_JY])
        nwz = _toward(nwz, 0.0, hold * p[_FRICTION] * p[_PER_JZ])
    if broken:
        flags[i, CRASHED] = 1
        for m in range(MOTORS):
            alive[i, m] = 0
            limit[i, m] = 0.0
    half = 0.5 * step_s
    attitude[i, 0], attitude[i, 1], attitude[i, 2], attitude[i, 3] = rotate_attitude(
        qw, qx, qy, qz, half * (rates[i, 0] + nwx), half * (rates[i, 1] + nwy), half * (rates[i, 2] + nwz)
    )
    rates[i, 0], rates[i, 1], rates[i, 2] = nwx, nwy, nwz
    return events


@compiled
def _move_lanes(step_s: float, s: Floats) -> None:
    """The quantum of aircraft in free flight, one in each lane of `s`, whose columns follow each other. Straight-line
    code at constant distances in one array, which LLVM turns into vector instructions.
    """
    half = 0.5 * step_s
    for k in range(LANES):
        vx, vy, vz = s[_VX + k], s[_VY + k], s[_VZ + k]
        qw, qx, qy, qz = s[_QW + k], s[_QX + k], s[_QY + k], s[_QZ + k]
        wx, wy, wz = s[_WX + k], s[_WY + k], s[_WZ + k]

        # rotors
        thrust = 0.0
        turning = 0.0
        torque_x = 0.0
        torque_y = 0.0
        torque_z = 0.0
        cubes = 0.0
        for m in range(MOTORS):
            speed = s[_SPEED + m * LANES + k]
            force = s[_THRUST * LANES + k] * speed * speed
            thrust += force
            turning += speed
            cubes += force * speed
            torque_x += s[(_LEFT + m) * LANES + k] * force
            torque_y -= s[(_FORWARD + m) * LANES + k] * force
            torque_z -= s[(_SPIN + m) * LANES + k] * s[_ARM * LANES + k] * force
        s[_WORK + k] = s[_ARM * LANES + k] * cubes * step_s

        # forces in the body, from the air's velocity across it
        r00 = 1.0 - 2.0 * (qy * qy + qz * qz)
        r01 = 2.0 * (qx * qy - qw * qz)
        r02 = 2.0 * (qx * qz + qw * qy)
        r10 = 2.0 * (qx * qy + qw * qz)
        r11 = 1.0 - 2.0 * (qx * qx + qz * qz)
        r12 = 2.0 * (qy * qz - qw * qx)
        r20 = 2.0 * (qx * qz - qw * qy)
        r21 = 2.0 * (qy * qz + qw * qx)
        r22 = 1.0 - 2.0 * (qx * qx + qy * qy)
        ux = vx - s[_UX + k]
        uy = vy - s[_UY + k]
        uz = vz - s[_UZ + k]
        bx = r00 * ux + r10 * uy + r20 * uz
        by = r01 * ux + r11 * uy + r21 * uz
        bz = r02 * ux + r12 * uy + r22 * uz
        body = s[_BODY_DRAG * LANES + k] * math.sqrt(ux * ux + uy * uy + uz * uz)
        rotor = s[_ROTOR_DRAG * LANES + k] * turning
        ax = -(body + rotor) * bx * s[_PER_MASS * LANES + k]
        ay = -(body + rotor) * by * s[_PER_MASS * LANES + k]
        az = (thrust - body * bz) * s[_PER_MASS * LANES + k]
        nvx = vx + (r00 * ax + r01 * ay + r02 * az) * step_s
        nvy = vy + (r10 * ax + r11 * ay + r12 * az) * step_s
        nvz = vz + (r20 * ax + r21 * ay + r22 * az - GRAVITY_MPS2) * step_s

        # rates: midpoint rule on Euler's equation
        torque_x -= s[_SPIN_DRAG * LANES + k] * abs(wx) * wx
        torque_y -= s[_SPIN_DRAG * LANES + k] * abs(wy) * wy
        torque_z -= s[_SPIN_DRAG * LANES + k] * abs(wz) * wz
        x_from_yz = s[_JZ * LANES + k] - s[_JY * LANES + k]
        y_from_zx = s[_JX * LANES + k] - s[_JZ * LANES + k]
        z_from_xy = s[_JY * LANES + k] - s[_JX * LANES + k]
        mx = wx + half * (torque_x - x_from_yz * wy * wz) * s[_PER_JX * LANES + k]
        my = wy + half * (torque_y - y_from_zx * wz * wx) * s[_PER_JY * LANES + k]
        mz = wz + half * (torque_z - z_from_xy * wx * wy) * s[_PER_JZ * LANES + k]
        nwx = wx + step_s * (torque_x - x_from_yz * my * mz) * s[_PER_JX * LANES + k]
        nwy = wy + step_s * (torque_y - y_from_zx * mz * mx) * s[_PER_JY * LANES + k]
        nwz = wz + step_s * (torque_z - z_from_xy * mx * my) * s[_PER_JZ * LANES + k]

        s[_NX + k] = s[_PX + k] + 0.5 * (vx + nvx) * step_s
        s[_NY + k] = s[_PY + k] + 0.5 * (vy + nvy) * step_s
        s[_NZ + k] = s[_PZ + k] + 0.5 * (vz + nvz) * step_s
        s[_NVX + k] = nvx
        s[_NVY + k] = nvy
        s[_NVZ + k] = nvz
        s[_AX + k] = ax
        s[_AY + k] = ay
        s[_AZ + k] = az
        s[_NWX + k] = nwx
        s[_NWY + k] = nwy
        s[_NWZ + k] = nwz
        s[_NQW + k], s[_NQX + k], s[_NQY + k], s[_NQZ + k] = rotate_attitude(
            qw, qx, qy, qz, half * (wx + nwx), half * (wy + nwy), half * (wz + nwz)
        )


@compiled
def advance(step_s: float, bodies: BodyState) -> int:
    """Move every aircraft by one quantum; returns the number of events it flagged.

    `work_j` gains the rotors' work, `before` receives the old positions. Where `is_imposed` is not 0 only the rotors
    turn: `imposed_poses.follow` moves the body.
    """
    parameters, airframe, wind, floor = bodies.parameters, bodies.airframe, bodies.air, bodies.floor
    position, velocity, attitude, rates = bodies.position, bodies.velocity, bodies.attitude, bodies.rates
    rotor_radps, accel, flags, height = bodies.rotor_radps, bodies.accel, bodies.flags, bodies.height
    limit, alive, impact_mps = bodies.limit, bodies.alive, bodies.impact_mps
    runs, max_step2_m2 = bodies.run, bodies.max_step2_m2
    work_j, before, odometer_m, is_imposed = bodies.work_j, bodies.before, bodies.odometer_m, bodies.is_imposed
    spin_rotors(
        bodies.expo.reshape(-1),
        bodies.lag_up.reshape(-1),
        bodies.lag_down.reshape(-1),
        bodies.limit.reshape(-1),
        bodies.commands.reshape(-1),
        rotor_radps.reshape(-1),
    )
    events = 0
    run = 0
    longest = 0.0
    count = position.shape[0]
    s = np.zeros(_COLUMNS)
    loaded = np.full(LANES, -1)  # the airframe whose numbers are in each lane
    for first in range(0, count, LANES):
        used = min(LANES, count - first)
        for lane in range(used):
            i = first + lane
            a = airframe[i]  # an index, not a view of its row: making a view every time costs more than a rotor
            if a != loaded[lane]:
                loaded[lane] = a
                for k in range(_NUMBERS):
                    s[k * LANES + lane] = parameters[a, k]
            s[_PX + lane], s[_PY + lane], s[_PZ + lane] = position[i, 0], position[i, 1], position[i, 2]
            s[_VX + lane], s[_VY + lane], s[_VZ + lane] = velocity[i, 0], velocity[i, 1], velocity[i, 2]
            s[_QW + lane], s[_QX + lane], s[_QY + lane] = attitude[i, 0], attitude[i, 1], attitude[i, 2]
            s[_QZ + lane] = attitude[i, 3]
            s[_WX + lane], s[_WY + lane], s[_WZ + lane] = rates[i, 0], rates[i, 1], rates[i, 2]
            s[_UX + lane], s[_UY + lane], s[_UZ + lane] = wind[i, 0], wind[i, 1], wind[i, 2]
            for m in range(MOTORS):
                s[_SPEED + m * LANES + lane] = rotor_radps[i, m]
        _move_lanes(step_s, s)
        for lane in range(used):
            i = first + lane
            if runs[i] != run:
                max_step2_m2[run] = longest
                run = runs[i]
                longest = 0.0
            px, py, pz = s[_PX + lane], s[_PY + lane], s[_PZ + lane]
            before[i, 0], before[i, 1], before[i, 2] = px, py, pz
            work_j[i] += s[_WORK + lane]
            if is_imposed[i]:
                continue
            ground = floor[i]
            nx, ny, nz = s[_NX + lane], s[_NY + lane], s[_NZ + lane]
            nvx, nvy, nvz = s[_NVX + lane], s[_NVY + lane], s[_NVZ + lane]
            nwx, nwy, nwz = s[_NWX + lane], s[_NWY + lane], s[_NWZ + lane]
            if nvz <= 0.0 and nz <= ground:
                events += _land(
                    i, step_s, parameters[airframe[i]], ground, nvx, nvy, nvz, nwx, nwy, nwz,
                    position, velocity, attitude, rates, accel, limit, alive, flags, impact_mps,
                )  # fmt: skip
                height[i] = 0.0
                nx, ny, nz = position[i, 0], position[i, 1], position[i, 2]
            else:
                flags[i, ON_GROUND] = 0
                flags[i, ALOFT] |= nz > ground + REARM_M
                height[i] = nz - ground
                position[i, 0], position[i, 1], position[i, 2] = nx, ny, nz
                velocity[i, 0], velocity[i, 1], velocity[i, 2] = nvx, nvy, nvz
                accel[i, 0], accel[i, 1], accel[i, 2] = s[_AX + lane], s[_AY + lane], s[_AZ + lane]
                attitude[i, 0], attitude[i, 1] = s[_NQW + lane], s[_NQX + lane]
                attitude[i, 2], attitude[i, 3] = s[_NQY + lane], s[_NQZ + lane]
                rates[i, 0], rates[i, 1], rates[i, 2] = nwx, nwy, nwz
            dx, dy, dz = nx - px, ny - py, nz - pz
            odometer_m[i] += abs(dx) + abs(dy) + abs(dz)
            longest = max(longest, dx * dx + dy * dy + dz * dz)
    max_step2_m2[run] = longest
    return events


@compiled
def advance_arrays(step_s: float, arrays: BodyArrays) -> int:
    """`advance`, of bodies in a plain tuple."""
    return advance(step_s, BodyState(*arrays))
