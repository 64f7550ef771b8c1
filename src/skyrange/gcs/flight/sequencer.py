"""Flight sequencer of one aircraft: runs the state machine of `gcs.lifecycle` from plan to landing.

The sequencer reacts to frames from the aircraft, to decisions of the approval, and to timers. It raises events, the
table of transitions gives the next state, and on entry to a state the sequencer sends that state's commands. All that
it sends or decides names the frames that caused it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from skyrange.agent.messages import Arrival, Outbox, Scalar
from skyrange.codec.mavlink import Message, Packer, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NEVER, NS_PER_S, Epoch, Time, from_seconds, to_seconds
from skyrange.gcs import scripts
from skyrange.gcs.belief import Belief, Watch
from skyrange.gcs.commands import Command, Exchange, result_name
from skyrange.gcs.filing import Filing
from skyrange.gcs.flights import Flight, FlightOutcome
from skyrange.gcs.guide import Guide
from skyrange.gcs.lifecycle import ARMED, CARRYING, OVER, Event, State, after
from skyrange.gcs.routes import estimated_duration_s
from skyrange.gcs.streams import Profile, requests
from skyrange.gcs.transfer import Download, Transfer, Upload
from skyrange.gcs.wire_items import wire_items
from skyrange.utm.messages import DecisionBody

STATION_SYSTEM = 255
STATION_COMPONENT = mav.MAV_COMP_ID_MISSIONPLANNER
"""190, the component id of ground stations by convention."""
AUTOPILOT_COMPONENT = mav.MAV_COMP_ID_AUTOPILOT1
HEARTBEAT_NS = NS_PER_S
"""Period of heartbeats; https://mavlink.io/en/services/heartbeat.html: generally 1 Hz."""
LINK_TIMEOUT_NS = 5 * NS_PER_S
"""Silence after which the link counts as lost (heartbeat.html: four or five missed)."""
DISARMED_BEATS = 2
"""Number of consecutive heartbeats that must report it before an armed aircraft counts as disarmed: a single one may
be an old heartbeat that was delayed."""
STALE_NS = 3 * NS_PER_S
"""Age of position or mission item after which the streams are requested again, if heartbeats still arrive.

An acknowledgement of SET_MESSAGE_INTERVAL does not name the message that it concerns, so a duplicate can be mistaken
for the acknowledgement of the next command. Only the telemetry that arrives shows whether the streams are set."""
_FLOWN = frozenset({mav.COPTER_MODE_AUTO, mav.COPTER_MODE_LAND, mav.COPTER_MODE_RTL, mav.COPTER_MODE_SMART_RTL})
"""Modes that show that a disarmed aircraft has flown: no aircraft is prepared in them."""
_STREAM_CHECKED = frozenset({State.WAITING, State.HOLDING, State.FLYING})
"""States in which the streams must arrive and in which no other required command can be in progress."""

_TIMED = {State.WAITING: Event.DUE, State.HOLDING: Event.DEPARTED}
"""States that end at a fixed time, with the event that ends them."""

Refs = tuple[FrameId, ...]


@dataclass(slots=True)
class Pilot:
    """The flight sequencer of one aircraft. `due` is when `on_time` must be called if no frame arrives before."""

    flight: Flight
    port: Port
    approval_port: Port
    epoch: Epoch
    streams: Profile
    belief: Belief
    packer: Packer
    state: State = State.PLANNED
    outcome: FlightOutcome | None = None
    due: Time = 0
    intent: str = ""
    link_lost: bool = False
    filing: Filing | None = None
    """The intent that awaits the decision of the approval."""
    deadline: Time = NEVER
    transfer: Transfer | None = None
    upload: Upload | None = None
    exchange: Exchange | None = None
    todo: list[Command] = field(default_factory=list)
    refused: set[str] = field(default_factory=set)
    """Reasons for rejections of optional commands that are already recorded."""
    guide: Guide | None = None
    state_causes: Refs = ()
    """Frames that led to the current state: the causes of what a timer triggers in it."""
    reason: str = ""
    """Why the plan was given up, while the aircraft returns home."""

    # --- inputs --------------------------------------------------------------------------------

    def on_frame(self, now: Time, arrival: Arrival, out: Outbox) -> bool:
        """Handle one frame from the aircraft's link; returns whether `due` may have changed."""
        self.belief.count("frames")
        try:
            message = decode(arrival.payload)
        except DecodeError as error:
            self._note_count("decision.bad_frame", self.belief.count("bad"), str(error), arrival.ref, out)
            return False
        header = message._header
        if header.srcSystem != self.flight.system_id or header.srcComponent != AUTOPILOT_COMPONENT:
            sender = f"{header.srcSystem}/{header.srcComponent}"
            self._note_count("decision.foreign_frame", self.belief.count("foreign"), f"from {sender}", arrival.ref, out)
            return False
        handler = _HANDLERS.get(message.get_msgId())
        if handler is None:
            return False
        handler(self, now, message, arrival.ref, out)
        self._reschedule()
        return True

    def on_decision(self, now: Time, decision: DecisionBody, ref: FrameId, out: Outbox) -> None:
        """Handle the approval's decision on this aircraft's intent; later decisions change nothing."""
        if self.state is not State.REQUESTING:
            return
        if decision.decision == "Accepted":
            self._raise(Event.APPROVED, now, out, (ref,), {"ovn": decision.ovn})
        else:
            self.reason = f"approval rejected: {decision.reason}" if decision.reason else "approval rejected"
            data: dict[str, Scalar] = {"reason": decision.reason, "alternatives": len(decision.alternatives)}
            self._raise(Event.REJECTED, now, out, (ref,), data)
        self._reschedule()

    def on_time(self, now: Time, out: Outbox) -> None:
        """Do what is due."""
        if self.state is State.PLANNED:
            self._raise(Event.BEGUN if now <= 0 else Event.BEGUN_ANEW, now, out, ())
        if self.filing is not None and now >= self.filing.due:
            self._submit_intent(self.filing, now, out)
        if self.transfer is not None and now >= self.transfer.due:
            self._send(self.transfer.on_time(now), out, self.state_causes)
            self._transfer_ended(now, out, self.state_causes)
        if self.exchange is not None and now >= self.exchange.due:
            self._send_command(now, out, self.state_causes)
        if self.state in _TIMED and now >= self._timed_end_ns():
            self._raise(_TIMED[self.state], now, out, self.state_causes)
        if now >= self.deadline and self.state not in OVER:
            self._give_up(f"{self.state.value} for too long", now, out, self.state_causes)
        self._reschedule()

    # --- message handlers ------------------------------------------------------------------------

    def _on_heartbeat(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        if self.link_lost:
            self.link_lost = False
            out.note("decision.link_restored", self.flight.vehicle, None, (ref,))
        if self.belief.on_heartbeat(now, message.base_mode, message.custom_mode, message.get_seq(), ref):
            name = result_name("COPTER_MODE", "COPTER_MODE_", message.custom_mode)
            out.note("decision.mode_seen", self.flight.vehicle, {"mode": name}, (ref,))
        if self.state is State.LISTENING:
            self._on_first_heartbeat(now, out, ref)
        elif self.state is State.CONNECTING:
            self._raise(Event.HEARD, now, out, (ref,))
        elif self.state is State.ARMING and self.belief.armed:
            self._drop_commands()  # the acknowledgement of the arm command may have been lost
            self._raise(Event.ARMED, now, out, (ref,))
        elif self.state in ARMED and self.belief.disarmed_beats >= DISARMED_BEATS:
            self._disarmed(now, out, ref)

    def _on_position(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        self.belief.set("position_ns", now)
        guide = self.guide
        if guide is not None and self.state is State.STARTING and guide.has_left(message.relative_alt):
            # the acknowledgement was lost; in the air, ArduCopter answers a repeated take-off command with FAILED
            self._drop_commands()
            self._raise(Event.STARTED, now, out, (ref,))
        if guide is None or self.state is not State.FLYING:
            return
        distance_m = guide.distance_m(message.lat, message.lon, message.relative_alt)
        if guide.is_reached(distance_m):
            data: dict[str, Scalar] = {"target": guide.at + 1, "of": len(guide.targets)}
            out.note("decision.target_reached", self.flight.vehicle, data, (ref,))
            if guide.advance(now):
                self._send_target(guide, now, out, (ref,))
            else:
                self._raise(Event.PLAN_DONE, now, out, (ref,))
        elif guide.is_stuck(now, distance_m):
            self._send_target(guide, now, out, (ref,))

    def _on_current(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        if self.belief.on_current(now, message.seq) and self.state is State.FLYING and self.guide is None:
            data: dict[str, Scalar] = {"item": message.seq, "of": len(self.flight.plan.items)}
            out.note("decision.progress", self.flight.vehicle, data, (ref,))
        if message.mission_state == mav.MISSION_STATE_COMPLETE:
            self._mission_done(now, out, ref)

    def _on_reached(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        self.belief.reached(message.seq)
        if message.seq == scripts.last_leg(self.flight.plan):
            self._mission_done(now, out, ref)

    def _on_item_request(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        if self.upload is not None and self.state in CARRYING and _is_ours(message):
            self._send(self.upload.on_request(now, message.seq), out, (ref,))

    def _on_mission_ack(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        if self.transfer is not None and _is_ours(message):
            self.transfer.on_ack(now, message.type)
            self._transfer_ended(now, out, (ref,))

    def _on_count(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        if isinstance(self.transfer, Download) and _is_ours(message):
            self._send(self.transfer.on_count(now, message.count), out, (ref,))
            self._transfer_ended(now, out, (ref,))

    def _on_item(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        if isinstance(self.transfer, Download) and _is_ours(message):
            self._send(self.transfer.on_item(now, message), out, (ref,))
            self._transfer_ended(now, out, (ref,))

    def _on_command_ack(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        exchange = self.exchange
        if exchange is None or message.command != exchange.command.command:
            return
        if message.target_system not in (0, STATION_SYSTEM):
            return
        answer = exchange.on_ack(now, message.result)
        if answer == "accepted":
            self._next_command(now, out, (ref,))
        elif answer != "wait":
            self._command_rejected(answer, now, out, (ref,))

    # --- events and states -------------------------------------------------------------------------

    def _raise(self, event: Event, now: Time, out: Outbox, causes: Refs, data: dict[str, Scalar] | None = None) -> None:
        self.state = after(self.state, event, self.flight.vehicle)
        self.state_causes = causes
        limit_s = scripts.limit_s(self.state, estimated_duration_s(self.flight.plan) if self.state in ARMED else 0.0)
        self.deadline = NEVER if limit_s is None else now + from_seconds(limit_s)
        kind = scripts.NOTES[event]
        if kind:
            out.note(kind, self.flight.vehicle, data, causes)
        self._enter(now, out, causes)

    def _enter(self, now: Time, out: Outbox, causes: Refs) -> None:
        state, plan = self.state, self.flight.plan
        if state not in CARRYING:
            self.transfer = self.upload = None
        if state is not State.REQUESTING:
            self.filing = None
        else:
            self.filing = Filing.of(self.flight, max(now, self._depart_ns()), self.epoch)
            self.intent = self.filing.intent.id
            out.note("decision.approval_requested", self.flight.vehicle, self.filing.summary())
            self._submit_intent(self.filing, now, out)
        if state is State.CONNECTING and now - self.belief.heard_ns < LINK_TIMEOUT_NS:
            self._raise(Event.HEARD, now, out, causes)
        elif state is State.UPLOADING:
            if plan.kind == "guided":
                self.guide = Guide.of(plan)
                self._raise(Event.NOTHING_TO_UPLOAD, now, out, causes)
            else:
                self.upload = Upload(wire_items(plan), self.flight.system_id, AUTOPILOT_COMPONENT)
                self._transfer(self.upload, now, out, causes)
        elif state is State.VERIFYING and self.upload is not None:
            download = Download(self.upload.items, self.flight.system_id, AUTOPILOT_COMPONENT)
            self._transfer(download, now, out, causes)
        elif state in _TIMED and now >= self._timed_end_ns():
            self._raise(_TIMED[state], now, out, causes)
        elif state is State.PREPARING:
            self._mark_telemetry_fresh(now)
        elif state is State.FLYING:
            self.belief.set("farthest_item", 0)
        elif state in OVER:
            self._finish(now, out, causes)
        if state is State.STREAMING:
            self._send(requests(self.streams, self.flight.system_id, AUTOPILOT_COMPONENT), out, causes)
        commands = scripts.commands(state, plan, self.streams.messages)
        if commands and self.state is state:
            self.todo = list(commands)
            self._next_command(now, out, causes)

    def _finish(self, now: Time, out: Outbox, causes: Refs) -> None:
        self._drop_commands()
        if self.state is State.LEFT:
            return
        self.outcome = FlightOutcome(self.state.value, self.reason if self.state is State.FAILED else "", now)
        reason = self.outcome.reason
        if reason:
            out.note("decision.failed", self.flight.vehicle, {"reason": reason}, causes)
        out.note("event.outcome", self.flight.vehicle, {"state": self.state.value, "reason": reason}, causes)

    def _give_up(self, reason: str, now: Time, out: Outbox, causes: Refs) -> None:
        self.reason = f"{self.reason}; {reason}" if self.reason else reason
        self._drop_commands()
        self._raise(Event.GAVE_UP, now, out, causes, {"reason": reason})

    def _disarmed(self, now: Time, out: Outbox, ref: FrameId) -> None:
        progress = self.guide.at if self.guide is not None else self.belief.farthest_item
        too_early = scripts.too_early(self.state, self.flight.plan, progress)
        self.reason = self.reason or too_early
        self._raise(Event.DISARMED if too_early else Event.LANDED, now, out, (ref,))

    def _mission_done(self, now: Time, out: Outbox, ref: FrameId) -> None:
        """Handle the end of the last leg; a mission without a landing leaves that to the ground station."""
        plan = self.flight.plan
        if self.state is State.FLYING and plan.kind == "auto" and not scripts.lands_itself(plan):
            self._raise(Event.PLAN_DONE, now, out, (ref,))

    # --- restart -------------------------------------------------------------------------------------

    def _on_first_heartbeat(self, now: Time, out: Outbox, ref: FrameId) -> None:
        """Handle the first heartbeat after a restart of the station; an aircraft that is flying goes on flying."""
        if not self.belief.armed:
            flown = self.belief.mode in _FLOWN
            self._raise(Event.FOUND_FLOWN if flown else Event.FOUND_WAITING, now, out, (ref,))
        elif self.flight.plan.kind == "guided":
            self.reason = "the station was started anew, and how far the plan had come is not known"
            self._raise(Event.FOUND_GUIDED, now, out, (ref,), {"reason": self.reason})
        else:
            self._raise(Event.FOUND_FLYING, now, out, (ref,))

    # --- requests, transfers, commands ----------------------------------------------------------------------

    def _submit_intent(self, filing: Filing, now: Time, out: Outbox) -> None:
        if filing.try_again(now):
            out.send(self.approval_port, filing.payload)
        else:
            self._give_up(f"approval: no answer after {filing.tries} requests", now, out, ())

    def _transfer(self, transfer: Transfer, now: Time, out: Outbox, causes: Refs) -> None:
        self.transfer = transfer
        self._send(transfer.begin(now), out, causes)

    def _transfer_ended(self, now: Time, out: Outbox, causes: Refs) -> None:
        transfer = self.transfer
        if transfer is None or not transfer.result:
            return
        if transfer.result != "done":
            self._give_up(transfer.result, now, out, causes)
            return
        data: dict[str, Scalar] = {"items": len(transfer.items) - 1, "attempts": transfer.attempts}
        self._raise(Event.UPLOADED if transfer is self.upload else Event.VERIFIED, now, out, causes, data)

    def _next_command(self, now: Time, out: Outbox, causes: Refs) -> None:
        """Start the next command, or raise the state's completion event after the last."""
        if self.todo:
            self.exchange = Exchange(self.todo.pop(0))
            self.exchange.begin(now)
            self.state_causes = causes or self.state_causes
            self._send_command(now, out, causes)
            return
        self.exchange = None
        event = scripts.DONE.get(self.state)
        if event is not None:
            self._raise(event, now, out, causes)

    def _send_command(self, now: Time, out: Outbox, causes: Refs) -> None:
        """Send the current command (again) if it is due."""
        exchange = self.exchange
        assert exchange is not None
        action = exchange.on_time(now)
        if action == "send":
            self._send([exchange.message(self.flight.system_id, AUTOPILOT_COMPONENT)], out, causes)
        elif action != "wait":
            self._command_rejected(action, now, out, causes)

    def _command_rejected(self, reason: str, now: Time, out: Outbox, causes: Refs) -> None:
        exchange = self.exchange
        if exchange is not None and exchange.command.optional:
            if reason not in self.refused:
                self.refused.add(reason)
                out.note("decision.command_refused", self.flight.vehicle, {"reason": reason}, causes)
            self._next_command(now, out, causes)
        else:
            self._give_up(reason, now, out, causes)

    def _drop_commands(self) -> None:
        self.exchange = None
        self.todo = []

    # --- timers ------------------------------------------------------------------------------------------

    def look_at_news(self, now: Time, out: Outbox) -> None:
        """Detect a lost link and stale telemetry; called with the station's heartbeat for stale beliefs."""
        if self.state is State.PLANNED or self.state in OVER:
            return
        belief = self.belief
        silent = now - belief.heard_ns > LINK_TIMEOUT_NS
        if silent and belief.heard_ns >= 0 and not self.link_lost:
            self.link_lost = True
            out.note("decision.link_lost", self.flight.vehicle, {"silent_s": to_seconds(now - belief.heard_ns)})
        if not silent and self.state in _STREAM_CHECKED and self.exchange is None:
            reported_ns = belief.position_ns if self.guide else min(belief.position_ns, belief.item_ns)
            if now - reported_ns > STALE_NS:
                self._mark_telemetry_fresh(now)  # not again until they are stale again
                self._send(requests(self.streams, self.flight.system_id, AUTOPILOT_COMPONENT), out, ())
                self.todo = list(scripts.stream_commands(self.streams.messages))
                self._next_command(now, out, ())
        self._reschedule()

    def _depart_ns(self) -> Time:
        return from_seconds(self.flight.depart_s)

    def _timed_end_ns(self) -> Time:
        """When the current state of `_TIMED` ends."""
        lead_s = scripts.ARM_LEAD_S if self.state is State.WAITING else 0.0
        return self._depart_ns() - from_seconds(lead_s)

    def _reschedule(self) -> None:
        if self.state is State.PLANNED:
            return  # due at once, whatever was received before
        due = self.deadline
        if self.filing is not None:
            due = min(due, self.filing.due)
        if self.transfer is not None:
            due = min(due, self.transfer.due)
        if self.exchange is not None:
            due = min(due, self.exchange.due)
        if self.state in _TIMED:
            due = min(due, self._timed_end_ns())
        self.due = due
        watch = Watch.NONE
        if self.link_lost or self.state in (State.LISTENING, State.CONNECTING, State.ARMING):
            watch |= Watch.HEARTBEAT
        if self.state in ARMED and not self.belief.armed:
            watch |= Watch.HEARTBEAT
        if self.guide is not None and self.state in (State.STARTING, State.FLYING):
            watch |= Watch.POSITION
        if self.state is State.FLYING:
            watch |= Watch.COMPLETE
        self.belief.set("watch", watch)

    def _mark_telemetry_fresh(self, now: Time) -> None:
        self.belief.set("position_ns", now)
        self.belief.set("item_ns", now)

    # --- outputs -----------------------------------------------------------------------------------------

    def _send_target(self, guide: Guide, now: Time, out: Outbox, causes: Refs) -> None:
        self._send([guide.message(now, self.flight.system_id, AUTOPILOT_COMPONENT)], out, causes)

    def _send(self, messages: list[Message], out: Outbox, causes: Refs) -> None:
        for message in messages:
            out.send(self.port, self.packer.pack(message), causes)

    def _note_count(self, kind: str, count: int, reason: str, ref: FrameId, out: Outbox) -> None:
        if count & (count - 1) == 0:  # 1, 2, 4, 8 …: a flood must not fill the record
            out.note(kind, self.flight.vehicle, {"count": count, "reason": reason}, (ref,))


def _is_ours(message: Message) -> bool:
    """Whether a mission message concerns flight plans (not fences) and is addressed to this station."""
    return (
        message.mission_type == mav.MAV_MISSION_TYPE_MISSION
        and message.target_system in (0, STATION_SYSTEM)
        and message.target_component in (0, STATION_COMPONENT)
    )


_HANDLERS = {
    mav.MAVLINK_MSG_ID_HEARTBEAT: Pilot._on_heartbeat,
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: Pilot._on_position,
    mav.MAVLINK_MSG_ID_MISSION_CURRENT: Pilot._on_current,
    mav.MAVLINK_MSG_ID_MISSION_ITEM_REACHED: Pilot._on_reached,
    mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT: Pilot._on_item_request,
    mav.MAVLINK_MSG_ID_MISSION_REQUEST: Pilot._on_item_request,
    mav.MAVLINK_MSG_ID_MISSION_ACK: Pilot._on_mission_ack,
    mav.MAVLINK_MSG_ID_MISSION_COUNT: Pilot._on_count,
    mav.MAVLINK_MSG_ID_MISSION_ITEM_INT: Pilot._on_item,
    mav.MAVLINK_MSG_ID_COMMAND_ACK: Pilot._on_command_ack,
}
READ = frozenset(_HANDLERS)
"""Ids of the messages that a flight sequencer handles; other telemetry is decoded and stored, bad frames counted."""
