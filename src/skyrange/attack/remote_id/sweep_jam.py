"""Sweeping jammer: noise on one channel after another, so that one transmitter disturbs several channels in turn."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.radio import Broadcaster, transmitter, up_link
from skyrange.attack.remote_id.jam import SILENT_CDBM
from skyrange.codec.remote_id.noise_request import NoiseRequest, pack
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Enu, Number, Params
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, NS_PER_US, Time


class SweepJam(Params):
    """Noise that stays on each channel for a time, in the order given, again and again."""

    transmitter_m: Enu = Field(
        description="Position of the jammer, [east_m, north_m, up_m] in metres from the origin or the attack's anchor."
    )
    power_dbm: Number = Field(default=30.0, ge=-30, le=60, description="Radiated power (EIRP) in dBm.")
    centres_mhz: tuple[Number, ...] = Field(
        default=(2402.0, 2426.0, 2437.0, 2480.0),
        min_length=2,
        max_length=100,
        description="Centres of the channels in MHz, in the order of the sweep; default: the three advertising "
        "channels of Bluetooth and Wi-Fi channel 6.",
    )
    bandwidth_mhz: Number = Field(
        default=2.0, ge=0.1, le=500, description="Width of the noise in MHz; narrower noise is denser."
    )
    dwell_ms: Number = Field(default=5.0, ge=1, le=10_000, description="Time on each channel in milliseconds.")


@dataclass(slots=True)
class Sweep:
    """One burst per dwell time, on the next channel each time; a burst ends when the attack stops."""

    centres_khz: tuple[int, ...]
    burst: NoiseRequest
    period_ns: Time
    schedule: Schedule
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
        return [pack(self.burst._replace(centre_khz=centre_khz, duration_us=duration_us, time_ns=now))]


def make(params: SweepJam, context: AttackContext) -> Attack:
    """The attack."""
    period_ns = round(params.dwell_ms * NS_PER_MS)
    burst = NoiseRequest(
        SILENT_CDBM if context.sham else round(params.power_dbm * 100),
        0,
        round(params.bandwidth_mhz * 1000),
        period_ns // NS_PER_US,
    )
    centres_khz = tuple(round(centre * 1000) for centre in params.centres_mhz)
    agent = Broadcaster(
        context.radio, Port(context.radio, context.up), Sweep(centres_khz, burst, period_ns, context.schedule)
    )
    radio = transmitter(context, params.transmitter_m, params.power_dbm)
    return Attack(agents=[agent], links=[up_link(context)], radios=[radio])


SWEEP_JAM = AttackPlugin(
    SweepJam,
    make,
    "Transmits noise on one channel after another, so that one transmitter disturbs all of them in turn.",
    technique="T0814",
    counterfactual="mute",
    surface=("medium",),
    effect="receivers miss a share of the broadcasts on every channel, Bluetooth and Wi-Fi alike",
    threat=ThreatModel(
        knowledge="the channels of the band",
        position="within some hundred metres of the receivers, by power and walls",
        equipment="a tunable noise generator for 2.4 GHz with an amplifier",
        budget="all of the time, on one channel at a time, up to 60 dBm",
    ),
    controls=Controls(
        load="none, because the noise is the attack; the sham has the same bursts at −200 dBm",
        content="none, because noise has no content",
        placement="the same jammer on channels that nobody uses, or at another place",
    ),
    realism={
        "missed broadcasts": "simulated: power at each receiver against noise, interference and walls",
        "change of channel": "assumed: at once, and the first 0.1 ms of a dwell without noise",
    },
)
