"""False battery in telemetry: remaining charge and voltage.

ArduPilot's battery failsafe reads its own monitor, not telemetry, so the aircraft does not react; who reads the
telemetry does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from pydantic import Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.attack.telemetry.alteration import CONTROLS, TelemetryLinks, alter_telemetry, put, threat
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.params import Number, refuse
from skyrange.core.errors import Problem
from skyrange.core.time import NS_PER_S, Time

_SYS_STATUS: Final = int(mav.MAVLINK_MSG_ID_SYS_STATUS)
_BATTERY: Final = int(mav.MAVLINK_MSG_ID_BATTERY_STATUS)
_NO_CELL: Final = 65_535
"""BATTERY_STATUS: a cell that does not exist."""
_LOW_PERCENT, _CRITICAL_PERCENT = 25.0, 10.0
"""Below these, the claimed charge state is low or critical."""


class FalseBattery(TelemetryLinks):
    """The charge and voltage that the battery seems to have."""

    remaining_percent: Number | None = Field(
        default=None, ge=0, le=100, description="Claimed charge at the start in percent; default: the true one."
    )
    rate_percent_per_s: Number = Field(
        default=0.0, ge=-100, le=100, description="Change of the claimed charge in percent per second."
    )
    voltage_v: Number | None = Field(
        default=None, ge=0, le=65, description="Claimed voltage of the battery in volts; default: the true one."
    )

    @model_validator(mode="after")
    def _claims_something(self) -> FalseBattery:
        if self.remaining_percent is None and self.voltage_v is None:
            raise refuse(Problem("remaining_percent", "missing", "a claim: remaining_percent or voltage_v"))
        if self.remaining_percent is None and self.rate_percent_per_s:
            raise refuse(
                Problem("rate_percent_per_s", f"{self.rate_percent_per_s}", "0 without a claimed remaining_percent")
            )
        return self


@dataclass(slots=True)
class BatteryAlteration:
    """Alters SYS_STATUS, and BATTERY_STATUS of the first battery; consumed charge and charge state agree with it."""

    remaining_percent: float | None
    rate_percent_per_s: float
    voltage_v: float | None

    @property
    def messages(self) -> frozenset[int]:
        """SYS_STATUS and BATTERY_STATUS."""
        return frozenset((_SYS_STATUS, _BATTERY))

    def alter(self, since_ns: Time, number: int, fields: Any) -> bool:
        """See `Alteration`."""
        if since_ns < 0 or (number == _BATTERY and fields["id"] != 0):
            return False
        if self.remaining_percent is not None:
            claimed = self.remaining_percent + self.rate_percent_per_s * since_ns / NS_PER_S
            claimed = min(max(claimed, 0.0), 100.0)
            if number == _BATTERY:
                _set_consumed(fields, claimed)
            put(fields, "battery_remaining", claimed)
        if self.voltage_v is not None:
            if number == _SYS_STATUS:
                put(fields, "voltage_battery", self.voltage_v * 1e3)
            else:
                _set_cells(fields, self.voltage_v * 1e3)
        return True


def _set_consumed(fields: Any, claimed: float) -> None:
    true = float(fields["battery_remaining"])
    if 0 <= true < 100:
        used = (100.0 - claimed) / (100.0 - true)
        for name in ("current_consumed", "energy_consumed"):
            if fields[name] > 0:
                put(fields, name, fields[name] * used)
    states = mav.MAV_BATTERY_CHARGE_STATE_OK, mav.MAV_BATTERY_CHARGE_STATE_LOW, mav.MAV_BATTERY_CHARGE_STATE_CRITICAL
    put(fields, "charge_state", states[(claimed < _LOW_PERCENT) + (claimed < _CRITICAL_PERCENT)])


def _set_cells(fields: Any, millivolts: float) -> None:
    """Scale the cells to a total; a battery without cells reports it in the first."""
    cells = fields["voltages"].astype(np.float64)
    there = cells < _NO_CELL
    total = float(cells[there].sum())
    if total > 0:
        cells[there] = np.clip(np.rint(cells[there] * (millivolts / total)), 0, _NO_CELL - 1)
    else:
        cells[0] = min(millivolts, _NO_CELL - 1)
    fields["voltages"] = cells.astype(np.uint16)


def make(params: FalseBattery, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for links that the scenario does not have, or that carry no telemetry."""
    alteration = BatteryAlteration(params.remaining_percent, params.rate_percent_per_s, params.voltage_v)
    return alter_telemetry(params.links, context, alteration)


BATTERY = AttackPlugin(
    FalseBattery,
    make,
    "Alters charge and voltage of the battery in telemetry.",
    technique="T0856",
    surface=("gcs", "log", "autopilot"),
    persists="acts",
    effect="the ground station shows a battery that the aircraft does not have",
    threat=threat("the messages with the state of the battery"),
    controls=CONTROLS,
    realism={"failsafes of the autopilot": "simulated: they read its own monitor and do not see the lie"},
)
