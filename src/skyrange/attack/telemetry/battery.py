"""False battery in telemetry: remaining charge and voltage."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.claimed_battery import BATTERY_MESSAGES, claim_charge, claim_voltage


@sky.attack(
    "telemetry.battery",
    surface=("gcs", "log", "autopilot"),
    effect="the ground station shows a battery that the aircraft does not have",
    knowledge="the messages with the state of the battery",
    realism={"failsafes of the autopilot": "simulated: they read its own monitor and do not see the lie"},
)
class FalseBattery(sky.AlteredTelemetry):
    """Alters charge and voltage of the battery in telemetry.

    It alters SYS_STATUS, and BATTERY_STATUS of the first battery; consumed charge and charge state agree with it.
    """

    remaining_percent: sky.Number | None = sky.param(
        "Claimed charge at the start in percent; default: the true one.", default=None, ge=0, le=100
    )
    rate_percent_per_s: sky.Number = sky.param(
        "Change of the claimed charge in percent per second.", default=0.0, ge=-100, le=100
    )
    voltage_v: sky.Number | None = sky.param(
        "Claimed voltage of the battery in volts; default: the true one.", default=None, ge=0, le=65
    )
    sees = BATTERY_MESSAGES

    def find_problems(self) -> sky.Problems:
        if self.remaining_percent is None and self.voltage_v is None:
            yield sky.Problem("remaining_percent", "missing", "a claim: remaining_percent or voltage_v")
        elif self.remaining_percent is None and self.rate_percent_per_s:
            yield sky.Problem(
                "rate_percent_per_s", f"{self.rate_percent_per_s}", "0 without a claimed remaining_percent"
            )

    def alter(self, message: str, fields: sky.MavlinkFields, since_ns: sky.Time) -> bool:
        if message == "BATTERY_STATUS" and fields["id"] != 0:
            return False
        if self.remaining_percent is not None:
            change = self.rate_percent_per_s * since_ns / sky.NS_PER_S
            claim_charge(message, fields, self.remaining_percent + change)
        if self.voltage_v is not None:
            claim_voltage(message, fields, self.voltage_v)
        return True
