"""False time in telemetry: UTC in SYSTEM_TIME, and the autopilot's clock in its answers to TIMESYNC."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from pydantic import Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.attack.telemetry.alteration import CONTROLS, TelemetryLinks, alter_telemetry, put, threat
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.params import Number, refuse
from skyrange.core.errors import Problem
from skyrange.core.time import NS_PER_S, NS_PER_US, Time

_SYSTEM_TIME: Final = int(mav.MAVLINK_MSG_ID_SYSTEM_TIME)
_TIMESYNC: Final = int(mav.MAVLINK_MSG_ID_TIMESYNC)


class FalseTime(TelemetryLinks):
    """The reported time is ahead of the true one, or behind it."""

    offset_s: Number = Field(
        default=0.0, ge=-1e9, le=1e9, description="Offset of the reported time at the start of the attack, in seconds."
    )
    drift_s_per_s: Number = Field(
        default=0.0, ge=-100, le=100, description="Growth of the offset, in seconds per second."
    )

    @model_validator(mode="after")
    def _shifts(self) -> FalseTime:
        if not (self.offset_s or self.drift_s_per_s):
            raise refuse(Problem("offset_s", "0", "an offset or a drift other than 0"))
        return self


@dataclass(slots=True)
class TimeAlteration:
    """Shifts the UTC of SYSTEM_TIME and the clock in TIMESYNC; the time since boot in other messages stays true."""

    offset_s: float
    drift_s_per_s: float

    @property
    def messages(self) -> frozenset[int]:
        """SYSTEM_TIME and TIMESYNC."""
        return frozenset((_SYSTEM_TIME, _TIMESYNC))

    def alter(self, since_ns: Time, number: int, fields: Any) -> bool:
        """See `Alteration`."""
        if since_ns < 0:
            return False
        shift_ns = round((self.offset_s + self.drift_s_per_s * since_ns / NS_PER_S) * NS_PER_S)
        if number == _SYSTEM_TIME:
            if fields["time_unix_usec"] == 0:
                return False  # UTC is not known
            put(fields, "time_unix_usec", int(fields["time_unix_usec"]) + shift_ns // NS_PER_US)
        else:
            if fields["tc1"] == 0:
                return False  # a request
            put(fields, "tc1", int(fields["tc1"]) + shift_ns)
        return True


def make(params: FalseTime, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for links that the scenario does not have, or that carry no telemetry."""
    return alter_telemetry(params.links, context, TimeAlteration(params.offset_s, params.drift_s_per_s))


SYSTEM_TIME = AttackPlugin(
    FalseTime,
    make,
    "Shifts the time in SYSTEM_TIME and TIMESYNC of an autopilot.",
    technique="EX-0014.01",
    surface=("rid_data", "log", "gcs", "autopilot"),
    persists="acts",
    effect="Remote ID broadcasts have wrong time stamps, and logs of a ground station a wrong time",
    threat=threat("the messages with the time"),
    controls=CONTROLS,
    realism={"time of signed frames": "simulated: it comes from each end's own clock and does not shift"},
)
