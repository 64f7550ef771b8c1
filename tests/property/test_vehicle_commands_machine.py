"""Valid commands in any order, sent by a state machine to two aircraft: none brings one down.

What is drawn is what a sane ground station may send: any mode, mission, target, parameter or stick that does not itself
ask for a crash (no target below the ground, no motors off in the air, no gain that cannot fly). Whatever the order, an
aircraft keeps the invariants of `Flight.check`, every command has one answer, and all that is said can be decoded.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import Item, Range, square, start, takeoff
from tests.tiers import examples, is_fuzzing

pytestmark = pytest.mark.rotating

A = dialect
NAMES = ("blue/b1", "blue/b2")
HOMES = ((0.0, 0.0, 0.0), (1500.0, 0.0, 0.0))
OK, BUSY, DENIED, FAILED = 0, 1, 2, 4
STEP_S = 0.1
LOW_M = 8.0
"""Below it nothing is asked for that leads downwards but landing, nor any lean."""

# --- what must hold -------------------------------------------------------------------------------------------------
TILT_MAX_DEG = 75.0
"""The largest lean that is asked for is ANGLE_MAX, at most 45 degrees here; what is beyond has flipped."""
SINK_MAX_MPS = 7.0
"""The fastest descent that any parameter here allows is 5 m/s (WPNAV_SPEED_DN, LAND_SPEED_HIGH), and an overshoot."""
FAST_MPS = 32.0
"""WPNAV_SPEED reaches 20 m/s; leaning 45 degrees in ALT_HOLD or by SET_ATTITUDE_TARGET for seconds is faster."""
FAR_M = 900.0
"""Targets and missions stay within 100 m of home; velocities and leans of some seconds lead beyond."""
BELIEF_M, BELIEF_MPS, BELIEF_DEG = 6.0, 2.0, 12.0
"""How far the estimate may be from the truth: the receiver's own error is about 1.5 m (one standard deviation)."""
SHAKEN_S = 3.0
"""For so long after a touchdown the velocity may be wrong: at 2.5 m/s the accelerometer clips."""
GROUND_M = 0.3
"""An aircraft no higher stands on its gear."""

PARAMS: dict[str, tuple[float, float]] = {
    "WPNAV_SPEED": (50, 2000), "WPNAV_SPEED_UP": (50, 500), "WPNAV_SPEED_DN": (50, 500), "WPNAV_ACCEL": (50, 500),
    "WPNAV_ACCEL_Z": (50, 500), "WPNAV_ACCEL_C": (0, 500), "WPNAV_JERK": (1, 20), "WPNAV_RADIUS": (5, 1000),
    "RTL_ALT": (300, 5000), "RTL_ALT_FINAL": (0, 1000), "RTL_CLIMB_MIN": (0, 3000), "RTL_CONE_SLOPE": (0, 10),
    "RTL_LOIT_TIME": (0, 3000), "RTL_SPEED": (0, 2000), "LAND_SPEED": (30, 200), "LAND_SPEED_HIGH": (0, 500),
    "LAND_ALT_LOW": (100, 10000), "ANGLE_MAX": (1000, 4500), "PSC_JERK_XY": (1, 20), "PSC_JERK_Z": (1, 50),
    "ATC_INPUT_TC": (0, 1), "ATC_SLEW_YAW": (500, 18000), "PILOT_SPEED_UP": (50, 250), "PILOT_ACCEL_Z": (50, 500),
    "PILOT_Y_RATE": (1, 360), "PILOT_Y_EXPO": (-0.5, 0.95), "THR_DZ": (0, 300), "LOIT_SPEED": (20, 3500),
    "LOIT_ACC_MAX": (100, 981), "LOIT_ANG_MAX": (0, 45), "LOIT_BRK_ACCEL": (25, 250), "LOIT_BRK_JERK": (500, 5000),
    "LOIT_BRK_DELAY": (0, 2), "CIRCLE_RADIUS": (0, 5000), "CIRCLE_RATE": (-90, 90), "CIRCLE_OPTIONS": (0, 15),
    "WP_YAW_BEHAVIOR": (0, 3), "GUID_TIMEOUT": (0.1, 5), "GUID_OPTIONS": (0, 255), "AUTO_OPTIONS": (0, 3),
    "MIS_RESTART": (0, 1), "DISARM_DELAY": (0, 127), "TKOFF_SLEW_TIME": (0.25, 5), "MOT_SPOOL_TIME": (0.05, 2),
    "FS_GCS_ENABLE": (0, 7), "FS_GCS_TIMEOUT": (2, 10), "FS_OPTIONS": (0, 31), "FENCE_ENABLE": (0, 1),
    "FENCE_TYPE": (0, 15), "FENCE_ACTION": (0, 5), "FENCE_RADIUS": (30, 300), "FENCE_ALT_MAX": (10, 100),
    "FENCE_ALT_MIN": (-10, 5), "FENCE_AUTOENABLE": (0, 3), "FENCE_OPTIONS": (0, 3), "RALLY_INCL_HOME": (0, 1),
    "SR0_EXTRA1": (0, 50), "SR0_POSITION": (0, 50), "BATT_CAPACITY": (1000, 10000), "FLIGHT_OPTIONS": (0, 1),
    "ARMING_CHECK": (0, 1), "FS_EKF_FILT": (1, 10), "BATT_FS_VOLTSRC": (0, 1),
}  # fmt: skip
"""Parameters with ranges of their own units in which everything flies."""

which = st.integers(0, 1)
bearing = st.floats(-math.pi, math.pi)
across = st.floats(-90.0, 90.0)
height = st.floats(5.0, 40.0)
seconds = st.sampled_from([0.1, 0.5, 1.0, 2.0, 4.0])
RELATIVE, TERRAIN, ABSOLUTE, MISSION = 3, 10, 0, 2


def _params(*drawn: st.SearchStrategy[float]) -> st.SearchStrategy[tuple[float, ...]]:
    return st.tuples(*drawn, *[st.just(0.0)] * (4 - len(drawn)))


def _there(command: int, *drawn: st.SearchStrategy[float]) -> st.SearchStrategy[Item]:
    frames = st.sampled_from([RELATIVE, TERRAIN, ABSOLUTE])
    return st.tuples(frames, st.just(command), _params(*drawn), st.tuples(across, across, height))


def _plain(command: int, *drawn: st.SearchStrategy[float]) -> st.SearchStrategy[Item]:
    return st.tuples(st.just(MISSION), st.just(command), _params(*drawn), st.just((0.0, 0.0, 0.0)))


_zero = st.just(0.0)
_few = st.sampled_from([0.0, 1.0, 3.0])
_radius = st.sampled_from([-20.0, -5.0, 0.0, 5.0, 20.0])
ITEMS: st.SearchStrategy[Item] = st.one_of(
    _there(A.MAV_CMD_NAV_WAYPOINT, _few),
    _there(A.MAV_CMD_NAV_WAYPOINT, _zero),
    _there(A.MAV_CMD_NAV_SPLINE_WAYPOINT, _few),
    _there(A.MAV_CMD_NAV_LOITER_UNLIM),
    _there(A.MAV_CMD_NAV_LOITER_TURNS, st.sampled_from([0.25, 1.0, 2.0]), _zero, _radius, st.sampled_from([0.0, 1.0])),
    _there(A.MAV_CMD_NAV_LOITER_TIME, _few),
    _there(A.MAV_CMD_NAV_LOITER_TO_ALT),
    _there(A.MAV_CMD_NAV_LAND),
    _there(A.MAV_CMD_NAV_TAKEOFF),
    _plain(A.MAV_CMD_NAV_RETURN_TO_LAUNCH),
    _plain(A.MAV_CMD_NAV_DELAY, _few, st.just(-1.0), st.just(-1.0), st.just(-1.0)),
    _plain(A.MAV_CMD_CONDITION_DELAY, _few),
    _plain(A.MAV_CMD_CONDITION_DISTANCE, st.sampled_from([0.0, 10.0, 500.0])),
    _plain(A.MAV_CMD_CONDITION_YAW, st.sampled_from([0.0, 90.0, 360.0]), _few, st.sampled_from([-1.0, 0.0, 1.0])),
    _plain(A.MAV_CMD_DO_JUMP, st.integers(1, 7).map(float), st.sampled_from([-1.0, 0.0, 1.0, 3.0])),
    _plain(A.MAV_CMD_DO_CHANGE_SPEED, st.sampled_from([0.0, 1.0, 2.0, 3.0]), st.sampled_from([0.5, 2.0, 5.0])),
    _plain(A.MAV_CMD_DO_SET_HOME, st.just(1.0)),
    _there(A.MAV_CMD_DO_LAND_START),
    _there(A.MAV_CMD_DO_SET_ROI),
    _there(A.MAV_CMD_DO_SET_ROI_LOCATION),
    _plain(A.MAV_CMD_DO_SET_ROI_NONE),
)
"""Every kind of mission item that there is, above the ground and near home."""


@cache
def _prepared(place: str) -> Range:
    """Two aircraft with usual sensors, their estimators settled: standing, hovering, or flying missions."""
    r = Range([VehicleSpec(v, i + 1, home_enu_m=HOMES[i]) for i, v in enumerate(NAMES)], noise=1.0)
    r.run(30.0)
    for name, home in zip(NAMES, HOMES, strict=True):
        if place == "hovering":
            assert r.mode(name, Mode.GUIDED) == OK
            assert r.arm(name) == OK
            assert r.command(name, A.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 15.0) == OK
        elif place == "mission":
            around = [
                (
                    frame,
                    number,
                    params,
                    (east + home[0], north + home[1], up) if number == A.MAV_CMD_NAV_WAYPOINT else (east, north, up),
                )
                for frame, number, params, (east, north, up) in square(30.0, 12.0)
            ]
            r.upload(name, around)
            start(r, name)
    r.run(20.0)
    return r


class Flight(RuleBasedStateMachine):
    """Two aircraft and their ground station, which does as the rules say."""

    r: Range

    @initialize(place=st.sampled_from(["standing", "hovering", "hovering", "mission"]))
    def begin(self, place: str) -> None:
        """From the ground, from a hover, or in the middle of a mission."""
        self.r = _prepared(place).copy()
        self.r.notes.clear()
        self.silent = False
        self.beat_s = -1.0
        self.stick_s = -1.0
        self.lean = [(0.0, 0.0, 0.0)] * 2
        self.lift = [0.5] * 2
        self.next_number: list[int | None] = [None, None]
        self.touched_s = [-SHAKEN_S] * 2

    # --- looking ------------------------------------------------------------------------------------------------------

    @property
    def fleet(self) -> Any:
        """The autopilots' own state."""
        return self.r.engines[0]._fleet

    def mode_of(self, i: int) -> int:
        """The mode that an aircraft is in."""
        return int(self.fleet.vehicles[i].reported_mode)

    def armed(self, i: int) -> bool:
        """Whether its motors may turn."""
        return bool(self.fleet.flight["armed"][i])

    def up_m(self, i: int) -> float:
        """True height."""
        return float(self.r.world.truth()["up_m"][i])

    def aloft(self, i: int) -> bool:
        """Whether it flies in truth."""
        return self.armed(i) and self.up_m(i) > GROUND_M

    def high(self, i: int) -> bool:
        """High enough for what may lose some height."""
        return self.aloft(i) and self.up_m(i) > LOW_M

    # --- acting -------------------------------------------------------------------------------------------------------

    def pass_time(self, seconds: float) -> None:
        """Go on, with heartbeats and sticks as a ground station sends them unless it is silent, and look."""
        end = self.r.seconds + seconds
        while self.r.seconds < end - 1e-6:
            if not self.silent and self.r.seconds >= self.beat_s + 1.0:
                self.beat_s = self.r.seconds
                for name in NAMES:
                    self.r.send(name, A.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            if not self.silent and self.r.seconds >= self.stick_s + 0.5:
                self.stick_s = self.r.seconds
                self.hold_sticks()
            self.r.run(STEP_S)
            self.check()

    def hold_sticks(self) -> None:
        """Repeat where the sticks are: throttle down on the ground, else as the last rule left them."""
        for i, name in enumerate(NAMES):
            roll, pitch, yaw = self.lean[i] if self.aloft(i) else (0.0, 0.0, 0.0)
            lift = self.lift[i] if self.aloft(i) or self.lift[i] > 0.6 else 0.0
            us = [round(1500 + 500 * part) for part in (roll, pitch)] + [
                round(1000 + 1000 * lift),
                round(1500 + 500 * yaw),
            ]
            system = self.fleet.vehicles[i].system_id
            self.r.send(name, A.MAVLink_rc_channels_override_message(system, 1, *us, 65535, 65535, 65535, 65535))

    def ask(self, i: int, number: int, *params: float) -> int:
        """A COMMAND_LONG; there must be one answer, to whoever asked (Range.command sees to the number)."""
        result = self.r.command(NAMES[i], number, *params)
        ack = self.r.heard("COMMAND_ACK", NAMES[i])[-1]
        assert (ack.target_system, ack.target_component) == (255, 190)
        assert result in A.enums["MAV_RESULT"]
        return result

    def ask_at(self, i: int, number: int, enu_m: tuple[float, float, float], frame: int, *params: float) -> int:
        """A COMMAND_INT with a place relative to where the aircraft started."""
        full = (*params, *([0.0] * (4 - len(params))))
        lat, lon = self.r.origin.geodetic_of(HOMES[i][0] + enu_m[0], enu_m[1])
        before = len(self.r.heard("COMMAND_ACK", NAMES[i]))
        message = A.MAVLink_command_int_message(
            i + 1, 1, frame, number, 0, 0, *full, round(lat * 1e7), round(lon * 1e7), self.alt(frame, enu_m[2])
        )
        self.r.send(NAMES[i], message)
        self.r.run(0.02)
        acks = self.r.heard("COMMAND_ACK", NAMES[i])[before:]
        assert [ack.command for ack in acks] == [number]
        return int(acks[0].result)

    def alt(self, frame: int, up_m: float) -> float:
        """A height in a frame's datum; homes are on the ground or above it."""
        return up_m + self.r.origin.alt_msl_m if frame == ABSOLUTE else up_m

    def put(self, i: int, name: str, value: float) -> None:
        """PARAM_SET, answered with what is stored."""
        before = len(self.r.heard("PARAM_VALUE", NAMES[i]))
        self.r.send(NAMES[i], A.MAVLink_param_set_message(i + 1, 1, name.encode(), value, A.MAV_PARAM_TYPE_REAL32))
        self.r.run(0.02)
        (told,) = self.r.heard("PARAM_VALUE", NAMES[i])[before:]
        assert told.param_value == np.float32(value) or told.param_value == math.trunc(value)

    # --- commands -----------------------------------------------------------------------------------------------------

    @rule(duration=seconds)
    def wait(self, duration: float) -> None:
        """Let it fly."""
        self.pass_time(duration)

    @rule(duration=st.sampled_from([10.0, 25.0]))
    def wait_long(self, duration: float) -> None:
        """Let a mission or a return come to its end."""
        self.pass_time(duration)

    @rule(i=which, forced=st.booleans(), mode=st.sampled_from([Mode.GUIDED, Mode.LOITER, Mode.ALT_HOLD, None]))
    def arm(self, i: int, forced: bool, mode: Mode | None) -> None:
        """Arm, in a mode that does."""
        if mode is not None and not self.aloft(i):
            self.ask(i, A.MAV_CMD_DO_SET_MODE, 1, mode)
        result = self.ask(i, A.MAV_CMD_COMPONENT_ARM_DISARM, 1, 2989 if forced else 0)
        assert result in (OK, FAILED)
        assert self.armed(i) == (result == OK)
        self.pass_time(0.5)

    @rule(i=which)
    def disarm(self, i: int) -> None:
        """Disarm, which is refused in the air."""
        aloft, armed = self.up_m(i) > 1.0, self.armed(i)
        result = self.ask(i, A.MAV_CMD_COMPONENT_ARM_DISARM, 0)
        assert result in (OK, FAILED)
        assert not (armed and aloft) or result == FAILED

    @precondition(lambda self: not (self.aloft(0) and self.aloft(1)))
    @rule(by=st.sampled_from([A.MAV_CMD_COMPONENT_ARM_DISARM, A.MAV_CMD_DO_FLIGHTTERMINATION]))
    def stop_motors(self, by: int) -> None:
        """Stop the motors whatever happens, of one that stands."""
        for i in range(2):
            if not self.aloft(i):
                first, second = (0.0, 21196.0) if by == A.MAV_CMD_COMPONENT_ARM_DISARM else (1.0, 0.0)
                assert self.ask(i, by, first, second) == OK
                assert not self.armed(i)

    @rule(i=which, up=height, wait=seconds)
    def take_off(self, i: int, up: float, wait: float) -> None:
        """GUIDED, arm and climb; refused where it flies already."""
        flies = self.aloft(i)
        self.ask(i, A.MAV_CMD_DO_SET_MODE, 1, Mode.GUIDED)
        self.ask(i, A.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        result = self.ask(i, A.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, up)
        assert result == FAILED if flies and self.up_m(i) > 1.0 else result in (OK, FAILED)
        self.pass_time(wait)

    @rule(
        i=which, mode=st.sampled_from([mode for mode in Mode if mode is not Mode.STABILIZE]), by_message=st.booleans()
    )
    def change_mode(self, i: int, mode: Mode, by_message: bool) -> None:
        """Any mode; STABILIZE has a rule of its own, since its throttle is the pilot's."""
        if by_message:
            self.r.send(NAMES[i], A.MAVLink_set_mode_message(i + 1, 1, mode))
            self.r.run(0.02)
        elif self.ask(i, A.MAV_CMD_DO_SET_MODE, 1, mode) == OK and not self.fleet.checks["gcs_lost"][i]:
            gone_on = mode == Mode.AUTO_RTL and self.mode_of(i) == Mode.AUTO
            assert self.mode_of(i) == mode or gone_on or (mode in (Mode.AUTO, Mode.AUTO_RTL) and not self.armed(i))
        self.pass_time(0.2)

    @rule(i=which, number=st.sampled_from([20, 21, 17]))
    def change_mode_by_its_command(self, i: int, number: int) -> None:
        """RETURN_TO_LAUNCH, LAND, LOITER_UNLIM."""
        assert self.ask(i, number) in (OK, FAILED)
        self.pass_time(1.0)

    @rule(i=which, what=st.sampled_from([0.0, 1.0]), wait=seconds)
    def pause_or_go_on(self, i: int, what: float, wait: float) -> None:
        """DO_PAUSE_CONTINUE, in any mode."""
        may = self.mode_of(i) in (Mode.AUTO, Mode.AUTO_RTL, Mode.GUIDED)
        result = self.ask(i, A.MAV_CMD_DO_PAUSE_CONTINUE, what)
        assert result in ((OK, FAILED) if may and what == 0.0 else (OK,) if may else (FAILED,))
        self.pass_time(wait)

    @rule(i=which, wait=seconds)
    def land_by_the_mission(self, i: int, wait: float) -> None:
        """DO_LAND_START, whether there is one or not."""
        assert self.ask(i, A.MAV_CMD_DO_LAND_START) in (OK, FAILED)
        self.pass_time(wait)

    @precondition(lambda self: not self.silent)
    @rule(i=which, roll=st.floats(-0.3, 0.3), pitch=st.floats(-0.3, 0.3), lift=st.floats(0.5, 0.6), time=seconds)
    def fly_by_hand(self, i: int, roll: float, pitch: float, lift: float, time: float) -> None:
        """STABILIZE with about the throttle that hovers, then LOITER."""
        if not self.high(i):
            return
        self.lean[i], self.lift[i] = (roll, pitch, 0.0), lift
        self.hold_sticks()
        self.pass_time(0.1)
        self.ask(i, A.MAV_CMD_DO_SET_MODE, 1, Mode.STABILIZE)
        self.pass_time(min(time, 1.0))
        self.lean[i], self.lift[i] = (0.0, 0.0, 0.0), 0.5
        self.hold_sticks()
        self.pass_time(0.1)
        if self.mode_of(i) == Mode.STABILIZE:
            assert self.ask(i, A.MAV_CMD_DO_SET_MODE, 1, Mode.LOITER) == OK

    @precondition(lambda self: not self.silent)
    @rule(
        i=which,
        mode=st.sampled_from([Mode.LOITER, Mode.ALT_HOLD]),
        lean=st.tuples(*[st.floats(-0.5, 0.5)] * 3),
        lift=st.floats(0.3, 1.0),
        manual=st.booleans(),
        time=seconds,
    )
    def fly_by_stick(
        self, i: int, mode: Mode, lean: tuple[float, float, float], lift: float, manual: bool, time: float
    ) -> None:
        """LOITER or ALT_HOLD with any sticks, as overrides or as a joystick; takes off where it stands armed."""
        if self.aloft(i) and (not self.high(i) or self.up_m(i) < LOW_M + 2.5 * time):
            lift = max(lift, 0.6)
        self.ask(i, A.MAV_CMD_DO_SET_MODE, 1, mode)
        if self.mode_of(i) != mode:
            return
        self.lean[i], self.lift[i] = lean if self.high(i) else (0.0, 0.0, lean[2]), lift
        if manual:
            roll, pitch, yaw = (round(1000 * part) for part in self.lean[i])
            message = A.MAVLink_manual_control_message(i + 1, -pitch, roll, round(1000 * lift), yaw, 0)
            self.r.send(NAMES[i], message)
        self.pass_time(time)
        self.lean[i], self.lift[i] = (0.0, 0.0, 0.0), 0.5
        self.hold_sticks()
        self.pass_time(0.1)

    @rule(i=which, items=st.lists(ITEMS, max_size=7), up=height, flown=st.booleans())
    def upload_mission(self, i: int, items: list[Item], up: float, flown: bool) -> None:
        """A mission of any items, jumps inside it, and (or not) fly it."""
        rows: list[Item] = [takeoff(up)]
        for frame, command, params, (east, north, z) in items:
            if command == A.MAV_CMD_DO_JUMP:
                params = (1.0 + (params[0] - 1.0) % (len(items) + 1), *params[1:])
            elif command in (A.MAV_CMD_DO_SET_HOME,):
                frame = RELATIVE
            rows.append((frame, command, params, (east + HOMES[i][0], north, self.alt(frame, z))))
        assert self.r.upload(NAMES[i], rows) == A.MAV_MISSION_ACCEPTED
        assert len(self.fleet.vehicles[i].mission) == len(rows) + 1
        if flown:
            if not self.aloft(i):
                self.ask(i, A.MAV_CMD_DO_SET_MODE, 1, Mode.GUIDED)
                self.ask(i, A.MAV_CMD_COMPONENT_ARM_DISARM, 1)
            self.ask(i, A.MAV_CMD_MISSION_START)
        self.pass_time(1.0)

    @rule(i=which)
    def start_mission(self, i: int) -> None:
        """MISSION_START, wherever it is."""
        assert self.ask(i, A.MAV_CMD_MISSION_START) in (OK, FAILED)
        self.pass_time(1.0)

    @rule(i=which, seq=st.integers(0, 9), again=st.booleans(), by_message=st.booleans())
    def set_current(self, i: int, seq: int, again: bool, by_message: bool) -> None:
        """Go on at another item; one that is not there is denied."""
        if by_message:
            self.r.send(NAMES[i], A.MAVLink_mission_set_current_message(i + 1, 1, seq))
            self.pass_time(0.5)
            return
        there = seq < len(self.fleet.vehicles[i].mission)
        result = self.ask(i, A.MAV_CMD_DO_SET_MISSION_CURRENT, seq, again)
        assert result in (OK, FAILED) if there else result == DENIED
        self.pass_time(0.5)

    @rule(i=which, kind=st.sampled_from([0, 1, 2]))
    def clear(self, i: int, kind: int) -> None:
        """No mission, fence or rally points; a mission that is being flown stays."""
        before = len(self.r.heard("MISSION_ACK", NAMES[i]))
        self.r.send(NAMES[i], A.MAVLink_mission_clear_all_message(i + 1, 1, kind))
        self.r.run(0.02)
        (ack,) = self.r.heard("MISSION_ACK", NAMES[i])[before:]
        assert ack.mission_type == kind
        assert ack.type in (A.MAV_MISSION_ACCEPTED, A.MAV_MISSION_ERROR)

    @rule(i=which, east=across, north=across, up=height, frame=st.sampled_from([3, 10, 0]), may=st.booleans())
    def reposition(self, i: int, east: float, north: float, up: float, frame: int, may: bool) -> None:
        """DO_REPOSITION."""
        result = self.ask_at(i, A.MAV_CMD_DO_REPOSITION, (east, north, up), frame, -1.0, float(may))
        assert result in (OK, DENIED, FAILED)
        self.pass_time(1.0)

    @rule(
        i=which,
        what=st.sampled_from(["position", "velocity", "track", "accel", "velocity+accel"]),
        place=st.tuples(across, across, height),
        speed=st.tuples(*[st.floats(-8.0, 8.0)] * 2, st.floats(-1.5, 1.5)),
        accel=st.tuples(*[st.floats(-2.0, 2.0)] * 2, st.floats(-0.5, 0.5)),
        yaw=st.one_of(st.none(), bearing),
        rate=st.one_of(st.none(), st.floats(-1.0, 1.0)),
        frame=st.sampled_from([A.MAV_FRAME_LOCAL_NED, A.MAV_FRAME_BODY_NED, A.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT]),
        time=seconds,
    )
    def target(
        self,
        i: int,
        what: str,
        place: tuple[float, float, float],
        speed: tuple[float, float, float],
        accel: tuple[float, float, float],
        yaw: float | None,
        rate: float | None,
        frame: int,
        time: float,
    ) -> None:
        """A position, velocity or acceleration in GUIDED, local, from the aircraft, or global."""
        mask = 0 if what in ("position", "track") else 0b111
        mask |= 0 if what in ("velocity", "track", "velocity+accel") else 0b111 << 3
        mask |= 0 if "accel" in what else 0b111 << 6
        mask |= (0 if yaw is not None else 1 << 10) | (0 if rate is not None else 1 << 11)
        # downwards only from high above, for as long as a target may hold: 1.5 m/s, or 0.5 m/s², times 5 s
        down = max(speed[2], -0.5) if not self.aloft(i) or self.up_m(i) > 25.0 else -abs(speed[2])
        fall = 0.5 * accel[2] if self.up_m(i) > 40.0 else -abs(accel[2])
        v = (speed[0], speed[1], 0.0 if what == "track" else down)
        rest = (*v, accel[0], accel[1], fall, yaw or 0.0, rate or 0.0)
        if frame == A.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT:
            lat, lon = self.r.origin.geodetic_of(HOMES[i][0] + place[0], place[1])
            message = A.MAVLink_set_position_target_global_int_message(
                0, i + 1, 1, frame, mask, round(lat * 1e7), round(lon * 1e7), place[2], *rest
            )
        else:
            x, y, z = place[1], HOMES[i][0] + place[0], -place[2]
            if frame == A.MAV_FRAME_BODY_NED:
                x, y, z = place[0] * 0.3, place[1] * 0.3, -1.0
            message = A.MAVLink_set_position_target_local_ned_message(0, i + 1, 1, frame, mask, x, y, z, *rest)
        self.r.send(NAMES[i], message)
        self.pass_time(time)

    @rule(i=which, lean=st.floats(0.0, 0.35), to=bearing, thrust=st.floats(0.5, 0.7), ignore=st.booleans())
    def attitude(self, i: int, lean: float, to: float, thrust: float, ignore: bool) -> None:
        """SET_ATTITUDE_TARGET: a lean of up to 20 degrees that does not lose height."""
        if not self.high(i):
            return
        half = 0.5 * lean
        quat = [math.cos(half), math.sin(half) * math.cos(to), math.sin(half) * math.sin(to), 0.0]
        norm = math.sqrt(sum(part * part for part in quat))
        mask = 0b111 if ignore else 0
        self.r.send(
            NAMES[i],
            A.MAVLink_set_attitude_target_message(0, i + 1, 1, mask, [q / norm for q in quat], 0.0, 0.0, 0.0, thrust),
        )
        self.pass_time(1.0)

    @rule(i=which, kind=st.integers(0, 3), speed=st.floats(0.2, 5.0))
    def change_speed(self, i: int, kind: int, speed: float) -> None:
        """DO_CHANGE_SPEED."""
        assert self.ask(i, A.MAV_CMD_DO_CHANGE_SPEED, kind, speed, -1.0) in (OK, FAILED)

    @rule(i=which, angle=st.floats(0.0, 360.0), rate=st.floats(0.0, 60.0), sense=st.integers(-1, 1), more=st.booleans())
    def turn(self, i: int, angle: float, rate: float, sense: int, more: bool) -> None:
        """CONDITION_YAW."""
        assert self.ask(i, A.MAV_CMD_CONDITION_YAW, angle, rate, sense, more) == OK
        self.pass_time(0.5)

    @rule(i=which, east=across, north=across, number=st.sampled_from([195, 201, 197]))
    def look_at(self, i: int, east: float, north: float, number: int) -> None:
        """DO_SET_ROI and its kin."""
        assert self.ask_at(i, number, (east, north, 2.0), RELATIVE) == OK
        self.pass_time(0.5)

    @rule(i=which, name=st.sampled_from(sorted(PARAMS)), share=st.floats(0.0, 1.0))
    def parameter(self, i: int, name: str, share: float) -> None:
        """PARAM_SET of anything inside its range."""
        low, high = PARAMS[name]
        whole = high - low <= 31 or name.startswith(("SR0", "BATT"))
        value = low + share * (high - low)
        self.put(i, name, float(round(value)) if whole and name not in ("GUID_TIMEOUT",) else float(np.float32(value)))

    @rule(i=which)
    def set_home(self, i: int) -> None:
        """Home is here from now on."""
        assert self.ask(i, A.MAV_CMD_DO_SET_HOME, 1) == OK

    @rule(i=which, radius=st.floats(20.0, 80.0), on=st.booleans())
    def fence(self, i: int, radius: float, on: bool) -> None:
        """A polygon around the start, in force or not."""
        corners = [(-radius, -radius), (radius, -radius), (radius, radius), (-radius, radius)]
        vertex = A.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
        self.transfer(i, 1, [(RELATIVE, vertex, (4.0, 0.0, 0.0, 0.0), (e, n, 0.0)) for e, n in corners])
        self.ask(i, A.MAV_CMD_DO_FENCE_ENABLE, on)
        self.pass_time(0.5)

    @rule(i=which, places=st.lists(st.tuples(across, across), min_size=1, max_size=3))
    def rally(self, i: int, places: list[tuple[float, float]]) -> None:
        """Other places to return to."""
        point = A.MAV_CMD_NAV_RALLY_POINT
        self.transfer(i, 2, [(RELATIVE, point, (0.0, 0.0, 0.0, 0.0), (e, n, 20.0)) for e, n in places])

    def transfer(self, i: int, kind: int, items: list[Item]) -> None:
        """Fence or rally points by the mission protocol."""
        name, r = NAMES[i], self.r
        asked, acked = len(r.heard("MISSION_REQUEST", name)), len(r.heard("MISSION_ACK", name))
        r.send(name, A.MAVLink_mission_count_message(i + 1, 1, len(items), kind))
        for seq, (frame, command, params, (east, north, up)) in enumerate(items):
            r.run(0.02)
            assert r.heard("MISSION_REQUEST", name)[asked:][-1].seq == seq
            lat, lon = r.origin.geodetic_of(HOMES[i][0] + east, north)
            place = (round(lat * 1e7), round(lon * 1e7), up)
            r.send(name, A.MAVLink_mission_item_int_message(i + 1, 1, seq, frame, command, 0, 1, *params, *place, kind))
        r.run(0.02)
        assert [ack.type for ack in r.heard("MISSION_ACK", name)[acked:]] == [A.MAV_MISSION_ACCEPTED]

    @rule(
        i=which,
        number=st.sampled_from([24, 30, 33, 74, 147, 193, 241]),
        period_us=st.sampled_from([-1, 0, 20000, 1000000]),
    )
    def ask_for_telemetry(self, i: int, number: int, period_us: int) -> None:
        """SET_MESSAGE_INTERVAL, and once at once."""
        assert self.ask(i, A.MAV_CMD_SET_MESSAGE_INTERVAL, number, period_us) == OK
        assert self.ask(i, A.MAV_CMD_REQUEST_MESSAGE, number) == OK

    @rule(i=which)
    def reboot(self, i: int) -> None:
        """Off and on, which is refused while armed."""
        armed = self.armed(i)
        assert self.ask(i, A.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) == (FAILED if armed else OK)
        if not armed:
            assert self.mode_of(i) == Mode.STABILIZE
            self.next_number[i] = None
        self.pass_time(1.0)

    @rule(time=st.sampled_from([3.0, 8.0]))
    def vanish(self, time: float) -> None:
        """The ground station is gone for a while: no heartbeat, no stick."""
        if Mode.ALT_HOLD in (self.mode_of(0), self.mode_of(1)):
            return  # with its throttle down it lands where it drifts, however fast
        self.silent = True
        self.pass_time(time)
        self.silent = False

    # --- what must hold ----------------------------------------------------------------------------------------------

    def check(self) -> None:
        """Nobody has crashed, flipped, fallen, flown away or lost itself."""
        r, fleet = self.r, self.fleet
        for _, note in r.notes:
            assert note.kind not in ("event.crash", "event.collision", "event.bad_frame"), note
            assert note.kind != "event.disarmed" or note.data["reason"] != "crash", note
            if note.kind == "event.contact":
                self.touched_s[NAMES.index(note.about)] = r.seconds
        r.notes.clear()
        truth, flight, estimate = r.world.truth(), fleet.flight, fleet.estimate
        assert all(np.isfinite(column).all() for column in truth.values())
        for table in (estimate, flight, fleet.settings, fleet.legs):
            for name in table.dtype.names:
                if table[name].dtype.names is None:
                    assert np.isfinite(table[name]).all(), name
        tilt_deg = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (truth["qx"] ** 2 + truth["qy"] ** 2), -1.0, 1.0)))
        assert (tilt_deg < TILT_MAX_DEG).all(), tilt_deg
        assert (truth["vel_up_mps"] > -SINK_MAX_MPS).all(), truth["vel_up_mps"]
        assert (np.hypot(truth["vel_east_mps"], truth["vel_north_mps"]) < FAST_MPS).all()
        place, speed = r.positions(), r.velocities()
        assert (np.hypot(*(place[:, :2] - np.array(HOMES)[:, :2]).T) < FAR_M).all(), place
        off = flight["armed"] == 0
        assert (fleet.actuators[off] == 0.0).all()
        assert (place[off, 2] < GROUND_M).all(), "disarmed in the air"
        assert (place[flight["landed"] == 1, 2] < 1.0).all(), "believes to stand, and flies"
        error_m, error_mps = np.abs(estimate["pos"] - place), np.abs(estimate["vel"] - speed)
        assert (error_m < BELIEF_M).all(), error_m
        shaken = r.seconds < np.array(self.touched_s) + SHAKEN_S
        assert (error_mps[~shaken] < BELIEF_MPS).all(), error_mps
        lean = np.arccos(np.clip(np.cos(estimate["roll"]) * np.cos(estimate["pitch"]), -1.0, 1.0))
        assert (np.abs(np.degrees(lean) - tilt_deg) < BELIEF_DEG).all(), (np.degrees(lean), tilt_deg)

    @invariant()
    def says_what_is(self) -> None:
        """All frames are numbered without a gap, hold numbers, and heartbeats tell mode and arming as they are."""
        if not hasattr(self, "r"):
            return
        self.check()
        for i, name in enumerate(NAMES):
            for payload in self.r.frames[name]:
                expected = self.next_number[i]
                assert expected is None or payload[4] in (expected, 0)
                self.next_number[i] = (payload[4] + 1) % 256
            self.r.frames[name].clear()
        for said in self.r.said:
            for field, value in said.message.to_dict().items():
                assert not isinstance(value, float) or math.isfinite(value), (said.message, field)
        for i, name in enumerate(NAMES):
            beats = [s for s in self.r.said if s.vehicle == name and s.message.get_type() == "HEARTBEAT"]
            if beats and beats[-1].at_s > self.r.seconds - 0.02:
                assert beats[-1].message.custom_mode == self.mode_of(i)
                assert bool(beats[-1].message.base_mode & 128) == self.armed(i)
        self.r.said.clear()
        self.r.track.clear()


Flight.TestCase.settings = settings(
    max_examples=examples(25),
    stateful_step_count=25,
    deadline=None,
    derandomize=not is_fuzzing(),
    suppress_health_check=list(HealthCheck),
)
TestFlight = Flight.TestCase
