"""Airframe parameters: one table, every number with its source.

Conventions: body frame forward-left-up, motors numbered and spinning as in ArduCopter's QUAD X (ArduPilot
`SIM_Frame.cpp`, `quad_x_motors`): 1 front right CCW, 2 rear left CCW, 3 front left CW, 4 rear right CW, seen from
above.

Throttle. An actuator command u in 0…1 is the ESC signal above its minimum. In steady state a rotor gives the fraction
`(1 - e)·u + e·u²` of its full thrust, e being `thrust_expo`: the curve that ArduPilot's `SIM_Motor.cpp`
(`Motor::calc_thrust`) uses and its `MOT_THST_EXPO` inverts. Thrust is k·ω², so the rotor's speed settles at
`rotor_max_radps · sqrt((1 - e)·u + e·u²)`; e = 1 is a speed linear in u (Gazebo's map).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from skyrange.core import elementary_python

GRAVITY_MPS2 = 9.80665
"""Standard gravity (ISO 80000-3; ArduPilot's GRAVITY_MSS)."""
AIR_DENSITY_KGM3 = 1.225
"""Sea level, 15 °C (ISO 2533 standard atmosphere); held constant with height."""
_POWER_ROUNDS = 4
"""In which thrust and rotor speed are made to agree; a fifth changes less than 0.1 % up to 25 m/s."""
MOTORS = 4
"""Rotors of every airframe in the table."""


@dataclass(frozen=True, slots=True)
class Rotor:
    """Position of a rotor from the centre of gravity, and its direction of rotation."""

    forward_m: float
    left_m: float
    spin: float
    """+1 counter-clockwise seen from above, -1 clockwise; the body feels the opposite torque."""


@dataclass(frozen=True, slots=True)
class Airframe:
    """One row of the table. Derived values are properties, so that they cannot contradict it."""

    name: str
    mass_kg: float
    inertia_kgm2: tuple[float, float, float]
    """Principal moments about forward, left, up."""
    rotors: tuple[Rotor, ...]
    """In motor order; `MOTORS` of them."""
    thrust_ns2: float
    """Newton per (rad/s)² of one rotor."""
    torque_arm_m: float
    """Drag torque of a rotor divided by its thrust."""
    rotor_max_radps: float
    tau_up_s: float
    """First-order lag of rotor speed while speeding up."""
    tau_down_s: float
    """The same while slowing down."""
    thrust_expo: float
    """Curve from command to thrust, 0 linear … 1 quadratic (see module)."""
    rotor_drag_ns2: float
    """In-plane force of one rotor per (rad/s of its speed · m/s of air across its disc), in N·s²."""
    drag_area_m2: float
    """Drag coefficient times area: body drag is ½·ρ·area·|v|·v, equal in all directions."""
    gear_half_track_m: float
    """Half the width of the landing gear: the lever arm with which the ground holds the aircraft level."""
    cg_height_m: float
    """Centre of gravity above the ground when standing."""
    friction: float
    """Coulomb coefficient of the gear on the ground."""
    propeller_m: float
    """Radius of a propeller."""
    height_m: float
    """From the bottom of the gear to the top."""
    cells: int
    """In series, lithium polymer."""
    capacity_ah: float
    resistance_ohm: float
    """Of the battery and its wires."""
    drive_efficiency: float
    """Shaft power divided by battery power, of motors and their controllers."""
    avionics_w: float
    """Drawn until the battery is empty."""

    @property
    def radius_m(self) -> float:
        """Radius of the upright cylinder that encloses it, propellers included, used for collisions."""
        return self.arm_m + self.propeller_m

    @property
    def arm_m(self) -> float:
        """From the centre to the farthest rotor."""
        return max(elementary_python.hypot(rotor.forward_m, rotor.left_m) for rotor in self.rotors)

    @property
    def max_thrust_n(self) -> float:
        """Thrust of all rotors at full speed."""
        return len(self.rotors) * self.thrust_ns2 * (self.rotor_max_radps * self.rotor_max_radps)

    @property
    def hover_thrust(self) -> float:
        """Fraction of full thrust that balances the weight: what ArduCopter calls hover throttle (`MOT_THST_HOVER`)."""
        return self.mass_kg * GRAVITY_MPS2 / self.max_thrust_n

    @property
    def hover_command(self) -> float:
        """Actuator command at which the thrust balances the weight."""
        return self.command_for(self.hover_thrust)

    @property
    def tip_angle_rad(self) -> float:
        """Tilt on the ground beyond which the aircraft tips over, because the centre of gravity leaves the gear's
        base.
        """
        return elementary_python.atan2(self.gear_half_track_m, self.cg_height_m)

    def thrust_for(self, east_mps: float, north_mps: float, up_mps: float) -> float:
        """Thrust in newtons that keeps this velocity through the air steady: weight plus drag.

        The drag is that of `multirotor`: of the body, ½·ρ·area·|v|·v, and of the rotors, linear in v, here at full
        speed and along the whole of v, so the result is an upper bound.
        """
        speed = math.sqrt((east_mps * east_mps) + (north_mps * north_mps) + (up_mps * up_mps))
        rotors = len(self.rotors) * self.rotor_drag_ns2 * self.rotor_max_radps
        drag = 0.5 * AIR_DENSITY_KGM3 * self.drag_area_m2 * speed + rotors
        return elementary_python.hypot3(drag * east_mps, drag * north_mps, self.mass_kg * GRAVITY_MPS2 + drag * up_mps)

    def power_for(self, east_mps: float, north_mps: float, up_mps: float) -> float:
        """Power in watts that the battery gives while this velocity through the air is kept steady.

        Aerodynamic power is torque times speed of the rotors, as in `multirotor`; the battery gives that divided by the
        efficiency of the drive, and what the avionics take. Weight and the drag of the body are held by the thrust and,
        at right angles to it, by the drag of the rotors, here for all of the level velocity.
        """
        flat_mps = elementary_python.hypot(east_mps, north_mps)
        drag = 0.5 * AIR_DENSITY_KGM3 * self.drag_area_m2 * elementary_python.hypot(flat_mps, up_mps)
        held_n2 = elementary_python.square(drag * flat_mps) + elementary_python.square(
            self.mass_kg * GRAVITY_MPS2 + drag * up_mps
        )
        rotor_radps, thrust_n = 0.0, 0.0
        for _ in range(_POWER_ROUNDS):
            rotors_n = len(self.rotors) * self.rotor_drag_ns2 * rotor_radps * flat_mps
            thrust_n = math.sqrt(max(held_n2 - (rotors_n * rotors_n), 0.0))
            rotor_radps = math.sqrt(thrust_n / (len(self.rotors) * self.thrust_ns2))
        return thrust_n * self.torque_arm_m * rotor_radps / self.drive_efficiency + self.avionics_w

    def command_for(self, thrust: float) -> float:
        """The command 0…1 that gives a fraction 0…1 of full thrust: the inverse of the thrust curve."""
        expo = self.thrust_expo
        if expo == 0.0:
            return thrust
        return (math.sqrt(elementary_python.square(1.0 - expo) + 4.0 * expo * thrust) - (1.0 - expo)) / (2.0 * expo)


_DRIVE_EFFICIENCY = 0.8
"""An assumption, 0.85 for a brushless motor and 0.95 for its controller; with it the Iris+ and the Hummingbird hover
for as long as their manufacturers state (tests/validation)."""


def _x_frame(arm_m: float) -> tuple[Rotor, ...]:
    """Four rotors at 45 degrees on arms of one length."""
    side = arm_m * math.sqrt(0.5)
    return (
        Rotor(side, -side, 1.0),
        Rotor(-side, side, 1.0),
        Rotor(side, side, -1.0),
        Rotor(-side, -side, -1.0),
    )


IRIS = Airframe(
    # [G] PX4/PX4-SITL_gazebo-classic, models/iris/iris.sdf.jinja, commit 032df71: base_link's mass and inertia,
    # the poses of rotor_0…3 (they are ArduCopter's motors 1…4), motorConstant, maxRotVelocity, timeConstantUp/Down.
    name="iris",
    mass_kg=1.5,
    inertia_kgm2=(0.029125, 0.029125, 0.055225),
    rotors=(Rotor(0.13, -0.22, 1.0), Rotor(-0.13, 0.20, 1.0), Rotor(0.13, 0.22, -1.0), Rotor(-0.13, -0.20, -1.0)),
    thrust_ns2=5.84e-06,
    rotor_max_radps=1100.0,
    tau_up_s=0.0125,
    tau_down_s=0.025,
    # [R] RotorS (Furrer, Burri, Achtelik & Siegwart, "RotorS — A Modular Gazebo MAV Simulator Framework", 2016):
    # ethz-asl/rotors_simulator, rotors_description/urdf/iris.xacro, commit 0d5209d. [G] has 0.06,
    # four times what a 10-inch propeller has (CP·D / (2π·CT) with a static CT of 0.11 and CP of 0.045: 0.0165 m).
    torque_arm_m=0.016,
    # [A] ArduPilot libraries/SITL/SIM_Frame.h `propExpo`, and AP_MotorsMulticopter's MOT_THST_EXPO default.
    thrust_expo=0.65,
    # [R] (also PX4's x500); [G] has 1.75e-4 and no body drag. Together with the body's drag this gives
    # 12.5 m/s at 30 degrees of tilt and 17.3 m/s at 45; ArduPilot's default SITL frame does 15 m/s at 45 (SIM_Frame.h).
    rotor_drag_ns2=8.06428e-05,
    # [G]'s collision box from the side, 0.47 m x 0.11 m, with a cube's coefficient 1.05 (Hoerner, "Fluid-Dynamic
    # Drag", 1965, ch. 3).
    drag_area_m2=0.0543,
    # Half the side of [G]'s box; and from the centre of gravity to the bottom of the box in
    # ArduPilot/ardupilot_gazebo, models/iris_with_standoffs/model.sdf, commit 06291d6.
    gear_half_track_m=0.235,
    cg_height_m=0.195,
    # SDFormat's default for surface/friction/ode/mu.
    friction=1.0,
    # 3DR Iris+ operation manual: 10 x 4.5 inch propellers; 3S, 5100 mAh. Height: [G]'s box above that bottom.
    propeller_m=0.127,
    height_m=0.25,
    cells=3,
    capacity_ah=5.1,
    # [A] SIM_Frame.h `refBatRes`, of its 3S frame.
    resistance_ohm=0.01,
    drive_efficiency=_DRIVE_EFFICIENCY,
    avionics_w=6.0,
)

HUMMINGBIRD = Airframe(
    # AscTec Hummingbird, flown as an X. [R] rotors_description/urdf/hummingbird.xacro: mass with its four rotors,
    # inertia, arm, motor and moment constants, speed, lags, rotor drag; there from Wang et al., "Novel Dynamic
    # Inversion Architecture Design for Quadrocopter Control".
    name="hummingbird",
    mass_kg=0.716,
    inertia_kgm2=(0.007, 0.007, 0.012),
    rotors=_x_frame(0.17),
    thrust_ns2=8.54858e-06,
    rotor_max_radps=838.0,
    tau_up_s=0.0125,
    tau_down_s=0.025,
    torque_arm_m=0.016,
    thrust_expo=0.65,
    rotor_drag_ns2=8.06428e-05,
    # [R] body_width x body_height from the side, 0.1 m x 0.12 m, a cube's coefficient as for the Iris, and half of it
    # again for four arms of 2 cm x 17 cm that [R] does not draw.
    drag_area_m2=0.019,
    # The arms' ends at 45 degrees; the centre of gravity in the middle of [R]'s body.
    gear_half_track_m=0.12,
    cg_height_m=0.06,
    friction=1.0,
    # [R] radius_rotor, body_height.
    propeller_m=0.1,
    height_m=0.12,
    # Ascending Technologies' data sheet: 3S, 2100 mAh, 20 minutes. Resistance: the Iris's, by capacity.
    cells=3,
    capacity_ah=2.1,
    resistance_ohm=0.024,
    drive_efficiency=_DRIVE_EFFICIENCY,
    avionics_w=5.0,
)

X500 = Airframe(
    # Holybro X500 as in PX4/PX4-gazebo-models, models/x500_base/model.sdf, commit 008216e: base_link and four rotors'
    # mass, inertia, rotor poses, landing gear; models/x500/model.sdf: motor and moment constants, speed, lags, rotor
    # drag.
    name="x500",
    mass_kg=2.064,
    inertia_kgm2=(0.0216667, 0.0216667, 0.04),
    rotors=_x_frame(0.174 * math.sqrt(2.0)),
    thrust_ns2=8.54858e-06,
    rotor_max_radps=1000.0,
    tau_up_s=0.0125,
    tau_down_s=0.025,
    torque_arm_m=0.016,
    thrust_expo=0.65,
    rotor_drag_ns2=8.06428e-05,
    # The model's plate and legs from the side, 0.354 m x 0.05 m + 2 x 0.21 m x 0.015 m, and arms and motors as much
    # as the legs, with a cube's coefficient.
    drag_area_m2=0.032,
    # Its skids: 0.264 m apart, their bottom 0.227 m below base_link; rotors 0.06 m above.
    gear_half_track_m=0.132,
    cg_height_m=0.227,
    friction=1.0,
    # Holybro's X500 V2 kit: 1045 propellers, 4S, 5000 mAh. Resistance: the Iris's, by cells and capacity.
    propeller_m=0.127,
    height_m=0.29,
    cells=4,
    capacity_ah=5.0,
    resistance_ohm=0.0136,
    drive_efficiency=_DRIVE_EFFICIENCY,
    avionics_w=10.0,
)

AIRFRAMES: dict[str, Airframe] = {airframe.name: airframe for airframe in (IRIS, HUMMINGBIRD, X500)}
"""The table, by name."""
