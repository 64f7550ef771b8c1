"""What does each state of a flight command, how long may it last, and what does its plan leave to do?"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from skyrange.codec.mavlink import dialect as mav
from skyrange.gcs.commands import Command, set_mode
from skyrange.gcs.lifecycle import Event, State
from skyrange.gcs.plans import FlightPlan
from skyrange.gcs.streams import interval_us

PREPARE_S = 60.0
"""How long arming and mode changes are asked for again: ArduCopter's estimator takes up to a minute to settle."""
ARM_LEAD_S = 3.0
"""How long before its departure an aircraft is armed, so that the start itself waits for nothing.

Heartbeats, which show it, come every second; ArduCopter disarms by itself after DISARM_DELAY, 10 s."""
TAKEOFF_S = 10.0
"""How long a take-off is asked for again. Where only its acknowledgement got lost, ArduCopter refuses the second one;
within this time the aircraft is seen to climb."""
FLIGHT_FACTOR = 3.0
FLIGHT_EXTRA_S = 120.0
"""A flight may last `FLIGHT_FACTOR` times its estimate and this much more."""

NOTES: Mapping[Event, str] = MappingProxyType(
    {
        Event.BEGUN: "",
        Event.BEGUN_ANEW: "",
        Event.FOUND_FLYING: "decision.resumed",
        Event.FOUND_GUIDED: "decision.gave_up",
        Event.FOUND_FLOWN: "decision.left",
        Event.FOUND_WAITING: "",
        Event.APPROVED: "decision.approved",
        Event.REJECTED: "decision.rejected",
        Event.HEARD: "decision.connected",
        Event.UPLOADED: "decision.uploaded",
        Event.NOTHING_TO_UPLOAD: "",
        Event.VERIFIED: "decision.verified",
        Event.STREAMS_SET: "decision.streams_set",
        Event.PREPARED: "decision.prepared",
        Event.DUE: "",
        Event.ARMED: "decision.armed",
        Event.DEPARTED: "decision.departing",
        Event.STARTED: "decision.started",
        Event.PLAN_DONE: "decision.plan_done",
        Event.LANDED: "decision.complete",
        Event.DISARMED: "decision.disarmed",
        Event.GAVE_UP: "decision.gave_up",
    }
)
"""The note that each event leaves in the record; none where the state entered writes its own."""

DONE: Mapping[State, Event] = MappingProxyType(
    {State.STREAMING: Event.STREAMS_SET, State.PREPARING: Event.PREPARED, State.STARTING: Event.STARTED}
)
"""The event that follows when a state's commands are all carried out. ARMING waits for a heartbeat."""


def commands(state: State, plan: FlightPlan, streams: tuple[tuple[int, float], ...]) -> tuple[Command, ...]:
    """What entering `state` commands, in order."""
    if state is State.STREAMING:
        return stream_commands(streams)
    if state is State.PREPARING:
        return (set_mode(mav.COPTER_MODE_GUIDED, "GUIDED", PREPARE_S),)
    if state is State.ARMING:
        return (Command(mav.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,), "arm", PREPARE_S),)
    if state is State.STARTING:
        return _start(plan)
    if state is State.FLYING and plan.kind == "guided":
        speed = (1.0, plan.cruise_mps, -1.0)  # ground speed, throttle unchanged
        return (Command(mav.MAV_CMD_DO_CHANGE_SPEED, speed, "speed", optional=True),)
    if state is State.RETURNING and plan.end == "land":
        return (set_mode(mav.COPTER_MODE_LAND, "LAND"),)
    if state in (State.RETURNING, State.ABORTING):
        return (set_mode(mav.COPTER_MODE_RTL, "RTL"),)
    return ()


def _start(plan: FlightPlan) -> tuple[Command, ...]:
    if plan.kind == "auto":
        # AUTO first: an armed aircraft on the ground holds still in it until the start raises auto_armed.
        return (
            set_mode(mav.COPTER_MODE_AUTO, "AUTO"),
            Command(mav.MAV_CMD_MISSION_START, (0.0, 0.0), "mission start", 5.0),
        )
    height_m = plan.targets_enu_m[0].up_m - plan.home_enu_m.up_m
    return (Command(mav.MAV_CMD_NAV_TAKEOFF, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m), "take-off", TAKEOFF_S),)


def stream_commands(streams: tuple[tuple[int, float], ...]) -> tuple[Command, ...]:
    """One SET_MESSAGE_INTERVAL per (message id, rate in Hz); an autopilot may refuse what it does not send."""
    return tuple(
        Command(
            mav.MAV_CMD_SET_MESSAGE_INTERVAL,
            (float(message), float(interval_us(rate_hz))),
            f"interval of {mav.mavlink_map[message].msgname}",
            optional=True,
        )
        for message, rate_hz in streams
    )


def limit_s(state: State, duration_s: float) -> float | None:
    """How long `state` may last, for a flight estimated at `duration_s`; `None` where retries bound it."""
    if state in (State.CONNECTING, State.LISTENING):
        return 60.0
    if state is State.ARMING:
        return PREPARE_S + 10.0
    if state in (State.FLYING, State.RETURNING, State.ABORTING):
        return duration_s * FLIGHT_FACTOR + FLIGHT_EXTRA_S
    return None


def last_leg(plan: FlightPlan) -> int:
    """Sequence number (home is 0) of a mission's last navigation command; 0 if it has none."""
    last = 0
    for seq, item in enumerate(plan.items, start=1):
        if item.command < mav.MAV_CMD_NAV_LAST:
            last = seq
    return last


def lands_itself(plan: FlightPlan) -> bool:
    """Whether a mission ends on the ground without the station's doing."""
    last = last_leg(plan)
    return last > 0 and plan.items[last - 1].command in (mav.MAV_CMD_NAV_LAND, mav.MAV_CMD_NAV_RETURN_TO_LAUNCH)


def too_early(state: State, plan: FlightPlan, progress: int) -> str:
    """Why being disarmed in `state` is not a landing; empty where it is one.

    `progress` is the farthest mission item seen, or the index of a guided plan's present target.
    """
    if state is State.RETURNING:
        return ""
    if state is State.ABORTING:
        return "plan given up"
    if state is not State.FLYING:
        return "disarmed before take-off"
    if plan.kind == "guided":
        return f"disarmed before target {progress + 1} of {len(plan.targets_enu_m)}"
    if lands_itself(plan) and progress >= last_leg(plan):
        return ""
    return f"disarmed at item {progress} of {len(plan.items)}"
