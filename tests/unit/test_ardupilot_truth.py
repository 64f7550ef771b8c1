"""What ArduPilot's own simulation tells of its aircraft, and what its scenario tells it, without a process."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from skyrange.bench.ardupilot import measure
from skyrange.codec.mavlink import dialect
from skyrange.contracts.components import Engine
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_MS
from skyrange.runtime.pace import resolve_speed
from skyrange.vehicle.ardupilot.json_backend.motion import to_ardupilot_motion
from skyrange.vehicle.ardupilot.options import Options
from skyrange.vehicle.ardupilot.parameters import NATIVE_PARAMETERS, native_values
from skyrange.vehicle.ardupilot.process_fleet import ClockOffsets
from skyrange.vehicle.contract import VehicleSpec
from skyrange.vehicle.reported_poses import GEAR_M, ReportedPoses, state_from_sim_state
from skyrange.world import Body, World

ORIGIN = Origin(40.778, -73.955, alt_msl_m=20.0)


def sim_state(quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0), **changes: float) -> object:
    w, x, y, z = quaternion
    values = {
        "q1": w, "q2": x, "q3": y, "q4": z, "roll": 0, "pitch": 0, "yaw": 0, "xacc": 0, "yacc": 0, "zacc": -9.8,
        "xgyro": 0.1, "ygyro": 0.2, "zgyro": 0.3, "lat": 0, "lon": 0, "alt": 25.0 + GEAR_M, "std_dev_horz": 0,
        "std_dev_vert": 0, "vn": 1.0, "ve": 2.0, "vd": 3.0, "lat_int": 407_780_000 + 899, "lon_int": -739_550_000,
    }  # fmt: skip
    return dialect.MAVLink_sim_state_message(**(values | changes))


def test_places_velocities_and_rates_turn_into_our_frames() -> None:
    state = state_from_sim_state(sim_state(), ORIGIN)
    assert state.position_enu_m == pytest.approx((0.0, 10.0, 5.0), abs=0.02)
    assert state.vel_enu_mps == (2.0, 1.0, -3.0)
    assert state.rates_radps == (0.1, -0.2, -0.3)
    assert state.is_valid


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 200.0])
def test_attitudes_are_those_that_our_world_would_have_sent(heading_deg: float) -> None:
    """`to_ardupilot_motion` is the other way: there and back is the same rotation."""
    world = World([Body("a/b", "iris", 0.0, 0.0, heading_deg=heading_deg)])
    world.advance(0)
    sensors = world.sensors(slice(None))
    theirs = to_ardupilot_motion(sensors, np.zeros(1)).attitude[0]
    ours = np.array(state_from_sim_state(sim_state(tuple(theirs.tolist())), ORIGIN).attitude)
    assert abs(float(ours @ sensors.attitude[0])) == pytest.approx(1.0, abs=1e-6)
    half = math.radians(heading_deg) / 2  # and by its definition: a turn about down
    ours = np.array(state_from_sim_state(sim_state((math.cos(half), 0.0, 0.0, math.sin(half))), ORIGIN).attitude)
    assert abs(float(ours @ sensors.attitude[0])) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("changes", [{"vn": math.nan}, {"alt": math.inf}, {"q1": 2.0}])
def test_what_no_body_can_be_is_not_sound(changes: dict[str, Any]) -> None:
    assert not state_from_sim_state(sim_state(**changes), ORIGIN).is_valid


def test_a_late_pose_is_brought_forward_and_told_once() -> None:
    truth = ReportedPoses(2)
    assert truth.take_new() is None
    truth.update(1, state_from_sim_state(sim_state(), ORIGIN), 100 * NS_PER_MS)
    poses = truth.take_new()
    assert poses is not None
    assert poses.fresh.tolist() == [False, True]
    assert poses.position_enu_m[1] == pytest.approx((0.2, 10.1, 4.7), abs=0.02)
    assert truth.take_new() is None
    truth.update(0, state_from_sim_state(sim_state(), ORIGIN), 10**12)  # a clock that is far off moves nothing far
    poses = truth.take_new()
    assert poses is not None
    assert poses.position_enu_m[0, 2] == pytest.approx(5.0 - 0.25 * 3.0, abs=0.02)


@pytest.mark.parametrize(
    ("wind", "from_deg", "speed_mps"), [((8.0, 0.0, 0.0), 270.0, 8.0), ((0.0, -3.0, 0.0), 0.0, 3.0)]
)
def test_wind_comes_from_where_it_does_and_the_airframe_is_theirs(
    wind: tuple[float, float, float], from_deg: float, speed_mps: float
) -> None:
    listed = dict.fromkeys([*NATIVE_PARAMETERS, "SIM_WIND_SPD", "SIM_WIND_DIR", "SIM_WIND_T", "GPS1_TYPE"], 0.0)
    values = native_values(VehicleSpec("a/b", 1, "x500", wind_enu_mps=wind), listed, 120)
    assert values["SIM_WIND_DIR"] == pytest.approx(from_deg)
    assert values["SIM_WIND_SPD"] == pytest.approx(speed_mps)
    assert values["MOT_THST_HOVER"] == 0.39
    assert values["GPS1_TYPE"] == 14.0


def test_speedup_is_for_native_physics() -> None:
    assert Options(physics="native", speedup=5.0).speedup == 5.0
    with pytest.raises(ValidationError, match="no speedup with shared physics"):
        Options(speedup=5.0)
    with pytest.raises(ValidationError):
        Options(physics="native", speedup=0.0)


@pytest.mark.rotating
def test_one_exchange_in_a_turn_is_for_physics_with_exchanges() -> None:
    assert Options(physics="native", rates="reduced").rates == "reduced"
    with pytest.raises(ValidationError, match="'full' or 'reduced' with native physics"):
        Options(physics="native", rates="single")
    with pytest.raises(InputError, match="'full' or 'reduced' with native physics"):
        measure(1, 1.0, rates="single", physics="native")


def test_the_pace_of_wall_engines_is_the_runs() -> None:
    class Paced:
        paces_itself = True

        def __init__(self, name: str, clock: str, pace: float) -> None:
            self.name, self.clock, self.pace = name, clock, pace

    def engines(*made: Paced) -> list[Engine]:
        return list(made)  # type: ignore[arg-type]

    lockstep, wall, other = Paced("a", "lockstep", 0.0), Paced("b", "wall", 5.0), Paced("c", "wall", 2.0)
    assert resolve_speed(3.0, engines(lockstep)) == 3.0
    assert resolve_speed(0.0, engines(lockstep, wall)) == 0.0
    assert resolve_speed(5.0, engines(wall)) == 0.0, "it holds itself"
    for speed, given in ((3.0, (wall,)), (0.0, (wall, other))):
        with pytest.raises(InputError, match="one speed"):
            resolve_speed(speed, engines(*given))


def test_skew_is_told_from_the_run_and_between_instances() -> None:
    skew = ClockOffsets()
    assert skew.summary == {}
    for row, ahead_ms in ((0, 4), (1, -2), (0, 0)):
        skew.record(row, ahead_ms * NS_PER_MS)
    assert skew.summary == {"mean": 2.0, "max": 4.0, "between": 6.0}
    skew.forget(1)
    skew.record(0, 50 * NS_PER_MS)
    assert skew.summary["between"] == 6.0
