"""MAVLink command detector: rare or dangerous orders to an aircraft in flight, scored by severity.

It reads the orders that travel towards the autopilot at a link end, and from the autopilot HEARTBEAT and
GLOBAL_POSITION_INT. The aircraft is *in flight* if it is armed (MAV_MODE_FLAG_SAFETY_ARMED) and above `airborne_m`, or,
while no height was received, if its status is MAV_STATE_ACTIVE. The rule: each order has a severity in flight and one
on the ground; the score is the severity. Orders to other systems do not count: judged is what is addressed to system 0,
which is all, or to a system whose autopilot sent a HEARTBEAT at that link end (mavlink.io, Routing). Every such system
counts from then on, so a forged heartbeat hides no order. Until there is one, all orders count.

The severities are a judgement by what the MAVLink specification (mavlink.io, common.xml) says that an order does:

- 4: the aircraft falls or loses its controller: flight termination, disarming by force, a parachute, a reboot.
- 2: it loses a protection or its plan: disarming, a fence off, a mission cleared, signing keys set, a parameter of
  `protected` prefixes set, a test of motors, a calibration.
- 1: another way to fly: a mode (but to return, land or brake), home, a mission item to go to, mission, fence or rally
  points replaced, sticks by radio, another parameter, a relay or servo.
- 0.5: what operators do in flight: to return, land or brake. On the ground an order has a tenth of it.

Targets in GUIDED mode and speeds are ordinary and have no severity. It cannot distinguish an attacker from the
operator: a ground station that replans in flight raises alerts, and a hostile order on the ground none. It does not see
orders that are injected beyond the end at which it listens; `mavlink.source` sees their acknowledgements.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from pydantic import BeforeValidator

import skyrange.plugin as sky
from skyrange.codec.mavlink import dialect as mav
from skyrange.detect.messages import Flags, MessageHeads, message_numbers
from skyrange.detect.series import Floats

WORST, PROTECTION, COURSE, USUAL = 4.0, 2.0, 1.0, 0.5
ON_GROUND: Final = 0.1
"""Share of the severity that an order has on the ground."""
SAFE_MODES: Final = frozenset(
    {mav.COPTER_MODE_RTL, mav.COPTER_MODE_SMART_RTL, mav.COPTER_MODE_LAND, mav.COPTER_MODE_BRAKE}
)
_FORCE: Final = 21196.0
"""Param 2 of MAV_CMD_COMPONENT_ARM_DISARM that disarms in flight."""


def _mode(mode: float) -> float:
    return USUAL if mode in SAFE_MODES else COURSE


def _termination(p1: float, p2: float) -> float:
    return WORST if p1 > 0.5 else 0.0


def _disarm(p1: float, p2: float) -> float:
    return 0.0 if p1 > 0.5 else WORST if p2 == _FORCE else PROTECTION


def _fence(p1: float, p2: float) -> float:
    return PROTECTION if p1 == 0.0 else 0.0


def _parachute(p1: float, p2: float) -> float:
    return WORST if p1 == mav.PARACHUTE_RELEASE else PROTECTION if p1 == mav.PARACHUTE_DISABLE else 0.0


def _set_mode(p1: float, p2: float) -> float:
    return _mode(p2)


COMMANDS: Final[dict[int, float | Callable[[float, float], float]]] = {
    mav.MAV_CMD_DO_FLIGHTTERMINATION: _termination,
    mav.MAV_CMD_COMPONENT_ARM_DISARM: _disarm,
    mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: WORST,
    mav.MAV_CMD_DO_PARACHUTE: _parachute,
    mav.MAV_CMD_DO_FENCE_ENABLE: _fence,
    mav.MAV_CMD_PREFLIGHT_CALIBRATION: PROTECTION,
    mav.MAV_CMD_PREFLIGHT_SET_SENSOR_OFFSETS: PROTECTION,
    mav.MAV_CMD_PREFLIGHT_STORAGE: PROTECTION,
    mav.MAV_CMD_DO_MOTOR_TEST: PROTECTION,
    mav.MAV_CMD_DO_SET_MODE: _set_mode,
    mav.MAV_CMD_DO_SET_HOME: COURSE,
    mav.MAV_CMD_DO_SET_MISSION_CURRENT: COURSE,
    mav.MAV_CMD_DO_SET_RELAY: COURSE,
    mav.MAV_CMD_DO_SET_SERVO: COURSE,
    mav.MAV_CMD_NAV_RETURN_TO_LAUNCH: USUAL,
    mav.MAV_CMD_NAV_LAND: USUAL,
}
"""The severity of a command in flight, or what computes it from its first two parameters."""
MESSAGES: Final = {
    "SET_MODE": COURSE,
    "MISSION_CLEAR_ALL": PROTECTION,
    "MISSION_COUNT": COURSE,
    "MISSION_WRITE_PARTIAL_LIST": COURSE,
    "MISSION_SET_CURRENT": COURSE,
    "SET_HOME_POSITION": COURSE,
    "SET_GPS_GLOBAL_ORIGIN": COURSE,
    "RC_CHANNELS_OVERRIDE": COURSE,
    "MANUAL_CONTROL": COURSE,
    "SETUP_SIGNING": PROTECTION,
}
"""The severity in flight of messages that order something; that of SET_MODE depends on its mode."""
PROTECTED: Final = (
    "FS_",
    "FENCE_",
    "BATT_FS",
    "BATT_LOW",
    "BATT_CRT",
    "ARMING_",
    "SYSID_MYGCS",
    "BRD_SAFETY",
    "AVOID_",
)
"""Beginnings of the names of ArduPilot's parameters that protect an aircraft: failsafes, fence, checks, avoidance."""


class Order(NamedTuple):
    """An order: its frame, what it is called in alerts, and how severe it is in flight."""

    row: int
    name: str
    severity: float


@sky.detector("mavlink.commands")
class Commands(sky.MessageDetector):
    """Raises an alert for rare or dangerous MAVLink orders in flight, by severity.

    An order is judged by what was received of the aircraft before the last service.
    """

    airborne_m: sky.Number = sky.param(
        "Height above home from which an armed aircraft is in flight, in metres.", default=2.0, ge=0.0, le=1000.0
    )
    protected: Annotated[tuple[str, ...], BeforeValidator(sky.items, json_schema_input_type=list[str])] = sky.param(
        "Beginnings of the names of parameters that protect the aircraft.", default=PROTECTED
    )
    service_ns: sky.Time = 200 * sky.NS_PER_MS
    armed: Flags = sky.table(dtype=np.bool_)
    active: Flags = sky.table(dtype=np.bool_)
    height_m: Floats = sky.table(dtype=np.float64)
    heard: Flags = sky.table(256, dtype=np.bool_)
    """By place and system id: whether an autopilot of that system was heard."""

    def judge(self, now: sky.Time, frames: sky.ObservedFrames, heads: MessageHeads) -> Sequence[sky.Alert]:
        """Read orders and telemetry since the last service. Returns an alert for each place that begins or doubles."""
        self.grow(len(frames.ports), armed=False, active=False, height_m=np.nan, heard=False)
        down = heads.take(heads.to_vehicle)
        orders = sorted(self._orders(frames.take(down.rows), down.messages))
        flying = self.armed & np.where(np.isnan(self.height_m), self.active, self.height_m >= self.airborne_m)
        rows = np.array([order.row for order in orders], dtype=np.int64)
        places, at_ns = down.places[rows], down.at_ns[rows]
        severity = np.array([order.severity for order in orders], dtype=np.float64)
        scores = np.where(flying[places], severity, severity * ON_GROUND)
        raised, raised_scores = self.episodes.update(at_ns, places, scores)
        alerts = []
        for row, score in zip(raised.tolist(), raised_scores.tolist(), strict=True):
            data = {"order": orders[row].name, "in_flight": int(flying[places[row]])}
            alerts.append(self.alert(int(at_ns[row]), frames.ports[int(places[row])].link, score, data))
        self._follow(frames, heads.rows[~heads.to_vehicle])
        return alerts

    def _orders(self, frames: sky.ObservedFrames, messages: sky.Ints) -> Iterator[Order]:
        """The orders to aircraft of their places, or to all, among frames that have these messages."""
        numbers, present = message_numbers(), set(np.unique(messages).tolist())
        for name in ("COMMAND_LONG", "COMMAND_INT", *MESSAGES, "PARAM_SET"):
            if numbers[name] in present:
                read = sky.read_messages(frames, name)
                targets = read.values["target" if name == "MANUAL_CONTROL" else "target_system"]
                heard = self.heard[frames.places[read.rows]]
                counts = (targets == 0) | heard[np.arange(len(targets)), targets] | ~heard.any(axis=1)
                for row, value in zip(read.rows[counts].tolist(), read.values[counts], strict=True):
                    order = self._judge_order(name, value)
                    if order is not None:
                        yield Order(row, *order)

    def _judge_order(self, message: str, value: Any) -> tuple[str, float] | None:
        """What an order is called, and how severe it is in flight."""
        if message == "PARAM_SET":
            parameter = bytes(value["param_id"]).decode("ascii", "replace")
            return f"PARAM_SET {parameter}", PROTECTION if parameter.startswith(self.protected) else COURSE
        if message in MESSAGES:
            return message, _mode(float(value["custom_mode"])) if message == "SET_MODE" else MESSAGES[message]
        severity = COMMANDS.get(int(value["command"]))
        if severity is None:
            return None
        if callable(severity):
            severity = severity(float(value["param1"]), float(value["param2"]))
        return str(mav.enums["MAV_CMD"][int(value["command"])].name).removeprefix("MAV_CMD_"), severity

    def _follow(self, frames: sky.ObservedFrames, from_vehicle: sky.Ints) -> None:
        """Keep the state of the aircraft: the systems, the last heartbeat and the height of each place."""
        up = frames.take(from_vehicle)
        beats = sky.read_messages(up, "HEARTBEAT")
        from_autopilot = beats.components == mav.MAV_COMP_ID_AUTOPILOT1
        places = up.places[beats.rows[from_autopilot]]
        self.heard[places, beats.systems[from_autopilot]] = True
        self.armed[places] = beats.values["base_mode"][from_autopilot] & mav.MAV_MODE_FLAG_SAFETY_ARMED != 0
        self.active[places] = beats.values["system_status"][from_autopilot] >= mav.MAV_STATE_ACTIVE
        positions = sky.read_messages(up, "GLOBAL_POSITION_INT")
        self.height_m[up.places[positions.rows]] = positions.values["relative_alt"] / 1000.0
