"""A scripted ArduCopter and a small loop of lossy links: what ground station tests fly against.

The autopilot answers as ArduCopter does where that is awkward for a ground station: a repeated item is
INVALID_SEQUENCE, an item after the end ERROR, a request list during an upload DENIED, a lost item is
asked for again after 1 s, an upload is given up after 8 s, altitudes are cut to centimetres, item 0 is
always its own home (libraries/GCS_MAVLink/MissionItemProtocol.cpp, libraries/AP_Mission).
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Any

from skyrange.codec.mavlink import Packer, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.mailboxes import Arrival, Inbox, Note
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.ids import FrameId, Port, hash64, link_name
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch
from skyrange.gcs.station import GroundStation
from skyrange.utm.approval_service import FlightApproval

STEP_NS = 20 * NS_PER_MS
LAND_MPS = 1.0
ORIGIN = Origin(-35.3633280, 149.1652241, 584.0, 19.0)
EPOCH = Epoch(1_767_268_800 * NS_PER_S)
ADDRESSED = {44, 73, 51, 40, 47, 43, 45, 76, 86}


@dataclass
class FakeAutopilot:
    """One aircraft: `home` and positions in metres east, north, up of `ORIGIN`."""

    system: int
    home: tuple[float, float, float] = (0.0, 0.0, 0.0)
    answers: dict[int, list[int | None]] = field(default_factory=dict)
    """command → results to give first, in order; `None` stays silent once."""
    texts: dict[int, list[tuple[int, str, int, int]]] = field(default_factory=dict)
    """command → STATUSTEXTs to send before each answer: severity, text, id, chunk number."""
    mute_until: int = 0
    """Says nothing before this time."""
    deaf: bool = False
    """Hears nothing, but its heartbeats go on."""
    tamper: dict[int, dict[str, Any]] = field(default_factory=dict)
    """item → fields that the read-back changes."""
    drop_requests: int = 0
    """How many of its first item requests get lost."""
    drop_final_ack: int = 0
    nack_count: list[int] = field(default_factory=list)
    """Results with which it answers the first MISSION_COUNTs instead of requesting items."""
    disarm_at: int | None = None
    heard: list[Any] = field(default_factory=list)
    heard_causes: list[tuple[FrameId, ...]] = field(default_factory=list)
    armed: bool = False
    mode: int = 0

    def __post_init__(self) -> None:
        self.packer = Packer(self.system, 1)
        self.position = list(self.home)
        self.items: list[Any] = []
        self.receiving = 0
        self.wanted = -1
        self.asked_ns = self.touched_ns = 0
        self.intervals: dict[int, int] = {}
        self.sent_ns: dict[int, int] = {}
        self.current = 0
        self.running = False
        self.goal: tuple[float, float, float] | None = None
        self.speed = 5.0
        self.out: list[bytes] = []
        self.now = 0

    # --- frames ----------------------------------------------------------------------------------

    def on_frame(self, now: int, payload: bytes) -> list[bytes]:
        self.now, self.out = now, []
        message = decode(payload)
        self.heard.append(message)
        assert message.get_srcSystem() == 255
        assert message.get_srcComponent() == 190
        if message.id in ADDRESSED:
            assert message.target_system == self.system, "a frame for another aircraft"
        if not self.deaf:
            handler = getattr(self, f"on_{message.get_type().lower()}", None)
            if handler is not None:
                handler(message)
        return self.out if now >= self.mute_until else []

    def say(self, message: Any) -> None:
        self.out.append(self.packer.pack(message))

    def ack(self, kind: int) -> None:
        self.say(mav.MAVLink_mission_ack_message(255, 190, kind, 0))

    def ask(self) -> None:
        self.asked_ns = self.now
        if self.drop_requests:
            self.drop_requests -= 1
            return
        kind = mav.MAVLink_mission_request_message if self.wanted % 2 else mav.MAVLink_mission_request_int_message
        self.say(kind(255, 190, self.wanted, 0))

    def on_mission_count(self, message: Any) -> None:
        if self.nack_count:
            self.ack(self.nack_count.pop(0))
            return
        self.receiving, self.wanted, self.items = message.count, 0, []
        self.touched_ns = self.now
        self.ask()

    def on_mission_item_int(self, message: Any) -> None:
        if not self.receiving:
            self.ack(mav.MAV_MISSION_ERROR)
        elif message.seq != self.wanted:
            self.ack(mav.MAV_MISSION_INVALID_SEQUENCE)
        else:
            self.items.append(message)
            self.wanted += 1
            self.touched_ns = self.now
            if self.wanted < self.receiving:
                self.ask()
                return
            self.receiving = 0
            if self.drop_final_ack:
                self.drop_final_ack -= 1
            else:
                self.ack(mav.MAV_MISSION_ACCEPTED)

    def on_mission_request_list(self, _: Any) -> None:
        if self.receiving:
            self.ack(mav.MAV_MISSION_DENIED)
        else:
            self.say(mav.MAVLink_mission_count_message(255, 190, len(self.items), 0))

    def on_mission_request_int(self, message: Any) -> None:
        if self.receiving:
            self.ack(mav.MAV_MISSION_DENIED)
            return
        item = self.items[message.seq]
        lat, lon = ORIGIN.geodetic_of(*self.home[:2])
        fields = {name: getattr(item, name) for name in item.fieldnames}
        fields |= {"target_system": 255, "target_component": 190, "z": int(item.z * 100) / 100}
        if item.frame == 6:
            fields["frame"] = 3
        if message.seq == 0:
            fields |= {"x": round(lat * 1e7), "y": round(lon * 1e7), "frame": 0, "z": 584.1}
        fields |= self.tamper.get(message.seq, {})
        self.say(mav.MAVLink_mission_item_int_message(*(fields[name] for name in item.fieldnames)))

    def on_command_long(self, message: Any) -> None:
        command = int(message.command)
        for severity, text, number, chunk in self.texts.get(command, ()):
            self.say(mav.MAVLink_statustext_message(severity, text.encode(), number, chunk))
        scripted = self.answers.get(command)
        result: int | None = scripted.pop(0) if scripted else mav.MAV_RESULT_ACCEPTED
        if result is None:
            return
        if result == mav.MAV_RESULT_ACCEPTED:
            result = self.obey(command, message)
        self.say(mav.MAVLink_command_ack_message(command, result, 0, 0, 255, 190))

    def obey(self, command: int, message: Any) -> int:
        if command == mav.MAV_CMD_DO_SET_MODE:
            self.set_mode(int(message.param2))
        elif command == mav.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = True
        elif command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
            self.intervals[int(message.param1)] = int(message.param2) * 1000
        elif command == mav.MAV_CMD_MISSION_START:
            if not (self.armed and len(self.items) > 1):
                return int(mav.MAV_RESULT_FAILED)
            self.set_mode(mav.COPTER_MODE_AUTO)
            if not self.running:
                self.running = True
                self.take(1)
        elif command == mav.MAV_CMD_NAV_TAKEOFF:
            flying = self.goal is not None or self.position[2] > self.home[2]
            if not self.armed or flying or self.mode != mav.COPTER_MODE_GUIDED:
                return int(mav.MAV_RESULT_FAILED)
            self.goal = (self.position[0], self.position[1], self.home[2] + message.param7)
        elif command == mav.MAV_CMD_DO_CHANGE_SPEED:
            self.speed = message.param2
        else:
            return int(mav.MAV_RESULT_UNSUPPORTED)
        return int(mav.MAV_RESULT_ACCEPTED)

    def on_set_position_target_global_int(self, message: Any) -> None:
        if self.mode == mav.COPTER_MODE_GUIDED and self.armed:
            assert message.coordinate_frame == 6
            self.goal = (*ORIGIN.enu_of(message.lat_int / 1e7, message.lon_int / 1e7), self.home[2] + message.alt)

    # --- flight ----------------------------------------------------------------------------------

    def set_mode(self, mode: int) -> None:
        if mode == self.mode:
            return  # as ArduCopter: a mode command that comes twice restarts nothing
        self.mode = mode
        self.goal = None
        if mode == mav.COPTER_MODE_RTL:
            self.running = False
            self.goal = self.home
        elif mode == mav.COPTER_MODE_LAND:
            self.running = False
            self.goal = (self.position[0], self.position[1], self.home[2])

    def take(self, seq: int) -> None:
        """Begin mission item `seq`."""
        self.current = seq
        item = self.items[seq]
        if item.command == mav.MAV_CMD_NAV_TAKEOFF:
            self.goal = (self.position[0], self.position[1], self.home[2] + item.z)
        elif item.command == mav.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            self.goal = self.home
        elif item.command == mav.MAV_CMD_DO_CHANGE_SPEED:
            self.speed = item.param2
            self.take(seq + 1)
        else:
            self.goal = (*ORIGIN.enu_of(item.x / 1e7, item.y / 1e7), self.home[2] + item.z)

    def reached(self) -> None:
        landed = self.position[2] <= self.home[2] + 1e-6
        if self.running:
            self.say(mav.MAVLink_mission_item_reached_message(self.current))
            if self.current + 1 < len(self.items):
                self.take(self.current + 1)
                return
            self.running = False
        if landed and self.mode != mav.COPTER_MODE_GUIDED:
            self.armed = False

    def tick(self, now: int) -> list[bytes]:
        """One step of `STEP_NS`: move, ask again, telemetry."""
        self.now, self.out = now, []
        if self.disarm_at is not None and now >= self.disarm_at:
            self.armed, self.disarm_at, self.goal = False, None, None
        if self.goal is not None and self.armed:
            away = math.dist(self.goal, self.position)
            landing = self.goal[2] == self.home[2]
            step = (LAND_MPS if landing else self.speed) * STEP_NS / NS_PER_S
            if away <= step:
                self.position, self.goal = list(self.goal), None
                self.reached()
            else:
                self.position = [p + (g - p) * step / away for p, g in zip(self.position, self.goal, strict=True)]
        if self.receiving:
            if now - self.touched_ns > 8 * NS_PER_S:
                self.receiving = 0
                self.ack(mav.MAV_MISSION_OPERATION_CANCELLED)
            elif now - self.asked_ns > NS_PER_S:
                self.ask()
        self.telemetry(now)
        return self.out if now >= self.mute_until else []

    def telemetry(self, now: int) -> None:
        for message, interval in {0: NS_PER_S, **self.intervals}.items():
            if now - self.sent_ns.get(message, -interval) < interval:
                continue
            self.sent_ns[message] = now
            if message == 0:
                flags = 81 | (128 if self.armed else 0)
                self.say(mav.MAVLink_heartbeat_message(2, 3, flags, self.mode, 4, 3))
            elif message == 33:
                lat, lon = ORIGIN.geodetic_of(*self.position[:2])
                above = round((self.position[2] - self.home[2]) * 1000)
                self.say(
                    mav.MAVLink_global_position_int_message(
                        now // NS_PER_MS, round(lat * 1e7), round(lon * 1e7), above + 584_000, above, 0, 0, 0, 0
                    )
                )
            elif message == 42:
                self.say(mav.MAVLink_mission_current_message(self.current))
            elif message == 30:
                self.say(mav.MAVLink_attitude_message(now // NS_PER_MS, 0, 0, 0, 0, 0, 0))
            elif message == 1:
                self.say(mav.MAVLink_sys_status_message(0, 0, 0, 100, 12_000, -1, 99, 0, 0, 0, 0, 0, 0))


@dataclass(frozen=True)
class Air:
    """How links behave, both ways."""

    latency_s: float = 0.01
    jitter_s: float = 0.0
    """Uniform, and frames overtake each other."""
    loss: float = 0.0
    duplicate: float = 0.0
    seed: int = 1


class Loop:
    """Ground stations, aircraft and approval, stepped every 20 ms over links described by `Air`."""

    def __init__(
        self,
        stations: list[GroundStation],
        aircraft: dict[str, FakeAutopilot],
        approval: FlightApproval,
        air: Air | None = None,
    ) -> None:
        self.stations, self.aircraft, self.approval = stations, aircraft, approval
        self.air = air or Air()
        self.chance = Chance(self.air.seed)
        self.now = 0
        self.flying: list[tuple[int, str, str, int, bytes, FrameId]] = []
        self.serials: Counter[tuple[str, str]] = Counter()
        self.notes: list[tuple[int, str, Note]] = []
        self.commands: list[tuple[int, str, Any, tuple[FrameId, ...]]] = []
        self.blocked: set[str] = set()
        """Links that carry nothing, as `name` or `name:fwd`."""

    def carry(self, link: str, direction: str, payload: bytes) -> None:
        serial = self.serials[link, direction]
        self.serials[link, direction] += 1
        if link in self.blocked or f"{link}:{direction}" in self.blocked:
            return
        ref = FrameId(link, direction, "x", serial)
        u, v, w, x = self.chance.uniform4("air", hash64(link + direction), self.now, serial)
        if u < self.air.loss:
            return
        delays = [v] if w >= self.air.duplicate else [v, x]
        for number, delay in enumerate(delays):
            at = self.now + round((self.air.latency_s + self.air.jitter_s * delay) * NS_PER_S)
            heappush(self.flying, (at, link, direction, serial * 2 + number, payload, ref))

    def run(self, until_s: float, *, stop: bool = True) -> Loop:
        """Until all flights are over, or `until_s`."""
        while self.now <= until_s * NS_PER_S:
            if stop and all(station.finished for station in self.stations):
                break
            self.step()
        return self

    def step(self) -> None:
        boxes: dict[str, list[Arrival]] = {}
        while self.flying and self.flying[0][0] <= self.now:
            at, link, direction, _, payload, ref = heappop(self.flying)
            kind, owner = link.split(":", 1)
            if kind == "gcs" and direction == "fwd":
                for reply in self.aircraft[owner].on_frame(self.now, payload):
                    self.carry(link, "rev", reply)
                continue
            name = "approval" if kind == "approval" and direction == "fwd" else f"{owner.split('/')[0]}.gcs"
            boxes.setdefault(name, []).append(Arrival(Port(name, link), at, payload, "?", ref))
        for vehicle, autopilot in self.aircraft.items():
            for payload in autopilot.tick(self.now):
                self.carry(link_name("gcs", vehicle), "rev", payload)
        agents: list[GroundStation | FlightApproval] = [*self.stations, self.approval]
        for agent in agents:
            mail = boxes.get(agent.name, [])
            due = agent.next_wakeup()
            if not mail and (due is None or due > self.now):
                continue
            out = agent.step(self.now, Inbox(mail))
            for departure in out.each(agent.ports):
                assert departure.port in agent.ports
                link = departure.port.link
                forward = agent is not self.approval
                if forward and link.startswith("gcs"):
                    self.commands.append((self.now, link, decode(departure.payload), departure.causes))
                self.carry(link, "fwd" if forward else "rev", departure.payload)
            self.notes += [(self.now, agent.name, note) for note in out.notes]
        self.now += STEP_NS

    # --- looking ---------------------------------------------------------------------------------

    def kinds(self, about: str) -> list[str]:
        """Note kinds about a vehicle, in order."""
        return [note.kind for _, _, note in self.notes if note.about == about]

    def note(self, kind: str, about: str) -> Note:
        """The only note of that kind about that vehicle."""
        (found,) = [note for _, _, note in self.notes if note.kind == kind and note.about == about]
        return found

    def sent(self, vehicle: str, message_id: int) -> list[Any]:
        """Messages of one kind that were sent to a vehicle."""
        link = link_name("gcs", vehicle)
        return [message for _, name, message, _ in self.commands if name == link and message.id == message_id]
