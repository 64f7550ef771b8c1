"""Reactive jammer: noise only while a frame of a Wi-Fi control link is on the air."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.control_link.wifi_links import find_wifi_links
from skyrange.attack.radio import make_sender
from skyrange.attack.remote_id.jam import SILENT_CDBM
from skyrange.codec.remote_id.noise_request import NoiseRequest, pack
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Enu, Number, Params, Whole
from skyrange.core.time import NS_PER_MS, NS_PER_US, Time

PERIOD_NS: Time = 100 * NS_PER_MS
"""The jammer's program renews its order to the radio this often; an order is for twice as long, if none replaces it."""


class ReactiveJam(Params):
    """A jammer that listens, and answers each frame of the links' channels with noise until the frame ends."""

    transmitter_m: Enu = Field(
        description="Position of the jammer, [east_m, north_m, up_m] in metres from the origin or the attack's anchor."
    )
    links: tuple[str, ...] = Field(
        default=("gcs:*",), min_length=1, description="Control links over Wi-Fi by name or pattern."
    )
    power_dbm: Number = Field(default=30.0, ge=-30, le=60, description="Radiated power (EIRP) in dBm.")
    follow_s: Number | None = Field(
        default=None,
        ge=0.001,
        le=65,
        description="Time in seconds after which it finds an access point that has changed its channel, and follows; "
        "default: it stays. A scan of 13 channels, each for a beacon interval, takes 1.3 s at most.",
    )
    turnaround_us: Whole = Field(
        default=20,
        ge=1,
        le=254,
        description="Time from the start of a frame to that of the noise, in microseconds; 20 is the preamble's end.",
    )


@dataclass(slots=True)
class ReactiveOrders:
    """One order per period and channel, or access point; the last one ends when the attack stops."""

    targets: tuple[tuple[int, bytes], ...]
    """Centre in kHz and the access point to be followed, if any."""
    follow_ms: int
    power_cdbm: int
    turnaround_us: int
    schedule: Schedule
    turn: int = 0

    @property
    def due(self) -> Time:
        """When the next order is due."""
        return self.turn * PERIOD_NS

    def make(self, now: Time) -> list[bytes]:
        """The orders that are due, if the attack acts; else nothing."""
        if self.due > now:
            return []
        self.turn = now // PERIOD_NS + 1
        left_us = min(self.schedule.stop_ns - now, 2 * PERIOD_NS) // NS_PER_US
        if self.schedule.start_ns > now or left_us <= 0:
            return []
        orders = (
            NoiseRequest(self.power_cdbm, centre, 20_000, left_us, now, self.turnaround_us, bssid, self.follow_ms)
            for centre, bssid in self.targets
        )
        return [pack(order) for order in orders]


def make(params: ReactiveJam, context: AttackContext) -> Attack:
    """The attack."""
    links = find_wifi_links(context, params.links)
    follow_ms = 0 if params.follow_s is None else max(1, round(params.follow_s * 1000))
    targets = {(round(link.centre_mhz * 1000), link.station_address if follow_ms else b"") for link in links.values()}
    orders = ReactiveOrders(
        tuple(sorted(targets)),
        follow_ms,
        SILENT_CDBM if context.sham else round(params.power_dbm * 100),
        params.turnaround_us,
        context.schedule,
    )
    return make_sender(context, params.transmitter_m, params.power_dbm, orders)


REACTIVE_JAM = AttackPlugin(
    ReactiveJam,
    make,
    "Transmits noise only while a frame of a Wi-Fi control link is on the air, so that its check sequence fails.",
    technique="T0814",
    counterfactual="mute",
    surface=("gcs", "medium"),
    persists="acts",
    effect="frames of the control link are repeated and lost, while the channel seems free between them",
    threat=ThreatModel(
        knowledge="the channel of the control link; to follow it, the address of its access point",
        position="where it hears the senders, and is heard by the receivers",
        equipment="a software-defined radio that reacts within a preamble",
        budget="noise for the time of the frames alone, up to 60 dBm, in one channel for each access point",
    ),
    controls=Controls(
        load="none, because the noise is the attack; the sham has the same orders at −200 dBm",
        content="none, because noise has no content",
        placement="the same jammer on a channel that nobody uses, or where it does not hear the senders",
    ),
    realism={
        "lost frames": "simulated: power of signal and noise over the part of a frame that the noise covers",
        "following": "assumed: an access point whose beacons reach it with -82 dBm is found after follow_s",
        "reaction time": "assumed: 20 µs by default, one preamble; software-defined radios have done so",
    },
)
"""The attack `control_link.reactive_jam`."""
