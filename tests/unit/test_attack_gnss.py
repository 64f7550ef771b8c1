"""What do the GNSS attacks do to a receiver's fixes, and to nothing else?"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from skyrange.assembly.build import build
from skyrange.attack.contract import Aircraft, AttackContext, AttackPlugin
from skyrange.contracts.components import SensorAct, SensorHook, Sensors
from skyrange.contracts.links import Schedule
from skyrange.contracts.plugins import registry as plugins
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NEVER, NS_PER_S, Epoch, Time
from skyrange.scenario.toml_files import load_text
from skyrange.world import Body, SensorSpec, World

DRIFT = AttackPlugin.find("gnss.drift")
JUMP = AttackPlugin.find("gnss.jump")

S = NS_PER_S
B1, EAST = '"blue/b1"', "rate_mps = [1, 0, 0]"
GNSS = {"gnss_enu_m", "gnss_vel_enu_mps"}
FLEET = """
name = "s"
origin = [40.778, -73.955]
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan.square = { side_m = 20, alt_m = 10 }
"""


def readings() -> Sensors:
    """Two aircraft's readings, whatever they are: each number another."""
    world = World(
        [Body("blue/b1", "iris", 0.0, 0.0), Body("blue/b2", "iris", 9.0, 0.0)], 2_500_000, sensors=SensorSpec(1.0)
    )
    world.advance(0)
    found = world.sensors(np.array([0, 1]))
    rng = np.random.default_rng(1)
    for column in fields(Sensors):
        array = getattr(found, column.name)
        if array.dtype == np.float64:
            array[:] = rng.normal(size=array.shape)
    return found


def context(start: Time = 2 * S, sham: bool = False) -> AttackContext:
    vehicles = {name: Aircraft((0.0, 0.0, 0.0), "") for name in ("blue/b1", "blue/b2", "blue/b3")}
    return AttackContext(
        "x", vehicles, [], Origin(40.0, -73.0, 0.0, 0.0), Epoch(0), Chance(3), 99 * S, Schedule(start, 90 * S), sham
    )


def fault(kind: AttackPlugin, where: AttackContext | None = None, **params: Any) -> SensorHook:
    chosen = kind.params.model_validate({"vehicles": ["blue/b1", "blue/b2"], **params})
    (only,) = kind(chosen, where or context()).sensor_hooks
    return only


def told(which: SensorHook, now: Time, measured: Sequence[Time] | None = None) -> tuple[Sensors, Sequence[SensorAct]]:
    """What it makes of the readings, of fixes measured then (default: now)."""
    sensors = readings()
    sensors.gnss_time_ns[:] = now if measured is None else measured
    return sensors, acts_of(which, now, sensors)


def acts_of(which: SensorHook, now: Time, sensors: Sensors) -> list[SensorAct]:
    acts = []
    for act in which.on_sensors(now, sensors):
        assert isinstance(act, SensorAct)
        acts.append(act)
    return acts


def off(sensors: Sensors) -> np.ndarray:
    """By how much position and velocity of the fixes were moved, (n, 6)."""
    true = readings()
    moved = [sensors.gnss_enu_m - true.gnss_enu_m, sensors.gnss_vel_enu_mps - true.gnss_vel_enu_mps]
    return np.hstack(moved)


def test_a_jump_moves_position_at_once_and_tells_it_once() -> None:
    jump = fault(JUMP, offset_m=[30, -20, 10])
    _, acts = told(jump, 2 * S - 1)
    assert acts == []
    sensors, acts = told(jump, 2 * S)
    assert off(sensors) == pytest.approx(np.tile([30, -20, 10, 0, 0, 0], (2, 1)))
    assert acts == [SensorAct("blue/b1", "gnss"), SensorAct("blue/b2", "gnss")]
    later, acts = told(jump, 50 * S)
    assert off(later) == pytest.approx(off(sensors))
    assert acts == []


@pytest.mark.parametrize(
    ("kind", "params"),
    [(JUMP, {"offset_m": [3, 4, 5]}), (DRIFT, {"rate_mps": [1, 2, 3]})],
    ids=["jump", "drift"],
)
def test_nothing_else_is_touched_and_not_the_other_aircraft(kind: AttackPlugin, params: dict[str, Any]) -> None:
    sensors, _ = told(fault(kind, vehicles=["blue/b1", "blue/b2"], **params), 9 * S)
    true = readings()
    true.gnss_time_ns[:] = 9 * S
    for column in fields(Sensors):
        same = getattr(sensors, column.name).tobytes() == getattr(true, column.name).tobytes()
        assert same == (column.name not in (GNSS if kind is DRIFT else {"gnss_enu_m"})), column.name


@pytest.mark.parametrize(("velocity", "share"), [("consistent", 1.0), ("unaltered", 0.0)])
def test_a_drift_grows_from_the_truth_with_or_without_its_velocity(velocity: str, share: float) -> None:
    drift = fault(DRIFT, rate_mps=[1.0, -2.0, 0.5], velocity=velocity)
    for seconds in (0.0, 0.4, 60.0):
        sensors, _ = told(drift, 2 * S + round(seconds * S))
        rate = np.array([1.0, -2.0, 0.5])
        assert off(sensors) == pytest.approx(np.tile([*(seconds * rate), *(share * rate)], (2, 1)), abs=1e-9)


def test_a_drift_is_held_at_its_largest_or_returns_and_each_turn_is_an_act() -> None:
    held = fault(DRIFT, rate_mps=[3, 4, 0], largest_m=50)
    back = fault(DRIFT, rate_mps=[3, 4, 0], largest_m=50, at_largest="return")
    expected = {
        5.0: ((15, 20, 3, 4), (15, 20, 3, 4)),
        10.0: ((30, 40, 0, 0), (30, 40, -3, -4)),
        15.0: ((30, 40, 0, 0), (15, 20, -3, -4)),
        25.0: ((30, 40, 0, 0), (0, 0, 0, 0)),
    }
    counts = []
    for seconds, wants in expected.items():
        for which, want in zip((held, back), wants, strict=True):
            sensors, acts = told(which, 2 * S + round(seconds * S))
            assert off(sensors)[0, [0, 1, 3, 4]] == pytest.approx(want), seconds
            counts.append(len(acts))
    assert counts == [2, 2, 2, 2, 0, 0, 0, 2]


def test_a_fix_is_moved_by_when_it_was_measured() -> None:
    """So a repetition repeats the same lie, and what was measured before the attack is true."""
    drift = fault(DRIFT, rate_mps=[10, 0, 0])
    sensors, acts = told(drift, 3 * S, [2 * S - 1, 2 * S + S // 2])
    assert off(sensors)[:, 0] == pytest.approx([0.0, 5.0])
    assert acts == [SensorAct("blue/b2", "gnss")]
    again, acts = told(drift, 3 * S + S // 10, [2 * S - 1, 2 * S + S // 2])
    assert again.gnss_enu_m.tobytes() == sensors.gnss_enu_m.tobytes()
    assert acts == []


def test_a_receiver_without_a_fix_has_none_to_be_false() -> None:
    jump, sensors = fault(JUMP, offset_m=[30, 0, 0]), readings()
    sensors.gnss_time_ns[:] = 3 * S
    sensors.gnss_fix[:] = [1, 3]
    assert [act.vehicle for act in acts_of(jump, 3 * S, sensors)] == ["blue/b2"]
    assert off(sensors)[:, 0] == pytest.approx([0.0, 30.0])


def test_it_waits_for_its_trigger_and_counts_from_there() -> None:
    where = context(start=NEVER)
    drift = fault(DRIFT, where, rate_mps=[1, 0, 0])
    assert told(drift, 50 * S)[1] == []
    where.schedule.start_ns = 60 * S
    assert off(told(drift, 61 * S)[0])[0, 0] == pytest.approx(1.0)
    where.schedule.start_ns = 61 * S + S // 10  # started anew: a fix from before is true again
    assert not off(told(drift, 61 * S + S // 10, [61 * S, 61 * S])[0]).any()
    where.schedule.start_ns = 60 * S + S // 2
    assert off(told(drift, 61 * S + S // 5, [61 * S, 61 * S])[0])[0, 0] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("kind", "params"),
    [(JUMP, {"offset_m": [3, 4, 5]}), (DRIFT, {"rate_mps": [1, 2, 3], "largest_m": 10, "at_largest": "return"})],
    ids=["jump", "drift"],
)
def test_a_sham_tells_the_same_acts_and_moves_nothing(kind: AttackPlugin, params: dict[str, Any]) -> None:
    live, sham = fault(kind, **params), fault(kind, context(sham=True), **params)
    for now in range(0, 20 * S, S // 5):
        sensors, acts = told(sham, now)
        assert acts == told(live, now)[1]
        assert not off(sensors).any()


def test_it_is_plain_state() -> None:
    drift = fault(DRIFT, rate_mps=[1, 0, 0], largest_m=5)
    told(drift, 3 * S)
    twin = copy.deepcopy(drift)
    assert told(twin, 9 * S)[1] == told(drift, 9 * S)[1] != []


def wrong(kind: str, params: str) -> list[str]:
    text = f'[[attacks]]\nid = "lie"\nkind = "{kind}"\nparams = {{ {params} }}\n'
    with pytest.raises(InputError) as caught:
        build(load_text(FLEET + text))
    return [str(fault) for fault in caught.value.problems]


@pytest.mark.parametrize(
    ("kind", "params", "words"),
    [
        ("jump", f"vehicles = [{B1}]", "params.offset_m: missing"),
        ("jump", f"vehicles = [{B1}], offset_m = [1, 2]", "params.offset_m.2: missing"),
        ("jump", f"vehicles = [{B1}], offset_m = [1, 2, 200000]", "each component from -100000 to 100000 metres"),
        ("jump", f"vehicles = [{B1}], offset_m = [1, 2, nan]", "params.offset_m.2"),
        ("jump", "vehicles = [], offset_m = [1, 2, 3]", "params.vehicles"),
        ("jump", f"vehicles = {B1}, offset_m = [1, 2, 3]", "params.vehicles: 'blue/b1' — expected a list"),
        ("jump", f"vehicles = [{B1}, {B1}], offset_m = [1, 2, 3]", "each aircraft once"),
        ("jump", 'vehicles = ["blue/b2"], offset_m = [1, 2, 3]', "Did you mean 'blue/b1'?"),
        ("drift", f"vehicles = [{B1}], rate_mps = [1, 0, 501]", "each component from -500 to 500 m/s"),
        ("drift", f'vehicles = [{B1}], {EAST}, velocity = "yes"', "expected 'consistent' or 'unaltered'"),
        ("drift", f"vehicles = [{B1}], {EAST}, largest_m = 0", "params.largest_m: 0"),
        ("drift", f'vehicles = [{B1}], {EAST}, at_largest = "return"', "params.largest_m: missing"),
        ("drift", f"vehicles = [{B1}], rate = [1, 0, 0]", "Write rate_mps, in m/s"),
    ],
)
def test_what_is_wrong_is_said(kind: str, params: str, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plugins.register(plugins.ATTACKS, "gnss.jump", JUMP)
    plugins.register(plugins.ATTACKS, "gnss.drift", DRIFT)
    found = wrong(f"gnss.{kind}", params)
    assert any(words in one for one in found), found
