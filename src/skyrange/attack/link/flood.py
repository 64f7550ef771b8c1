"""Flood of a link: useless frames towards one end, which take their share of rates and queues."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import ceil
from typing import Any, Final, Literal

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.link.frame_taps import MAX_INJECTS, FrameChance, benign_payload
from skyrange.attack.on_path import Names, TapMaker, ends_of, place_taps
from skyrange.codec.mavlink import Packer, dialect
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule, TapPlacement
from skyrange.contracts.params import Number, Params, Whole
from skyrange.contracts.verdicts import Direction, Inject, Verdict
from skyrange.core.errors import InputError, nearest
from skyrange.core.ids import hash64
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, Time

ROLES: Final = ("gcs", "log", "autopilot")
"""Links that can be flooded."""
STATION: Final = (255, 190)
"""System and component id of the ground station, in whose name frames towards an aircraft are sent."""
BATCH_NS: Final[Time] = NS_PER_MS
"""Shortest time between two batches of frames."""
_SYSTEMS: Final = 254
_ALL_COMPONENTS: Final = 0


class Flood(Params):
    """Frames of one kind at a constant rate. They enter the link before its channel, so they take their share of its
    `rate_bps` and `queue_bytes`, and of the `frames_per_s` and `queue_frames` of the endpoints that process them, if
    the scenario declares those. Without any limit, frames do not wait for each other.
    """

    links: Names = Field(
        min_length=1, description="Links gcs, log or autopilot by name or pattern, such as ['gcs:blue/b1']."
    )
    towards: Literal["aircraft", "station"] = Field(default="aircraft", description="End that the frames go to.")
    message: Literal["HEARTBEAT", "PING", "PARAM_REQUEST_LIST", "COMMAND_LONG", "random"] = Field(
        default="PING",
        description="Frames that are sent. HEARTBEAT: of foreign systems; PING: no receiver answers it; "
        "PARAM_REQUEST_LIST: all parameters are requested; COMMAND_LONG: AUTOPILOT_VERSION is requested; random: bytes "
        "that are no frame.",
    )
    rate_hz: Number = Field(default=100.0, gt=0, le=20_000, description="Frames per second on each link.")
    random_bytes: Whole = Field(default=64, ge=1, le=1024, description="Length of a frame of random bytes.")


def _heartbeat(turn: int, system: int, now: Time) -> Any:
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_GENERIC, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
    )


def _ping(turn: int, system: int, now: Time) -> Any:
    return dialect.MAVLink_ping_message(now // 1000, turn & 0xFFFFFFFF, 0, 0)


def _parameter_list(turn: int, system: int, now: Time) -> Any:
    return dialect.MAVLink_param_request_list_message(system, _ALL_COMPONENTS)


def _request(turn: int, system: int, now: Time) -> Any:
    wanted = float(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    command = dialect.MAV_CMD_REQUEST_MESSAGE
    return dialect.MAVLink_command_long_message(
        system, dialect.MAV_COMP_ID_AUTOPILOT1, command, 0, wanted, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    )


_MESSAGES: Final[dict[str, Callable[[int, int, Time], Any]]] = {
    "HEARTBEAT": _heartbeat, "PING": _ping, "PARAM_REQUEST_LIST": _parameter_list, "COMMAND_LONG": _request,
}  # fmt: skip


@dataclass(slots=True)
class FloodTap:
    """An injecting node at the sending end of a link: `rate_hz` frames per second in one direction."""

    link: str
    params: Flood
    direction: Direction
    schedule: Schedule
    chance: FrameChance
    systems: dict[str, int]
    """System ids of the aircraft."""
    sham: bool
    packer: Packer = field(init=False)
    sent: int = 0
    begun_ns: Time = NEVER
    """When the first frame was sent: the start, or soon after where a trigger set that."""
    woken_ns: Time = -NEVER

    def __post_init__(self) -> None:
        self.packer = Packer(*(STATION if self.direction == "fwd" else (self._aircraft, 1)))

    @property
    def _aircraft(self) -> int:
        return self.systems[self.link.partition(":")[2]]

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Let it pass."""
        return ()

    def next_wakeup(self) -> Time | None:
        """When the next frame is due, but for the shortest time between batches; `None` once the attack has ended."""
        start = self.schedule.start_ns if self.begun_ns == NEVER else self.begun_ns
        if start == NEVER:
            return None
        due = start + ceil(self.sent * NS_PER_S / self.params.rate_hz)
        due += -(due - start) % BATCH_NS if self.params.rate_hz * BATCH_NS > NS_PER_S else 0
        due = max(due, self.woken_ns + BATCH_NS) if due <= self.woken_ns else due  # it was woken late
        return due if due < self.schedule.stop_ns else None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """The frames that are due."""
        self.woken_ns = now
        self.begun_ns = min(self.begun_ns, now)
        due = int((now - self.begun_ns) * self.params.rate_hz / NS_PER_S) + 1 - self.sent
        made: list[Verdict] = []
        for _ in range(min(due, MAX_INJECTS)):
            payload = self._payload(now)
            self.sent += 1
            payload = benign_payload(payload) if self.sham else payload
            made.append(Inject(payload, self.direction, *ends_of(self.link, self.direction)))
        return made

    def _payload(self, now: Time) -> bytes:
        if self.params.message == "random":
            return self._random_bytes()
        aircraft = self._aircraft
        if self.params.message == "HEARTBEAT":
            self.packer.system, self.packer.component = self._foreign_system(aircraft), 1
        return self.packer.pack(_MESSAGES[self.params.message](self.sent, aircraft, now))

    def _foreign_system(self, aircraft: int) -> int:
        """The next system id that is neither the aircraft's nor the ground station's."""
        system = 1 + self.sent % (_SYSTEMS - 1)
        return system + 1 if system >= aircraft else system

    def _random_bytes(self) -> bytes:
        who = hash64(f"{self.chance.attack}|{self.link}")
        size, made = self.params.random_bytes, b""
        while len(made) < size:
            for uniform in self.chance.chance.uniform4("attack.flood", who, self.sent, len(made)):
                made += int(uniform * 2.0**48).to_bytes(6, "little")
        return made[:size]


def make(params: Flood, context: AttackContext) -> Attack:
    """The attack; its sham sends benign frames of the same length.

    Raises `InputError` for links of other kinds than gcs, log and autopilot.
    """
    direction: Direction = "fwd" if params.towards == "aircraft" else "rev"
    systems = {name: aircraft.system_id for name, aircraft in context.vehicles.items()}
    chance = FrameChance(context.chance, context.id)
    maker = TapMaker(FloodTap, (params, direction, context.schedule, chance, systems, context.sham))
    taps = place_taps(params.links, context, maker)
    floodable = [name for name in context.links if name.partition(":")[0] in ROLES]
    for tap in taps:
        if tap.match not in floodable:
            hint = nearest(tap.match, floodable)
            raise InputError.one(context.id, "links", tap.match, "a gcs, log or autopilot link", hint)
    return Attack(taps=[_at_sender(tap, direction) for tap in taps])


def _at_sender(tap: TapPlacement, direction: Direction) -> TapPlacement:
    """The tap at the end that sends in a direction: what it injects meets the channel."""
    return replace(tap, side=ends_of(tap.match, direction)[0].rpartition(".")[2])


FLOOD = AttackPlugin(
    Flood,
    make,
    "Sends useless frames towards one end of a link, at a constant rate.",
    technique="T0814",
    counterfactual="mute",
    surface=ROLES,
    persists="acts",
    effect="frames wait behind useless ones, and are lost where the queue of the link or of a receiver is full",
    threat=ThreatModel(
        knowledge="the addresses of the link's ends, and the system id of the aircraft",
        position="in the network of the sending end; it need not be on the path",
        equipment="a computer with as fast a connection",
        budget="the declared rate in frames per second on each link",
    ),
    controls=Controls(
        load="the sham: benign frames of the same length, which no receiver answers",
        content="random bytes of the same length and rate",
        placement="the same flood on another aircraft's link, or towards the other end",
    ),
    realism={
        "queueing": "simulated: the rate and queue that the scenario declares for the link",
        "processing time": "simulated: the same for each frame, as the scenario declares for the receiver; else none",
    },
)
