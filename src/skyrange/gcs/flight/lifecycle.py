"""One flight of one aircraft: what is asked of it, and the state machine of its states, events and transitions.

A flight is a conversation with two peers, the approval and the autopilot, over links that lose, duplicate and reorder
frames, so any message may arrive in any state. If the transitions were conditions in the message handlers, then a
question such as "what if the approval arrives twice, or the aircraft disarms during the read-back?" would have one
answer per handler. In a table, every state lists the events that it accepts, in one place that can be read and tested
as a whole.

The table rests on three rules. First, only the flight sequencer raises events, and only those that the current state
accepts. A frame that has no meaning in the current state updates the belief or is counted; it is never an event. An
event outside the table is therefore a defect of skyrange, and `next_state` raises an error.
Second, waiting is a state and giving up is an event (`GAVE_UP`, with a reason). Each state that waits has a deadline,
so each flight ends in COMPLETE, FAILED or LEFT. Third, a flight that is given up in the air does not fail at once: the
aircraft first returns home (ABORTING), as an operator would have it do.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from skyrange.core.errors import ComponentError
from skyrange.core.time import Time
from skyrange.gcs.plan.plans import FlightPlan


@dataclass(frozen=True, slots=True)
class Flight:
    """One aircraft of an operator and the plan that it flies.

    `vehicle` is the range-wide id (`blue/b1`). `system_id` is the MAVLink system id, 1…250, unique within the
    operator's MAVLink network number `network`. The ground station arms and starts the aircraft at `depart_s`
    (seconds of simulated time), or as soon after that as the aircraft is ready. It asks for approval at `request_s`.
    With a `telemetry_radio` its link is over a SiK radio, which reports to the station.
    """

    vehicle: str
    system_id: int
    plan: FlightPlan
    depart_s: float = 0.0
    request_s: float = 0.0
    network: int = 0
    telemetry_radio: bool = False


@dataclass(frozen=True, slots=True)
class FlightOutcome:
    """How a flight ended: `state` (complete or failed), `reason` of a failure, and when."""

    state: str
    reason: str
    finished_ns: Time


class FlightState(StrEnum):
    """State of a flight, as its ground station sees it."""

    PLANNED = "planned"  # nothing was sent yet
    LISTENING = "listening"  # the station was restarted and does not know whether the aircraft is flying
    REQUESTING = "requesting"  # the intent was submitted to the approval
    CONNECTING = "connecting"  # approved; no heartbeat of the aircraft received yet
    UPLOADING = "uploading"  # the mission, then the fence and the rally points, if the plan has any, are uploaded
    VERIFYING = "verifying"  # what was uploaded is read back and compared with what was sent
    STREAMING = "streaming"  # telemetry rates are requested
    PREPARING = "preparing"  # GUIDED mode is set, in which ArduCopter lets a ground station arm
    WAITING = "waiting"  # ready; it is too early to arm
    ACTIVATING = "activating"  # the approval was told that the aircraft is about to take off
    ARMING = "arming"  # until a heartbeat reports the aircraft as armed
    HOLDING = "holding"  # armed before its departure time
    STARTING = "starting"  # mission start or take-off commanded
    FLYING = "flying"  # the plan is being flown
    REROUTING = "rerouting"  # the way is closed; the approval was asked for the rest of the plan around it
    RETURNING = "returning"  # the plan is done; the aircraft was commanded to return or land
    ABORTING = "aborting"  # the plan was given up; the aircraft was commanded to return
    COMPLETE = "complete"
    FAILED = "failed"
    LEFT = "left"  # found on the ground after a flight under another station, which alone knew the outcome


class FlightEvent(StrEnum):
    """Event that changes the state of a flight."""

    BEGUN = "begun"
    BEGUN_ANEW = "begun_anew"  # started after time 0: what an earlier station of this name did is not known
    FOUND_FLYING = "found_flying"  # armed, but not by this station
    FOUND_GUIDED = "found_guided"  # armed under a guided plan whose progress is not known
    FOUND_FLOWN = "found_flown"  # on the ground, in a mode that shows that the flight took place
    FOUND_WAITING = "found_waiting"  # on the ground, not flown yet
    APPROVED = "approved"
    ALTERED = "altered"  # rejected; an alternative is asked for
    OVERRULED = "overruled"  # approved, and rejected later because of another intent
    CLOSED = "closed"  # in the air, the approval has told what closes the way
    REROUTED = "rerouted"  # the approval has accepted the rest of the plan on another way
    REJECTED = "rejected"
    HEARD = "heard"  # a heartbeat of the aircraft's autopilot arrived
    UPLOADED = "uploaded"
    NOTHING_TO_UPLOAD = "nothing_to_upload"  # a guided plan is not uploaded
    LIST_VERIFIED = "list_verified"  # and the fence or the rally points are to be uploaded next
    VERIFIED = "verified"
    STREAMS_SET = "streams_set"
    PREPARED = "prepared"
    ACTIVATION_DUE = "activation_due"  # time to arm; the approval has to know
    ACTIVATED = "activated"
    DUE = "due"  # time to arm, a little before departure
    ARMED = "armed"
    DEPARTED = "departed"  # departure time
    STARTED = "started"
    PLAN_DONE = "plan_done"  # all of the plan is done, except for a landing that it leaves to the ground station
    LANDED = "landed"  # disarmed after the plan was done
    DISARMED = "disarmed"  # disarmed before the plan was done
    GAVE_UP = "gave_up"  # a peer rejected a request, the retries are used up, or a deadline has passed


S, E = FlightState, FlightEvent
TRANSITIONS: dict[FlightState, dict[FlightEvent, FlightState]] = {
    S.PLANNED: {E.BEGUN: S.REQUESTING, E.BEGUN_ANEW: S.LISTENING},
    S.LISTENING: {
        E.FOUND_FLYING: S.FLYING,
        E.FOUND_GUIDED: S.ABORTING,
        E.FOUND_FLOWN: S.LEFT,
        E.FOUND_WAITING: S.REQUESTING,
        E.GAVE_UP: S.FAILED,
    },
    S.REQUESTING: {
        E.APPROVED: S.CONNECTING,
        E.ALTERED: S.REQUESTING,
        E.REJECTED: S.FAILED,
        E.GAVE_UP: S.FAILED,
    },
    S.CONNECTING: {E.HEARD: S.UPLOADING, E.OVERRULED: S.REQUESTING, E.GAVE_UP: S.FAILED},
    S.UPLOADING: {
        E.UPLOADED: S.VERIFYING,
        E.NOTHING_TO_UPLOAD: S.STREAMING,
        E.OVERRULED: S.REQUESTING,
        E.GAVE_UP: S.FAILED,
    },
    S.VERIFYING: {
        E.LIST_VERIFIED: S.UPLOADING,
        E.VERIFIED: S.STREAMING,
        E.OVERRULED: S.REQUESTING,
        E.GAVE_UP: S.FAILED,
    },
    S.STREAMING: {E.STREAMS_SET: S.PREPARING, E.OVERRULED: S.REQUESTING, E.GAVE_UP: S.FAILED},
    S.PREPARING: {E.PREPARED: S.WAITING, E.OVERRULED: S.REQUESTING, E.GAVE_UP: S.FAILED},
    S.WAITING: {E.DUE: S.ARMING, E.ACTIVATION_DUE: S.ACTIVATING, E.OVERRULED: S.REQUESTING},
    S.ACTIVATING: {
        E.ACTIVATED: S.ARMING,
        E.ALTERED: S.REQUESTING,
        E.OVERRULED: S.REQUESTING,
        E.REJECTED: S.FAILED,
        E.GAVE_UP: S.FAILED,
    },
    S.ARMING: {E.ARMED: S.HOLDING, E.GAVE_UP: S.FAILED},
    S.HOLDING: {E.DEPARTED: S.STARTING, E.DISARMED: S.FAILED, E.GAVE_UP: S.ABORTING},
    S.STARTING: {E.STARTED: S.FLYING, E.DISARMED: S.FAILED, E.GAVE_UP: S.ABORTING},
    S.FLYING: {
        E.PLAN_DONE: S.RETURNING,
        E.CLOSED: S.REROUTING,
        E.LANDED: S.COMPLETE,
        E.DISARMED: S.FAILED,
        E.GAVE_UP: S.ABORTING,
    },
    S.REROUTING: {E.REROUTED: S.FLYING, E.DISARMED: S.FAILED, E.GAVE_UP: S.ABORTING},
    S.RETURNING: {E.LANDED: S.COMPLETE, E.GAVE_UP: S.ABORTING},
    S.ABORTING: {E.DISARMED: S.FAILED, E.GAVE_UP: S.ABORTING},
    S.COMPLETE: {},
    S.FAILED: {},
    S.LEFT: {},
}
"""State → event → next state. An event that a state does not list cannot happen in it."""

ENDED = frozenset({FlightState.COMPLETE, FlightState.FAILED, FlightState.LEFT})
"""States that end a flight."""
ARMED = frozenset(
    {
        FlightState.HOLDING,
        FlightState.STARTING,
        FlightState.FLYING,
        FlightState.REROUTING,
        FlightState.RETURNING,
        FlightState.ABORTING,
    }
)
"""States in which the station believes that the motors run."""
OVERRULABLE = frozenset(state for state, row in TRANSITIONS.items() if FlightEvent.OVERRULED in row)
"""States in which an approval may be taken back: before the aircraft is armed."""
TRANSFERRING = frozenset({FlightState.UPLOADING, FlightState.VERIFYING})
"""States in which requests for mission items are answered, late and duplicate ones included."""


class LifecycleError(ComponentError):
    """An event was raised in a state that does not accept it: a defect of the ground station."""


def next_state(state: FlightState, event: FlightEvent, who: str = "ground station") -> FlightState:
    """The state after `event` in `state`; raises `LifecycleError` if the table has no such transition."""
    row = TRANSITIONS[state]
    if event not in row:
        known = ", ".join(row) or "no event, because the flight is over"
        problem = f"event {event.value!r} cannot happen in state {state.value!r}"
        raise LifecycleError(who, problem, f"That state accepts {known}")
    return row[event]
