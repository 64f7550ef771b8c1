"""False home in telemetry: HOME_POSITION at an offset from the true home."""

from __future__ import annotations

from typing import Any

from skyrange.attack.bases.mavlink.message_fields import move_place, put
from skyrange.attack.bases.mavlink.telemetry import AlteredTelemetry
from skyrange.attack.declaration import attack
from skyrange.attack.presets import TELEMETRY_CONTROLS, rewrites_telemetry
from skyrange.contracts.params import Enu
from skyrange.contracts.plugins.fields import param
from skyrange.core.time import Time


@attack(
    "telemetry.home",
    technique="T0856",
    surface=("gcs", "log", "autopilot", "rid_data"),
    persists="acts",
    effect="the ground station shows a home to which the aircraft would not return",
    threat=rewrites_telemetry("the message with the home position"),
    controls=TELEMETRY_CONTROLS,
    realism={
        "place of RTL": "simulated: the autopilot's own home, which does not move",
        "operator's place in Remote ID": "simulated: that of the ground station, which every operator of a scenario "
        "has; only a transmitter without one broadcasts the reported home",
    },
)
class FalseHome(AlteredTelemetry):
    """Alters the home position in telemetry.

    Home appears elsewhere; the home to which the autopilot returns stays.
    """

    offset_m: Enu = param("Offset of the reported home, [east, north, up] in metres.")
    sees = ("HOME_POSITION",)

    def alter(self, message: str, fields: Any, since_ns: Time) -> bool:
        """Move it."""
        move_place(fields, "latitude", "longitude", self.offset_m, self.origin)
        put(fields, "altitude", float(fields["altitude"]) + self.offset_m[2] * 1e3)
        return True
