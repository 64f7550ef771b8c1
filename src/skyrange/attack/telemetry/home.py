"""False home in telemetry: HOME_POSITION at an offset from the true home."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Place
from skyrange.attack.telemetry.alteration import CONTROLS, TelemetryLinks, alter_telemetry, put, threat
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.params import Enu
from skyrange.core.geodesy import Origin
from skyrange.core.time import Time

_HOME: Final = int(mav.MAVLINK_MSG_ID_HOME_POSITION)


class FalseHome(TelemetryLinks):
    """Home appears elsewhere; the home to which the autopilot returns stays."""

    offset_m: Enu = Field(description="Offset of the reported home, [east, north, up] in metres.")


@dataclass(slots=True)
class HomeAlteration:
    """Moves HOME_POSITION."""

    origin: Origin
    offset_m: Place

    @property
    def messages(self) -> frozenset[int]:
        """HOME_POSITION."""
        return frozenset((_HOME,))

    def alter(self, since_ns: Time, number: int, fields: Any) -> bool:
        """See `Alteration`."""
        east_m, north_m = self.origin.enu_of(fields["latitude"] * 1e-7, fields["longitude"] * 1e-7)
        lat_deg, lon_deg = self.origin.geodetic_of(east_m + self.offset_m[0], north_m + self.offset_m[1])
        put(fields, "latitude", lat_deg * 1e7)
        put(fields, "longitude", lon_deg * 1e7)
        put(fields, "altitude", float(fields["altitude"]) + self.offset_m[2] * 1e3)
        return True


def make(params: FalseHome, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for links that the scenario does not have, or that carry no telemetry."""
    return alter_telemetry(params.links, context, HomeAlteration(context.origin, params.offset_m))


HOME = AttackPlugin(
    FalseHome,
    make,
    "Alters the home position in telemetry.",
    technique="T0856",
    surface=("gcs", "log", "autopilot", "rid_data"),
    persists="acts",
    effect="the ground station shows a home to which the aircraft would not return",
    threat=threat("the message with the home position"),
    controls=CONTROLS,
    realism={
        "place of RTL": "simulated: the autopilot's own home, which does not move",
        "operator's place in Remote ID": "simulated: that of the ground station, which every operator of a scenario "
        "has; only a transmitter without one broadcasts the reported home",
    },
)
