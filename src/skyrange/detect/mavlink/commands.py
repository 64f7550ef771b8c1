"""MAVLink command detector: rare or dangerous orders to an aircraft in flight, scored by severity.

It reads the orders that travel towards the autopilot at a link end, and from the autopilot HEARTBEAT and
GLOBAL_POSITION_INT. The aircraft is *in flight* if it is armed (MAV_MODE_FLAG_SAFETY_ARMED) and above `airborne_m`, or,
while no height was received, if its status is MAV_STATE_ACTIVE. The rule: each order has a severity in flight and one
on the ground; the score is the severity.

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

from collections.abc import Callable, Sequence
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field

from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.alerts import Alert
from skyrange.contracts.detectors import DetectorContext, DetectorPlugin
from skyrange.contracts.frames.payloads import Ints
from skyrange.contracts.monitors import Monitor, ObservedFrames
from skyrange.contracts.params import Number, items
from skyrange.core.time import NS_PER_MS, Time
from skyrange.detect.episodes import EpisodeParams, Episodes, subject_of_link
from skyrange.detect.mavlink.heads import message_numbers, read_heads
from skyrange.detect.telemetry import read_messages

KIND = "mavlink.commands"
ABOUT = "Raises an alert for rare or dangerous MAVLink orders in flight, by severity."
SERVICE_NS: Time = 200 * NS_PER_MS
WORST, PROTECTION, COURSE, USUAL = 4.0, 2.0, 1.0, 0.5
ON_GROUND: Final = 0.1
"""Share of the severity that an order has on the ground."""
SAFE_MODES: Final = frozenset(
    {mav.COPTER_MODE_RTL, mav.COPTER_MODE_SMART_RTL, mav.COPTER_MODE_LAND, mav.COPTER_MODE_BRAKE}
)
_FORCE: Final = 21196.0
"""Param 2 of MAV_CMD_COMPONENT_ARM_DISARM that disarms in flight."""


class Order(NamedTuple):
    """An order: what it is called in alerts, and how severe it is in flight."""

    name: str
    severity: float


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


def _worst(p1: float, p2: float) -> float:
    return WORST


def _protection(p1: float, p2: float) -> float:
    return PROTECTION


def _course(p1: float, p2: float) -> float:
    return COURSE


def _usual(p1: float, p2: float) -> float:
    return USUAL


COMMANDS: Final[dict[int, Callable[[float, float], float]]] = {
    mav.MAV_CMD_DO_FLIGHTTERMINATION: _termination,
    mav.MAV_CMD_COMPONENT_ARM_DISARM: _disarm,
    mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _worst,
    mav.MAV_CMD_DO_PARACHUTE: _parachute,
    mav.MAV_CMD_DO_FENCE_ENABLE: _fence,
    mav.MAV_CMD_PREFLIGHT_CALIBRATION: _protection,
    mav.MAV_CMD_PREFLIGHT_SET_SENSOR_OFFSETS: _protection,
    mav.MAV_CMD_PREFLIGHT_STORAGE: _protection,
    mav.MAV_CMD_DO_MOTOR_TEST: _protection,
    mav.MAV_CMD_DO_SET_MODE: _set_mode,
    mav.MAV_CMD_DO_SET_HOME: _course,
    mav.MAV_CMD_DO_SET_MISSION_CURRENT: _course,
    mav.MAV_CMD_DO_SET_RELAY: _course,
    mav.MAV_CMD_DO_SET_SERVO: _course,
    mav.MAV_CMD_NAV_RETURN_TO_LAUNCH: _usual,
    mav.MAV_CMD_NAV_LAND: _usual,
}
"""The severity of a command in flight, from its first two parameters."""

MESSAGES: Final[dict[str, Callable[[Any], float]]] = {
    "SET_MODE": lambda row: _mode(float(row["custom_mode"])),
    "MISSION_CLEAR_ALL": lambda row: PROTECTION,
    "MISSION_COUNT": lambda row: COURSE,
    "MISSION_WRITE_PARTIAL_LIST": lambda row: COURSE,
    "MISSION_SET_CURRENT": lambda row: COURSE,
    "SET_HOME_POSITION": lambda row: COURSE,
    "SET_GPS_GLOBAL_ORIGIN": lambda row: COURSE,
    "RC_CHANNELS_OVERRIDE": lambda row: COURSE,
    "MANUAL_CONTROL": lambda row: COURSE,
    "SETUP_SIGNING": lambda row: PROTECTION,
}
"""The severity in flight of messages that order something."""

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


class CommandsParams(EpisodeParams):
    """Parameters of the MAVLink command detector."""

    airborne_m: Number = Field(
        default=2.0,
        ge=0.0,
        le=1000.0,
        description="Height above home from which an armed aircraft is in flight, in metres.",
    )
    protected: Annotated[tuple[str, ...], BeforeValidator(items, json_schema_input_type=list[str])] = Field(
        default=PROTECTED, description="Beginnings of the names of parameters that protect the aircraft."
    )


class CommandsDetector:
    """A `skyrange.contracts.monitors.Monitor`. The subject of an alert is the owner of the link.

    An order is judged by what was received of the aircraft before the last service.
    """

    service_ns: Time = SERVICE_NS

    def __init__(self, params: CommandsParams) -> None:
        self._params = params
        self._armed = np.zeros(0, dtype=np.bool_)
        self._active = np.zeros(0, dtype=np.bool_)
        self._height_m = np.zeros(0)
        self._episodes = Episodes(params)

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Read orders and telemetry since the last service. Returns an alert for each place that begins or doubles."""
        count = len(frames.ports)
        if len(self._armed) != count:
            self._armed, self._active = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
            self._height_m = np.full(count, np.nan)
        if not len(frames):
            return []
        heads = read_heads(frames)
        orders = self._orders(frames, heads.rows[heads.to_vehicle])
        flying = self._armed & np.where(
            np.isnan(self._height_m), self._active, self._height_m >= self._params.airborne_m
        )
        rows = np.array(sorted(orders), dtype=np.int64)
        places = frames.places[rows]
        severity = np.array([orders[row].severity for row in rows.tolist()], dtype=np.float64)
        scores = np.where(flying[places], severity, severity * ON_GROUND)
        at_ns = np.maximum(frames.at_ns[rows], 0)
        raised, found = self._episodes.update(at_ns, places, scores)
        alerts = []
        for row, score in zip(raised.tolist(), found.tolist(), strict=True):
            link = frames.ports[int(places[row])].link
            data: dict[str, str | int] = {
                "link": link,
                "order": orders[int(rows[row])].name,
                "in_flight": int(flying[places[row]]),
            }
            alerts.append(Alert(int(at_ns[row]), subject_of_link(link), KIND, score, data))
        self._follow(frames, heads.rows[~heads.to_vehicle])
        return alerts

    def _orders(self, frames: ObservedFrames, to_vehicle: Ints) -> dict[int, Order]:
        """The orders by their rows."""
        found: dict[int, Order] = {}
        down = frames.take(to_vehicle)
        if not len(down):
            return found
        present = set(np.unique(read_heads(down).messages).tolist())
        numbers = message_numbers()
        for name in ("COMMAND_LONG", "COMMAND_INT"):
            if numbers[name] in present:
                read = read_messages(down, name)
                for row, value in zip(read.rows.tolist(), read.values, strict=True):
                    judge = COMMANDS.get(int(value["command"]))
                    if judge is not None:
                        severity = judge(float(value["param1"]), float(value["param2"]))
                        found[int(to_vehicle[row])] = Order(_command_name(int(value["command"])), severity)
        for name, rate in MESSAGES.items():
            if numbers[name] in present:
                read = read_messages(down, name)
                for row, value in zip(read.rows.tolist(), read.values, strict=True):
                    found[int(to_vehicle[row])] = Order(name, rate(value))
        if numbers["PARAM_SET"] in present:
            read = read_messages(down, "PARAM_SET")
            for row, value in zip(read.rows.tolist(), read.values, strict=True):
                parameter = bytes(value["param_id"]).decode("ascii", "replace")
                severity = PROTECTION if parameter.startswith(self._params.protected) else COURSE
                found[int(to_vehicle[row])] = Order(f"PARAM_SET {parameter}", severity)
        return found

    def _follow(self, frames: ObservedFrames, from_vehicle: Ints) -> None:
        """Keep the state of the aircraft: the last heartbeat and height of each place."""
        up = frames.take(from_vehicle)
        beats = read_messages(up, "HEARTBEAT")
        own = beats.components == mav.MAV_COMP_ID_AUTOPILOT1
        places = up.places[beats.rows[own]]
        self._armed[places] = beats.values["base_mode"][own] & mav.MAV_MODE_FLAG_SAFETY_ARMED != 0
        self._active[places] = beats.values["system_status"][own] >= mav.MAV_STATE_ACTIVE
        positions = read_messages(up, "GLOBAL_POSITION_INT")
        self._height_m[up.places[positions.rows]] = positions.values["relative_alt"] / 1000.0


def _command_name(command: int) -> str:
    return str(mav.enums["MAV_CMD"][command].name).removeprefix("MAV_CMD_")


def make_commands_detector(params: CommandsParams, context: DetectorContext | None = None) -> Monitor:
    """A new detector."""
    return CommandsDetector(params)


MAVLINK_COMMANDS = DetectorPlugin(CommandsParams, make_commands_detector, ABOUT)
