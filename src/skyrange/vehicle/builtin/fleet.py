"""Shared state of the autopilot: the arrays of the fleet, one object per aircraft, and the outbox.

`Fleet` holds the arrays and the objects (`Vehicle`) and is passed to every handler. A handler reads and writes one
aircraft and its row, nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink.message_columns import FleetPacker
from skyrange.contracts.alerts import Scalar
from skyrange.contracts.mailboxes import Outbox
from skyrange.core.geodesy import Origin
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NEVER, Epoch, Time
from skyrange.vehicle.builtin.layout import (
    BATTERY_STATE,
    CHECK_STATE,
    FENCE_STATE,
    LEGS,
    ZONES,
    ControlMode,
    Records,
    new_records,
)
from skyrange.vehicle.builtin.memory_card import FileStore
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.parameters.table import INDEX, MAX_VALUES, MIN_VALUES, PARAMETERS
from skyrange.vehicle.builtin.range_readings.readings import RangeSensors
from skyrange.vehicle.builtin.utc_clocks import UtcClocks

Causes = tuple[FrameId, ...]
COMPONENT_ID = 1
"""MAV_COMP_ID_AUTOPILOT1."""
RC_CHANNELS = 8
"""Number of RC channels of the receiver."""
MAX_TEXT_CHARS = 50
"""Characters that fit one STATUSTEXT."""


class Timer(IntEnum):
    """Timers of an aircraft: columns of `Fleet.timers`."""

    UPLOAD = 0
    """The next mission item of an upload is overdue."""
    HOLD = 1
    """The end of a wait at a waypoint or above home."""
    LANDED = 2
    """The motors have spooled down after a landing."""
    DISARM_DELAY = 3
    """Armed on the ground for too long (DISARM_DELAY)."""
    GUIDED_TIMEOUT = 4
    """A GUIDED target times out (GUID_TIMEOUT)."""
    PARAM_LIST = 5
    """The next values of a parameter list are due."""
    RC_OVERRIDE = 6
    """An RC override times out (RC_OVERRIDE_TIME)."""
    CONDITION = 7
    """The next check of the condition that DO commands wait for."""
    FILE_BURST = 8
    """The next pieces of a file that is read in a burst."""
    FILE_IDLE = 9
    """No reply of the file server for a second: streams have their own pace again."""


class Slowdown(IntFlag):
    """Why an aircraft's streams are slower, each by a factor of four (`GCS_MAVLINK::get_reschedule_interval_ms`)."""

    NONE = 0
    PARAM_LIST = 1
    """A parameter list is being sent."""
    FILE_TRANSFER = 2
    """A reply of the file server was sent less than a second ago."""


@dataclass(slots=True)
class MissionItem:
    """One stored mission item: MISSION_ITEM_INT's fields; `causes` is the frame that wrote it."""

    command: int
    frame: int
    param1: float = 0.0
    param2: float = 0.0
    param3: float = 0.0
    param4: float = 0.0
    x: int = 0
    y: int = 0
    z: float = 0.0
    causes: Causes = ()


def all_causes(items: Sequence[MissionItem], last: Causes) -> Causes:
    """The frames that wrote these items, each once, then `last`, those that completed them."""
    return tuple(dict.fromkeys((*(cause for item in items for cause in item.causes), *last)))


@dataclass(slots=True)
class Upload:
    """A mission upload in progress, or none (`active` false)."""

    active: bool = False
    next: int = 0
    last: int = 0
    peer: tuple[int, int] = (0, 0)
    received_ns: Time = 0
    asked_ns: Time = 0
    items: list[MissionItem | None] = field(default_factory=list)
    """The items of a fence received so far; a fence takes effect as a whole."""


class MissionState(IntEnum):
    """MAVLink's MISSION_STATE as ArduPilot uses it: a mission that AUTO has left is "not started", not "paused"."""

    NONE = 1
    NOT_STARTED = 2
    ACTIVE = 3
    PAUSED = 4
    """Reported while `Vehicle.paused`; never stored."""
    COMPLETE = 5


class SubMode(IntEnum):
    """Sub-mode of a return or a landing (ArduCopter's ModeRTL::SubMode and ModeAuto::SubMode)."""

    NONE = 0
    INITIAL_CLIMB = 1
    RETURN_HOME = 2
    LOITER_AT_HOME = 3
    FINAL_DESCENT = 4
    LAND = 5
    TRANSIT = 6
    """Flying to a landing place or the edge of a circle, or waiting there."""


@dataclass(slots=True)
class OpenFile:
    """The file that a client of MAVLink FTP has opened."""

    path: str
    virtual: str
    """@PARAM or @MISSION for a file that stands for these, "" for one of the card."""
    writes: bool
    content: bytearray | bytes | None = None
    """What is read or written; `None` for parameters that were not read yet."""
    size: int = 0
    """Of @PARAM: in which pieces it is read, 0 before the first."""
    causes: Causes = ()
    """The frames that opened and wrote it."""


@dataclass(slots=True)
class Burst:
    """A burst of pieces of a file that is being sent."""

    peer: tuple[int, int]
    session: int
    sequence: int
    """Of the next piece."""
    offset: int
    size: int
    left: int
    """Pieces that it may still have."""


@dataclass(slots=True)
class FileServer:
    """State of MAVLink FTP of one aircraft: one session, as in ArduPilot 4.6."""

    file: OpenFile | None = None
    session: int = -1
    sent_ns: Time = 0
    """When it last answered."""
    last_reply: tuple[tuple[int, int], int, int, tuple[int, ...]] | None = None
    """Peer, session, sequence number and payload of the last reply: a request that comes again has it again."""
    burst: Burst | None = None
    waiting: list[tuple[tuple[int, int], bytes, Causes]] = field(default_factory=list)
    """Requests that wait for the end of a burst: peer, payload, causes."""


@dataclass(slots=True)
class Vehicle:
    """The message-rate state of one aircraft. Its numbers are in row `row` of the fleet's arrays."""

    id: str
    """Unique in the engine: its name, with its run where the engine flies several (`core.ids.qualify`)."""
    row: int
    system_id: int
    port: Port
    packer: FleetPacker
    home: tuple[float, float, float]
    """East, north, up of home in metres."""
    origin_e7: tuple[int, int]
    """Latitude and longitude where it was switched on, 1e-7 degrees: the origin of ArduPilot's EKF."""
    has_telemetry_radio: bool = False
    """Whether its control link is over a radio whose RADIO_STATUS it heeds."""
    stream_slowdown_ms: int = 0
    """What is added to every interval of its streams because the buffer of that radio fills."""
    mode: int = 0
    mode_causes: Causes = ()
    mode_reason: str = ""
    """Why the mode was chosen: ArduCopter's ModeReason in lower case."""
    mission: list[MissionItem] = field(default_factory=list)
    """Item 0 is a placeholder for home, as in ArduPilot."""
    fence: list[MissionItem] = field(default_factory=list)
    rally: list[MissionItem] = field(default_factory=list)
    uploads: list[Upload] = field(default_factory=lambda: [Upload(), Upload(), Upload()])
    """By MAV_MISSION_TYPE: missions, fences and rally points are uploaded independently."""
    legacy_warned: set[tuple[int, int]] = field(default_factory=set)
    """(MAV_MISSION_TYPE, message id) of the deprecated messages reported since the last upload began."""
    mission_state: int = MissionState.NONE
    current: int = 0
    """Sequence number of the navigation command in progress, 0 for none."""
    active_item: MissionItem | None = None
    """That item as it was when it started, `None` before: an upload may since have rewritten or removed it."""
    upcoming: tuple[object, ...] = ()
    """Contents of it and of the navigation commands after it at that time, to detect a changed mission."""
    jump_counts: dict[int, int] = field(default_factory=dict)
    """How often each DO_JUMP has jumped."""
    in_landing_sequence: bool = False
    """The mission is in its landing sequence (AP_Mission's `in_landing_sequence`)."""
    auto_rtl: bool = False
    """AUTO was entered to fly the landing sequence and is reported as AUTO_RTL."""
    resume_mission: bool = False
    """AUTO continues with the current item when it is next entered, whatever MIS_RESTART says."""
    paused: bool = False
    """DO_PAUSE_CONTINUE has paused it, in AUTO or GUIDED."""
    suspended_targets: tuple[tuple[str, Any], ...] = ()
    """The targets that a paused GUIDED continues with: fields of its row in `Fleet.flight`."""
    submode: int = SubMode.NONE
    circles_completed: int = -1
    """Completed turns of LOITER_TURNS, -1 before the first was reported (ArduCopter's `circle_last_num_complete`)."""
    return_target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Destination of the present return: home or a rally point, ENU metres."""
    auto_armed: bool = False
    """Allowed to leave the ground (ArduPilot's `auto_armed`)."""
    target_causes: Causes = ()
    speed_overrides: dict[str, float] = field(default_factory=dict)
    """Speeds that the mission has set, m/s, by field of `Fleet.flight` (ModeAuto's `desired_speed_override`)."""
    aux_functions: list[tuple[int, int, Causes]] = field(default_factory=list)
    """Auxiliary functions that the mission has triggered and that were not run yet: function, position, causes."""
    guided_limits: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """DO_GUIDED_LIMITS: seconds, lowest and highest altitude above the origin, horizontal distance, m; 0 for none."""
    guided_start: tuple[float, float, Time] = (0.0, 0.0, 0)
    """Where and when AUTO began to obey the targets of GUIDED: east, north, time."""
    next_do: int = 0
    """The DO command that is due while the navigation command is flown, 0 for none."""
    do_started: bool = False
    """It has started, and is complete once its condition is met."""
    condition: tuple[int, float] = (0, 0.0)
    """The CONDITION command that DO commands wait for, and its end time (ns) or distance (m); 0 for none."""
    reached_ns: dict[int, Time] = field(default_factory=dict)
    """When each item was last reached."""
    rc_overrides: dict[int, tuple[int, Time]] = field(default_factory=dict)
    """RC channels that MAVLink overrides: µs, and since when."""
    next_param: int = 0
    params_sent_ns: Time = 0
    """When values of the list were last sent, or the list requested."""
    slowdowns: Slowdown = Slowdown.NONE
    bad_frames: int = 0
    ignored_frames: int = 0
    rid_error: str = ""
    """Reason given by the Remote ID transmitter for not being ready to arm."""
    home_locked: bool = False
    """Home was set by command: arming does not move it."""
    armed_yaw: float = 0.0
    """Yaw when it was armed, rad from east to north."""
    item_to_report: int = 0
    """The navigation command that was reached and not yet reported, 0 for none."""
    params_erased: bool = False
    """Its parameters were erased, which takes effect at the next boot."""
    unsaved_params: dict[int, float] = field(default_factory=dict)
    """Parameters (by index) changed only until the next boot, with the values they return to."""
    card: FileStore = field(default_factory=FileStore)
    """Its memory card."""
    logged: bool = False
    """It was armed since its boot, so its log has begun."""
    log_refused: bool = False
    """It has told that logs are listed only while it is disarmed."""
    file_server: FileServer | None = None
    """The server of MAVLink FTP, from the first request on."""

    @property
    def flight_causes(self) -> Causes:
        """The frames that led to its present mode and target."""
        return tuple(dict.fromkeys((*self.mode_causes, *self.target_causes)))

    @property
    def reported_mode(self) -> int:
        """HEARTBEAT.custom_mode (`Mode::mode_number`)."""
        return Mode.AUTO_RTL if self.auto_rtl else self.mode

    @property
    def has_mission(self) -> bool:
        """Whether there is a mission to fly: more items than home."""
        return len(self.mission) > 1


class Fleet:
    """All aircraft of one engine: arrays by row, objects in the same order, and the outbox."""

    def __init__(
        self,
        vehicles: list[Vehicle],
        origin: Origin,
        epoch: Epoch,
        estimate: Records,
        flight: Records,
        settings: Records,
    ) -> None:
        self.vehicles = vehicles
        self.origin = origin
        self.clocks = UtcClocks(len(vehicles), epoch)
        self.estimate = estimate
        self.flight = flight
        self.settings = settings
        self.legs = new_records(LEGS, len(vehicles))
        self.battery: Records = np.zeros(len(vehicles), dtype=BATTERY_STATE)
        self.fence: Records = np.zeros(len(vehicles), dtype=FENCE_STATE)
        self.fence_zones: Records = np.zeros(len(vehicles), dtype=ZONES)
        self.checks: Records = np.zeros(len(vehicles), dtype=CHECK_STATE)
        self.timers: NDArray[np.int64] = np.full((len(vehicles), len(Timer)), NEVER, dtype=np.int64)
        self.next_timer: Time = NEVER
        """No timer expires before this time."""
        self.now: Time = 0
        self.outbox = Outbox()
        count = len(vehicles)
        self.actuators: NDArray[np.float64] = np.zeros((count, 4))
        """(n, motors) the last motor commands, 0…1."""
        self.rotor_speeds: NDArray[np.float64] = np.zeros((count, 4))
        """(n, motors) rad/s, the last speeds measured by the speed controllers."""
        self.rc_channels: NDArray[np.int64] = np.zeros((count, RC_CHANNELS), dtype=np.int64)
        """(n, channels) µs, from the receiver or an override."""
        self.stored_params: NDArray[np.float64] = np.zeros((count, len(PARAMETERS)))
        """(n, parameters) values as written; `param` and `settings` hold them inside their ranges."""
        self.sequences: NDArray[np.int64] = vehicles[0].packer.sequences
        """(n,) sequence number of the next frame."""
        self.system_ids: NDArray[np.int64] = np.array([vehicle.system_id for vehicle in vehicles], dtype=np.int64)
        """(n,) MAVLink system ids in use."""
        self.modes: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        """(n,) reported mode of each aircraft."""
        self.boot_ns: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        """(n,) boot time of each aircraft."""
        self.report_phases_ns: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        """(n,) phase of each aircraft's reports within a second."""
        self.stream_factors: dict[int, int] = {}
        """Rows whose streams change their pace, and how many times as long their intervals are."""
        self.stream_delays_ns: dict[int, Time] = {}
        """Rows whose streams change their pace, and what is added to each interval before that."""
        self.range_sensors: dict[int, RangeSensors] = {}
        """The range sensors of the rows that have any."""
        self.aux_pending = False
        """Whether any aircraft has `aux_functions` to run."""
        self.rebooted: list[str] = []
        """Aircraft that rebooted in this tick."""
        self.new_keys: list[tuple[int, tuple[bytes, int] | None]] = []
        """Rows of aircraft that were given a signing key in this tick, with its bytes and its timestamp; `None` for no
        key."""

    def send(self, vehicle: Vehicle, message: Any, causes: Causes = ()) -> None:
        """Pack and send one message from an aircraft."""
        self.outbox.send(vehicle.port, vehicle.packer.pack(message), causes)

    def send_text(self, vehicle: Vehicle, severity: int, text: str, causes: Causes = ()) -> None:
        """Send STATUSTEXT, cut to the length of one message."""
        self.send(vehicle, dialect.MAVLink_statustext_message(severity, text.encode()[:MAX_TEXT_CHARS]), causes)

    def note(self, kind: str, vehicle: Vehicle, data: Mapping[str, Scalar] | None = None, causes: Causes = ()) -> None:
        """Record an event of an aircraft."""
        self.outbox.note(kind, vehicle.id, data, causes)

    def assign_mode(self, vehicle: Vehicle, mode: int) -> None:
        """Record that an aircraft is in a mode."""
        vehicle.mode = self.modes[vehicle.row] = mode
        vehicle.auto_rtl = False

    def set_auto_rtl(self, vehicle: Vehicle, *, shown: bool) -> None:
        """Start or stop to report AUTO as AUTO_RTL."""
        vehicle.auto_rtl = shown
        self.modes[vehicle.row] = vehicle.reported_mode

    def assign_home(self, vehicle: Vehicle, place: tuple[float, float, float]) -> None:
        """Set an aircraft's home to a place (ENU metres)."""
        vehicle.home = place
        self.checks["home"][vehicle.row] = place

    def set_timer(self, vehicle: Vehicle, timer: Timer, at: Time = NEVER) -> None:
        """Set a timer; NEVER clears it."""
        self.timers[vehicle.row, timer] = at
        self.next_timer = min(self.next_timer, at)

    def slow_streams(self, vehicle: Vehicle, reason: Slowdown, *, on: bool) -> None:
        """Slow an aircraft's streams for a reason, or no longer."""
        slowdowns = vehicle.slowdowns | reason if on else vehicle.slowdowns & ~reason
        if slowdowns != vehicle.slowdowns:
            vehicle.slowdowns = slowdowns
            self.stream_factors[vehicle.row] = 4 ** slowdowns.bit_count()

    def param(self, vehicle: Vehicle, name: str) -> float:
        """Return a parameter's value in its own unit, inside its range."""
        index = INDEX[name]
        return min(
            max(float(self.stored_params[vehicle.row, index]), float(MIN_VALUES[index])), float(MAX_VALUES[index])
        )

    def armed(self, vehicle: Vehicle) -> bool:
        """Whether the motors may turn."""
        return bool(self.flight["armed"][vehicle.row])

    def landed(self, vehicle: Vehicle) -> bool:
        """Whether it stands on the ground, according to the landing detector."""
        return bool(self.flight["landed"][vehicle.row])

    def control(self, vehicle: Vehicle) -> int:
        """Return its `ControlMode`."""
        return int(self.flight["control"][vehicle.row])

    def position(self, vehicle: Vehicle) -> tuple[float, float, float]:
        """Return its estimated position, ENU metres."""
        east, north, up = self.estimate["pos"][vehicle.row].tolist()
        return east, north, up

    def set_default_limits(self, vehicle: Vehicle) -> None:
        """Set speed and acceleration limits to the WPNAV parameters, the initial values in every mode."""
        row, flight = vehicle.row, self.flight
        self.set_default_level_limits(vehicle)
        flight["speed_up"][row] = self.param(vehicle, "WPNAV_SPEED_UP") * 0.01
        flight["speed_down"][row] = self.param(vehicle, "WPNAV_SPEED_DN") * 0.01
        flight["accel_z"][row] = self.param(vehicle, "WPNAV_ACCEL_Z") * 0.01

    def set_default_level_limits(self, vehicle: Vehicle) -> None:
        """Set the horizontal limits of speed and acceleration to the WPNAV parameters, and keep the vertical ones."""
        row, flight = vehicle.row, self.flight
        flight["speed_xy"][row] = self.param(vehicle, "WPNAV_SPEED") * 0.01
        flight["accel_xy"][row] = self.param(vehicle, "WPNAV_ACCEL") * 0.01
        flight["speed_changed"][row] = 0

    def set_control(
        self, vehicle: Vehicle, control: ControlMode, target_vel: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> None:
        """Set the control mode and velocity target of a flying aircraft; the reference continues from where it is."""
        row = vehicle.row
        self.flight["control"][row] = control
        self.flight["target_vel"][row] = target_vel
        self.flight["target_acc"][row] = 0.0
        self.flight["land_delay_s"][row] = 0.0
        self.flight["land_nogps"][row] = 0
        self.flight["land_datum"][row] = 0.0
