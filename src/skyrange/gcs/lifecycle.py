"""In which state is an aircraft's flight, and which event leads where? One table.

Why a table: a flight is a conversation with two peers (the approval and the autopilot) over links that
lose, repeat and reorder, so anything may arrive in any state. Written as conditions scattered over
handlers, "what if the approval comes twice, or the aircraft disarms while the plan is read back"
has as many answers as handlers. Here every state lists the events that can move it, in one place that
can be read and tested whole. Three rules keep it honest. First, only the pilot raises events, and only
what its state listens to; a frame that means nothing now is data (a belief) or is counted, never an
event. So an event outside the table is a defect of ours, and `after` raises instead of ignoring it.
Second, waiting is a state and giving up is an event (`GAVE_UP`, with a reason): each state that
waits has a deadline, so each flight ends in COMPLETE or FAILED (or LEFT). Third, once airborne, giving up
does not fail at once: the aircraft is first brought home (ABORTING), as an operator would.
"""

from __future__ import annotations

from enum import StrEnum

from skyrange.core.errors import ComponentError


class State(StrEnum):
    """Where a flight stands, as its ground station sees it."""

    PLANNED = "planned"  # nothing said yet
    LISTENING = "listening"  # the station was started anew: is the aircraft flying already?
    REQUESTING = "requesting"  # the approval has been asked
    CONNECTING = "connecting"  # approved; no heartbeat of the aircraft heard so far
    UPLOADING = "uploading"  # the mission goes up
    VERIFYING = "verifying"  # the mission is read back and compared
    STREAMING = "streaming"  # telemetry rates are requested
    PREPARING = "preparing"  # GUIDED mode, in which ArduCopter lets a ground station arm
    WAITING = "waiting"  # ready before it is time to arm
    ARMING = "arming"  # until a heartbeat shows it
    HOLDING = "holding"  # armed before its departure time
    STARTING = "starting"  # mission start or take-off commanded
    FLYING = "flying"  # the plan is being flown
    RETURNING = "returning"  # the plan is done, the aircraft is told to come home or land
    ABORTING = "aborting"  # the plan is given up, the aircraft is told to come home
    COMPLETE = "complete"
    FAILED = "failed"
    LEFT = "left"  # found on the ground after a flight that another station watched: what became of it, that one knew


class Event(StrEnum):
    """What moves a flight on."""

    BEGUN = "begun"
    BEGUN_ANEW = "begun_anew"  # after time 0: another of this name was there before, and what it did is not known
    FOUND_FLYING = "found_flying"  # armed, by none of this station's doing
    FOUND_GUIDED = "found_guided"  # armed, under a guided plan of which nobody knows how far it had come
    FOUND_FLOWN = "found_flown"  # on the ground, in a mode that a flight leaves behind
    FOUND_WAITING = "found_waiting"  # on the ground, not flown yet
    APPROVED = "approved"
    REJECTED = "rejected"
    HEARD = "heard"  # a heartbeat of the aircraft's autopilot
    UPLOADED = "uploaded"
    NOTHING_TO_UPLOAD = "nothing_to_upload"  # a guided plan stays on the ground
    VERIFIED = "verified"
    STREAMS_SET = "streams_set"
    PREPARED = "prepared"
    DUE = "due"  # time to arm, a little before departure
    ARMED = "armed"
    DEPARTED = "departed"  # departure time
    STARTED = "started"
    PLAN_DONE = "plan_done"  # all done but the landing, which the plan leaves to the ground station
    LANDED = "landed"  # disarmed with the plan done
    DISARMED = "disarmed"  # disarmed too early
    GAVE_UP = "gave_up"  # a peer refused, retries are used up, or a deadline has passed


S, E = State, Event
TABLE: dict[State, dict[Event, State]] = {
    S.PLANNED: {E.BEGUN: S.REQUESTING, E.BEGUN_ANEW: S.LISTENING},
    S.LISTENING: {
        E.FOUND_FLYING: S.FLYING,
        E.FOUND_GUIDED: S.ABORTING,
        E.FOUND_FLOWN: S.LEFT,
        E.FOUND_WAITING: S.REQUESTING,
        E.GAVE_UP: S.FAILED,
    },
    S.REQUESTING: {E.APPROVED: S.CONNECTING, E.REJECTED: S.FAILED, E.GAVE_UP: S.FAILED},
    S.CONNECTING: {E.HEARD: S.UPLOADING, E.GAVE_UP: S.FAILED},
    S.UPLOADING: {E.UPLOADED: S.VERIFYING, E.NOTHING_TO_UPLOAD: S.STREAMING, E.GAVE_UP: S.FAILED},
    S.VERIFYING: {E.VERIFIED: S.STREAMING, E.GAVE_UP: S.FAILED},
    S.STREAMING: {E.STREAMS_SET: S.PREPARING, E.GAVE_UP: S.FAILED},
    S.PREPARING: {E.PREPARED: S.WAITING, E.GAVE_UP: S.FAILED},
    S.WAITING: {E.DUE: S.ARMING},
    S.ARMING: {E.ARMED: S.HOLDING, E.GAVE_UP: S.FAILED},
    S.HOLDING: {E.DEPARTED: S.STARTING, E.DISARMED: S.FAILED},
    S.STARTING: {E.STARTED: S.FLYING, E.DISARMED: S.FAILED, E.GAVE_UP: S.ABORTING},
    S.FLYING: {E.PLAN_DONE: S.RETURNING, E.LANDED: S.COMPLETE, E.DISARMED: S.FAILED, E.GAVE_UP: S.ABORTING},
    S.RETURNING: {E.LANDED: S.COMPLETE, E.GAVE_UP: S.ABORTING},
    S.ABORTING: {E.DISARMED: S.FAILED, E.GAVE_UP: S.FAILED},
    S.COMPLETE: {},
    S.FAILED: {},
    S.LEFT: {},
}
"""State → event → next state. What is absent cannot happen."""

OVER = frozenset({State.COMPLETE, State.FAILED, State.LEFT})
"""States that end a flight."""
ARMED = frozenset({State.HOLDING, State.STARTING, State.FLYING, State.RETURNING, State.ABORTING})
"""States in which the station believes the motors run."""
CARRYING = frozenset({State.UPLOADING, State.VERIFYING})
"""States in which a request for a mission item is answered (late or repeated ones too)."""


class LifecycleError(ComponentError):
    """An event was raised in a state that does not know it: a defect of the ground station."""


def after(state: State, event: Event, who: str = "ground station") -> State:
    """The state that `event` leads to from `state`; `LifecycleError` where the table has none."""
    row = TABLE[state]
    if event not in row:
        known = ", ".join(row) or "nothing: it is over"
        raise LifecycleError(who, f"event {event.value!r} cannot happen in state {state.value!r}", f"It knows {known}")
    return row[event]
