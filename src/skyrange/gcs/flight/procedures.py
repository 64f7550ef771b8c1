"""Procedures of a flight: the commands, time limit and recorded note of each state."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from skyrange.codec.mavlink import dialect as mav
from skyrange.gcs.flight.lifecycle import FlightEvent, FlightState
from skyrange.gcs.plan.plans import LANDINGS, FlightPlan, is_navigation
from skyrange.gcs.protocols.commands import Command, set_mode
from skyrange.gcs.telemetry_streams import interval_us

PREPARE_S = 60.0
"""For how long arming and mode changes are retried; ArduCopter's estimator takes up to a minute to settle."""
ARM_LEAD_S = 3.0
"""How long before its departure an aircraft is armed, so that it can start on time.

The heartbeats that confirm arming come once per second. ArduCopter disarms by itself after DISARM_DELAY, 10 s."""
TAKEOFF_S = 10.0
"""For how long a take-off command is retried. If only the acknowledgement was lost, ArduCopter rejects the repeated
command, and telemetry shows within this time that the aircraft climbs."""
FLIGHT_FACTOR = 3.0
FLIGHT_EXTRA_S = 120.0
"""A flight may last `FLIGHT_FACTOR` times its estimated duration plus this many seconds."""

EVENT_NOTES: Mapping[FlightEvent, str] = MappingProxyType(
    {
        FlightEvent.BEGUN: "",
        FlightEvent.BEGUN_ANEW: "",
        FlightEvent.FOUND_FLYING: "decision.resumed",
        FlightEvent.FOUND_GUIDED: "decision.gave_up",
        FlightEvent.FOUND_FLOWN: "decision.left",
        FlightEvent.FOUND_WAITING: "",
        FlightEvent.APPROVED: "decision.approved",
        FlightEvent.ALTERED: "decision.alternative_chosen",
        FlightEvent.OVERRULED: "decision.overruled",
        FlightEvent.CLOSED: "",
        FlightEvent.REROUTED: "decision.rerouted",
        FlightEvent.REJECTED: "decision.rejected",
        FlightEvent.HEARD: "decision.connected",
        FlightEvent.UPLOADED: "decision.uploaded",
        FlightEvent.NOTHING_TO_UPLOAD: "",
        FlightEvent.LIST_VERIFIED: "decision.verified",
        FlightEvent.VERIFIED: "decision.verified",
        FlightEvent.STREAMS_SET: "decision.streams_set",
        FlightEvent.PREPARED: "decision.prepared",
        FlightEvent.ACTIVATION_DUE: "",
        FlightEvent.ACTIVATED: "decision.activated",
        FlightEvent.DUE: "",
        FlightEvent.ARMED: "decision.armed",
        FlightEvent.DEPARTED: "decision.departing",
        FlightEvent.STARTED: "decision.started",
        FlightEvent.PLAN_DONE: "decision.plan_done",
        FlightEvent.LANDED: "decision.complete",
        FlightEvent.DISARMED: "decision.disarmed",
        FlightEvent.GAVE_UP: "decision.gave_up",
    }
)
"""The kind of note that each event writes to the record; empty if the next state writes its own note."""

COMPLETION_EVENTS: Mapping[FlightState, FlightEvent] = MappingProxyType(
    {
        FlightState.STREAMING: FlightEvent.STREAMS_SET,
        FlightState.PREPARING: FlightEvent.PREPARED,
        FlightState.STARTING: FlightEvent.STARTED,
    }
)
"""The event that is raised when all commands of a state are accepted. ARMING waits for a heartbeat instead."""


def entry_commands(state: FlightState, plan: FlightPlan, streams: tuple[tuple[int, float], ...]) -> tuple[Command, ...]:
    """The commands that are sent on entry to `state`, in order."""
    if state is FlightState.STREAMING:
        return stream_commands(streams)
    if state is FlightState.PREPARING:
        return (set_mode(mav.COPTER_MODE_GUIDED, "GUIDED", PREPARE_S),)
    if state is FlightState.ARMING:
        return (Command(mav.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,), "arm", PREPARE_S),)
    if state is FlightState.STARTING:
        return _start_commands(plan)
    if state is FlightState.FLYING and plan.kind == "guided":
        speed = (1.0, plan.cruise_mps, -1.0)  # ground speed, throttle unchanged
        return (Command(mav.MAV_CMD_DO_CHANGE_SPEED, speed, "speed", optional=True),)
    if state is FlightState.REROUTING:
        return (set_mode(mav.COPTER_MODE_GUIDED, "GUIDED"),)  # it stops there
    if state is FlightState.RETURNING and plan.end == "land":
        return (set_mode(mav.COPTER_MODE_LAND, "LAND"),)
    if state in (FlightState.RETURNING, FlightState.ABORTING):
        return (set_mode(mav.COPTER_MODE_RTL, "RTL"),)
    return ()


def _start_commands(plan: FlightPlan) -> tuple[Command, ...]:
    if plan.kind == "auto":
        # AUTO first: an armed aircraft on the ground stays there in AUTO until MISSION_START sets auto_armed.
        return (
            set_mode(mav.COPTER_MODE_AUTO, "AUTO"),
            Command(mav.MAV_CMD_MISSION_START, (0.0, 0.0), "mission start", 5.0),
        )
    height_m = plan.targets_enu_m[0].up_m - plan.home_enu_m.up_m
    return (Command(mav.MAV_CMD_NAV_TAKEOFF, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m), "take-off", TAKEOFF_S),)


def stream_commands(streams: tuple[tuple[int, float], ...]) -> tuple[Command, ...]:
    """One SET_MESSAGE_INTERVAL per (message id, rate in Hz); an autopilot may reject messages that it does not have."""
    return tuple(
        Command(
            mav.MAV_CMD_SET_MESSAGE_INTERVAL,
            (float(message), float(interval_us(rate_hz))),
            f"interval of {mav.mavlink_map[message].msgname}",
            optional=True,
        )
        for message, rate_hz in streams
    )


def time_limit_s(state: FlightState, duration_s: float) -> float | None:
    """Time limit of `state` in seconds for a flight estimated at `duration_s`; `None` if retries limit it instead."""
    if state in (FlightState.CONNECTING, FlightState.LISTENING):
        return 60.0
    if state is FlightState.ARMING:
        return PREPARE_S + 10.0
    if state in (FlightState.FLYING, FlightState.RETURNING, FlightState.ABORTING):
        return duration_s * FLIGHT_FACTOR + FLIGHT_EXTRA_S
    return None


def last_navigation_item(plan: FlightPlan) -> int:
    """Sequence number (home is 0) of a mission's last navigation command; 0 if there is none."""
    last = 0
    for seq, item in enumerate(plan.items, start=1):
        if is_navigation(item.command):
            last = seq
    return last


def is_done_at_last_item(plan: FlightPlan) -> bool:
    """Whether a mission is done once its last navigation command is reached: no jump back follows it."""
    jumps = (mav.MAV_CMD_DO_JUMP, mav.MAV_CMD_DO_JUMP_TAG)
    return not any(item.command in jumps for item in plan.items[last_navigation_item(plan) :])


def lands_itself(plan: FlightPlan) -> bool:
    """Whether a mission ends on the ground without a command of the ground station."""
    last = last_navigation_item(plan)
    return last > 0 and plan.items[last - 1].command in LANDINGS | {mav.MAV_CMD_NAV_RETURN_TO_LAUNCH}


def premature_disarm_reason(state: FlightState, plan: FlightPlan, progress: int) -> str:
    """Why disarming in `state` counts as premature; empty if it counts as the landing.

    `progress` is the highest mission item number reported, or the index of a guided plan's current target.
    """
    if state is FlightState.RETURNING:
        return ""
    if state is FlightState.ABORTING:
        return "plan given up"
    if state not in (FlightState.FLYING, FlightState.REROUTING):
        return "disarmed before take-off"
    if plan.kind == "guided":
        return f"disarmed before target {progress + 1} of {len(plan.targets_enu_m)}"
    if lands_itself(plan) and progress >= last_navigation_item(plan):
        return ""
    return f"disarmed at item {progress} of {len(plan.items)}"
