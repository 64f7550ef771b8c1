"""One episode: a run of a scenario with the parts of both teams, driven step by step, recorded or not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from skyrange.assembly.build import BuiltScenario, build
from skyrange.assembly.placement.flight_plans import make_flight_plan
from skyrange.attack.gnss.drift import Drift
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.components import World
from skyrange.core.errors import InputError, Problem
from skyrange.core.ids import link_name, operator_of, vehicle_id
from skyrange.core.time import Time, from_seconds, to_seconds
from skyrange.env.acts import RED, BlueAct, BlueChoices, Clock, RedAct, RedChoice, blue_agent
from skyrange.env.observations import TelemetryFeatures, place_monitor
from skyrange.env.outcomes import MissionProgress, Outcomes, Rewards
from skyrange.env.parts import make_blue_team, make_red_team
from skyrange.kernel import Kernel
from skyrange.runtime.run import Run
from skyrange.scenario.model.scenario import Scenario

BLOCK_S: Final = 10.0
"""How long a BLOCK lasts."""
RED_MODE: Final = "LAND"
"""The flight mode that `RedAct.MODE` commands."""
DRIFT: Final = Drift(vehicles=("any",), rate_mps=(2.0, 0.0, 0.0), largest_m=60.0)
"""The drift of `RedAct.GNSS`: 2 m/s to the east, up to 60 m, with the velocity of the false track."""


def check_scenario(scenario: Scenario) -> None:
    """Raise `InputError` for a scenario that this task cannot be played on."""
    found = []
    for operator in scenario.operators:
        if operator.signing != "off":
            expected = "'off', because the commands of the agents are not signed"
            found.append(Problem(f"operators.{operator.id}.signing", repr(operator.signing), expected))
    for operator, vehicle in scenario.fleet:
        where = f"operators.{operator.id}.vehicles.{vehicle.id}"
        if vehicle.autopilot != "builtin":
            found.append(Problem(f"{where}.autopilot", repr(vehicle.autopilot), "'builtin', which repeats to the byte"))
        if vehicle.plan.mode == "guided":
            found.append(Problem(f"{where}.plan.mode", "'guided'", "'auto', because agents command the mode AUTO"))
    if found:
        raise InputError(f"scenario {scenario.name}", found)


@dataclass(slots=True)
class Parts:
    """What the environment adds to a run, and through which it acts and observes."""

    red: RedChoice
    blue: Mapping[str, BlueChoices]
    """By agent."""
    monitors: Mapping[str, TelemetryFeatures]
    """By agent."""
    outcomes: Outcomes


class Episode:
    """A run with the parts of both teams, at the beginning of a step."""

    def __init__(self, scenario: Scenario, step_ns: Time, rewards: Rewards, out: Path | None) -> None:
        """Build the run; with `out` it is recorded in that folder. Raises `InputError` before anything is written."""
        self.step_ns = step_ns
        self._end_ns = from_seconds(scenario.duration_s)
        self.parts, hooks = _make_parts(scenario, step_ns, rewards)
        self._run: Run | None = None
        self._built: BuiltScenario
        if out is None:
            self._built = build(scenario, **hooks)
            self._kernel = Kernel(self._built.wiring, [self.parts.outcomes])
        else:
            more = {
                "environment": {"task": "hold-the-mission", "agents": list(self.parts.monitors), "step_ns": step_ns}
            }
            self._run = Run.start(scenario, out, observers=[self.parts.outcomes], more=more, **hooks)
            self._built, self._kernel = self._run.built, self._run.kernel
        self._closed = False
        self.parts.outcomes.progress = _list_routes(self._built.scenario)
        self._advance(0)

    @property
    def now(self) -> Time:
        """Simulated time reached, in nanoseconds."""
        return self._kernel.now

    @property
    def world(self) -> World:
        """The truth."""
        world = self._built.wiring.world
        assert world is not None
        return world

    @property
    def out_of_time(self) -> bool:
        """Whether the next step would end after the scenario's duration."""
        return self.now + self.step_ns > self._end_ns

    def step(self, red: tuple[str, RedAct | None], blue: Mapping[str, Mapping[str, BlueAct]]) -> dict[str, float]:
        """Fly a step with red's act on an aircraft, and each blue agent's acts by aircraft; returns `end_step`'s."""
        now, parts = self.now, self.parts
        vehicle, act = red
        parts.red.choose(now, vehicle, act)
        if act is not None:
            parts.outcomes.hostile_ns[vehicle] = now
        for agent, acts in blue.items():
            for name, chosen in acts.items():
                parts.blue[agent].choose(now, name, chosen, from_seconds(BLOCK_S))
        self._advance(now + self.step_ns)
        return parts.outcomes.end_step(self.world, to_seconds(self.step_ns))

    def _advance(self, until: Time) -> None:
        try:
            if self._run is not None:
                self._run.advance(to_seconds(until))
            else:
                self._kernel.advance(until)
        except BaseException:
            self.close("failed")
            raise

    def close(self, status: str) -> None:
        """End the run, and close its record with `status`; again does nothing."""
        if self._closed:
            return
        self._closed = True
        if self._run is not None:
            self._run.finish(status)
            return
        self._kernel.finish()
        self._built.close()


def _make_parts(scenario: Scenario, step_ns: Time, rewards: Rewards) -> tuple[Parts, dict[str, Any]]:
    """The parts of both teams, and the arguments of `build` that put them into a run."""
    fleet = {vehicle_id(operator.id, vehicle.id): vehicle for operator, vehicle in scenario.fleet}
    origin, clock, systems = scenario.origin.datum, Clock(step_ns), {name: one.system_id for name, one in fleet.items()}
    red = RedChoice()
    over_air = {link for link in (link_name("gcs", one) for one in fleet) if scenario.over_air(link) is not None}
    mode = COPTER_MODE_NUMBERS[RED_MODE]
    plan, taps = make_red_team(systems, red, clock, mode=mode, drift=DRIFT, over_air=over_air)
    plans, defences = [plan], []
    monitors = {RED: TelemetryFeatures(list(fleet), origin, step_ns, received=False)}
    blue = {}
    for operator in scenario.operators:
        own = {name: system for name, system in systems.items() if operator_of(name) == operator.id}
        agent = blue_agent(operator.id)
        blue[agent] = BlueChoices()
        plan, placed = make_blue_team(agent, own, blue[agent], clock)
        plans.append(plan)
        defences += placed
        monitors[agent] = TelemetryFeatures(list(own), origin, step_ns, received=True)
    hooks = {
        "taps": [*defences, *taps],  # on one side, the later one is nearer to the channel
        "acts": plans,
        "monitors": [place_monitor(agent, monitor) for agent, monitor in monitors.items()],
    }
    return Parts(red, blue, monitors, Outcomes(rewards)), hooks


def _list_routes(scenario: Scenario) -> dict[str, MissionProgress]:
    """By aircraft of a built scenario, the route of its plan, of which nothing is done."""
    return {
        vehicle_id(operator.id, vehicle.id): MissionProgress.of(make_flight_plan(scenario.origin.datum, vehicle))
        for operator, vehicle in scenario.fleet
    }
