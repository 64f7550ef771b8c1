"""Flight sequencer of one aircraft: runs the state machine of `gcs.flight.lifecycle` from plan to landing.

The sequencer reacts to frames from the aircraft, to decisions of the approval, and to timers. It raises events, the
table of transitions gives the next state, and on entry to a state the sequencer sends that state's commands. All that
it sends or decides names the frames that caused it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from skyrange.codec.mavlink import Message, Packer, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import mode_name
from skyrange.contracts.alerts import Scalar
from skyrange.contracts.mailboxes import Arrival, Outbox
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NEVER, NS_PER_S, Time, from_seconds, to_seconds
from skyrange.core.volumes import Volume4D
from skyrange.core.whole_numbers import worth_noting
from skyrange.gcs.flight import procedures
from skyrange.gcs.flight.airspace_claim import AirspaceClaim
from skyrange.gcs.flight.autopilot_texts import AutopilotTexts
from skyrange.gcs.flight.flight import Flight, FlightOutcome
from skyrange.gcs.flight.guided_sequencer import GuidedSequencer
from skyrange.gcs.flight.intent_submission import IntentSubmission
from skyrange.gcs.flight.lifecycle import (
    ARMED,
    ENDED,
    OVERRULABLE,
    TRANSFERRING,
    FlightEvent,
    FlightState,
    next_state,
)
from skyrange.gcs.plan.rerouting import reroute
from skyrange.gcs.plan.routes import estimated_duration_s, is_endless
from skyrange.gcs.protocols.commands import Command, CommandExchange
from skyrange.gcs.protocols.mission_items import ItemList, encode_lists
from skyrange.gcs.protocols.mission_transfer import Download, Transfer, Upload
from skyrange.gcs.telemetry.belief import Belief, Watch
from skyrange.gcs.telemetry.streams import StreamProfile, stream_requests
from skyrange.planning.limits import NoRouteError
from skyrange.utm.intent_states import IntentState
from skyrange.utm.messages import DecisionBody

STATION_SYSTEM = 255
STATION_COMPONENT = mav.MAV_COMP_ID_MISSIONPLANNER
"""190, the component id of ground stations by convention."""
AUTOPILOT_COMPONENT = mav.MAV_COMP_ID_AUTOPILOT1
HEARTBEAT_NS = NS_PER_S
"""Period of heartbeats; https://mavlink.io/en/services/heartbeat.html: generally 1 Hz."""
LINK_TIMEOUT_NS = 5 * NS_PER_S
"""Silence after which the link counts as lost (heartbeat.html: four or five missed)."""
DISARMED_HEARTBEATS = 2
"""Number of consecutive heartbeats that must report it before an armed aircraft counts as disarmed: a single one may
be an old heartbeat that was delayed."""
STALE_NS = 3 * NS_PER_S
"""Age of position or mission item after which the streams are requested again, if heartbeats still arrive.

An acknowledgement of SET_MESSAGE_INTERVAL does not name the message that it concerns, so a duplicate can be mistaken
for the acknowledgement of the next command. Only the telemetry that arrives shows whether the streams are set."""
_BEGUN_NS = NS_PER_S
"""A station that begins a flight later than this after the time of its request was restarted in between."""
_FLOWN = frozenset({mav.COPTER_MODE_AUTO, mav.COPTER_MODE_LAND, mav.COPTER_MODE_RTL, mav.COPTER_MODE_SMART_RTL})
"""Modes that show that a disarmed aircraft has flown: no aircraft is prepared in them."""
_STREAM_CHECKED = frozenset({FlightState.WAITING, FlightState.HOLDING, FlightState.FLYING})
"""States in which the streams must arrive and in which no other required command can be in progress."""

_FLIGHT = frozenset({FlightState.STARTING, FlightState.FLYING})
_WITHDRAWABLE = _FLIGHT | {FlightState.ARMING, FlightState.HOLDING, FlightState.REROUTING}
"""States in which a flight is given up when its approval is withdrawn."""

_EXPLAINED = frozenset({FlightState.PREPARING, FlightState.ARMING, FlightState.STARTING})
"""States in which the texts of the autopilot say why it rejects a command."""

_TIMED = {FlightState.WAITING: FlightEvent.DUE, FlightState.HOLDING: FlightEvent.DEPARTED}
"""States that end at a fixed time, with the event that ends them."""

_REPORTED = {
    IntentState.ACTIVATED: "decision.intent_activated",
    IntentState.NONCONFORMING: "decision.intent_nonconforming",
    IntentState.CONTINGENT: "decision.intent_contingent",
    IntentState.ENDED: "decision.intent_ended",
}
"""The kind of note of each report to the approval."""

Refs = tuple[FrameId, ...]


@dataclass(slots=True)
class FlightSequencer:
    """The flight sequencer of one aircraft. `due` is when `on_time` must be called if no frame arrives before."""

    flight: Flight
    port: Port
    approval_port: Port
    streams: StreamProfile
    belief: Belief
    packer: Packer
    claim: AirspaceClaim
    state: FlightState = FlightState.PLANNED
    outcome: FlightOutcome | None = None
    due: Time = field(init=False)
    intent: str = ""
    link_lost: bool = False
    submission: IntentSubmission | None = None
    """The intent that awaits the decision of the approval, before the aircraft is armed."""
    report: IntentSubmission | None = None
    """The report on the intent of a flight that has begun, or ended, until the approval confirms it."""
    deadline: Time = NEVER
    transfer: Transfer | None = None
    upload: Upload | None = None
    lists: list[ItemList] = field(default_factory=list)
    """What is still to be uploaded."""
    exchange: CommandExchange | None = None
    todo: list[Command] = field(default_factory=list)
    refused: set[str] = field(default_factory=set)
    """Reasons for rejections of optional commands that are already recorded."""
    guided: GuidedSequencer | None = None
    rerouted: Flight | None = None
    """The rest of the flight on another way, while the approval is asked for it."""
    state_causes: Refs = ()
    """Frames that led to the current state: the causes of what a timer triggers in it."""
    reason: str = ""
    """Why the plan was given up, while the aircraft returns home."""
    texts: AutopilotTexts = field(default_factory=AutopilotTexts)
    """What the autopilot said since the ground station began to prepare it."""

    def __post_init__(self) -> None:
        self.due = from_seconds(self.flight.request_s)

    @property
    def progress(self) -> int:
        """The mission item, or the index of the target, that is being flown to."""
        return self.guided.at if self.guided is not None else self.belief.farthest_item

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
        """Handle the approval's decision on this aircraft's intent; one that answers no open request changes
        nothing.
        """
        if decision.overruled:
            self._overruled(now, decision, ref, out)
        elif self.state is FlightState.REROUTING and self.submission is not None:
            self._on_reroute(now, self.submission, decision, ref, out)
        elif self.report is not None and self.report.is_answered_by(decision):
            if decision.decision == "Accepted":
                self.claim.accept(self.report, True)
            self.report = None
        elif self.submission is not None and self.submission.is_answered_by(decision):
            if decision.decision == "Accepted":
                self.claim.accept(self.submission, decision.tracked is True)
                activated = self.state is FlightState.ACTIVATING
                event = FlightEvent.ACTIVATED if activated else FlightEvent.APPROVED
                self._raise(event, now, out, (ref,), {"ovn": decision.ovn})
            else:
                self._rejected(now, decision, ref, out)
        self._reschedule()

    def _rejected(self, now: Time, decision: DecisionBody, ref: FrameId, out: Outbox) -> None:
        chosen = self.claim.choose(self.flight, decision.alternatives)
        if chosen is None:
            self.reason = f"approval rejected: {decision.reason}" if decision.reason else "approval rejected"
            data: dict[str, Scalar] = {"reason": decision.reason, "alternatives": len(decision.alternatives)}
            self._raise(FlightEvent.REJECTED, now, out, (ref,), data)
            return
        self.flight, taken = chosen
        data = {
            "reason": decision.reason,
            "delay_s": taken.delay_s,
            "climb_m": taken.climb_m,
            "east_m": taken.east_m,
            "north_m": taken.north_m,
        }
        self._raise(FlightEvent.ALTERED, now, out, (ref,), data)

    def _overruled(self, now: Time, decision: DecisionBody, ref: FrameId, out: Outbox) -> None:
        """Before activation, ask anew; in the air, fly around what has closed the way, or return."""
        data: dict[str, Scalar] = {"reason": decision.reason}
        if self.state in OVERRULABLE:
            self.claim.state = None
            self._drop_commands()
            self._raise(FlightEvent.OVERRULED, now, out, (ref,), data)
        elif self.state is FlightState.FLYING and decision.closed:
            closed = [one.volume4d(self.claim.epoch) for one in decision.closed]
            error = self.ask_for_way(now, closed, decision.reason, (ref,), out)
            if error:
                self.give_up(f"approval withdrawn: {decision.reason}; no way around: {error}", now, out, (ref,))
        elif self.state in _WITHDRAWABLE:
            self.give_up(f"approval withdrawn: {decision.reason}", now, out, (ref,))

    def ask_for_way(
        self, now: Time, closed: Sequence[Volume4D], reason: str, causes: Refs, out: Outbox, *, direct: bool = False
    ) -> str:
        """Stop, and ask the approval for the rest of the plan around closed volumes, or with `direct` without the
        points between. Returns why that cannot be, or "".
        """
        plan, claim = self.flight.plan, self.claim
        try:
            rest = reroute(
                plan, self.progress, claim.position(plan), closed, now, claim.city, claim.margins, direct=direct
            )
        except NoRouteError as error:
            return str(error)
        self._drop_commands()
        self.rerouted = replace(self.flight, plan=rest)
        self._raise(FlightEvent.CLOSED, now, out, causes, {"reason": reason})
        self._reschedule()
        return ""

    def _on_reroute(
        self, now: Time, submission: IntentSubmission, decision: DecisionBody, ref: FrameId, out: Outbox
    ) -> None:
        """Fly on where the approval has accepted the other way, and return where it has not."""
        if not submission.is_answered_by(decision):
            return
        if decision.decision != "Accepted" or self.rerouted is None:
            self.give_up(f"approval rejected: {decision.reason}", now, out, (ref,))
            return
        self.claim.accept(submission, True)
        self.flight, self.rerouted = self.rerouted, None
        self.guided = GuidedSequencer.for_plan(self.flight.plan)
        self.guided.advance(now)
        data: dict[str, Scalar] = {"targets": len(self.guided.targets), "hold_s": self.flight.plan.hold_s}
        self._raise(FlightEvent.REROUTED, now, out, (ref,), data)
        self._send_target(self.guided, now, out, (ref,))

    def on_time(self, now: Time, out: Outbox) -> None:
        """Do what is due."""
        if self.state is FlightState.PLANNED:
            request_ns = from_seconds(self.flight.request_s)
            begins = now <= request_ns + (_BEGUN_NS if request_ns else 0)
            self._raise(FlightEvent.BEGUN if begins else FlightEvent.BEGUN_ANEW, now, out, ())
        if self.submission is not None and now >= self.submission.due:
            self._submit_intent(self.submission, now, out)
        if self.report is not None and now >= self.report.due:
            self._send_report(self.report, now, out)
        if self.transfer is not None and now >= self.transfer.due:
            self._send(self.transfer.on_time(now), out, self.state_causes)
            self._transfer_ended(now, out, self.state_causes)
        if self.exchange is not None and now >= self.exchange.due:
            self._send_command(now, out, self.state_causes)
        if self.state in _TIMED and now >= self._timed_end_ns():
            self._raise(self._timed_event(), now, out, self.state_causes)
        if now >= self.deadline and self.state not in ENDED:
            self.give_up(f"{self.state.value} for too long", now, out, self.state_causes)
        self._reschedule()

    # --- message handlers ------------------------------------------------------------------------

    def _on_heartbeat(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        if self.link_lost:
            self.link_lost = False
            out.note("decision.link_restored", self.flight.vehicle, None, (ref,))
        if self.belief.on_heartbeat(now, message.base_mode, message.custom_mode, message.get_seq()):
            name = mode_name(message.type, message.autopilot, message.custom_mode)
            out.note("decision.mode_seen", self.flight.vehicle, {"mode": name}, (ref,))
        if self.state is FlightState.LISTENING:
            self._on_first_heartbeat(now, out, ref)
        elif self.state is FlightState.CONNECTING:
            self._raise(FlightEvent.HEARD, now, out, (ref,))
        elif self.state is FlightState.ARMING and self.belief.armed:
            self._drop_commands()  # the acknowledgement of the arm command may have been lost
            self._raise(FlightEvent.ARMED, now, out, (ref,))
        elif self.state in ARMED and self.belief.consecutive_disarmed >= DISARMED_HEARTBEATS:
            self._disarmed(now, out, ref)

    def _on_position(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        self.belief.set("position_ns", now)
        if self.claim.tracked and self.state in ARMED:
            self._watch_conformance(now, message, ref, out)
        guided = self.guided
        if guided is not None and self.state is FlightState.STARTING and guided.has_left(message.relative_alt):
            # the acknowledgement was lost; in the air, ArduCopter answers a repeated take-off command with FAILED
            self._drop_commands()
            self._raise(FlightEvent.STARTED, now, out, (ref,))
        if guided is None or self.state is not FlightState.FLYING:
            return
        distance_m = guided.distance_m(message.lat, message.lon, message.relative_alt)
        if guided.is_reached(now, distance_m):
            data: dict[str, Scalar] = {"target": guided.at + 1, "of": len(guided.targets)}
            out.note("decision.target_reached", self.flight.vehicle, data, (ref,))
            if guided.advance(now):
                self._send_target(guided, now, out, (ref,))
            else:
                self._raise(FlightEvent.PLAN_DONE, now, out, (ref,))
        elif guided.is_stuck(now, distance_m):
            self._send_target(guided, now, out, (ref,))

    def _on_current(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        if self.belief.on_current(now, message.seq) and self.state is FlightState.FLYING and self.guided is None:
            data: dict[str, Scalar] = {"item": message.seq, "of": len(self.flight.plan.items)}
            out.note("decision.progress", self.flight.vehicle, data, (ref,))
        if message.mission_state == mav.MISSION_STATE_COMPLETE:
            self._mission_done(now, out, ref)

    def _on_reached(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        self.belief.reached(message.seq)
        plan = self.flight.plan
        if message.seq == procedures.last_navigation_item(plan) and procedures.is_done_at_last_item(plan):
            self._mission_done(now, out, ref)

    def _on_item_request(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        if self.upload is not None and self.state in TRANSFERRING and _is_of(message, self.upload):
            self._send(self.upload.on_request(now, message.seq), out, (ref,))

    def _on_mission_ack(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        if self.transfer is not None and _is_of(message, self.transfer):
            self.transfer.on_ack(now, message.type)
            self._transfer_ended(now, out, (ref,))

    def _on_count(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        if isinstance(self.transfer, Download) and _is_of(message, self.transfer):
            self._send(self.transfer.on_count(now, message.count), out, (ref,))
            self._transfer_ended(now, out, (ref,))

    def _on_item(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        if isinstance(self.transfer, Download) and _is_of(message, self.transfer):
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

    def _on_text(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        if self.state in _EXPLAINED:
            self.texts.read(message)

    # --- events and states -------------------------------------------------------------------------

    def _raise(
        self, event: FlightEvent, now: Time, out: Outbox, causes: Refs, data: dict[str, Scalar] | None = None
    ) -> None:
        self.state = next_state(self.state, event, self.flight.vehicle)
        self.state_causes = causes
        plan = self.flight.plan
        time_limit_s = procedures.time_limit_s(self.state, estimated_duration_s(plan) if self.state in ARMED else 0.0)
        if self.state is FlightState.FLYING and is_endless(plan):
            time_limit_s = None
        self.deadline = NEVER if time_limit_s is None else now + from_seconds(time_limit_s)
        kind = procedures.EVENT_NOTES[event]
        if kind:
            out.note(kind, self.flight.vehicle, data, causes)
        self._enter(now, out, causes)

    def _enter(self, now: Time, out: Outbox, causes: Refs) -> None:
        state, plan = self.state, self.flight.plan
        if state not in TRANSFERRING:
            self.transfer = self.upload = None
        self.submission = None
        if state in (FlightState.REQUESTING, FlightState.ACTIVATING):
            activating = state is FlightState.ACTIVATING
            request = self.claim.activate if activating else self.claim.request
            self.submission = request(self.flight, now)
            self.intent = self.submission.intent.id
            kind = "decision.activation_requested" if activating else "decision.approval_requested"
            out.note(kind, self.flight.vehicle, self.submission.summary())
            if now >= self.submission.due:
                self._submit_intent(self.submission, now, out)
        if state is FlightState.REROUTING and self.rerouted is not None:
            self.submission = self.claim.reroute(self.rerouted, now)
            out.note("decision.reroute_requested", self.flight.vehicle, self.submission.summary(), causes)
            self._submit_intent(self.submission, now, out)
        if state is FlightState.CONNECTING:
            self.lists = encode_lists(plan)
        if state is FlightState.CONNECTING and now - self.belief.heard_ns < LINK_TIMEOUT_NS:
            self._raise(FlightEvent.HEARD, now, out, causes)
        elif state is FlightState.UPLOADING:
            if plan.kind == "guided":
                self.guided = GuidedSequencer.for_plan(plan)
            if self.lists:
                following = self.lists.pop(0)
                self.upload = Upload(following.items, self.flight.system_id, AUTOPILOT_COMPONENT, following.kind)
                self._transfer(self.upload, now, out, causes)
            else:
                self._raise(FlightEvent.NOTHING_TO_UPLOAD, now, out, causes)
        elif state is FlightState.VERIFYING and self.upload is not None:
            upload = self.upload
            download = Download(upload.items, self.flight.system_id, AUTOPILOT_COMPONENT, upload.kind)
            self._transfer(download, now, out, causes)
        elif state in _TIMED and now >= self._timed_end_ns():
            self._raise(self._timed_event(), now, out, causes)
        elif state is FlightState.PREPARING:
            self._mark_telemetry_fresh(now)
            self.texts.clear()
        elif state is FlightState.FLYING:
            self.belief.set("farthest_item", 0)
        elif state is FlightState.ABORTING and self.claim.tracked:
            self._report(IntentState.CONTINGENT, now, out, causes)
        elif state in ENDED:
            self._finish(now, out, causes)
        if state is FlightState.STREAMING:
            self._send(stream_requests(self.streams, self.flight.system_id, AUTOPILOT_COMPONENT), out, causes)
        commands = procedures.entry_commands(state, plan, self.streams.messages)
        if commands and self.state is state:
            self.todo = list(commands)
            self._next_command(now, out, causes)

    def _finish(self, now: Time, out: Outbox, causes: Refs) -> None:
        self._drop_commands()
        if self.claim.tracked and self.claim.state is not None:
            self._report(IntentState.ENDED, now, out, causes)
        if self.state is FlightState.LEFT:
            return
        self.outcome = FlightOutcome(self.state.value, self.reason if self.state is FlightState.FAILED else "", now)
        reason = self.outcome.reason
        if reason:
            out.note("decision.failed", self.flight.vehicle, {"reason": reason}, causes)
        out.note("event.outcome", self.flight.vehicle, {"state": self.state.value, "reason": reason}, causes)

    def give_up(self, reason: str, now: Time, out: Outbox, causes: Refs) -> None:
        """Give up the plan: the aircraft returns, or stays on the ground."""
        if self.state in _EXPLAINED and self.texts.texts:
            reason = f"{reason}; {self.texts.quote()}"
        self.reason = f"{self.reason}; {reason}" if self.reason else reason
        self._drop_commands()
        self._raise(FlightEvent.GAVE_UP, now, out, causes, {"reason": reason})

    def _disarmed(self, now: Time, out: Outbox, ref: FrameId) -> None:
        premature_disarm_reason = procedures.premature_disarm_reason(self.state, self.flight.plan, self.progress)
        self.reason = self.reason or premature_disarm_reason
        self._raise(FlightEvent.DISARMED if premature_disarm_reason else FlightEvent.LANDED, now, out, (ref,))

    def _mission_done(self, now: Time, out: Outbox, ref: FrameId) -> None:
        """Handle the end of the last leg; a mission without a landing leaves that to the ground station."""
        plan = self.flight.plan
        if self.state is FlightState.FLYING and plan.kind == "auto" and not procedures.lands_itself(plan):
            self._raise(FlightEvent.PLAN_DONE, now, out, (ref,))

    # --- restart -------------------------------------------------------------------------------------

    def _on_first_heartbeat(self, now: Time, out: Outbox, ref: FrameId) -> None:
        """Handle the first heartbeat after a restart of the station; an aircraft that is flying goes on flying."""
        if not self.belief.armed:
            flown = self.belief.mode in _FLOWN
            self._raise(FlightEvent.FOUND_FLOWN if flown else FlightEvent.FOUND_WAITING, now, out, (ref,))
        elif self.flight.plan.kind == "guided":
            self.reason = "the station was started anew, and how far the plan had come is not known"
            self._raise(FlightEvent.FOUND_GUIDED, now, out, (ref,), {"reason": self.reason})
        else:
            self._raise(FlightEvent.FOUND_FLYING, now, out, (ref,))

    # --- requests, transfers, commands ----------------------------------------------------------------------

    def _submit_intent(self, submission: IntentSubmission, now: Time, out: Outbox) -> None:
        if submission.count_attempt(now):
            out.send(self.approval_port, submission.payload)
        else:
            self.give_up(f"approval: no answer after {submission.tries} requests", now, out, ())

    def _watch_conformance(self, now: Time, message: Message, ref: FrameId, out: Outbox) -> None:
        """Report that the aircraft has left its volumes, is back, or will not come back."""
        up_m = self.flight.plan.origin.ellipsoid_of(message.alt * 1e-3)
        state = self.claim.observe(now, message.lat * 1e-7, message.lon * 1e-7, up_m)
        if state is not None and self.report is None:
            self._report(state, now, out, (ref,))

    def _report(self, state: IntentState, now: Time, out: Outbox, causes: Refs) -> None:
        self.report = self.claim.report(self.flight, now, state)
        out.note(_REPORTED[state], self.flight.vehicle, None, causes)
        self._send_report(self.report, now, out)

    def _send_report(self, report: IntentSubmission, now: Time, out: Outbox) -> None:
        """Send a report (again). One that is not answered is given up; the flight goes on unless it is outside its
        volumes, which nobody else knows then: the aircraft flies its contingency.
        """
        if report.count_attempt(now):
            out.send(self.approval_port, report.payload)
            return
        self.report = None
        out.note("decision.approval_silent", self.flight.vehicle, {"tries": report.tries})
        if report.intent.state is IntentState.NONCONFORMING and self.state in _FLIGHT:
            self.give_up("outside its volumes, and approval: no answer", now, out, ())

    def _transfer(self, transfer: Transfer, now: Time, out: Outbox, causes: Refs) -> None:
        self.transfer = transfer
        self._send(transfer.begin(now), out, causes)

    def _transfer_ended(self, now: Time, out: Outbox, causes: Refs) -> None:
        transfer = self.transfer
        if transfer is None or not transfer.result:
            return
        if transfer.result != "done":
            self.give_up(transfer.result, now, out, causes)
            return
        data: dict[str, Scalar] = {"items": len(transfer.items) - transfer.homes, "attempts": transfer.attempts}
        if transfer.kind != mav.MAV_MISSION_TYPE_MISSION:
            data["list"] = transfer.name
        verified = FlightEvent.LIST_VERIFIED if self.lists else FlightEvent.VERIFIED
        self._raise(FlightEvent.UPLOADED if transfer is self.upload else verified, now, out, causes, data)

    def _next_command(self, now: Time, out: Outbox, causes: Refs) -> None:
        """Start the next command, or raise the state's completion event after the last."""
        if self.todo:
            self.exchange = CommandExchange(self.todo.pop(0))
            self.exchange.begin(now)
            self.state_causes = causes or self.state_causes
            self._send_command(now, out, causes)
            return
        self.exchange = None
        event = procedures.COMPLETION_EVENTS.get(self.state)
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
            self.give_up(reason, now, out, causes)

    def _drop_commands(self) -> None:
        self.exchange = None
        self.todo = []

    # --- timers ------------------------------------------------------------------------------------------

    def check_telemetry_age(self, now: Time, out: Outbox) -> None:
        """Detect a lost link and stale telemetry; called with the station's heartbeat for stale beliefs."""
        if self.state is FlightState.PLANNED or self.state in ENDED:
            return
        belief = self.belief
        silent = now - belief.heard_ns > LINK_TIMEOUT_NS
        if silent and belief.heard_ns >= 0 and not self.link_lost:
            self.link_lost = True
            out.note("decision.link_lost", self.flight.vehicle, {"silent_s": to_seconds(now - belief.heard_ns)})
        if not silent and self.state in _STREAM_CHECKED and self.exchange is None:
            reported_ns = belief.position_ns if self.guided else min(belief.position_ns, belief.item_ns)
            if now - reported_ns > STALE_NS:
                self._mark_telemetry_fresh(now)  # not again until they are stale again
                self._send(stream_requests(self.streams, self.flight.system_id, AUTOPILOT_COMPONENT), out, ())
                self.todo = list(procedures.stream_commands(self.streams.messages))
                self._next_command(now, out, ())
        self._reschedule()

    def _depart_ns(self) -> Time:
        return from_seconds(self.flight.depart_s)

    def _timed_event(self) -> FlightEvent:
        """The event that ends the current state of `_TIMED`."""
        if self.state is FlightState.WAITING and self.claim.tracked:
            return FlightEvent.ACTIVATION_DUE
        return _TIMED[self.state]

    def _timed_end_ns(self) -> Time:
        """When the current state of `_TIMED` ends."""
        lead_s = procedures.ARM_LEAD_S if self.state is FlightState.WAITING else 0.0
        return self._depart_ns() - from_seconds(lead_s)

    def _reschedule(self) -> None:
        if self.state is FlightState.PLANNED:
            return  # due at once, whatever was received before
        due = self.deadline
        if self.submission is not None:
            due = min(due, self.submission.due)
        if self.report is not None:
            due = min(due, self.report.due)
        if self.transfer is not None:
            due = min(due, self.transfer.due)
        if self.exchange is not None:
            due = min(due, self.exchange.due)
        if self.state in _TIMED:
            due = min(due, self._timed_end_ns())
        self.due = due
        watch = Watch.NONE
        if self.link_lost or self.state in (FlightState.LISTENING, FlightState.CONNECTING, FlightState.ARMING):
            watch |= Watch.HEARTBEAT
        if self.state in ARMED and not self.belief.armed:
            watch |= Watch.HEARTBEAT
        if self.guided is not None and self.state in _FLIGHT:
            watch |= Watch.POSITION
        if self.claim.tracked and self.state in ARMED:
            watch |= Watch.POSITION
        if self.state is FlightState.FLYING:
            watch |= Watch.COMPLETE
        self.belief.set("watch", watch)

    def _mark_telemetry_fresh(self, now: Time) -> None:
        self.belief.set("position_ns", now)
        self.belief.set("item_ns", now)

    # --- outputs -----------------------------------------------------------------------------------------

    def _send_target(self, guided: GuidedSequencer, now: Time, out: Outbox, causes: Refs) -> None:
        self._send([guided.message(now, self.flight.system_id, AUTOPILOT_COMPONENT)], out, causes)

    def _send(self, messages: list[Message], out: Outbox, causes: Refs) -> None:
        for message in messages:
            out.send(self.port, self.packer.pack(message), causes)

    def _note_count(self, kind: str, count: int, reason: str, ref: FrameId, out: Outbox) -> None:
        if worth_noting(count):
            out.note(kind, self.flight.vehicle, {"count": count, "reason": reason}, (ref,))


def _is_of(message: Message, transfer: Transfer) -> bool:
    """Whether a mission message concerns what is transferred, and is addressed to this station."""
    return (
        message.mission_type == transfer.kind
        and message.target_system in (0, STATION_SYSTEM)
        and message.target_component in (0, STATION_COMPONENT)
    )


_HANDLERS = {
    mav.MAVLINK_MSG_ID_HEARTBEAT: FlightSequencer._on_heartbeat,
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: FlightSequencer._on_position,
    mav.MAVLINK_MSG_ID_MISSION_CURRENT: FlightSequencer._on_current,
    mav.MAVLINK_MSG_ID_MISSION_ITEM_REACHED: FlightSequencer._on_reached,
    mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT: FlightSequencer._on_item_request,
    mav.MAVLINK_MSG_ID_MISSION_REQUEST: FlightSequencer._on_item_request,
    mav.MAVLINK_MSG_ID_MISSION_ACK: FlightSequencer._on_mission_ack,
    mav.MAVLINK_MSG_ID_MISSION_COUNT: FlightSequencer._on_count,
    mav.MAVLINK_MSG_ID_MISSION_ITEM_INT: FlightSequencer._on_item,
    mav.MAVLINK_MSG_ID_COMMAND_ACK: FlightSequencer._on_command_ack,
    mav.MAVLINK_MSG_ID_STATUSTEXT: FlightSequencer._on_text,
}
READ = frozenset(_HANDLERS)
"""Ids of the messages that a flight sequencer handles; other telemetry is decoded and stored, bad frames counted."""
