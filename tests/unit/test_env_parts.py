"""The parts of the learning environment: bad input, progress along a route, and the contracts of taps and monitors."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from skyrange.attack.gnss.drift import Drift
from skyrange.codec.mavlink import Packer
from skyrange.contracts.components import SensorAct
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.env import FEATURES, BlueAct, HoldTheMission, Quiet, RedAct, Rewards, ScriptedRed, make_scenario, play
from skyrange.env.acts import BlueChoices, Clock, RedChoice
from skyrange.env.observations import TelemetryFeatures
from skyrange.env.outcomes import MissionProgress
from skyrange.env.parts import AdversaryTap, Announcer, ChosenDrift, CommandConsole, SourceFilter, make_red_team
from skyrange.scenario import Scenario
from skyrange.scenario.model.scenario import Origin as ScenarioOrigin
from skyrange.testing import check_agent, check_monitor, check_tap
from tests.unit.test_attack_gnss import off, readings

pytestmark = pytest.mark.rotating

CLOCK = Clock(NS_PER_S)
BLUE = "blue_blue"


def altered(**changes: Any) -> Scenario:
    (blue,) = make_scenario(1).operators
    return Scenario(
        name="altered", origin=ScenarioOrigin(lat=47.0, lon=8.0), operators=(blue.model_copy(update=changes),)
    )


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"aircraft": 0}, "aircraft: 0 — expected a whole number from 1 to 100"),
        ({"aircraft": 2.0}, "aircraft: 2.0 — expected a whole number from 1 to 100"),
        ({"scenario": "squares", "aircraft": 2}, "aircraft: 2 — expected nothing"),
        ({"scenario": "sqares"}, "squares"),
        ({"step_s": 0}, "step_s: 0 — expected a number of seconds from 0.1 to 60"),
        ({"step_s": float("nan")}, "step_s: nan — expected"),
        ({"step_s": "1"}, "step_s: 1 — expected"),
        ({"scenario": make_scenario(1, duration_s=5), "step_s": 6}, "step_s: 6 — expected at most"),
        ({"render_mode": "human"}, "render_mode: human — expected None"),
        ({"rewards": {"progress": 1}}, "rewards: .* — expected skyrange.env.Rewards"),
        ({"scenario": altered(signing="on")}, "operators.blue.signing: 'on' — expected 'off'"),
    ],
)
def test_a_bad_argument_is_named_with_what_was_expected(arguments: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        HoldTheMission(**arguments)


def test_guided_plans_and_other_autopilots_are_rejected() -> None:
    scenario = Scenario.from_file("squares", ["operators.0.vehicles.0.plan.mode=guided"])
    with pytest.raises(InputError, match=r"operators.blue.vehicles.b1.plan.mode: 'guided' — expected 'auto'"):
        HoldTheMission(scenario)
    scenario = Scenario.from_file("squares", ["operators.1.vehicles.0.autopilot=ardupilot"])
    with pytest.raises(InputError, match=r"operators.green.vehicles.g1.autopilot: 'ardupilot' — expected 'builtin'"):
        HoldTheMission(scenario)


@pytest.mark.parametrize("value", [-0.1, float("inf"), float("nan"), True, "1"])
def test_a_weight_is_a_finite_number(value: Any) -> None:
    with pytest.raises(InputError, match=r"rewards\.mishap"):
        Rewards(mishap=value)


@pytest.fixture(scope="module")
def begun() -> HoldTheMission:
    environment = HoldTheMission(make_scenario(2, duration_s=5))
    environment.reset(seed=1)
    return environment


@pytest.mark.parametrize(
    ("actions", "named"),
    [
        ({"red": 0}, "actions.blue_blue: missing"),
        ({"red": 7, BLUE: [0, 0]}, "actions.red: 7 — expected an action of Discrete"),
        ({"red": -1, BLUE: [0, 0]}, "actions.red: -1"),
        ({"red": 1.0, BLUE: [0, 0]}, "actions.red: 1.0"),
        ({"red": [1], BLUE: [0, 0]}, "actions.red"),
        ({"red": 0, BLUE: [0]}, "actions.blue_blue"),
        ({"red": 0, BLUE: [0, 4]}, "actions.blue_blue"),
        ({"red": 0, BLUE: None}, "actions.blue_blue: None"),
        ({"red": 0, BLUE: [0, 0], "blue_blu": [0]}, "agent: blue_blu — expected an agent: red, blue_blue"),
    ],
)
def test_a_bad_action_is_named_and_nothing_is_flown(begun: HoldTheMission, actions: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        begun.step(actions)
    assert begun._episode is not None
    assert begun._episode.now == 0


@pytest.mark.parametrize("seed", [-1, 2**63, 1.5, True, "1"])
def test_a_bad_seed_is_named(seed: Any) -> None:
    with pytest.raises(InputError, match=r"seed: .* — expected a whole number from 0"):
        HoldTheMission(aircraft=1).reset(seed=seed)


def test_what_needs_an_episode_says_so() -> None:
    environment = HoldTheMission(aircraft=1)
    for call in (lambda: environment.step({"red": 0, BLUE: [0]}), environment.state):
        with pytest.raises(InputError, match="no episode is under way — expected a call of reset before"):
            call()
    with pytest.raises(InputError, match="agent: green — expected an agent"):
        environment.action_space("green")
    with pytest.raises(InputError, match=r"policies\.blue_blue: missing"):
        play(environment, {"red": Quiet("red")})


def test_observations_lie_in_their_space_and_the_state_joins_them(begun: HoldTheMission) -> None:
    observations, _ = begun.reset(seed=1)
    for agent, one in observations.items():
        assert begun.observation_space(agent).contains(one)
        assert one.shape == (2, len(FEATURES))
    assert np.array_equal(begun.state(), np.concatenate([observations[agent].ravel() for agent in ("red", BLUE)]))


def test_a_missing_package_names_the_extra() -> None:
    code = "import sys; sys.modules['pettingzoo'] = None\nimport skyrange.env\nskyrange.env.HoldTheMission"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "InputError" in done.stderr
    assert "pip install 'skyrange[env]'" in done.stderr


def square() -> MissionProgress:
    """A square of 20 m on the ground, a point each metre."""
    sides = [[(n, 0), (20, n), (20 - n, 20), (0, 20 - n)] for n in range(20)]
    points = [sides[n][side] for side in range(4) for n in range(20)] + [(0, 0)]
    return MissionProgress(np.array([(*point, 0.0) for point in points]), [0, 20, 40, 60, 80])


def at(east_m: float, north_m: float) -> Any:
    return np.array([east_m, north_m, 0.0])


def test_progress_follows_the_route_and_does_not_go_back() -> None:
    progress = square()
    assert progress.advance(at(8, 1), 1.0) == pytest.approx(0.1)
    assert progress.advance(at(3, 0), 1.0) == 0.0
    assert progress.advance(at(20, 0), 1.0) == pytest.approx(0.15)
    assert progress.share == 0.25


def test_an_aircraft_at_the_start_of_a_loop_is_not_at_its_end() -> None:
    progress = square()
    for _ in range(100):
        progress.advance(at(0.3, 0.4), 1.0)
    assert progress.share < 0.05


def test_one_that_was_away_goes_on_with_the_leg_that_it_had_left_and_skips_no_corner() -> None:
    progress = square()
    progress.advance(at(4, 0), 1.0)
    for _ in range(5):
        assert progress.advance(at(10, 12), 1.0) == 0.0
    assert progress.advance(at(0, 15), 1.0) == 0.0
    assert progress.advance(at(20, 0), 1.0) == pytest.approx(0.2)


def test_the_way_home_is_not_astray() -> None:
    assert square().distance_m(at(10, 10)) == 0.0
    assert square().distance_m(at(-25, 10)) == pytest.approx(25.0)
    assert square().end_distance_m(at(3, 4)) == pytest.approx(5.0)


@pytest.mark.parametrize("name", ["cut_steps", "pause_steps"])
@pytest.mark.parametrize("value", [-1, 1.5, True])
def test_steps_of_the_scripted_adversary_are_whole_numbers(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"{name}: {value} — expected a whole number, at least 0"):
        ScriptedRed(**{name: value})


def test_an_episode_whose_flight_fails_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    environment = HoldTheMission(aircraft=1)
    environment.reset(seed=1)
    assert environment._episode is not None

    def fail(until: Time) -> None:
        raise ComponentError("kernel", "failed")

    monkeypatch.setattr(environment._episode._kernel, "advance", fail)
    with pytest.raises(ComponentError, match="kernel: failed"):
        environment.step({"red": 0, BLUE: [0]})
    assert environment.agents == []
    with pytest.raises(InputError, match="no episode is under way"):
        environment.step({"red": 0, BLUE: [0]})


def red_tap(act: RedAct | None) -> Callable[[str], AdversaryTap]:
    choice = RedChoice("blue/b1", act, 0)
    return lambda link: AdversaryTap(link, "blue/b1", 1, 9, choice, CLOCK, Packer(254, 190))


@pytest.mark.parametrize("act", [None, RedAct.MODE, RedAct.LINK])
def test_taps_of_the_adversary_keep_their_contract(act: RedAct | None) -> None:
    check_tap(red_tap(act))


@pytest.mark.parametrize("act", list(BlueAct))
def test_taps_and_agents_of_operators_keep_their_contract(act: BlueAct) -> None:
    choices = BlueChoices()
    choices.choose(0, "blue/b1", act, 5 * NS_PER_S)
    check_tap(lambda link: CommandConsole(link, "blue/b1", 1, choices, CLOCK, Packer(255, 26)))
    check_tap(lambda link: SourceFilter(link, "blue/b1", choices))
    check_agent(partial(Announcer, BLUE, choices, CLOCK))


@pytest.mark.parametrize("received", [True, False])
def test_the_monitor_keeps_its_contract_whatever_the_frames_say(received: bool) -> None:
    vehicles = ["blue/b1", "blue/b2"]
    ports = [Port("blue.gcs", f"gcs:{vehicle}") for vehicle in vehicles]
    made = partial(TelemetryFeatures, vehicles, Origin(47.0, 8.0), NS_PER_S, received)
    check_monitor(made, ports=ports)


def shift(fault: ChosenDrift, now: Time, measured: Time) -> tuple[np.ndarray, list[SensorAct]]:
    """By how much it moves position and velocity of two aircraft's fixes of that time, (2, 6), and its acts."""
    sensors = readings()
    sensors.gnss_time_ns[:] = measured
    acts = list(fault.on_sensors(now, sensors))
    return off(sensors), acts


def test_the_drift_is_that_of_the_chosen_aircraft_from_its_choice_on() -> None:
    choice = RedChoice()
    fault = ChosenDrift(
        "red.gnss", ["blue/b1", "blue/b2"], Drift(vehicles=["any"], rate_mps=(2.0, 0.0, 0.0), largest_m=60.0), choice
    )
    assert not shift(fault, NS_PER_S, NS_PER_S)[0].any()
    choice.choose(2 * NS_PER_S, "blue/b2", RedAct.GNSS)
    moved, acts = shift(fault, 3 * NS_PER_S, 3 * NS_PER_S)
    assert moved[1] == pytest.approx([2, 0, 0, 2, 0, 0])
    assert not moved[0].any()
    assert acts == [SensorAct("blue/b2", "gnss")]
    choice.choose(3 * NS_PER_S, "blue/b2", RedAct.GNSS)
    moved, acts = shift(fault, 5 * NS_PER_S, 5 * NS_PER_S)
    assert moved[1] == pytest.approx([6, 0, 0, 2, 0, 0])
    assert acts == []
    assert not shift(fault, 5 * NS_PER_S, NS_PER_S)[0].any()
    choice.choose(6 * NS_PER_S, "blue/b2", RedAct.LINK)
    assert not shift(fault, 6 * NS_PER_S, 6 * NS_PER_S)[0].any()
    choice.choose(7 * NS_PER_S, "blue/b2", RedAct.GNSS)
    moved, acts = shift(fault, 8 * NS_PER_S, 8 * NS_PER_S)
    assert moved[1] == pytest.approx([2, 0, 0, 2, 0, 0])
    assert len(acts) == 1


def test_frames_of_acts_are_sent_just_after_the_beginning_of_a_step() -> None:
    assert CLOCK.next_act(0) == NS_PER_MS
    assert CLOCK.next_act(NS_PER_MS) == NS_PER_S + NS_PER_MS
    plan, taps = make_red_team(
        {"blue/b1": 1}, RedChoice(), CLOCK, mode=9, drift=Drift(vehicles=["any"], rate_mps=(1.0, 0, 0), largest_m=9)
    )
    assert plan.id == "red"
    assert [(tap.match, tap.side, tap.attack) for tap in taps] == [("gcs:blue/b1", "companion", "red")]


def test_the_adversary_is_in_the_network_of_a_link_over_the_air() -> None:
    drift = Drift(vehicles=["any"], rate_mps=(1.0, 0, 0), largest_m=9)
    over_air = {"gcs:blue/b2"}
    _, taps = make_red_team({"blue/b1": 1, "blue/b2": 2}, RedChoice(), CLOCK, mode=9, drift=drift, over_air=over_air)
    assert [tap.side for tap in taps] == ["companion", "gcs"]
