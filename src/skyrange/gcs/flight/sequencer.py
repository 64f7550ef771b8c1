"""Flight sequencer of one aircraft: runs the state machine of `gcs.flight.lifecycle` from plan to landing.

The sequencer reacts to frames from the aircraft, to decisions of the approval, and to timers. It raises events, the
table of transitions gives the next state, and on entry to a state the sequencer sends that state's commands. All that
it sends or decides names the frames that caused it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from skyrange.codec.mavlink import Message, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import mode_name
from skyrange.contracts.alerts import Scalar
from skyrange.contracts.mailboxes import Arrival, Turn
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NEVER, NS_PER_S, Time, from_seconds, to_seconds
from skyrange.core.volumes import Volume4D
from skyrange.core.whole_numbers import worth_noting
from skyrange.gcs.flight import procedures
from skyrange.gcs.flight.airspace_claim import REPORT_PAUSE_NS, AirspaceClaim, IntentSubmission
from skyrange.gcs.flight.autopilot_dialogue import AUTOPILOT_COMPONENT, AutopilotDialogue, Progress
from skyrange.gcs.flight.guided_sequencer import GuidedSequencer
from skyrange.gcs.flight.lifecycle import (
    ARMED,
    ENDED,
    OVERRULABLE,
    TRANSFERRING,
    Flight,
    FlightEvent,
    FlightOutcome,
    FlightState,
    next_state,
)
from skyrange.gcs.plan.rerouting import reroute
from skyrange.gcs.plan.routes import estimated_duration_s, is_endless
from skyrange.gcs.protocols.commands import AutopilotTexts
from skyrange.gcs.protocols.mission_transfer import encode_lists
from skyrange.gcs.telemetry import Belief, Watch
from skyrange.gcs.telemetry_streams import StreamProfile, stream_requests
from skyrange.planning.limits import NoRouteError
from skyrange.utm.intent_states import IntentState
from skyrange.utm.messages import DecisionBody

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
    dialogue: AutopilotDialogue
    approval_port: Port
    streams: StreamProfile
    belief: Belief
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

    def on_frame(self, turn: Turn, arrival: Arrival) -> bool:
        """Handle one frame from the aircraft's link; returns whether `due` may have changed."""
        self.belief.count("frames")
        try:
            message = decode(arrival.payload)
        except DecodeError as error:
            self._note_count(turn, "decision.bad_frame", self.belief.count("bad"), str(error))
            return False
        header = message._header
        if self.flight.telemetry_radio and message.get_msgId() == mav.MAVLINK_MSG_ID_RADIO_STATUS:
            return False
        if header.srcSystem != self.flight.system_id or header.srcComponent != AUTOPILOT_COMPONENT:
            sender = f"{header.srcSystem}/{header.srcComponent}"
            self._note_count(turn, "decision.foreign_frame", self.belief.count("foreign"), f"from {sender}")
            return False
        handler = _HANDLERS.get(message.get_msgId())
        if handler is None:
            return False
        handler(self, turn, message)
        self._reschedule()
        return True

    def on_decision(self, turn: Turn, decision: DecisionBody) -> None:
        """Handle the approval's decision on this aircraft's intent; one that answers no open request changes
        nothing.
        """
        if decision.overruled:
            self._overruled(turn, decision)
        elif self.state is FlightState.REROUTING and self.submission is not None:
            self._on_reroute(turn, self.submission, decision)
        elif self.report is not None and self.report.is_answered_by(decision):
            report, self.report = self.report, None
            if decision.decision == "Accepted":
                self.claim.accept(report, tracked=True)
            elif decision.decision == "Rejected":
                self._on_unreported(turn, report, f"approval rejected: {decision.reason}")
        elif self.submission is not None and self.submission.is_answered_by(decision):
            if decision.decision == "Accepted":
                self.claim.accept(self.submission, tracked=decision.tracked is True)
                activated = self.state is FlightState.ACTIVATING
                event = FlightEvent.ACTIVATED if activated else FlightEvent.APPROVED
                self._raise(turn, event, {"ovn": decision.ovn})
            else:
                self._rejected(turn, decision)
        self._reschedule()

    def on_approval_error(self, error: str) -> None:
        """The approval has answered the open request with an error; the request is repeated like one that is lost."""
        for submission in (self.submission, self.report):
            if submission is not None:
                submission.error = error

    def _rejected(self, turn: Turn, decision: DecisionBody) -> None:
        chosen = self.claim.choose(self.flight, decision.alternatives)
        if chosen is None:
            self.reason = f"approval rejected: {decision.reason}" if decision.reason else "approval rejected"
            data: dict[str, Scalar] = {"reason": decision.reason, "alternatives": len(decision.alternatives)}
            self._raise(turn, FlightEvent.REJECTED, data)
            return
        self.flight, alternative = chosen
        data = {
            "reason": decision.reason,
            "delay_s": alternative.delay_s,
            "climb_m": alternative.climb_m,
            "east_m": alternative.east_m,
            "north_m": alternative.north_m,
        }
        self._raise(turn, FlightEvent.ALTERED, data)

    def _overruled(self, turn: Turn, decision: DecisionBody) -> None:
        """Before activation, ask anew; in the air, fly around what has closed the way, or return."""
        data: dict[str, Scalar] = {"reason": decision.reason}
        if self.state in OVERRULABLE:
            self.claim.state = None
            self.dialogue.drop_commands()
            self._raise(turn, FlightEvent.OVERRULED, data)
        elif self.state is FlightState.FLYING and decision.closed:
            closed_volumes = [volume.volume4d(self.claim.epoch) for volume in decision.closed]
            error = self.request_reroute(turn, closed_volumes, decision.reason)
            if error:
                self.give_up(turn, f"approval withdrawn: {decision.reason}; no way around: {error}")
        elif self.state in _WITHDRAWABLE:
            self.give_up(turn, f"approval withdrawn: {decision.reason}")

    def request_reroute(
        self, turn: Turn, closed_volumes: Sequence[Volume4D], reason: str, *, direct: bool = False
    ) -> str:
        """Stop, and ask the approval for the rest of the plan around closed volumes, or with `direct` without the
        points between. Returns why that cannot be, or "".
        """
        plan, claim = self.flight.plan, self.claim
        try:
            remaining_plan = reroute(
                plan,
                self.progress,
                claim.position(plan),
                closed_volumes,
                now=turn.now,
                city=claim.city,
                margins=claim.margins,
                direct=direct,
            )
        except NoRouteError as error:
            return str(error)
        self.dialogue.drop_commands()
        self.rerouted = replace(self.flight, plan=remaining_plan)
        self._raise(turn, FlightEvent.CLOSED, {"reason": reason})
        self._reschedule()
        return ""

    def _on_reroute(self, turn: Turn, submission: IntentSubmission, decision: DecisionBody) -> None:
        """Fly on where the approval has accepted the other way, and return where it has not."""
        if not submission.is_answered_by(decision):
            return
        if decision.decision != "Accepted" or self.rerouted is None:
            self.give_up(turn, f"approval rejected: {decision.reason}")
            return
        self.claim.accept(submission, tracked=True)
        self.flight, self.rerouted = self.rerouted, None
        self.guided = GuidedSequencer.for_plan(self.flight.plan)
        self.guided.advance(turn.now)
        data: dict[str, Scalar] = {"targets": len(self.guided.targets), "hold_s": self.flight.plan.hold_s}
        self._raise(turn, FlightEvent.REROUTED, data)
        self._send_target(turn, self.guided)

    def on_time(self, turn: Turn) -> None:
        """Do what is due."""
        if self.state is FlightState.PLANNED:
            request_ns = from_seconds(self.flight.request_s)
            begins = turn.now <= request_ns + (_BEGUN_NS if request_ns else 0)
            self._raise(turn, FlightEvent.BEGUN if begins else FlightEvent.BEGUN_ANEW)
        if self.submission is not None and turn.now >= self.submission.due:
            self._submit_intent(turn, self.submission)
        if self.report is not None and turn.now >= self.report.due:
            self._send_report(turn, self.report)
        caused = turn.caused_by(*self.state_causes)
        if self.dialogue.repeat_transfer(caused):
            self._follow_transfer(caused)
        caused = turn.caused_by(*self.state_causes)
        self._follow_commands(caused, self.dialogue.repeat_command(caused))
        if self.state in _TIMED and turn.now >= self._timed_end_ns():
            self._raise(turn.caused_by(*self.state_causes), self._timed_event())
        if turn.now >= self.deadline and self.state not in ENDED:
            self.give_up(turn.caused_by(*self.state_causes), f"{self.state.value} for too long")
        self._reschedule()

    # --- message handlers ------------------------------------------------------------------------

    def _on_heartbeat(self, turn: Turn, message: Message) -> None:
        if self.link_lost:
            self.link_lost = False
            turn.note("decision.link_restored", self.flight.vehicle, None)
        if self.belief.on_heartbeat(turn.now, message.base_mode, message.custom_mode, message.get_seq()):
            name = mode_name(message.type, message.autopilot, message.custom_mode)
            turn.note("decision.mode_seen", self.flight.vehicle, {"mode": name})
        if self.state is FlightState.LISTENING:
            self._on_first_heartbeat(turn)
        elif self.state is FlightState.CONNECTING:
            self._raise(turn, FlightEvent.HEARD)
        elif self.state is FlightState.ARMING and self.belief.armed:
            self.dialogue.drop_commands()  # the acknowledgement of the arm command may have been lost
            self._raise(turn, FlightEvent.ARMED)
        elif self.state in ARMED and self.belief.consecutive_disarmed >= DISARMED_HEARTBEATS:
            self._disarmed(turn)

    def _on_position(self, turn: Turn, message: Message) -> None:
        self.belief.set("position_ns", turn.now)
        if self.claim.tracked and self.state in ARMED:
            self._watch_conformance(turn, message)
        guided = self.guided
        if guided is not None and self.state is FlightState.STARTING and guided.has_left(message.relative_alt):
            # the acknowledgement was lost; in the air, ArduCopter answers a repeated take-off command with FAILED
            self.dialogue.drop_commands()
            self._raise(turn, FlightEvent.STARTED)
        if guided is None or self.state is not FlightState.FLYING:
            return
        distance_m = guided.distance_m(message.lat, message.lon, message.relative_alt)
        if guided.is_reached(turn.now, distance_m):
            data: dict[str, Scalar] = {"target": guided.at + 1, "of": len(guided.targets)}
            turn.note("decision.target_reached", self.flight.vehicle, data)
            if guided.advance(turn.now):
                self._send_target(turn, guided)
            else:
                self._raise(turn, FlightEvent.PLAN_DONE)
        elif guided.is_stuck(turn.now, distance_m):
            self._send_target(turn, guided)

    def _on_current(self, turn: Turn, message: Message) -> None:
        if self.belief.on_current(turn.now, message.seq) and self.state is FlightState.FLYING and self.guided is None:
            data: dict[str, Scalar] = {"item": message.seq, "of": len(self.flight.plan.items)}
            turn.note("decision.progress", self.flight.vehicle, data)
        if message.mission_state == mav.MISSION_STATE_COMPLETE:
            self._mission_done(turn)

    def _on_reached(self, turn: Turn, message: Message) -> None:
        self.belief.reached(message.seq)
        plan = self.flight.plan
        if message.seq == procedures.last_navigation_item(plan) and procedures.is_done_at_last_item(plan):
            self._mission_done(turn)

    def _on_item_request(self, turn: Turn, message: Message) -> None:
        if self.state in TRANSFERRING:
            self.dialogue.answer_item_request(turn, message)

    def _on_mission_ack(self, turn: Turn, message: Message) -> None:
        if self.dialogue.read_mission_ack(turn, message):
            self._follow_transfer(turn)

    def _on_count(self, turn: Turn, message: Message) -> None:
        if self.dialogue.read_count(turn, message):
            self._follow_transfer(turn)

    def _on_item(self, turn: Turn, message: Message) -> None:
        if self.dialogue.read_item(turn, message):
            self._follow_transfer(turn)

    def _on_command_ack(self, turn: Turn, message: Message) -> None:
        self._follow_commands(turn, self.dialogue.read_command_ack(turn, message))

    def _on_text(self, turn: Turn, message: Message) -> None:
        if self.state in _EXPLAINED:
            self.texts.read(message)

    # --- events and states -------------------------------------------------------------------------

    def _raise(self, turn: Turn, event: FlightEvent, data: dict[str, Scalar] | None = None) -> None:
        self.state = next_state(self.state, event, self.flight.vehicle)
        self.state_causes = turn.causes
        plan = self.flight.plan
        time_limit_s = procedures.time_limit_s(self.state, estimated_duration_s(plan) if self.state in ARMED else 0.0)
        if self.state is FlightState.FLYING and is_endless(plan):
            time_limit_s = None
        self.deadline = NEVER if time_limit_s is None else turn.now + from_seconds(time_limit_s)
        kind = procedures.EVENT_NOTES[event]
        if kind:
            turn.note(kind, self.flight.vehicle, data)
        self._enter(turn)

    def _enter(self, turn: Turn) -> None:
        state, plan = self.state, self.flight.plan
        if state not in TRANSFERRING:
            self.dialogue.end_transfers()
        self.submission = None
        if state in (FlightState.REQUESTING, FlightState.ACTIVATING):
            activating = state is FlightState.ACTIVATING
            request = self.claim.activate if activating else self.claim.request
            self.submission = request(self.flight, turn.now)
            self.intent = self.submission.intent.id
            kind = "decision.activation_requested" if activating else "decision.approval_requested"
            turn.caused_by().note(kind, self.flight.vehicle, self.submission.summary())
            if turn.now >= self.submission.due:
                self._submit_intent(turn, self.submission)
        if state is FlightState.REROUTING and self.rerouted is not None:
            self.submission = self.claim.reroute(self.rerouted, turn.now)
            turn.note("decision.reroute_requested", self.flight.vehicle, self.submission.summary())
            self._submit_intent(turn, self.submission)
        if state is FlightState.CONNECTING:
            self.dialogue.lists = encode_lists(plan)
        if state is FlightState.CONNECTING and turn.now - self.belief.heard_ns < LINK_TIMEOUT_NS:
            self._raise(turn, FlightEvent.HEARD)
        elif state is FlightState.UPLOADING:
            if plan.kind == "guided":
                self.guided = GuidedSequencer.for_plan(plan)
            if not self.dialogue.upload_next(turn):
                self._raise(turn, FlightEvent.NOTHING_TO_UPLOAD)
        elif state is FlightState.VERIFYING:
            self.dialogue.read_back(turn)
        elif state in _TIMED and turn.now >= self._timed_end_ns():
            self._raise(turn, self._timed_event())
        elif state is FlightState.PREPARING:
            self._mark_telemetry_fresh(turn.now)
            self.texts.clear()
        elif state is FlightState.FLYING:
            self.belief.set("farthest_item", 0)
        elif state is FlightState.ABORTING and self.claim.tracked:
            self._report(turn, IntentState.CONTINGENT)
        elif state in ENDED:
            self._finish(turn)
        if state is FlightState.STREAMING:
            self._request_streams(turn)
        commands = procedures.entry_commands(state, plan, self.streams.messages)
        if commands and self.state is state:
            self._follow_commands(turn, self.dialogue.command(turn, commands))

    def _finish(self, turn: Turn) -> None:
        self.dialogue.drop_commands()
        if self.claim.tracked and self.claim.state is not None:
            self._report(turn, IntentState.ENDED)
        if self.state is FlightState.LEFT:
            return
        reason = self.reason if self.state is FlightState.FAILED else ""
        self.outcome = FlightOutcome(self.state.value, reason, turn.now)
        if reason:
            turn.note("decision.failed", self.flight.vehicle, {"reason": reason})
        turn.note("event.outcome", self.flight.vehicle, {"state": self.state.value, "reason": reason})

    def give_up(self, turn: Turn, reason: str) -> None:
        """Give up the plan: the aircraft returns, or stays on the ground."""
        if self.state in _EXPLAINED and self.texts.texts:
            reason = f"{reason}; {self.texts.quote()}"
        self.reason = f"{self.reason}; {reason}" if self.reason else reason
        self.dialogue.drop_commands()
        self._raise(turn, FlightEvent.GAVE_UP, {"reason": reason})

    def _disarmed(self, turn: Turn) -> None:
        premature_disarm_reason = procedures.premature_disarm_reason(self.state, self.flight.plan, self.progress)
        self.reason = self.reason or premature_disarm_reason
        self._raise(turn, FlightEvent.DISARMED if premature_disarm_reason else FlightEvent.LANDED)

    def _mission_done(self, turn: Turn) -> None:
        """Handle the end of the last leg; a mission without a landing leaves that to the ground station."""
        plan = self.flight.plan
        if self.state is FlightState.FLYING and plan.kind == "auto" and not procedures.lands_itself(plan):
            self._raise(turn, FlightEvent.PLAN_DONE)

    # --- restart -------------------------------------------------------------------------------------

    def _on_first_heartbeat(self, turn: Turn) -> None:
        """Handle the first heartbeat after a restart of the station; an aircraft that is flying goes on flying."""
        if not self.belief.armed:
            flown = self.belief.mode in _FLOWN
            self._raise(turn, FlightEvent.FOUND_FLOWN if flown else FlightEvent.FOUND_WAITING)
        elif self.flight.plan.kind == "guided":
            self.reason = "the station was started anew, and how far the plan had come is not known"
            self._raise(turn, FlightEvent.FOUND_GUIDED, {"reason": self.reason})
        else:
            self._raise(turn, FlightEvent.FOUND_FLYING)

    # --- requests, transfers, commands ----------------------------------------------------------------------

    def _submit_intent(self, turn: Turn, submission: IntentSubmission) -> None:
        turn = turn.caused_by()
        if submission.count_attempt(turn.now):
            turn.send(self.approval_port, submission.payload)
        else:
            self.give_up(turn, submission.describe_failure())

    def _watch_conformance(self, turn: Turn, message: Message) -> None:
        """Report that the aircraft has left its volumes, is back, or will not come back."""
        up_m = self.flight.plan.origin.ellipsoid_of(message.alt * 1e-3)
        state = self.claim.observe(turn.now, message.lat * 1e-7, message.lon * 1e-7, up_m)
        if state is not None and self.report is None:
            self._report(turn, state)

    def _report(self, turn: Turn, state: IntentState) -> None:
        self.report = self.claim.report(self.flight, turn.now, state)
        turn.note(_REPORTED[state], self.flight.vehicle, None)
        self._send_report(turn, self.report)

    def _send_report(self, turn: Turn, report: IntentSubmission) -> None:
        """Send a report (again); one that is not answered is given up."""
        turn = turn.caused_by()
        if report.count_attempt(turn.now):
            turn.send(self.approval_port, report.payload)
            return
        self.report = None
        turn.note("decision.approval_silent", self.flight.vehicle, {"tries": report.tries})
        self._on_unreported(turn, report, report.describe_failure())

    def _on_unreported(self, turn: Turn, report: IntentSubmission, reason: str) -> None:
        """The approval did not take a report. The flight goes on unless it is outside its volumes, which nobody else
        knows then: the aircraft flies its contingency.
        """
        self.claim.report_after_ns = turn.now + REPORT_PAUSE_NS
        if report.intent.state is IntentState.NONCONFORMING and self.state in _FLIGHT:
            self.give_up(turn, f"outside its volumes, and {reason}")

    def _follow_transfer(self, turn: Turn) -> None:
        """Go on with what has come of a transfer."""
        dialogue, transfer = self.dialogue, self.dialogue.transfer
        if transfer is None or not transfer.result:
            return
        if transfer.result != "done":
            self.give_up(turn, transfer.result)
            return
        data: dict[str, Scalar] = {"items": len(transfer.items) - transfer.homes, "attempts": transfer.attempts}
        if transfer.kind != mav.MAV_MISSION_TYPE_MISSION:
            data["list"] = transfer.name
        verified = FlightEvent.LIST_VERIFIED if dialogue.lists else FlightEvent.VERIFIED
        self._raise(turn, FlightEvent.UPLOADED if transfer is dialogue.upload else verified, data)

    def _follow_commands(self, turn: Turn, progress: Progress) -> None:
        """Go on with what has come of commands: raise the state's completion event after the last, or give up."""
        if progress.state == "begun":
            self.state_causes = turn.causes or self.state_causes
        elif progress.state == "done":
            event = procedures.COMPLETION_EVENTS.get(self.state)
            if event is not None:
                self._raise(turn, event)
        elif progress.state == "rejected":
            self.give_up(turn, progress.reason)

    def _request_streams(self, turn: Turn) -> None:
        self.dialogue.send(turn, stream_requests(self.streams, self.flight.system_id, AUTOPILOT_COMPONENT))

    # --- timers ------------------------------------------------------------------------------------------

    def check_telemetry_age(self, turn: Turn) -> None:
        """Detect a lost link and stale telemetry; called with the station's heartbeat for stale beliefs."""
        if self.state is FlightState.PLANNED or self.state in ENDED:
            return
        belief = self.belief
        silent = turn.now - belief.heard_ns > LINK_TIMEOUT_NS
        if silent and belief.heard_ns >= 0 and not self.link_lost:
            self.link_lost = True
            turn.note("decision.link_lost", self.flight.vehicle, {"silent_s": to_seconds(turn.now - belief.heard_ns)})
        if not silent and self.state in _STREAM_CHECKED and self.dialogue.exchange is None:
            reported_ns = belief.position_ns if self.guided else min(belief.position_ns, belief.item_ns)
            if turn.now - reported_ns > STALE_NS:
                self._mark_telemetry_fresh(turn.now)  # not again until they are stale again
                self._request_streams(turn)
                commands = procedures.stream_commands(self.streams.messages)
                self._follow_commands(turn, self.dialogue.command(turn, commands))
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
        due = min(self.deadline, self.dialogue.due)
        if self.submission is not None:
            due = min(due, self.submission.due)
        if self.report is not None:
            due = min(due, self.report.due)
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

    def _send_target(self, turn: Turn, guided: GuidedSequencer) -> None:
        self.dialogue.send(turn, [guided.message(turn.now, self.flight.system_id, AUTOPILOT_COMPONENT)])

    def _note_count(self, turn: Turn, kind: str, count: int, reason: str) -> None:
        if worth_noting(count):
            turn.note(kind, self.flight.vehicle, {"count": count, "reason": reason})


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
