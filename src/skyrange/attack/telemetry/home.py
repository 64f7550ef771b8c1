"""False home in telemetry: HOME_POSITION at an offset from the true home."""

from __future__ import annotations

import skyrange.plugin as sky


@sky.attack(
    "telemetry.home",
    effect="the ground station shows a home to which the aircraft would not return",
    knowledge="the message with the home position",
    realism={
        "place of RTL": "simulated: the autopilot's own home, which does not move",
        "operator's place in Remote ID": "simulated: that of the ground station, which every operator of a scenario "
        "has; only a transmitter without one broadcasts the reported home",
    },
)
class FalseHome(sky.AlteredTelemetry):
    """Alters the home position in telemetry."""

    offset_m: sky.Enu = sky.param("Offset of the reported home, [east, north, up] in metres.")
    sees = ("HOME_POSITION",)

    def alter(self, message: str, fields: sky.MavlinkFields, since_ns: sky.Time) -> bool:
        sky.move_place(fields, "latitude", "longitude", self.offset_m, self.origin)
        sky.put(fields, "altitude", float(fields["altitude"]) + self.offset_m[2] * 1e3)
        return True
