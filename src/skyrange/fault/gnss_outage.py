"""GNSS outage: receivers have no fix for as long as the fault acts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import Field

from skyrange.attack.gnss.emitter import FIX_NONE
from skyrange.attack.victims import Victims, check_vehicles
from skyrange.contracts.components import SensorAct, Sensors
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Params
from skyrange.core.time import Time
from skyrange.fault.contract import FaultContext, FaultParts, FaultPlugin


class Outage(Params):
    """Receivers without a fix."""

    vehicles: Victims = Field(description="Aircraft whose receivers have no fix, such as ['blue/b1'].")


@dataclass(slots=True)
class NoFix:
    """A sensor fault that takes fix and satellites away."""

    name: str
    vehicles: Sequence[str]
    schedule: Schedule
    slow: bool = True
    _begun: bool = False

    def on_sensors(self, now: Time, sensors: Sensors) -> list[SensorAct]:
        """Take them away. Returns an act for each vehicle when it begins."""
        if now < self.schedule.start_ns:
            return []
        sensors.gnss_fix[:] = FIX_NONE
        sensors.gnss_satellites[:] = 0
        if self._begun:
            return []
        self._begun = True
        return [SensorAct(vehicle, "gnss") for vehicle in self.vehicles]


def make(params: Outage, context: FaultContext) -> FaultParts:
    """The parts. Raises `InputError` for aircraft that are not in the scenario."""
    check_vehicles(context, params.vehicles)
    return FaultParts(faults=[NoFix(f"{context.id}.gnss", params.vehicles, context.schedule)])


GNSS_OUTAGE = FaultPlugin(
    Outage,
    make,
    "Takes the GNSS fix away for as long as it acts.",
    surface=("gnss",),
    effect="the estimator stops aiding, and the autopilot fails safe",
    cause="a broken antenna cable, a receiver that restarts, or an antenna in the shade",
    not_modelled="the way to the loss and back: no satellites at once, and a full fix at once when it stops",
    realism={"fix type and satellites": "assumed: no fix and no satellites while the fault acts"},
)
