"""Flood of a link: useless frames towards one end, which take their share of rates and queues."""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from typing import Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.shams import benign_payload
from skyrange.attack.bases.waiting_frames import MAX_INJECTS
from skyrange.attack.link.useless_frames import Subject, UselessFrames
from skyrange.attack.tapped_links import STATION_SIDE, ends_of

BATCH_NS: Final[sky.Time] = sky.NS_PER_MS
"""Shortest time between two batches of frames."""


@sky.attack(
    "link.flood",
    technique="T0814",
    counterfactual="mute",
    surface=("gcs", "log", "autopilot"),
    persists="acts",
    effect="frames wait behind useless ones, and are lost where the queue of the link or of a receiver is full",
    knowledge="the addresses of the link's ends, and the system id of the aircraft",
    position="by place: in the network of the sending end, or near the link with a radio",
    equipment="a computer with as fast a connection",
    budget="the declared rate in frames per second on each link",
    load="the sham: benign frames of the same length, which no receiver answers",
    content="random bytes of the same length and rate",
    placement="the same flood on another aircraft's link, or towards the other end",
    realism={
        "queueing": "simulated: the rate and queue that the scenario declares for the link",
        "processing time": "simulated: the same for each frame, as the scenario declares for the receiver; else none",
    },
)
class Flood(sky.InjectionOnLinks):
    """Sends useless frames towards one end of a link, at a constant rate.

    By default they enter the link before its channel, as from the network of the sending end. So they take their share
    of its `rate_bps` and `queue_bytes`, and of the `frames_per_s` and `queue_frames` of the endpoints that process
    them, if the scenario declares those. Without any limit, frames do not wait for each other.
    """

    towards: Literal["aircraft", "station"] = sky.param("End that the frames go to.", default="aircraft")
    message: Subject = sky.param(
        "Frames that are sent. HEARTBEAT: of foreign systems; PING: no receiver answers it; PARAM_REQUEST_LIST: all "
        "parameters are requested; COMMAND_LONG: AUTOPILOT_VERSION is requested; random: bytes that are no frame.",
        default="PING",
    )
    rate_hz: sky.Number = sky.param("Frames per second on each link.", default=100.0, gt=0, le=20_000)
    random_bytes: sky.Whole = sky.param("Length of a frame of random bytes.", default=64, ge=1, le=1024)

    frames: UselessFrames
    sent: int = 0
    begun_ns: sky.Time = sky.NEVER
    """When the first frame was sent: the start, or soon after where a trigger set that."""
    woken_ns: sky.Time = -sky.NEVER

    def prepare(self, context: sky.AttackContext) -> None:
        self.way = "fwd" if self.towards == "aircraft" else "rev"

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """Taps at their place, by default at the sending ends: what they inject meets the channel."""
        taps = super().build(context).taps
        return sky.Attack(taps=taps if self.place is not None else [self._at_sender(tap) for tap in taps])

    def begin(self) -> None:
        super().begin()
        packer = self.packer if self.way == "fwd" else sky.MavlinkPacker(self.target, sky.AUTOPILOT)
        address = f"{self.id}|{self.link}"
        self.frames = UselessFrames(self.message, self.random_bytes, packer, self.target, self.chance, address)

    def _at_sender(self, tap: sky.TapPlacement) -> sky.TapPlacement:
        side = ends_of(tap.match, self.way)[0].rpartition(".")[2]
        place: sky.NetworkPlace = "network" if side == STATION_SIDE else "onboard"
        return replace(tap, side=side, place=tap.place and place)

    def next_wakeup(self) -> sky.Time | None:
        """When the next frame is due, but for the shortest time between batches; `None` once the attack has ended."""
        start = self.schedule.start_ns if self.begun_ns == sky.NEVER else self.begun_ns
        if start == sky.NEVER:
            return None
        due = start + ceil(self.sent * sky.NS_PER_S / self.rate_hz)
        due += -(due - start) % BATCH_NS if self.rate_hz * BATCH_NS > sky.NS_PER_S else 0
        due = max(due, self.woken_ns + BATCH_NS) if due <= self.woken_ns else due  # it was woken late
        return due if due < self.schedule.stop_ns else None

    def on_wakeup(self, now: sky.Time) -> sky.Verdicts:
        self.woken_ns = now
        return self.send(now)

    def send(self, now: sky.Time) -> sky.Verdicts:
        self.begun_ns = min(self.begun_ns, now)
        due = int((now - self.begun_ns) * self.rate_hz / sky.NS_PER_S) + 1 - self.sent
        numbers = range(self.sent, self.sent + min(due, MAX_INJECTS))
        self.sent += len(numbers)
        payloads = [self.frames.make(number, now) for number in numbers]
        return [self.inject(benign_payload(one) if self.sham else one) for one in payloads]
