"""Jamming: noise in the band, continuous or pulsed, from a transmitter of the attacker."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.attack.radio import Broadcaster, transmitter, up_link
from skyrange.codec.remote_id.noise_request import NoiseRequest, pack
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Enu, Number, Params
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, NS_PER_US, Time

SILENT_CDBM = -20_000
"""−200 dBm, below any receiver's noise: what a sham radiates."""


class Jam(Params):
    """Noise over a band of frequencies; its power is spread evenly over it."""

    transmitter_m: Enu = Field(description="Where the jammer stands: [east_m, north_m, up_m] in metres.")
    power_dbm: Number = Field(default=30.0, ge=-30, le=60, description="Radiated power (EIRP) in dBm.")
    centre_mhz: Number = Field(
        default=2437.0, ge=100, le=8000, description="Middle of the band in MHz; 2437 is Wi-Fi channel 6."
    )
    bandwidth_mhz: Number = Field(default=20.0, ge=0.1, le=500, description="Width of the band in MHz.")
    period_ms: Number = Field(default=100.0, ge=1, le=10_000, description="Time from burst to burst, in milliseconds.")
    duty: Number = Field(default=1.0, gt=0, le=1, description="Part of the time that it is on; 1 is continuous.")


@dataclass(slots=True)
class BurstSchedule:
    """A burst every period, cut where the attack stops."""

    burst: NoiseRequest
    period_ns: Time
    schedule: Schedule
    turn: int = 0

    @property
    def due(self) -> Time:
        """When the next one begins."""
        return self.turn * self.period_ns

    def make(self, now: Time) -> list[bytes]:
        """The burst that is due, if the attack acts."""
        if self.due > now:
            return []
        self.turn = now // self.period_ns + 1
        left_us = (self.schedule.stop_ns - now) // NS_PER_US
        if self.schedule.start_ns > now or left_us <= 0:
            return []
        return [pack(self.burst._replace(duration_us=min(self.burst.duration_us, left_us), time_ns=now))]


def make(params: Jam, context: AttackContext) -> Attack:
    """The attack."""
    period_ns = round(params.period_ms * NS_PER_MS)
    burst = NoiseRequest(
        SILENT_CDBM if context.sham else round(params.power_dbm * 100),
        round(params.centre_mhz * 1000),
        round(params.bandwidth_mhz * 1000),
        max(1, round(period_ns * params.duty) // NS_PER_US),
    )
    agent = Broadcaster(
        context.radio, Port(context.radio, context.up), BurstSchedule(burst, period_ns, context.schedule)
    )
    radio = transmitter(context, params.transmitter_m, params.power_dbm)
    return Attack(agents=[agent], links=[up_link(context)], radios=[radio])


JAM = AttackPlugin(
    Jam,
    make,
    "Noise over the band, so that broadcasts are not heard.",
    technique="T0814",  # Denial of Service
)
