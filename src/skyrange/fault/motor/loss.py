"""Motor loss: one motor of an aircraft gives less thrust than its command asks for, or none."""

from __future__ import annotations

import skyrange.plugin as sky


@sky.fault(
    "motor.loss",
    surface=("motor",),
    effect="the aircraft turns and falls, or flies on with less control of its heading",
    cause="a failed motor or speed controller, a broken wire, or a propeller that came off",
    not_modelled="vibration of a damaged propeller, drag of a propeller that the air turns, thrust that inflow changes "
    "in a fall, a motor that restarts, and a fire; aircraft whose pose their autopilot imposes are refused",
    realism={
        "speed of the motor": "simulated: the root of the remaining share, because thrust is k·ω² (Mahony, Kumar and "
        "Corke, IEEE RAM 19:3, 2012); it slows down with the motor's own lag",
        "forces and torques": "simulated: each rotor by itself, on its arm; roll, pitch and yaw follow from the rest",
        "power": "simulated: a slower rotor takes less from the battery",
        "size of the loss": "assumed: the parameter says it",
    },
)
class Loss(sky.OnBodies):
    """Stops a motor of an aircraft, or takes a share of its thrust away."""

    vehicles: sky.Victims = sky.param("Aircraft that lose a motor, such as ['blue/b1'].")
    motor: sky.Whole = sky.param(
        "Number in ArduCopter's quad X: 1 front right, 2 rear left, 3 front left, 4 rear right.", default=1, ge=1, le=4
    )
    loss: sky.Number = sky.param(
        "Share of its thrust that is lost at every command: 1 stops it, 0.3 is a damaged one.", default=1.0, gt=0, le=1
    )

    def on_bodies(self, now: sky.Time, bodies: sky.Disturbances) -> list[sky.BodyAct]:
        if now < self.schedule.start_ns:
            return []
        bodies.thrust_share[:, self.motor - 1] = 1.0 - self.loss
        return [] if self.met else self.meet(range(len(self.vehicles)))
