"""Do the sensors err as much as they are said to, when they are said to, and each aircraft's by its own chance?"""

from __future__ import annotations

import copy
import math
from dataclasses import fields, replace

import numpy as np
import pytest

from skyrange.contracts.components import READINGS_NS, Sensors
from skyrange.core.geodesy import Origin
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_S
from skyrange.world import Body, SensorSpec, World
from skyrange.world.sensing import sensor_errors as models
from skyrange.world.sensing.geomagnetism import magnetic_field_at

pytestmark = pytest.mark.rotating

ORIGIN = Origin(-35.363328, 149.1652241, 584.0, 19.0)
STEP = 2_500_000
SPEC = SensorSpec(1.0, magnetic_field_at(ORIGIN))


def standing(count: int, spec: SensorSpec = SPEC, first: int = 0, step_ns: int = STEP) -> World:
    bodies = [Body(f"blue/b{i}", "iris", 10.0 * i, 0.0, 0.0, 90.0, seed=11) for i in range(first, first + count)]
    return World(bodies, step_ns, sensors=spec)


def readings(world: World) -> dict[str, np.ndarray]:
    sensors = world.sensors(slice(None))
    return {field.name: np.array(getattr(sensors, field.name)) for field in fields(Sensors)}


def flown(world: World, seconds: float, every_ns: int) -> dict[str, np.ndarray]:
    """All readings, (times, rows, …), standing on the ground."""
    kept = []
    for now in range(0, int(seconds * 1e9), STEP):
        world.advance(now)
        if now % every_ns == 0:
            kept.append(readings(world))
    return {name: np.array([reading[name] for reading in kept]) for name in kept[0]}


def test_deviates_have_mean_0_variance_1_and_are_independent() -> None:
    """4e4 draws of 6, within 4 standard errors: kurtosis is that of three uniforms, 2.6."""
    seed, stream, who, zero = (np.uint64(x) for x in (5, 6, 7, 0))
    z = np.array([models.normal6(seed, stream, who, when, zero) for when in range(40_000)])
    assert np.abs(z.mean(axis=0)).max() < 0.02
    assert np.abs(z.var(axis=0) - 1.0).max() < 0.03
    assert np.abs((z**4).mean(axis=0) - 2.6).max() < 0.12
    assert np.abs(np.corrcoef(z.T) - np.eye(6)).max() < 0.02
    assert np.abs(z).max() <= 3.0


def test_gnss_reports_at_five_hertz_what_was_a_moment_ago() -> None:
    log = flown(standing(1), 4.0, STEP)
    times = log["gnss_time_ns"][:, 0]
    fresh = np.flatnonzero(np.diff(times)) + 1
    assert set(np.diff(times[fresh]).tolist()) == {models.GNSS_PERIOD_NS}
    ages = fresh * STEP - times[fresh]
    assert (ages >= models.GNSS_LAG_NS).all()
    assert (ages < models.GNSS_LAG_NS + models.IMU_PERIOD_NS).all()


def test_errors_are_of_the_size_that_is_said() -> None:
    """200 aircraft standing for 2 s, against the constants; tolerances are four standard errors or more."""
    world = standing(200)
    log = flown(world, 2.0, 10_000_000)
    east = log["gnss_enu_m"][-1, :, 0] - 10.0 * np.arange(200)
    assert east.std() == pytest.approx(models.GNSS_WANDER_M, rel=0.2)
    up = log["gnss_enu_m"][-1, :, 2]
    assert up.std() == pytest.approx(models.GNSS_WANDER_UP_M, rel=0.2)
    assert log["gnss_vel_enu_mps"][-1].std() == pytest.approx(models.GNSS_SPEED_MPS, rel=0.15)
    assert log["gyro_radps"].mean(axis=0).std() == pytest.approx(models.GYRO_BIAS_RADPS, rel=0.15)
    noise = log["gyro_radps"] - log["gyro_radps"].mean(axis=0)
    assert noise.std() == pytest.approx(models.GYRO_FLOOR_RADPS, rel=0.05)
    assert log["accel_mps2"][:, :, 0].mean(axis=0).std() == pytest.approx(models.ACCEL_BIAS_MPS2, rel=0.2)
    baro = log["baro_up_m"]
    assert (baro - baro.mean(axis=0)).std() == pytest.approx(models.BARO_NOISE_M, rel=0.1)
    field = np.array(magnetic_field_at(ORIGIN))
    nose_east = np.array([field[0], field[1], field[2]])  # heading 90: forward is east, left is north
    offset = log["compass_gauss"].mean(axis=0) - nose_east
    assert offset.std() == pytest.approx(models.COMPASS_OFFSET_GAUSS, rel=0.15)


def test_sensors_that_warm_up_drift_towards_their_coefficient_times_the_rise() -> None:
    """At rest, without noise of motors: the mean of a second after 300 s is 1 - 1/e of the way."""
    step_ns = 4 * STEP  # aircraft at rest need no finer one
    cold, warm = (standing(8, spec, step_ns=step_ns) for spec in (SPEC, replace(SPEC, warming_k=20.0)))
    for now in range(0, 20 * STEP, step_ns):
        cold.advance(now)
        warm.advance(now)
    at_start = np.abs(readings(warm)["accel_mps2"] - readings(cold)["accel_mps2"]).max()
    late = round(300e9)
    for world in (cold, warm):
        world.advance(late)
    share = 1.0 - np.exp(-1.0)
    drift = readings(warm)["accel_mps2"] - readings(cold)["accel_mps2"]
    assert at_start < 1e-4
    assert np.std(drift) == pytest.approx(share * 20.0 * models.ACCEL_PER_K, rel=0.5)
    turned = readings(warm)["gyro_radps"] - readings(cold)["gyro_radps"]
    assert np.std(turned) == pytest.approx(share * 20.0 * models.GYRO_PER_K, rel=0.5)
    higher = readings(warm)["baro_up_m"] - readings(cold)["baro_up_m"]
    assert np.std(higher) == pytest.approx(share * 20.0 * models.BARO_PER_K, rel=0.7)


def test_biases_wander_and_fixes_are_worse_by_their_factors() -> None:
    usual, unstable = standing(20), standing(20, replace(SPEC, instability=100.0, gnss=3.0))
    for now in [*range(0, 3 * STEP, STEP), *(k * 1_000_000_000 for k in range(1, 120))]:
        usual.advance(now)
        unstable.advance(now)
    wandered = readings(unstable)["accel_mps2"] - readings(usual)["accel_mps2"]
    assert np.std(wandered) == pytest.approx(100.0 * models.ACCEL_INSTABILITY_MPS2, rel=0.3)
    truth = np.array([[10.0 * i, 0.0] for i in range(20)])
    errors = [np.std(readings(world)["gnss_enu_m"][:, :2] - truth) for world in (usual, unstable)]
    assert errors[1] / errors[0] == pytest.approx(3.0, rel=0.1)


def test_gnss_wanders_with_its_correlation_time() -> None:
    """Lag-10 s correlation of 300 aircraft's errors: exp(-10/60), within 0.05."""
    world = standing(300)
    sensing = world._sensing
    errors = []
    for now in range(0, 12_000_000_000, models.IMU_PERIOD_NS):
        sensing.sample(now)
        if now in (1_000_000_000, 11_000_000_000):
            errors.append(readings(world)["gnss_enu_m"][:, :2] - world._bodies.position[:, :2])
    first, second = (e.ravel() for e in errors)
    assert np.corrcoef(first, second)[0, 1] == pytest.approx(math.exp(-10.0 / models.GNSS_WANDER_S), abs=0.05)


def test_the_receiver_loses_its_fix_now_and_then() -> None:
    """100 hours of bins: chance within 25 %, a length in its bounds, no new time meanwhile."""
    bins = 720_000
    seed, who = np.uint64(3), np.uint64(9)
    out = 0
    for start in range(bins // 20):
        at = start * models.OUTAGE_BIN_NS
        out += any(models.in_outage(seed, who, at + k * 400_000_000, 1.0) for k in range(25))
    assert out / (bins / 20) == pytest.approx(models.OUTAGE_CHANCE, rel=0.25)
    me = np.uint64(hash64("blue/b0"))
    lost_bin = next(
        b * models.OUTAGE_BIN_NS
        for b in range(10_000)
        if models.in_outage(np.uint64(11), me, b * models.OUTAGE_BIN_NS + 5_000_000_000, 1.0)
    )
    sensing = standing(1)._sensing
    fixes, ages = [], []
    for now in range(lost_bin, lost_bin + models.OUTAGE_BIN_NS, models.IMU_PERIOD_NS):
        sensing.sample(now)
        sensors = sensing.read(slice(None))
        fixes.append(int(sensors.gnss_fix[0]))
        ages.append(now - int(sensors.gnss_time_ns[0]))
    lost_s = fixes.count(models.FIX_NONE) * 0.01
    assert models.OUTAGE_MIN_S - 0.2 <= lost_s <= models.OUTAGE_MAX_S + 0.2
    assert max(ages) > models.GNSS_PERIOD_NS + models.GNSS_LAG_NS + 100_000_000


def test_ideal_sensors_are_the_truth_of_the_tick() -> None:
    world = standing(2, SensorSpec(0.0, magnetic_field_at(ORIGIN)))
    world.advance(0)
    world.actuate(slice(None), np.full((2, 4), 0.8))
    for now in range(STEP, 200 * STEP, STEP):
        world.advance(now)
    seen, truth = readings(world), world.truth()
    assert seen["gnss_enu_m"][:, 2].tobytes() == truth["up_m"].tobytes() == seen["baro_up_m"].tobytes()
    assert seen["gnss_time_ns"].tolist() == [199 * STEP] * 2
    assert seen["gnss_fix"].tolist() == [6, 6]
    assert np.linalg.norm(seen["compass_gauss"], axis=1) == pytest.approx(np.linalg.norm(magnetic_field_at(ORIGIN)))


def test_an_aircrafts_readings_depend_on_no_other_and_a_copy_goes_on_alike() -> None:
    alone, among = standing(1, first=3), standing(6)
    for now in range(0, 2_000_000_000, STEP):
        alone.advance(now)
        among.advance(now)
        if now == 1_000_000_000:
            fork = copy.deepcopy(among)
    for now in range(1_000_000_000 + STEP, 2_000_000_000, STEP):
        fork.advance(now)
    one, many, copied = readings(alone), readings(among), readings(fork)
    for name, values in one.items():
        assert values[0].tobytes() == many[name][3].tobytes(), name
        assert copied[name].tobytes() == many[name].tobytes(), name


@pytest.mark.parametrize(
    ("lat", "lon", "declination", "inclination", "gauss"),
    [
        (40.78, -73.97, -12.8, 66.4, 0.512),
        (-35.36, 149.17, 12.3, -66.0, 0.578),
        (51.5, -0.1, 0.4, 66.5, 0.490),
        (35.7, 139.7, -7.6, 49.6, 0.466),
        (0.0, 0.0, -4.2, -30.2, 0.318),
    ],
)
def test_the_field_is_the_world_magnetic_models(
    lat: float, lon: float, declination: float, inclination: float, gauss: float
) -> None:
    """NOAA's calculator for WMM2020, rounded; within 3 degrees and 6 % for what is cut off after degree 4."""
    east, north, up = magnetic_field_at(Origin(lat, lon, 0.0, 0.0))
    assert math.degrees(math.atan2(east, north)) == pytest.approx(declination, abs=3.0)
    assert math.degrees(math.atan2(-up, math.hypot(east, north))) == pytest.approx(inclination, abs=3.0)
    assert math.sqrt(east**2 + north**2 + up**2) == pytest.approx(gauss, rel=0.06)


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_delta_angles_and_velocities_are_the_integrals_of_the_readings(noise: float) -> None:
    world = standing(2, replace(SPEC, noise=noise))
    world.actuate(slice(None), np.array([[0.9, 0.6, 0.6, 0.6], [0.0, 0.0, 0.0, 0.0]]))
    turns, pushes = np.zeros((2, 3)), np.zeros((2, 3))
    for now in range(0, 400_000_000, STEP):
        world.advance(now)
        read = readings(world)
        if now:
            turns += read["gyro_radps"] * STEP / NS_PER_S
            pushes += read["accel_mps2"] * STEP / NS_PER_S
        if now % READINGS_NS == 0:
            assert read["delta_angle_rad"] == pytest.approx(turns, abs=1e-12)
            assert read["delta_velocity_mps"] == pytest.approx(pushes, abs=1e-12)
            turns, pushes = np.zeros((2, 3)), np.zeros((2, 3))
    assert np.abs(read["delta_angle_rad"][0]).max() > 1e-4
