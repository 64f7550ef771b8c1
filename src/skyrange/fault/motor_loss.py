"""Motor loss: one motor of an aircraft gives less thrust than its command asks for, or none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import Field

from skyrange.attack.victims import Victims, check_vehicles
from skyrange.contracts.components import BodyAct, Disturbances
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Number, Params, Whole
from skyrange.core.time import Time
from skyrange.fault.contract import FaultContext, FaultParts, FaultPlugin


class Loss(Params):
    """Which motor of whom loses thrust, and how much."""

    vehicles: Victims = Field(description="Aircraft that lose a motor, such as ['blue/b1'].")
    motor: Whole = Field(
        default=1,
        ge=1,
        le=4,
        description="Number of the motor, as ArduCopter counts those of a quadrotor in X: 1 front right, 2 rear left, "
        "3 front left, 4 rear right.",
    )
    loss: Number = Field(
        default=1.0,
        gt=0,
        le=1,
        description="Share of the motor's thrust that is lost at every command: 1 stops it, 0.3 is a damaged one.",
    )


@dataclass(slots=True)
class WeakMotor:
    """A body fault that takes a share of one motor's thrust away."""

    name: str
    vehicles: Sequence[str]
    motor: int
    """Its column, from 0 on."""
    loss: float
    schedule: Schedule
    _begun: bool = False

    def on_bodies(self, now: Time, bodies: Disturbances) -> list[BodyAct]:
        """Take it away. Returns an act for each vehicle when it begins."""
        if now < self.schedule.start_ns:
            return []
        bodies.thrust_share[:, self.motor] = 1.0 - self.loss
        if self._begun:
            return []
        self._begun = True
        return [BodyAct(vehicle, "motor") for vehicle in self.vehicles]


def make(params: Loss, context: FaultContext) -> FaultParts:
    """The parts. Raises `InputError` for aircraft that are not in the scenario."""
    check_vehicles(context, params.vehicles)
    fault = WeakMotor(f"{context.id}.motor", params.vehicles, params.motor - 1, params.loss, context.schedule)
    return FaultParts(body_faults=[fault])


MOTOR_LOSS = FaultPlugin(
    Loss,
    make,
    "Stops a motor of an aircraft, or takes a share of its thrust away.",
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
