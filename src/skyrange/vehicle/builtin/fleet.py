"""What does the autopilot know of each aircraft, and how does it speak? The state that all its parts share.

`Fleet` holds the arrays and the objects (`Craft`), and is handed to every handler; a handler reads and
writes one craft and its row, nothing else.
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
from skyrange.vehicle.builtin.fence_zones import ZONES
from skyrange.vehicle.builtin.layout import LEGS, Control, Records, zeros
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.parameters import HIGH, INDEX, LOW, PARAMETERS
from skyrange.vehicle.builtin.watch_layout import BOUNDARY, POWER, WATCH

Causes = tuple[FrameId, ...]
COMPONENT = 1
"""MAV_COMP_ID_AUTOPILOT1."""
CHANNELS = 8
"""Radio channels of the receiver."""
TEXT_MAX = 50
"""Characters of one STATUSTEXT."""


class Timer(IntEnum):
    """What a craft may be waiting for: columns of `Fleet.timers`."""

    UPLOAD = 0
    """The next mission item of an upload."""
    HOLD = 1
    """The end of a wait at a waypoint or above home."""
    LANDED = 2
    """Motors have spooled down after landing."""
    IDLE = 3
    """Armed on the ground for too long."""
    STALE = 4
    """A velocity target runs out."""
    PARAMS = 5
    """The next values of a parameter list."""
    STICKS = 6
    """A pilot's stick that MAVLink set runs out."""
    CONDITION = 7
    """The next look at what a mission's DO items wait for."""


@dataclass(slots=True)
class Slot:
    """One mission item as stored: MISSION_ITEM_INT's fields; `causes` is the frame that wrote it."""

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
    """A mission transfer under way, or none (`active` false)."""

    active: bool = False
    next: int = 0
    last: int = 0
    partner: tuple[int, int] = (0, 0)
    received_ns: Time = 0
    asked_ns: Time = 0
    items: list[Slot | None] = field(default_factory=list)
    """What has come of a fence, which is put in force as a whole."""


class MissionState(IntEnum):
    """MAVLink's MISSION_STATE values as ArduPilot uses them: one that was left is "not started", not "paused"."""

    NONE = 1
    NOT_STARTED = 2
    ACTIVE = 3
    PAUSED = 4
    """Told while `Craft.paused`, never a craft's own state."""
    COMPLETE = 5


class Stage(IntEnum):
    """Where a return or a landing stands."""

    NONE = 0
    CLIMB = 1
    RETURN = 2
    LOITER = 3
    DESCEND = 4
    LAND = 5
    TRANSIT = 6
    """Flying to a landing place, or waiting there as a waypoint asks."""


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
    """By MAV_MISSION_TYPE: missions, fences and rally points are transferred apart."""
    warned: set[tuple[int, int]] = field(default_factory=set)
    """(MAV_MISSION_TYPE, message id) of the old messages that were warned about since the last upload began."""
    mission_state: int = MissionState.NONE
    current: int = 0
    """Sequence number of the navigation item under way, 0 for none."""
    flown: Slot | None = None
    """That item as it was when started, `None` before: an upload may rewrite or remove its slot meanwhile."""
    ahead: tuple[object, ...] = ()
    """What it and the navigation items behind it said then: whether a new mission changes them."""
    jumps: dict[int, int] = field(default_factory=dict)
    """How often each DO_JUMP has jumped."""
    in_landing: bool = False
    """The mission is in its landing sequence (AP_Mission's `in_landing_sequence`)."""
    auto_rtl: bool = False
    """AUTO was entered to fly the landing sequence: it is shown as AUTO_RTL."""
    resumes: bool = False
    """AUTO goes on with the current item when it is entered next, whatever MIS_RESTART says."""
    paused: bool = False
    """DO_PAUSE_CONTINUE holds it, in AUTO or GUIDED."""
    beneath: tuple[tuple[str, Any], ...] = ()
    """What a paused GUIDED flies when it goes on: fields of its row in `Fleet.flight`."""
    stage: int = Stage.NONE
    circles: int = -1
    """Whole turns flown of a circle, -1 before its first has been told."""
    return_to: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the present return leads: home or a rally point."""
    ready: bool = False
    """Allowed to leave the ground (ArduPilot's `auto_armed`)."""
    target_causes: Causes = ()
    do_next: int = 0
    """The DO item that is due while the navigation item under way is flown, 0 for none."""
    condition: tuple[int, float] = (0, 0.0)
    """The CONDITION item that DO items wait for, and its number: the time it ends, or metres; 0 for none."""
    reached: dict[int, Time] = field(default_factory=dict)
    """When each item was reached last."""
    overrides: dict[int, tuple[int, Time]] = field(default_factory=dict)
    """RC channels that MAVLink sets: µs and since when."""
    params_next: int = 0
    bad_frames: int = 0
    ignored: int = 0
    rid_error: str = ""
    """Why its Remote ID transmitter says that it may not be armed."""
    home_locked: bool = False
    """Home was set by command: arming does not move it."""
    armed_yaw: float = 0.0
    """Where the nose pointed when it was armed, rad from east to north."""
    untold: int = 0
    """The navigation item that is reached and not told yet."""
    erased: bool = False
    """Its parameters were erased, which the next boot shows."""
    unsaved: dict[int, float] = field(default_factory=dict)
    """Parameters (by index) that were changed only until the next boot, and what they are then."""

    @property
    def shown_mode(self) -> int:
        """HEARTBEAT.custom_mode (`Mode::mode_number`)."""
        return Mode.AUTO_RTL if self.auto_rtl else self.mode

    @property
    def sees_mission(self) -> bool:
        """Whether there is anything to fly: more than the home item."""
        return len(self.mission) > 1


class Fleet:
    """All aircraft of one engine: arrays by row, crafts in the same order, and the way out."""

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
        """No timer runs out before."""
        self.now: Time = 0
        self.outbox = Outbox()
        count = len(crafts)
        self.actuators: NDArray[np.float64] = np.zeros((count, 4))
        """(n, motors) the last commands, 0…1."""
        self.rotors: NDArray[np.float64] = np.zeros((count, 4))
        """(n, motors) rad/s, as the speed controllers measured them last."""
        self.channels: NDArray[np.int64] = np.zeros((count, CHANNELS), dtype=np.int64)
        """(n, channels) µs, as the receiver or an override says."""
        self.stored: NDArray[np.float64] = np.zeros((count, len(PARAMETERS)))
        """(n, parameters) what was written to each parameter; `param` and `settings` hold it inside its range."""
        self.sequences: NDArray[np.int64] = crafts[0].packer.sequences
        """(n,) the next frame's number."""
        self.systems: NDArray[np.int64] = np.array([craft.system_id for craft in crafts], dtype=np.int64)
        """(n,) MAVLink system ids in use."""
        self.modes: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        """(n,) each craft's mode as it is shown, for reports."""
        self.boot_ns: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        """(n,) when each was switched on."""
        self.rebooted: list[str] = []
        """Aircraft that were switched off and on in this tick."""

    def send(self, craft: Craft, message: Any, causes: Causes = ()) -> None:
        """Pack and send one message from a craft."""
        self.outbox.send(craft.port, craft.packer.pack(message), causes)

    def text(self, craft: Craft, severity: int, words: str, causes: Causes = ()) -> None:
        """STATUSTEXT, cut to one message's length."""
        self.send(craft, dialect.MAVLink_statustext_message(severity, words.encode()[:TEXT_MAX]), causes)

    def note(self, kind: str, craft: Craft, data: Mapping[str, Scalar] | None = None, causes: Causes = ()) -> None:
        """Record an event about a craft."""
        self.outbox.note(kind, craft.id, data, causes)

    def take_mode(self, craft: Craft, mode: int) -> None:
        """Say that a craft is in a mode from now on."""
        craft.mode = self.modes[craft.row] = mode
        craft.auto_rtl = False

    def show_auto_rtl(self, craft: Craft, shown: bool) -> None:
        """Show AUTO as AUTO_RTL from now on, or no longer."""
        craft.auto_rtl = shown
        self.modes[craft.row] = craft.shown_mode

    def take_home(self, craft: Craft, place: tuple[float, float, float]) -> None:
        """Say that a craft's home is at a place (ENU metres) from now on."""
        craft.home = place
        self.watch["home"][craft.row] = place

    def timer(self, craft: Craft, timer: Timer, at: Time = NEVER) -> None:
        """Set a timer to a moment; NEVER clears it."""
        self.timers[craft.row, timer] = at
        self.next_timer = min(self.next_timer, at)

    def param(self, craft: Craft, name: str) -> float:
        """A parameter's value in its own unit, inside its range."""
        index = INDEX[name]
        return min(max(float(self.stored[craft.row, index]), float(LOW[index])), float(HIGH[index]))

    def armed(self, craft: Craft) -> bool:
        """Whether the motors may turn."""
        return bool(self.flight["armed"][craft.row])

    def landed(self, craft: Craft) -> bool:
        """Whether it stands on the ground, as the landing detector has it."""
        return bool(self.flight["landed"][craft.row])

    def control(self, craft: Craft) -> int:
        """What the array side does with it."""
        return int(self.flight["control"][craft.row])

    def position(self, craft: Craft) -> tuple[float, float, float]:
        """Where it believes to be, ENU metres."""
        east, north, up = self.estimate["pos"][craft.row].tolist()
        return east, north, up

    def limits(self, craft: Craft) -> None:
        """Speeds and accelerations as the WPNAV parameters say: what every mode starts from."""
        row, flight = craft.row, self.flight
        flight["speed_xy"][row] = self.param(craft, "WPNAV_SPEED") * 0.01
        flight["speed_up"][row] = self.param(craft, "WPNAV_SPEED_UP") * 0.01
        flight["speed_down"][row] = self.param(craft, "WPNAV_SPEED_DN") * 0.01
        flight["accel_xy"][row] = self.param(craft, "WPNAV_ACCEL") * 0.01
        flight["accel_z"][row] = self.param(craft, "WPNAV_ACCEL_Z") * 0.01
        flight["replan"][row] = 0

    def fly(self, craft: Craft, control: Control, target_vel: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        """Give a flying craft another control and velocity target; the reference goes on from where it is."""
        row = craft.row
        self.flight["control"][row] = control
        self.flight["target_vel"][row] = target_vel
        self.flight["target_acc"][row] = 0.0
        self.flight["pause_s"][row] = 0.0
        self.flight["blind"][row] = 0
