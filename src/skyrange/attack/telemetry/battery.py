"""False battery in telemetry: remaining charge and voltage."""

from __future__ import annotations

from typing import Final

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.message_fields import Fields, put
from skyrange.codec.mavlink import dialect as mav

BATTERY_MESSAGES: Final = ("SYS_STATUS", "BATTERY_STATUS")
"""All messages that tell charge or voltage, by name."""
_NO_CELL: Final = 65_535
"""BATTERY_STATUS: a cell that does not exist."""
_LOW_PERCENT, _CRITICAL_PERCENT = 25.0, 10.0
"""Below these, the claimed charge state is low or critical."""


def claim_charge(message: str, fields: Fields, percent: float) -> None:
    """Claim a charge, within 0 to 100 %; consumed charge and charge state agree with it."""
    claimed = min(max(percent, 0.0), 100.0)
    if message == "BATTERY_STATUS":
        _set_consumed(fields, claimed)
    put(fields, "battery_remaining", claimed)


def claim_voltage(message: str, fields: Fields, volts: float) -> None:
    """Claim a voltage of the battery; its cells have their shares of it."""
    if message == "BATTERY_STATUS":
        _set_cells(fields, volts * 1e3)
    else:
        put(fields, "voltage_battery", volts * 1e3)


def _set_consumed(fields: Fields, claimed: float) -> None:
    true = float(fields["battery_remaining"])
    if 0 <= true < 100:
        used = (100.0 - claimed) / (100.0 - true)
        for name in ("current_consumed", "energy_consumed"):
            if fields[name] > 0:
                put(fields, name, fields[name] * used)
    states = mav.MAV_BATTERY_CHARGE_STATE_OK, mav.MAV_BATTERY_CHARGE_STATE_LOW, mav.MAV_BATTERY_CHARGE_STATE_CRITICAL
    put(fields, "charge_state", states[(claimed < _LOW_PERCENT) + (claimed < _CRITICAL_PERCENT)])


def _set_cells(fields: Fields, millivolts: float) -> None:
    """Scale the cells to a total; a battery without cells reports it in the first."""
    cells = fields["voltages"].astype(np.float64)
    is_present = cells < _NO_CELL
    total = float(cells[is_present].sum())
    if total > 0:
        cells[is_present] = np.clip(np.rint(cells[is_present] * (millivolts / total)), 0, _NO_CELL - 1)
    else:
        cells[0] = min(millivolts, _NO_CELL - 1)
    fields["voltages"] = cells.astype(np.uint16)


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
