"""Flood of a link: useless frames towards one end, which take their share of rates and queues."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import ceil
from typing import Any, Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.on_path import MAX_INJECTS
from skyrange.attack.bases.shams import benign_payload
from skyrange.attack.tapped_links import Names, ends_of
from skyrange.codec.mavlink import dialect
from skyrange.contracts.verdicts import Direction

ROLES: Final = ("gcs", "log", "autopilot")
"""Links that can be flooded."""
STATION: Final = (255, 190)
"""System and component id of the ground station, in whose name frames towards an aircraft are sent."""
BATCH_NS: Final[sky.Time] = sky.NS_PER_MS
"""Shortest time between two batches of frames."""
_SYSTEMS: Final = 254
_ALL_COMPONENTS: Final = 0


def _heartbeat(turn: int, system: int, now: sky.Time) -> Any:
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_GENERIC, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
    )


def _ping(turn: int, system: int, now: sky.Time) -> Any:
    return dialect.MAVLink_ping_message(now // 1000, turn & 0xFFFFFFFF, 0, 0)


def _parameter_list(turn: int, system: int, now: sky.Time) -> Any:
    return dialect.MAVLink_param_request_list_message(system, _ALL_COMPONENTS)


def _request(turn: int, system: int, now: sky.Time) -> Any:
    wanted = float(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    command = dialect.MAV_CMD_REQUEST_MESSAGE
    return dialect.MAVLink_command_long_message(
        system, dialect.MAV_COMP_ID_AUTOPILOT1, command, 0, wanted, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    )


_MESSAGES: Final[dict[str, Callable[[int, int, sky.Time], Any]]] = {
    "HEARTBEAT": _heartbeat, "PING": _ping, "PARAM_REQUEST_LIST": _parameter_list, "COMMAND_LONG": _request,
}  # fmt: skip


@sky.attack(
    "link.flood",
    technique="T0814",
    counterfactual="mute",
    surface=("gcs", "log", "autopilot"),
    persists="acts",
    effect="frames wait behind useless ones, and are lost where the queue of the link or of a receiver is full",
    knowledge="the addresses of the link's ends, and the system id of the aircraft",
    position="in the network of the sending end; it need not be on the path",
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
class Flood(sky.LinkTap):
    """Sends useless frames towards one end of a link, at a constant rate.

    They enter the link before its channel, so they take their share of its `rate_bps` and `queue_bytes`, and of the
    `frames_per_s` and `queue_frames` of the endpoints that process them, if the scenario declares those. Without any
    limit, frames do not wait for each other.
    """

    links: Names = sky.param("Links gcs, log or autopilot by name or pattern, such as ['gcs:blue/b1'].", min_length=1)
    towards: Literal["aircraft", "station"] = sky.param("End that the frames go to.", default="aircraft")
    message: Literal["HEARTBEAT", "PING", "PARAM_REQUEST_LIST", "COMMAND_LONG", "random"] = sky.param(
        "Frames that are sent. HEARTBEAT: of foreign systems; PING: no receiver answers it; PARAM_REQUEST_LIST: all "
        "parameters are requested; COMMAND_LONG: AUTOPILOT_VERSION is requested; random: bytes that are no frame.",
        default="PING",
    )
    rate_hz: sky.Number = sky.param("Frames per second on each link.", default=100.0, gt=0, le=20_000)
    random_bytes: sky.Whole = sky.param("Length of a frame of random bytes.", default=64, ge=1, le=1024)

    way: Direction
    systems: dict[str, int]
    """System ids of the aircraft, until the tap has that of its own."""
    aircraft: int
    """That of the aircraft on the link."""
    packer: sky.MavlinkPacker
    sent: int = 0
    begun_ns: sky.Time = sky.NEVER
    """When the first frame was sent: the start, or soon after where a trigger set that."""
    woken_ns: sky.Time = -sky.NEVER

    def prepare(self, context: sky.AttackContext) -> None:
        self.way = "fwd" if self.towards == "aircraft" else "rev"
        self.systems = {name: aircraft.system_id for name, aircraft in context.vehicles.items()}

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """Taps at the sending ends. Raises `InputError` for links of other kinds than gcs, log and autopilot."""
        taps = self.place(self.links, context)
        floodable = [name for name in context.links if name.partition(":")[0] in ROLES]
        for tap in taps:
            if tap.match not in floodable:
                hint = sky.nearest(tap.match, floodable)
                raise sky.InputError.one(context.id, "links", tap.match, "a gcs, log or autopilot link", hint)
        return sky.Attack(taps=[_at_sender(tap, self.way) for tap in taps])

    def begin(self) -> None:
        self.aircraft, self.systems = self.systems[self.link.partition(":")[2]], {}
        self.packer = sky.MavlinkPacker(*(STATION if self.way == "fwd" else (self.aircraft, 1)))

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        return ()

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
        self.begun_ns = min(self.begun_ns, now)
        due = int((now - self.begun_ns) * self.rate_hz / sky.NS_PER_S) + 1 - self.sent
        made: list[sky.Verdict] = []
        for _ in range(min(due, MAX_INJECTS)):
            payload = self._payload(now)
            self.sent += 1
            payload = benign_payload(payload) if self.sham else payload
            made.append(sky.Inject(payload, self.way, *ends_of(self.link, self.way)))
        return made

    def _payload(self, now: sky.Time) -> bytes:
        if self.message == "random":
            return self._random_bytes()
        if self.message == "HEARTBEAT":
            self.packer.system, self.packer.component = self._foreign_system(), 1
        return self.packer.pack(_MESSAGES[self.message](self.sent, self.aircraft, now))

    def _foreign_system(self) -> int:
        """The next system id that is neither the aircraft's nor the ground station's."""
        system = 1 + self.sent % (_SYSTEMS - 1)
        return system + 1 if system >= self.aircraft else system

    def _random_bytes(self) -> bytes:
        who = sky.hash64(f"{self.id}|{self.link}")
        size, made = self.random_bytes, b""
        while len(made) < size:
            for uniform in self.chance.uniform4("attack.flood", who, self.sent, len(made)):
                made += int(uniform * 2.0**48).to_bytes(6, "little")
        return made[:size]


def _at_sender(tap: sky.TapPlacement, direction: Direction) -> sky.TapPlacement:
    """The tap at the end that sends in a direction: what it injects meets the channel."""
    return replace(tap, side=ends_of(tap.match, direction)[0].rpartition(".")[2])
