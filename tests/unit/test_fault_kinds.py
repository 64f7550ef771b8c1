"""What do benign faults do to readings, links and commands, and what does a scenario say of them?"""

from __future__ import annotations

from dataclasses import fields, replace
from math import cos, pi, radians
from typing import Any

import numpy as np
import pytest
import shapely

from skyrange.assembly.build import build
from skyrange.attack.bases.gnss.receiver_noise import CHIP_M
from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.codec.mavlink import decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.components import BodyAct, BodyHook, Disturbances, SensorAct, SensorHook, Sensors
from skyrange.contracts.frames import Frame
from skyrange.contracts.plugins.registry import ATTACKS, FAULTS, kinds
from skyrange.contracts.verdicts import Drop, Inject
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.fault.contract import FaultPlugin
from skyrange.fault.gnss.multipath import Satellite, Seen, even_sky, pseudorange_errors, see, solve
from skyrange.scenario.shipped import FAULT_EXAMPLES, load
from skyrange.scenario.toml_files import load_text
from tests.unit.test_attack_gnss import FLEET, context, readings

BATTERY_FADE = FaultPlugin.find("battery.fade")
GNSS_MULTIPATH = FaultPlugin.find("gnss.multipath")
GNSS_OUTAGE = FaultPlugin.find("gnss.outage")
GUST = FaultPlugin.find("gust")
MOTOR_LOSS = FaultPlugin.find("motor.loss")
OPERATOR_ERROR = FaultPlugin.find("operator.error")
SENSOR_FAILURE = FaultPlugin.find("sensor.failure")

LINK_LOSS = FaultPlugin.find("link.loss")
STATION_RESTART = FaultPlugin.find("station.restart")

S, MS = NS_PER_S, NS_PER_MS
NAMES = ("battery.fade", "gnss.multipath", "gnss.outage", "gust", "link.loss", "link.outage", "motor.loss",
         "lens.dirt", "operator.error", "sensor.failure", "station.restart", "weather.fog", "weather.rain")  # fmt: skip
LINKS = ["gcs:blue/b1", "gcs:blue/b2", "gcs:blue/b3", "approval:blue"]


def fault(kind: FaultPlugin, **params: Any) -> SensorHook:
    chosen = kind.params.model_validate({"vehicles": ["blue/b1", "blue/b2"], **params})
    (only,) = kind(chosen, context()).sensor_hooks
    return only


def frame(now: Time, serial: int, payload: bytes = b"x") -> Frame:
    return Frame(
        "gcs:blue/b1", "fwd", "blue.gcs", serial, "blue.gcs", "blue/b1.companion", sent_ns=now, payload=payload
    )


def altered(which: SensorHook, now: Time) -> tuple[Sensors, set[str]]:
    mine, true = readings(), readings()
    which.on_sensors(now, mine)
    return mine, {
        one.name for one in fields(Sensors) if getattr(mine, one.name).tobytes() != getattr(true, one.name).tobytes()
    }


@pytest.mark.parametrize("name", NAMES)
def test_a_kind_is_described_whole(name: str) -> None:
    kind = FaultPlugin.find(name)
    assert kind.surface
    for phrase in (kind.effect, kind.cause, kind.not_modelled):
        assert phrase
        assert not phrase.endswith(".")
    assert kind.realism
    assert all(how.split(":")[0] in ("simulated", "cited", "assumed") for how in kind.realism.values())


def test_kinds_differ_in_effect_and_are_no_attacks() -> None:
    assert set(NAMES) <= set(kinds(FAULTS))
    assert not set(NAMES) & set(kinds(ATTACKS))
    assert len({FaultPlugin.find(name).effect for name in NAMES}) == len(NAMES)
    assert set(FAULT_EXAMPLES) == set(NAMES)


def test_an_outage_takes_fix_and_satellites_away() -> None:
    which = fault(GNSS_OUTAGE)
    assert altered(which, 2 * S - 1)[1] == set()
    mine, names = altered(which, 2 * S)
    assert names == {"gnss_fix", "gnss_satellites"}
    assert mine.gnss_fix.tolist() == [1, 1]
    assert which.on_sensors(3 * S, readings()) == []


def test_a_frozen_sensor_repeats_its_reading() -> None:
    which = fault(SENSOR_FAILURE, sensor="compass")
    first = readings()
    assert which.on_sensors(2 * S, first) == [SensorAct("blue/b1", "compass"), SensorAct("blue/b2", "compass")]
    assert first.compass_gauss.tobytes() == readings().compass_gauss.tobytes()
    later = readings()
    later.compass_gauss += 0.3
    later.baro_up_m += 1.0
    assert which.on_sensors(3 * S, later) == []
    assert later.compass_gauss.tobytes() == first.compass_gauss.tobytes()
    assert later.baro_up_m.tobytes() == (readings().baro_up_m + 1.0).tobytes()


@pytest.mark.rotating
def test_noise_has_its_deviation_and_stays_until_the_next_measurement() -> None:
    which = fault(SENSOR_FAILURE, sensor="barometer", failure="noisy", noise_m=2.0)
    errors = []
    for turn in range(2_000):
        mine = readings()
        mine.baro_up_m += turn
        which.on_sensors(2 * S + turn * 100 * MS, mine)
        errors += (mine.baro_up_m - readings().baro_up_m - turn).tolist()
    assert np.std(errors) == pytest.approx(2.0, rel=0.05)
    assert np.mean(errors) == pytest.approx(0.0, abs=0.1)
    one, same = readings(), readings()
    which.on_sensors(500 * S, one)
    which.on_sensors(500 * S + 10 * MS, same)
    assert one.baro_up_m.tobytes() == same.baro_up_m.tobytes()


def test_voltage_sags_with_the_current() -> None:
    which = fault(BATTERY_FADE, resistance_ohm=0.2, drop_v=1.0, rise_s=10.0)
    mine = readings()
    mine.battery_v[:], mine.battery_a[:] = [12.0, 1.0], [10.0, 40.0]
    which.on_sensors(7 * S, mine)  # half of the rise
    assert mine.battery_v.tolist() == pytest.approx([12.0 - 0.5 * 3.0, 0.0])


def test_losses_come_in_bursts_of_the_given_lengths() -> None:
    given = replace(context(), links=LINKS, duration_ns=10_000 * S)
    given.schedule.stop_ns = 10_000 * S
    params = LINK_LOSS.params.model_validate({"links": ["gcs:blue/b1"], "burst_s": 1.0, "gap_s": 3.0, "loss": 0.5})
    (placed,) = LINK_LOSS(params, given).taps
    tap = placed.make("gcs:blue/b1")
    lost = np.array([bool(tap.on_frame(2 * S + k * 100 * MS, frame(2 * S + k * 100 * MS, k))) for k in range(60_000)])
    assert lost.mean() == pytest.approx(0.5 * 1.0 / 4.0, rel=0.1)
    # in a burst of exponential length the next frame is bad too with exp(-0.1 s / 1 s), and is then lost with 0.5
    assert lost[1:][lost[:-1]].mean() == pytest.approx(0.5 * np.exp(-0.1), rel=0.1)


def test_a_restart_silences_all_links_of_the_station_once() -> None:
    given = replace(context(), links=[*LINKS, "gcs:green/g1", "log:blue/b1"])
    taps = STATION_RESTART(STATION_RESTART.params.model_validate({"operator": "blue", "down_s": 5.0}), given).taps
    assert sorted(tap.match for tap in taps) == sorted(LINKS)
    assert {tap.side for tap in taps} == {"gcs"}
    tap = taps[0].make(taps[0].match)
    assert [bool(tap.on_frame(at * S, frame(at * S, at))) for at in (1, 2, 6, 7, 30)] == [
        False,
        True,
        True,
        False,
        False,
    ]
    assert list(tap.on_frame(3 * S, frame(3 * S, 3))) == [Drop()]
    with pytest.raises(InputError, match="an operator of the scenario"):
        STATION_RESTART(STATION_RESTART.params.model_validate({"operator": "bleu"}), given)


def test_the_wrong_command_bears_the_name_of_the_station() -> None:
    given = replace(context(), links=LINKS)
    params = OPERATOR_ERROR.params.model_validate({"vehicles": ["blue/b2"], "command": "speed", "speed_mps": 3.0})
    (placed,) = OPERATOR_ERROR(params, given).taps
    assert (placed.match, placed.side) == ("gcs:blue/b2", "gcs")
    tap = placed.make(placed.match)
    (act,) = tap.on_wakeup(2 * S)
    assert isinstance(act, Inject)
    message = decode(act.payload)
    assert (message.get_srcSystem(), message.command, message.param2) == (255, mav.MAV_CMD_DO_CHANGE_SPEED, 3.0)
    assert (act.src, act.dst) == ("blue.gcs", "blue/b2.companion")
    assert tap.next_wakeup() is None


def block(east_m: float, height_m: float) -> Building:
    return Building(str(east_m), height_m, shapely.box(east_m, -500.0, east_m + 30.0, 500.0))


def test_walls_hide_satellites_and_reflect_them_with_a_detour() -> None:
    """A street 40 m wide: the wall in the east hides what is lower than atan((60 - 10) / 20) = 68 degrees."""
    city = City([block(20.0, 60.0), block(-50.0, 300.0)], "test")
    sky = (Satellite(0.0, radians(60.0)), Satellite(0.0, radians(75.0)), Satellite(pi / 2, radians(30.0)))
    seen = see(city, (0.0, 0.0, 10.0), sky, 150.0)
    assert seen.hidden.tolist() == [1.0, 0.0, 0.0]
    assert seen.detour_m[:2] == pytest.approx([2 * 20.0 * cos(radians(60.0)), 2 * 20.0 * cos(radians(75.0))])
    assert np.isnan(seen.detour_m[2])
    low = see(city, (0.0, 0.0, 10.0), (Satellite(0.0, radians(30.0)),), 150.0)
    assert low.hidden.tolist() == [1.0]
    assert np.isnan(low.detour_m[0]), (
        "the ray does not reach the western wall: 10 + 60·tan 30° is below the eastern roof"
    )


def test_errors_of_satellites_in_sight_stay_within_the_envelope_of_the_correlator() -> None:
    detours = np.linspace(0.0, 400.0, 20_001)
    errors = pseudorange_errors(Seen(np.zeros_like(detours), detours), 0.5, 0.1)
    assert np.abs(errors).max() == pytest.approx(0.5 * 0.1 * CHIP_M / 2.0, rel=1e-3)
    assert np.abs(errors).max() == pytest.approx(7.3, abs=0.1)
    assert not errors[detours > 1.5 * CHIP_M].any()
    hidden = pseudorange_errors(Seen(np.array([1.0, 1.0]), np.array([30.0, np.nan])), 0.5, 0.1)
    assert hidden[0] == 30.0
    assert np.isnan(hidden[1])


def test_a_common_error_is_one_of_the_clock() -> None:
    sky, ones = even_sky(10, 0.3), np.ones(10)
    solved = solve(sky, np.full(10, 25.0), ones)
    assert solved is not None
    assert solved[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    moved = np.array([-np.dot(one.unit, (3.0, -2.0, 5.0)) for one in sky])
    solved = solve(sky, moved, ones)
    assert solved is not None
    assert solved[0] == pytest.approx([3.0, -2.0, 5.0])
    assert solve(sky, np.where(np.arange(10) < 3, 0.0, np.nan), ones) is None


def test_multipath_needs_buildings() -> None:
    params = GNSS_MULTIPATH.params.model_validate({"vehicles": ["blue/b1"]})
    with pytest.raises(InputError, match="a scenario with a city"):
        GNSS_MULTIPATH(params, context())


def body_fault(kind: FaultPlugin, **params: Any) -> BodyHook:
    chosen = kind.params.model_validate(params)
    (only,) = kind(chosen, context()).body_hooks
    return only


def bodies(*places: tuple[float, float, float]) -> Disturbances:
    return Disturbances(np.array(places), np.ones((len(places), 4)), np.zeros((len(places), 3)))


def test_a_lost_motor_gives_the_rest_of_its_thrust_alone() -> None:
    which = body_fault(MOTOR_LOSS, vehicles=["blue/b1", "blue/b2"], motor=3, loss=0.25)
    before, after = bodies((0, 0, 0), (9, 0, 0)), bodies((0, 0, 0), (9, 0, 0))
    assert which.on_bodies(2 * S - 1, before) == []
    assert before.thrust_share.tolist() == [[1.0] * 4] * 2
    assert which.on_bodies(2 * S, after) == [BodyAct("blue/b1", "motor"), BodyAct("blue/b2", "motor")]
    assert after.thrust_share.tolist() == [[1.0, 1.0, 0.75, 1.0]] * 2
    assert not after.wind_enu_mps.any()
    assert which.on_bodies(3 * S, bodies((0, 0, 0), (9, 0, 0))) == []


def test_a_gust_has_the_shape_of_half_a_cosine_along_its_way() -> None:
    """MIL-F-8785C, 3.7.1.3: V/2·(1 - cos(π·x/d)); from the west, with 10 m/s, from the origin at 2 s on."""
    which = body_fault(
        GUST, vehicles=["blue/b1", "blue/b2"], speed_mps=8.0, up_mps=-2.0, from_deg=270, length_m=20, hold_m=10
    )
    found = {}
    for at_ms in (1_999, 2_500, 3_000, 4_000, 5_000, 6_000, 7_000, 12_000):
        moved = bodies((0.0, 50.0, 30.0), (60.0, 0.0, 3.0))
        acts = which.on_bodies(at_ms * MS, moved)
        found[at_ms] = (moved.wind_enu_mps[:, 0].tolist(), [act.vehicle for act in acts])
        assert moved.wind_enu_mps[:, 1] == pytest.approx([0.0, 0.0], abs=1e-12)
        assert moved.wind_enu_mps[:, 2] == pytest.approx(moved.wind_enu_mps[:, 0] / -4.0)
        assert (moved.thrust_share == 1.0).all()
    assert found[1_999] == ([0.0, 0.0], [])
    assert found[2_500][0] == pytest.approx([4.0 * (1.0 - cos(pi * 5 / 20)), 0.0])
    assert found[2_500][1] == ["blue/b1"]
    assert [found[at][0][0] for at in (3_000, 4_000, 5_000, 6_000, 7_000)] == pytest.approx([4.0, 8.0, 8.0, 4.0, 0.0])
    assert found[12_000][0] == pytest.approx([0.0, 4.0 * (1.0 - cos(pi * 10 / 20))])
    assert found[12_000][1] == ["blue/b2"]


def test_a_gust_meets_those_within_its_radius_and_fades_out_beyond() -> None:
    given = {"speed_mps": 8.0, "length_m": 20, "hold_m": 1_000, "radius_m": 30, "at": [100, 0, 0]}
    which = body_fault(GUST, vehicles=["blue/b1", "blue/b2", "blue/b3"], **given)
    moved = bodies((130.0, 0.0, 30.0), (140.0, 0.0, 3.0), (150.1, 0.0, 0.0))
    which.on_bodies(10 * S, moved)
    assert moved.wind_enu_mps[:, 1] == pytest.approx([-8.0, -4.0, 0.0])
    assert set(body_fault(GUST, up_mps=1.0).vehicles) == set(context().vehicles), "all, unless named"
    with pytest.raises(ValueError, match="other than zero"):
        GUST.params.model_validate({"from_deg": 90})


def scenario_with(*tables: str) -> str:
    return FLEET + "".join(f"\n{table}\n" for table in tables)


OUTAGE = '[[faults]]\nid = "dark"\nkind = "gnss.outage"\nstart_s = 3\nparams = { vehicles = ["blue/b1"] }'
JUMP = '[[attacks]]\nid = "dark"\nkind = "gnss.jump"\nparams = { vehicles = ["blue/b1"], offset_m = [9, 0, 0] }'


def test_a_fault_is_planned_as_one_and_stands_apart_in_the_manifest() -> None:
    built = build(load_text(scenario_with(OUTAGE)))
    (plan,) = built.wiring.acts
    assert (plan.id, plan.is_fault, plan.sham, plan.start_ns) == ("dark", True, False, 3 * S)
    assert built.header["attacks"] == []
    (row,) = built.header["faults"]
    assert (row["id"], row["kind"], row["touches"]) == ("dark", "gnss.outage", ["sensors of blue/b1"])
    assert not {"technique", "threat", "radios", "sham"} & set(row)
    assert "faults" not in build(load_text(FLEET)).header


@pytest.mark.parametrize(
    ("tables", "where"),
    [
        ((OUTAGE, JUMP), "an id that no attack has"),
        ((OUTAGE, OUTAGE), "an id that no other fault has"),
        ((OUTAGE + "\nsham = true",), "sham"),
        ((OUTAGE.replace("gnss.outage", "gnss.outrage"),), "a kind of fault"),
        ((OUTAGE.replace("gnss.outage", "gnss.jump"),), "a kind of fault"),
        ((OUTAGE + '\nanchor = "blue/b9"',), "a vehicle of the scenario"),
    ],
)
def test_wrong_tables_are_errors(tables: tuple[str, ...], where: str) -> None:
    with pytest.raises(InputError, match=where):
        load_text(scenario_with(*tables))


def test_a_stranger_is_an_error_of_the_fault() -> None:
    with pytest.raises(InputError, match=r"faults\.dark\.params\.vehicles\.0"):
        build(load_text(scenario_with(OUTAGE.replace('["blue/b1"]', '["blue/b9"]'))))


@pytest.mark.parametrize("name", sorted(FAULT_EXAMPLES))
def test_an_example_shows_its_kind(name: str) -> None:
    scenario = load(name)
    assert scenario.name == name
    assert {fault.kind for fault in scenario.faults} == {name}
    assert not scenario.attacks
    assert scenario.duration_s <= 90
    build(scenario)
