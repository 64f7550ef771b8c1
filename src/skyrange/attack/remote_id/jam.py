"""Jamming: noise in a band, continuous or pulsed, from a transmitter of the attacker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, Place, ThreatModel
from skyrange.attack.radio import make_sender
from skyrange.codec.remote_id.noise_request import CONTINUED, NoiseRequest, pack
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Enu, Number, Params
from skyrange.core.time import NS_PER_MS, NS_PER_US, Time

SILENT_CDBM = -20_000
"""Power of a sham, −200 dBm: below the noise of every receiver."""


class Jam(Params):
    """Noise over a frequency band, with an even power density."""

    transmitter_m: Enu = Field(
        description="Position of the jammer, [east_m, north_m, up_m] in metres from the origin or the attack's anchor."
    )
    power_dbm: Number = Field(default=30.0, ge=-30, le=60, description="Radiated power (EIRP) in dBm.")
    centre_mhz: Number = Field(
        default=2437.0, ge=100, le=8000, description="Centre of the band in MHz; 2437 is Wi-Fi channel 6."
    )
    bandwidth_mhz: Number = Field(default=20.0, ge=0.1, le=500, description="Width of the band in MHz.")
    period_ms: Number = Field(
        default=100.0, ge=1, le=10_000, description="Time between the starts of two bursts, in milliseconds."
    )
    duty: Number = Field(
        default=1.0, gt=0, le=1, description="Share of time in which the jammer transmits; 1 is continuous."
    )


@dataclass(slots=True)
class BurstSchedule:
    """One burst per period, on the next of the centres each time; a burst ends when the attack stops."""

    centres_khz: tuple[int, ...]
    burst: NoiseRequest
    """A burst of whole length; its centre is replaced."""
    period_ns: Time
    schedule: Schedule
    continuous: bool = False
    """Whether each burst lasts until the next one in the same band."""
    turn: int = 0

    @property
    def due(self) -> Time:
        """When the next burst begins."""
        return self.turn * self.period_ns

    def make(self, now: Time) -> list[bytes]:
        """The burst that is due, if the attack acts; else nothing."""
        if self.due > now:
            return []
        number = now // self.period_ns
        self.turn = number + 1
        left_us = (self.schedule.stop_ns - now) // NS_PER_US
        if self.schedule.start_ns > now or left_us <= 0:
            return []
        centre_khz = self.centres_khz[number % len(self.centres_khz)]
        duration_us = min(self.burst.duration_us, left_us)
        continued = CONTINUED if self.continuous and left_us > duration_us else 0
        order = self.burst._replace(
            centre_khz=centre_khz, duration_us=duration_us, time_ns=now, turnaround_us=continued
        )
        return [pack(order)]


def make_jammer(
    context: AttackContext,
    transmitter_m: Place,
    power_dbm: float,
    centres_mhz: Sequence[float],
    bandwidth_mhz: float,
    period_ms: float,
    duty: float = 1.0,
) -> Attack:
    """A transmitter of noise bursts, one per period, on the next of the centres each time."""
    period_ns = round(period_ms * NS_PER_MS)
    burst = NoiseRequest(
        SILENT_CDBM if context.sham else round(power_dbm * 100),
        0,
        round(bandwidth_mhz * 1000),
        max(1, round(period_ns * duty) // NS_PER_US),
    )
    centres_khz = tuple(round(centre * 1000) for centre in centres_mhz)
    bursts = BurstSchedule(centres_khz, burst, period_ns, context.schedule, duty == 1.0 and len(centres_mhz) == 1)
    return make_sender(context, transmitter_m, power_dbm, bursts)


def make(params: Jam, context: AttackContext) -> Attack:
    """The attack."""
    centres = (params.centre_mhz,)
    return make_jammer(
        context, params.transmitter_m, params.power_dbm, centres, params.bandwidth_mhz, params.period_ms, params.duty
    )


JAM = AttackPlugin(
    Jam,
    make,
    "Transmits noise over the band, so that receivers miss broadcasts.",
    technique="T0814",
    counterfactual="mute",
    surface=("medium",),
    persists="acts",
    effect="receivers near the transmitter miss broadcasts, and senders defer",
    threat=ThreatModel(
        knowledge="the channel in use",
        position="within some hundred metres of the receivers, by power and walls",
        equipment="a noise generator for 2.4 GHz with an amplifier",
        budget="airtime by duty, up to 60 dBm",
    ),
    controls=Controls(
        load="none, because the noise is the attack; the sham has the same bursts at −200 dBm",
        content="none, because noise has no content",
        placement="the same jammer on another channel or at another place",
    ),
    realism={"missed broadcasts": "simulated: power at each receiver against noise, interference and walls"},
)
