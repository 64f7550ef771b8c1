"""Restart of a ground station: for some seconds it neither sends nor receives."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.fault.bases import AtStation


@sky.fault(
    "station.restart",
    surface=("gcs", "approval"),
    effect="all aircraft of an operator lose their station at once, and it hears none of them",
    cause="a crash or an update of the station's program or computer",
    not_modelled="loss of the station's memory: its program goes on behind silent links, with missions and parameters "
    "known, and counts the silence as a lost link; a new start would read them from the aircraft again",
    realism={"the station's frames": "assumed: none leaves and none is read while it restarts, then all do at once"},
)
class Restart(AtStation):
    """Restarts the ground station of an operator: all its links are silent for some seconds."""

    operator: str = sky.param("Operator whose ground station restarts, such as 'blue'.")
    down_s: sky.Number = sky.param(
        "Time in seconds until the station is back, or until the fault stops.", default=15.0, gt=0, le=3_600
    )

    def build(self, context: sky.FaultContext) -> sky.FaultParts:
        """Taps at the station. Raises `InputError` for an operator that the scenario does not have."""
        vehicles = [vehicle for vehicle in context.vehicles if sky.operator_of(vehicle) == self.operator]
        if not vehicles:
            operators = list(dict.fromkeys(map(sky.operator_of, context.vehicles)))
            hint = sky.nearest(self.operator, operators)
            raise sky.InputError.one(context.id, "operator", self.operator, "an operator of the scenario", hint)
        names = [sky.link_name("approval", self.operator), *(sky.link_name("gcs", vehicle) for vehicle in vehicles)]
        return self.place_at_station([name for name in names if name in context.links], context)

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        is_down = self.is_acting(now) and now - self.schedule.start_ns < sky.from_seconds(self.down_s)
        return (sky.Drop(),) if is_down else ()
