"""Flood of a link: useless frames towards one end, which take their share of rates and queues."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil
from typing import Any, Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.links import MAX_INJECTS
from skyrange.attack.bases.mavlink.orders import AUTOPILOT
from skyrange.attack.bases.shams import benign_payload
from skyrange.attack.tapped_links import STATION_SIDE, ends_of
from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.core.time import Time

Subject = Literal["HEARTBEAT", "PING", "PARAM_REQUEST_LIST", "COMMAND_LONG", "random"]
"""A message, or random bytes."""
_SYSTEMS: Final = 254
_ALL_COMPONENTS: Final = 0


def _heartbeat(turn: int, system: int, now: Time) -> Any:
    return mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, 3)


def _ping(turn: int, system: int, now: Time) -> Any:
    return mav.MAVLink_ping_message(now // 1000, turn & 0xFFFFFFFF, 0, 0)


def _parameter_list(turn: int, system: int, now: Time) -> Any:
    return mav.MAVLink_param_request_list_message(system, _ALL_COMPONENTS)


def _request(turn: int, system: int, now: Time) -> Any:
    wanted = float(mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    command = mav.MAV_CMD_REQUEST_MESSAGE
    return mav.MAVLink_command_long_message(system, AUTOPILOT, command, 0, wanted, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


_MESSAGES: Final[dict[str, Callable[[int, int, Time], Any]]] = {
    "HEARTBEAT": _heartbeat, "PING": _ping, "PARAM_REQUEST_LIST": _parameter_list, "COMMAND_LONG": _request,
}  # fmt: skip


@dataclass(slots=True)
class UselessFrames:
    """Makes useless frames for one link; heartbeats have system ids of nobody on it."""

    subject: Subject
    random_bytes: int
    """Length of a frame of random bytes."""
    packer: Packer
    """The sender in whose name they are."""
    aircraft: int
    """System id of the aircraft on the link."""
    chance: Chance
    address: str
    """Of the random bytes, with the number of a frame."""

    def make(self, turn: int, now: Time) -> bytes:
        """Frame number `turn`, from 0."""
        if self.subject == "random":
            return self._draw_bytes(turn)
        if self.subject == "HEARTBEAT":
            self.packer.system, self.packer.component = self._foreign_system(turn), 1
        return self.packer.pack(_MESSAGES[self.subject](turn, self.aircraft, now))

    def _foreign_system(self, turn: int) -> int:
        """The next system id that is neither the aircraft's nor the ground station's."""
        system = 1 + turn % (_SYSTEMS - 1)
        return system + 1 if system >= self.aircraft else system

    def _draw_bytes(self, turn: int) -> bytes:
        who, made = hash64(self.address), b""
        while len(made) < self.random_bytes:
            for uniform in self.chance.uniform4("attack.flood", who, turn, len(made)):
                made += int(uniform * 2.0**48).to_bytes(6, "little")
        return made[: self.random_bytes]


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
        return [self.inject(benign_payload(payload) if self.sham else payload) for payload in payloads]
