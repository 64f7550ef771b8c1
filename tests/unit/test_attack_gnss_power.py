"""Whom do jammer, spoofer and repeater reach by their power, and what do the receivers then report?"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
import shapely

from skyrange.attack.bases.gnss.emitter import AUTHENTIC_DBM, FIX_NONE, HORIZON_DBIC, LEAST_DBIC, Emitter, gain_dbic
from skyrange.attack.bases.gnss.receiver_noise import code_jitter_m, effective_db_hz
from skyrange.attack.bases.gnss.takeover import ALONE_DB, reach_of_loss_m
from skyrange.attack.contract import Aircraft, AttackContext, AttackPlugin
from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.contracts.components import SensorAct, SensorHook, Sensors
from skyrange.contracts.links import Schedule
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Epoch, Time
from skyrange.world import Body, SensorSpec, World

CAPTURE = AttackPlugin.find("gnss.capture")
GNSS_JAM = AttackPlugin.find("gnss.jam")
MEACON = AttackPlugin.find("gnss.meacon")

S = NS_PER_S
WALL = City([Building("wall", 40.0, shapely.box(-5.0, -60.0, 5.0, 60.0))], "test")
NAMES = ("blue/b1", "blue/b2")
STEP = S // 5


def context(sham: bool = False, city: Any = None) -> AttackContext:
    vehicles = {name: Aircraft((0.0, 0.0, 0.0), "") for name in NAMES}
    schedule = Schedule(2 * S, 90 * S)
    return AttackContext(
        "x", vehicles, [], Origin(40.0, -73.0, 0.0, 0.0), Epoch(0), Chance(3), 99 * S, schedule, sham, city
    )


def fault(kind: AttackPlugin, sham: bool = False, **params: Any) -> SensorHook:
    (only,) = kind(kind.params.model_validate(params), context(sham)).sensor_hooks
    return only


def readings(now: Time, first: list[float], second: list[float], velocity: tuple[float, ...] = (0, 0, 0)) -> Sensors:
    world = World([Body(name, "iris", 0.0, 9.0 * k) for k, name in enumerate(NAMES)], 2_500_000, sensors=SensorSpec(1))
    world.advance(0)
    sensors = world.sensors(np.array([0, 1]))
    sensors.gnss_enu_m[:] = [first, second]
    sensors.gnss_vel_enu_mps[:] = velocity
    sensors.gnss_time_ns[:] = now
    return sensors


def test_power_falls_as_in_free_space() -> None:
    emitter = Emitter((0.0, 0.0, 0.0), 10.0, 30.0, None)
    # 20·log10(4π·1000 m / 0.1903 m) = 96.4 dB
    assert emitter.loss_db(np.array([[1000.0, 0, 0], [0, 0, 2000.0]])) == pytest.approx([96.4, 102.4], abs=0.05)


def test_an_antenna_that_faces_the_sky_receives_what_comes_from_below_weakly() -> None:
    """-8.89 dB at the horizon and -14.44 dB 30 degrees below it against the zenith (gps-sdr-sim, `ant_pat_db`)."""
    assert gain_dbic(np.array([90.0, 0.0, -30.0])) == pytest.approx([5.0, 5.0 - 8.89, 5.0 - 14.44])
    gains = gain_dbic(np.linspace(90.0, -90.0, 181))
    assert (np.diff(gains) <= 0.0).all()
    assert gains[-1] == LEAST_DBIC
    emitter = Emitter((0.0, 0.0, 100.0), 10.0, 30.0, None)
    above, level, below = emitter.received_dbm(np.array([[0.0, 0, 0], [100.0, 0, 100], [0, 0, 200.0]]))
    assert (above - level, level - below) == pytest.approx((8.89, -3.89 + 10.0))


@pytest.mark.parametrize(
    ("kind", "params"),
    [
        (GNSS_JAM, {"power_dbm": -5}),
        (CAPTURE, {"at": [0, 900, 60], "power_dbm": -15}),
        (MEACON, {"at": [0, 900, 60], "power_dbm": -15, "isolation_db": 130}),
    ],
    ids=["jam", "capture", "meacon"],
)
def test_all_that_radiate_reach_less_far_from_the_ground(kind: AttackPlugin, params: dict[str, Any]) -> None:
    """At the same distance, the first from its own height and the second from 60 degrees below."""
    acting = fault(kind, transmitter_m=[0, 0, 60], **params)
    sensors = readings(2 * S, [150, 0, 60], [75, 0, 190])
    acting.on_sensors(2 * S, sensors)
    assert sensors.gnss_fix.tolist() == [FIX_NONE, 3]


def test_a_building_in_the_way_costs_its_loss() -> None:
    emitter, free = (Emitter((-50.0, 0.0, 2.0), 10.0, 25.0, where) for where in (WALL, None))
    places = np.array([[50.0, 0.0, 2.0], [50.0, 0.0, 60.0], [50.0, 0.0, 120.0]])
    assert emitter.received_dbm(places) - free.received_dbm(places) == pytest.approx([-25.0, -25.0, 0.0])


def test_a_receiver_tolerates_a_jammer_thirty_five_decibels_stronger() -> None:
    """Q = 2 and 28 dB-Hz: 10·log10(2 · 1.023e6 · (10^-2.8 - 10^-4.25)) = 35 dB."""
    jam_dbm = np.array([AUTHENTIC_DBM + 34.0, AUTHENTIC_DBM + 36.0])
    middle = effective_db_hz(jam_dbm, 3)[:, 1]
    assert middle[0] > 28.0 > middle[1]
    assert effective_db_hz(np.array([-np.inf]), 3)[0] == pytest.approx([37.5, 42.5, 47.5])
    assert code_jitter_m(42.5) < 1.5 < 5.0 < code_jitter_m(28.0)


def test_near_the_jammer_there_is_no_fix_at_its_edge_a_worse_one_and_far_away_the_usual() -> None:
    jam = fault(GNSS_JAM, transmitter_m=[0, 0, 0], power_dbm=-10 - HORIZON_DBIC)
    clean = readings(3 * S, [120, 0, 0], [3_000, 0, 0])
    sensors = readings(3 * S, [120, 0, 0], [3_000, 0, 0])
    assert jam.on_sensors(3 * S, sensors) == [SensorAct("blue/b1", "gnss")]
    assert sensors.gnss_fix.tolist() == [FIX_NONE, 3]
    assert sensors.gnss_enu_m[1].tolist() == clean.gnss_enu_m[1].tolist()
    assert sensors.gnss_accuracy[1].tolist() == clean.gnss_accuracy[1].tolist()
    edge = readings(4 * S, [120, 0, 0], [300, 0, 0])
    assert jam.on_sensors(4 * S, edge) == [SensorAct("blue/b2", "gnss")]
    assert edge.gnss_fix.tolist() == [FIX_NONE, 3]
    assert 4 <= edge.gnss_satellites[1] < clean.gnss_satellites[1]
    assert (edge.gnss_accuracy[1] > 1.2 * clean.gnss_accuracy[1]).all()
    assert edge.gnss_enu_m[1].tolist() != [300, 0, 0]


def test_a_receiver_that_recovers_is_no_act() -> None:
    jam = fault(GNSS_JAM, transmitter_m=[0, 0, 0], power_dbm=-10 - HORIZON_DBIC)
    acts = []
    for step, away_m in enumerate((9_000, 300, 300, 9_000, 300, 120, 9_000)):
        now = 3 * S + step * S
        acts.append(len(jam.on_sensors(now, readings(now, [away_m, 0, 0], [9_000, 0, 0]))))
    assert acts == [0, 1, 0, 0, 1, 1, 0], "each time that it begins to be degraded, or loses its fix"


def test_a_lost_fix_returns_when_the_noise_is_weak_for_long_enough() -> None:
    jam = fault(GNSS_JAM, transmitter_m=[0, 0, 0], power_dbm=-10 - HORIZON_DBIC, reacquire_s=2)
    fixes = {}
    for step in range(40):
        now = 2 * S + step * STEP
        away = 100.0 if step < 10 else 330.0 if step < 20 else 900.0
        sensors = readings(now, [away, 0, 0], [9_000, 0, 0])
        jam.on_sensors(now, sensors)
        fixes[step] = int(sensors.gnss_fix[0])
    assert fixes[19] == FIX_NONE, "enough to keep a fix, too little to find one"
    assert [fixes[20], fixes[29], fixes[30]] == [FIX_NONE, FIX_NONE, 3]


def states(
    which: SensorHook, places: list[list[float]], seconds: float, velocity: tuple[float, ...] = (0, 0, 0)
) -> Any:
    """Fix types and positions at every fix, and acts."""
    rows = []
    for step in range(round(seconds * 5)):
        now = 2 * S + step * STEP
        sensors = readings(now, places[0], places[1], velocity)
        acted = []
        for act in which.on_sensors(now, sensors):
            assert isinstance(act, SensorAct)
            acted.append(act.vehicle)
        rows.append((sensors.gnss_fix.tolist(), sensors.gnss_enu_m.tolist(), acted))
    return rows


def test_only_the_aligned_go_over_at_once_and_others_lose_their_fix_by_the_power_of_all_signals_together() -> None:
    spoof = fault(
        CAPTURE, transmitter_m=[0, -300, 30], at=[10, 0, 30], velocity_mps=[1, 0, 0], reacquire_s=3, power_dbm=0
    )  # 10 m from b1, 400 m from b2
    rows = states(spoof, [[0, 0, 30], [400, 0, 30]], 6.0)
    assert rows[0][0] == [3, FIX_NONE]
    assert rows[0][2] == ["blue/b1", "blue/b2"]
    assert [rows[14][0], rows[15][0]] == [[3, FIX_NONE], [3, 3]]
    assert rows[15][2] == ["blue/b2"]
    for place in rows[20][1]:
        assert np.abs(np.subtract(place, [14, 0, 30])).max() < 8.0


@pytest.mark.parametrize(
    ("params", "velocity", "seamless"),
    [
        ({"at": [60, 0, 30]}, (0, 0, 0), True),
        ({"at": [200, 0, 30]}, (0, 0, 0), False),
        ({"at": [0, 0, 30], "time_error_ns": 400}, (0, 0, 0), True),
        ({"at": [0, 0, 30], "time_error_ns": 600}, (0, 0, 0), False),  # 180 m
        ({"at": [0, 0, 30]}, (8, 0, 0), False),
        ({"at": [0, 0, 30], "velocity_mps": [8, 0, 0]}, (8, 0, 0), True),
    ],
)
def test_a_capture_is_seamless_within_its_alignment(params: Any, velocity: tuple[float, ...], seamless: bool) -> None:
    spoof = fault(CAPTURE, transmitter_m=[0, -300, 30], power_dbm=10, **params)
    assert (states(spoof, [[0, 0, 30], [9_000, 0, 30]], 0.2, velocity)[0][0][0] == 3) is seamless


def test_signals_that_are_not_aligned_are_noise_however_much_stronger_they_are_by_some_decibels() -> None:
    """-35 dBm arrive at an antenna of 0 dBi and 500 m with 3 dB more than the authentic signals; a loss takes 29 dB."""
    place = [400.0, 300.0, 30.0]
    spoof = fault(CAPTURE, transmitter_m=[0, 0, 30], at=[5_000, 0, 30], power_dbm=-35 - HORIZON_DBIC, reacquire_s=0)
    rows = states(spoof, [place, [9_000, 0, 30]], 5.0)
    assert {tuple(row[0]) for row in rows} == {(3, 3)}
    assert all(row[1][0] == place for row in rows), "and it costs too little to be noticed"
    assert reach_of_loss_m(-30.0 - HORIZON_DBIC) == pytest.approx(1012.0 / 10 ** ((ALONE_DB - 2.0) / 20), rel=1e-3)
    near = fault(CAPTURE, transmitter_m=[0, 0, 30], at=[5_000, 0, 30], power_dbm=-30 - HORIZON_DBIC, reacquire_s=1)
    assert [row[0] for row in states(near, [[20, 0, 30], [9_000, 0, 30]], 1.4)] == [[FIX_NONE, 3]] * 5 + [[3, 3]] * 2


def test_the_fix_is_lost_where_a_jammer_of_their_total_power_takes_it() -> None:
    """Eight signals of P at GPS L1 are one jammer of P + 9 dB to seven satellites; two are of GLONASS."""
    fixes = []
    for kind, params in (
        (CAPTURE, {"at": [90_000, 0, 30], "power_dbm": 0, "reacquire_s": 120}),
        (GNSS_JAM, {"power_dbm": 10 * np.log10(8), "reacquire_s": 120}),
    ):
        acting = fault(kind, transmitter_m=[0, 0, 30], **params)
        rows = []
        for step, away_m in enumerate(range(4_000, 200, -50)):
            sensors = readings(2 * S + step * STEP, [away_m, 0, 30], [90_000, 0, 30])
            acting.on_sensors(2 * S + step * STEP, sensors)
            rows.append((int(sensors.gnss_fix[0]), int(sensors.gnss_satellites[0])))
        fixes.append([fix for fix, _ in rows])
        assert len({satellites for fix, satellites in rows if fix == 3}) > 3, "satellites are lost one after the other"
    # ten signals at one frequency: 10 log10(10) = 10 dB; eight: 9 dB, and the two of GLONASS are lost later
    assert 26.0 < ALONE_DB < 30.0
    lost = [each.index(FIX_NONE) for each in fixes]
    assert 0 <= lost[0] - lost[1] <= 8, "a little nearer, by the satellites of GLONASS"
    assert all(set(each) == {FIX_NONE, 3} for each in fixes)


@pytest.mark.parametrize(
    ("constellations", "taken", "satellites"),
    [
        (["gps"], False, 7),
        (["glonass", "beidou"], False, 6),
        (["gps", "galileo"], True, 6),
        (["gps", "galileo", "glonass", "beidou"], True, 10),
    ],
)
def test_a_receiver_believes_the_greater_number_of_satellites(
    constellations: list[str], taken: bool, satellites: int
) -> None:
    """Of ten there are 3 of GPS, 3 of Galileo, 2 of GLONASS and 2 of BeiDou; aligned signals, 3 dB stronger."""
    power_dbm = -35 - HORIZON_DBIC
    spoof = fault(CAPTURE, transmitter_m=[0, -500, 30], at=[100, 0, 30], power_dbm=power_dbm,
                  constellations=constellations)  # fmt: skip
    clean, sensors = (readings(2 * S, [0, 0, 30], [9_000, 0, 30]) for _ in range(2))
    spoof.on_sensors(2 * S, sensors)
    assert (sensors.gnss_enu_m[0, 0] > 50.0) == taken
    assert sensors.gnss_fix.tolist() == [3, 3]
    assert sensors.gnss_satellites.tolist() == [satellites, 10]
    growth = np.sqrt(10 / satellites)
    assert sensors.gnss_accuracy[0] / clean.gnss_accuracy[0] == pytest.approx(growth, rel=0.02)


def test_who_simulates_gps_alone_captures_receivers_whose_other_satellites_are_jammed() -> None:
    """Its own power, near it, jams Galileo and BeiDou, which share a frequency with GPS."""
    spoof = fault(CAPTURE, transmitter_m=[0, -100, 30], at=[5_000, 0, 30], power_dbm=0, constellations=["gps"],
                  reacquire_s=1)  # fmt: skip
    rows = states(spoof, [[0, 0, 30], [9_000, 0, 30]], 2.0)
    assert [row[0][0] for row in rows] == [FIX_NONE] * 5 + [3] * 5
    assert rows[-1][1][0][0] > 4_900.0


@pytest.mark.parametrize("constellations", [[], ["gps", "gps"], ["navic"], "gps"])
def test_constellations_are_some_of_the_four_each_once(constellations: Any) -> None:
    with pytest.raises(ValueError, match="constellations"):
        fault(CAPTURE, transmitter_m=[0, 0, 0], at=[0, 0, 0], constellations=constellations)


def test_aligned_signals_need_their_advantage() -> None:
    # -30 dBm arrive with 2 dB more than -128.5 dBm at 10^((-30 + 126.5 - 36.4) / 20) = 1012 m
    spoof = fault(CAPTURE, transmitter_m=[0, 0, 0], at=[1_010, 0, 0], power_dbm=-30 - HORIZON_DBIC)
    rows = states(spoof, [[1_005, 0, 0], [1_020, 0, 0]], 0.2)
    assert rows[0][2] == ["blue/b1"]
    assert rows[0][1][1] == [1_020, 0, 0]


def test_a_receiver_without_a_fix_for_another_cause_is_taken_over_without_alignment_once_that_ends() -> None:
    """For as long as the noise lasts, it covers the simulated signals too."""
    for power_dbm, taken in ((-35.0, True), (-60.0, False)):
        spoof = fault(
            CAPTURE, transmitter_m=[0, 0, 30], at=[5_000, 0, 30], power_dbm=power_dbm - HORIZON_DBIC, reacquire_s=1
        )
        fixes, places, acts = [], [], []
        for step in range(20):
            now = 2 * S + step * STEP
            sensors = readings(now, [400, 300, 30], [9_000, 0, 30])
            if 3 <= step < 10:
                sensors.gnss_fix[0], sensors.gnss_satellites[0] = FIX_NONE, 0  # as gnss.jam leaves them
            acts.append(len(spoof.on_sensors(now, sensors)))
            fixes.append(int(sensors.gnss_fix[0]))
            places.append(float(sensors.gnss_enu_m[0, 0]))
        assert fixes[:10] == [3] * 3 + [FIX_NONE] * 7
        assert fixes[10:] == ([FIX_NONE] * 5 + [3] * 5 if taken else [3] * 10)
        assert (places[-1] > 4_900.0) == taken
        assert sum(acts) == (2 if taken else 0)


def test_captured_fixes_have_the_noise_of_a_receiver_and_ideal_sensors_none() -> None:
    spoof = fault(CAPTURE, transmitter_m=[0, -300, 30], at=[0, 0, 30], power_dbm=-20)
    rows = states(spoof, [[0, 0, 30], [20, 0, 30]], 60.0)
    places = np.array([row[1] for row in rows])
    assert len({tuple(place) for place in places[:, 0].tolist()}) == len(rows), "each fix has an error of its own"
    assert not np.allclose(places[:, 0], places[:, 1]), "and each receiver"
    errors = places[:, 0] - [0, 0, 30]
    steps = np.diff(errors, axis=0)
    assert 0.03 < steps[:, :2].std() < 0.25, "from fix to fix centimetres"
    assert 0.3 < np.abs(errors).max() < 10.0, "over a minute metres"
    ideal = fault(CAPTURE, transmitter_m=[0, -300, 30], at=[7, 0, 30], power_dbm=-20)
    sensors = readings(2 * S, [0, 0, 30], [20, 0, 30])
    sensors.gnss_accuracy[:] = 0.01
    ideal.on_sensors(2 * S, sensors)
    assert sensors.gnss_enu_m.tolist() == [[7, 0, 30]] * 2


def test_a_repeater_yields_its_own_antenna_to_all_after_a_loss_of_lock() -> None:
    repeater = fault(MEACON, at=[40, 30, 20], reacquire_s=1, isolation_db=140, power_dbm=5)
    rows = states(repeater, [[41, 230, 20], [300, 0, 50]], 2.0, (3, 0, 0))
    assert rows[0][0] == [FIX_NONE, FIX_NONE]
    for place in (*rows[5][1], *rows[9][1]):
        assert np.abs(np.subtract(place, [40, 30, 20])).max() < 8.0


@pytest.mark.parametrize(
    ("params", "isolation"),
    [({}, "30.4 dB"), ({"transmitter_m": [140, 30, 20]}, "76.4 dB"), ({"isolation_db": 118}, "118.0 dB")],
)
def test_a_repeater_whose_gain_reaches_its_isolation_is_refused(params: Any, isolation: str) -> None:
    with pytest.raises(InputError, match=rf"oscillates.*118.5 dB.*{isolation}.*state isolation_db"):
        fault(MEACON, at=[40, 30, 20], **params)
    fault(MEACON, at=[40, 30, 20], **{**params, "power_dbm": -99})
    fault(MEACON, at=[40, 30, 20], **{**params, "isolation_db": 119})


@pytest.mark.parametrize(
    ("kind", "params"),
    [
        (GNSS_JAM, {"transmitter_m": [0, 0, 0]}),
        (CAPTURE, {"transmitter_m": [0, 0, 0], "at": [900, 0, 9]}),
        (MEACON, {"at": [400, 0, 0], "transmitter_m": [0, 0, 0], "isolation_db": 130}),
    ],
    ids=["jam", "capture", "meacon"],
)
def test_a_sham_acts_as_often_and_reports_nothing_false_and_all_is_plain_state(kind: AttackPlugin, params: Any) -> None:
    places: list[list[float]] = [[50, 0, 30], [60, 0, 30]]
    live, sham = states(fault(kind, **params), places, 8.0), states(fault(kind, sham=True, **params), places, 8.0)
    assert [row[2] for row in live] == [row[2] for row in sham]
    assert all(row[1] == places for row in sham)
    if kind is GNSS_JAM:
        assert all(row[0] == [3, 3] for row in sham)
    else:
        assert [row[0] for row in live] == [row[0] for row in sham] == [[FIX_NONE] * 2] * 25 + [[3, 3]] * 15
        assert live[-1][1] != places
    assert kind.counterfactual == ("mute" if kind is GNSS_JAM else "sham")
    first = fault(kind, **params)
    states(first, places, 3.0)
    twin = copy.deepcopy(first)
    assert states(first, places, 8.0) == states(twin, places, 8.0)


def test_a_transmitter_is_not_inside_a_building() -> None:
    with pytest.raises(InputError, match="outside of buildings"):
        GNSS_JAM(GNSS_JAM.params.model_validate({"transmitter_m": [0, 0, 3]}), context(city=WALL))
