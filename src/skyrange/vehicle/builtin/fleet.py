"""Shared state of the autopilot: the arrays of the fleet, one object per aircraft, and the outbox.

`Fleet` holds the arrays and the objects (`Vehicle`) and is passed to every handler. A handler reads and writes one
aircraft and its row, nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.agent.messages import Outbox, Scalar
from skyrange.codec.mavlink import dialect
from skyrange.codec.numbering import RowPacker
from skyrange.core.geodesy import Origin
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NEVER, Epoch, Time
from skyrange.vehicle.builtin.layout import LEGS, Control, Records, zeros
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.parameters import HIGH, INDEX, LOW, PARAMETERS
from skyrange.vehicle.builtin.watch_layout import BOUNDARY, POWER, WATCH, ZONES

Causes = tuple[FrameId, ...]
COMPONENT = 1
"""MAV_COMP_ID_AUTOPILOT1."""
CHANNELS = 8
"""Number of RC channels of the receiver."""
TEXT_MAX = 50
"""Characters that fit one STATUSTEXT."""


class Timer(IntEnum):
    """Timers of an aircraft: columns of `Fleet.timers`."""

    UPLOAD = 0
    """The next mission item of an upload is overdue."""
    HOLD = 1
    """The end of a wait at a waypoint or above home."""
    LANDED = 2
    """The motors have spooled down after a landing."""
    IDLE = 3
    """Armed on the ground for too long (DISARM_DELAY)."""
    STALE = 4
    """A GUIDED target times out (GUID_TIMEOUT)."""
    PARAMS = 5
    """The next values of a parameter list are due."""
    STICKS = 6
    """An RC override times out (RC_OVERRIDE_TIME)."""
    CONDITION = 7
    """The next check of the condition that DO commands wait for."""


@dataclass(slots=True)
class Slot:
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


@dataclass(slots=True)
class Upload:
    """A mission upload in progress, or none (`active` false)."""

    active: bool = False
    next: int = 0
    last: int = 0
    partner: tuple[int, int] = (0, 0)
    received_ns: Time = 0
    asked_ns: Time = 0
    items: list[Slot | None] = field(default_factory=list)
    """The items of a fence received so far; a fence takes effect as a whole."""


class MissionState(IntEnum):
    """MAVLink's MISSION_STATE as ArduPilot uses it: a mission that AUTO has left is "not started", not "paused"."""

    NONE = 1
    NOT_STARTED = 2
    ACTIVE = 3
    PAUSED = 4
    """Reported while `Vehicle.paused`; never stored."""
    COMPLETE = 5


class Stage(IntEnum):
    """Sub-mode of a return or a landing (ArduCopter's ModeRTL::SubMode and ModeAuto::SubMode)."""

    NONE = 0
    CLIMB = 1
    RETURN = 2
    LOITER = 3
    DESCEND = 4
    LAND = 5
    TRANSIT = 6
    """Flying to a landing place or the edge of a circle, or waiting there."""


@dataclass(slots=True)
class Craft:
    """The message-rate state of one aircraft. Its numbers are in row `row` of the fleet's arrays."""

    id: str
    row: int
    system_id: int
    port: Port
    packer: RowPacker
    home: tuple[float, float, float]
    """East, north, up of home in metres."""
    mode: int = 0
    mode_causes: Causes = ()
    mode_reason: str = ""
    """Why the mode was chosen: ArduCopter's ModeReason in lower case."""
    mission: list[Slot] = field(default_factory=list)
    """Item 0 is a placeholder for home, as in ArduPilot."""
    fence: list[Slot] = field(default_factory=list)
    rally: list[Slot] = field(default_factory=list)
    uploads: list[Upload] = field(default_factory=lambda: [Upload(), Upload(), Upload()])
    """By MAV_MISSION_TYPE: missions, fences and rally points are uploaded independently."""
    warned: set[tuple[int, int]] = field(default_factory=set)
    """(MAV_MISSION_TYPE, message id) of the deprecated messages reported since the last upload began."""
    mission_state: int = MissionState.NONE
    current: int = 0
    """Sequence number of the navigation command in progress, 0 for none."""
    flown: Slot | None = None
    """That item as it was when it started, `None` before: an upload may since have rewritten or removed it."""
    ahead: tuple[object, ...] = ()
    """Contents of it and of the navigation commands after it at that time, to detect a changed mission."""
    jumps: dict[int, int] = field(default_factory=dict)
    """How often each DO_JUMP has jumped."""
    in_landing: bool = False
    """The mission is in its landing sequence (AP_Mission's `in_landing_sequence`)."""
    auto_rtl: bool = False
    """AUTO was entered to fly the landing sequence and is reported as AUTO_RTL."""
    resumes: bool = False
    """AUTO continues with the current item when it is next entered, whatever MIS_RESTART says."""
    paused: bool = False
    """DO_PAUSE_CONTINUE has paused it, in AUTO or GUIDED."""
    beneath: tuple[tuple[str, Any], ...] = ()
    """The targets that a paused GUIDED continues with: fields of its row in `Fleet.flight`."""
    stage: int = Stage.NONE
    circles: int = -1
    """Completed turns of LOITER_TURNS, -1 before the first was reported (ArduCopter's `circle_last_num_complete`)."""
    return_to: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Destination of the present return: home or a rally point, ENU metres."""
    ready: bool = False
    """Allowed to leave the ground (ArduPilot's `auto_armed`)."""
    target_causes: Causes = ()
    do_next: int = 0
    """The DO command that is due while the navigation command is flown, 0 for none."""
    condition: tuple[int, float] = (0, 0.0)
    """The CONDITION command that DO commands wait for, and its end time (ns) or distance (m); 0 for none."""
    reached: dict[int, Time] = field(default_factory=dict)
    """When each item was last reached."""
    overrides: dict[int, tuple[int, Time]] = field(default_factory=dict)
    """RC channels that MAVLink overrides: µs, and since when."""
    params_next: int = 0
    bad_frames: int = 0
    ignored: int = 0
    rid_error: str = ""
    """Reason given by the Remote ID transmitter for not being ready to arm."""
    home_locked: bool = False
    """Home was set by command: arming does not move it."""
    armed_yaw: float = 0.0
    """Yaw when it was armed, rad from east to north."""
    untold: int = 0
    """The navigation command that was reached and not yet reported, 0 for none."""
    erased: bool = False
    """Its parameters were erased, which takes effect at the next boot."""
    unsaved: dict[int, float] = field(default_factory=dict)
    """Parameters (by index) changed only until the next boot, with the values they return to."""

    @property
    def shown_mode(self) -> int:
        """HEARTBEAT.custom_mode (`Mode::mode_number`)."""
        return Mode.AUTO_RTL if self.auto_rtl else self.mode

    @property
    def sees_mission(self) -> bool:
        """Whether there is a mission to fly: more items than home."""
        return len(self.mission) > 1


class Fleet:
    """All aircraft of one engine: arrays by row, objects in the same order, and the outbox."""

    def __init__(
        self, crafts: list[Craft], origin: Origin, epoch: Epoch, estimate: Records, flight: Records, settings: Records
    ) -> None:
        self.crafts = crafts
        self.origin = origin
        self.epoch = epoch
        self.estimate = estimate
        self.flight = flight
        self.settings = settings
        self.legs = zeros(LEGS, len(crafts))
        self.power: Records = np.zeros(len(crafts), dtype=POWER)
        self.boundary: Records = np.zeros(len(crafts), dtype=BOUNDARY)
        self.zones: Records = np.zeros(len(crafts), dtype=ZONES)
        self.watch: Records = np.zeros(len(crafts), dtype=WATCH)
        self.timers: NDArray[np.int64] = np.full((len(crafts), len(Timer)), NEVER, dtype=np.int64)
        self.next_timer: Time = NEVER
        """No timer expires before this time."""
        self.now: Time = 0
        self.outbox = Outbox()
        count = len(crafts)
        self.actuators: NDArray[np.float64] = np.zeros((count, 4))
        """(n, motors) the last motor commands, 0…1."""
        self.rotors: NDArray[np.float64] = np.zeros((count, 4))
        """(n, motors) rad/s, the last speeds measured by the speed controllers."""
        self.channels: NDArray[np.int64] = np.zeros((count, CHANNELS), dtype=np.int64)
        """(n, channels) µs, from the receiver or an override."""
        self.stored: NDArray[np.float64] = np.zeros((count, len(PARAMETERS)))
        """(n, parameters) values as written; `param` and `settings` hold them inside their ranges."""
        self.sequences: NDArray[np.int64] = crafts[0].packer.sequences
        """(n,) sequence number of the next frame."""
        self.systems: NDArray[np.int64] = np.array([craft.system_id for craft in crafts], dtype=np.int64)
        """(n,) MAVLink system ids in use."""
        self.modes: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        """(n,) reported mode of each aircraft."""
        self.boot_ns: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        """(n,) boot time of each aircraft."""
        self.rebooted: list[str] = []
        """Aircraft that rebooted in this tick."""

    def send(self, craft: Craft, message: Any, causes: Causes = ()) -> None:
        """Pack and send one message from an aircraft."""
        self.outbox.send(craft.port, craft.packer.pack(message), causes)

    def text(self, craft: Craft, severity: int, words: str, causes: Causes = ()) -> None:
        """Send STATUSTEXT, cut to the length of one message."""
        self.send(craft, dialect.MAVLink_statustext_message(severity, words.encode()[:TEXT_MAX]), causes)

    def note(self, kind: str, craft: Craft, data: Mapping[str, Scalar] | None = None, causes: Causes = ()) -> None:
        """Record an event of an aircraft."""
        self.outbox.note(kind, craft.id, data, causes)

    def take_mode(self, craft: Craft, mode: int) -> None:
        """Record that an aircraft is in a mode."""
        craft.mode = self.modes[craft.row] = mode
        craft.auto_rtl = False

    def show_auto_rtl(self, craft: Craft, shown: bool) -> None:
        """Start or stop to report AUTO as AUTO_RTL."""
        craft.auto_rtl = shown
        self.modes[craft.row] = craft.shown_mode

    def take_home(self, craft: Craft, place: tuple[float, float, float]) -> None:
        """Set an aircraft's home to a place (ENU metres)."""
        craft.home = place
        self.watch["home"][craft.row] = place

    def timer(self, craft: Craft, timer: Timer, at: Time = NEVER) -> None:
        """Set a timer; NEVER clears it."""
        self.timers[craft.row, timer] = at
        self.next_timer = min(self.next_timer, at)

    def param(self, craft: Craft, name: str) -> float:
        """Return a parameter's value in its own unit, inside its range."""
        index = INDEX[name]
        return min(max(float(self.stored[craft.row, index]), float(LOW[index])), float(HIGH[index]))

    def armed(self, craft: Craft) -> bool:
        """Whether the motors may turn."""
        return bool(self.flight["armed"][craft.row])

    def landed(self, craft: Craft) -> bool:
        """Whether it stands on the ground, according to the landing detector."""
        return bool(self.flight["landed"][craft.row])

    def control(self, craft: Craft) -> int:
        """Return its `ControlMode`."""
        return int(self.flight["control"][craft.row])

    def position(self, craft: Craft) -> tuple[float, float, float]:
        """Return its estimated position, ENU metres."""
        east, north, up = self.estimate["pos"][craft.row].tolist()
        return east, north, up

    def limits(self, craft: Craft) -> None:
        """Set speed and acceleration limits to the WPNAV parameters, the initial values in every mode."""
        row, flight = craft.row, self.flight
        flight["speed_xy"][row] = self.param(craft, "WPNAV_SPEED") * 0.01
        flight["speed_up"][row] = self.param(craft, "WPNAV_SPEED_UP") * 0.01
        flight["speed_down"][row] = self.param(craft, "WPNAV_SPEED_DN") * 0.01
        flight["accel_xy"][row] = self.param(craft, "WPNAV_ACCEL") * 0.01
        flight["accel_z"][row] = self.param(craft, "WPNAV_ACCEL_Z") * 0.01
        flight["replan"][row] = 0

    def fly(self, craft: Craft, control: Control, target_vel: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        """Set the control mode and velocity target of a flying aircraft; the reference continues from where it is."""
        row = craft.row
        self.flight["control"][row] = control
        self.flight["target_vel"][row] = target_vel
        self.flight["target_acc"][row] = 0.0
        self.flight["pause_s"][row] = 0.0
        self.flight["blind"][row] = 0
