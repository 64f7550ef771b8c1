"""GNSS outage: receivers have no fix for as long as the fault acts."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.gnss.emitter import FIX_NONE


@sky.fault(
    "gnss.outage",
    surface=("gnss",),
    effect="the estimator stops aiding, and the autopilot fails safe",
    cause="a broken antenna cable, a receiver that restarts, or an antenna in the shade",
    not_modelled="the way to the loss and back: no satellites at once, and a full fix at once when it stops",
    realism={"fix type and satellites": "assumed: no fix and no satellites while the fault acts"},
)
class Outage(sky.OnSensors):
    """Takes the GNSS fix away for as long as it acts."""

    slow = True

    vehicles: sky.Victims = sky.param("Aircraft whose receivers have no fix, such as ['blue/b1'].")

    def act(self, now: sky.Time, sensors: sky.Sensors) -> None:
        sensors.gnss_fix[:] = FIX_NONE
        sensors.gnss_satellites[:] = 0
