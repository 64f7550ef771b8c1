"""Episodes: runs of a scenario with the parts of both teams, driven step by step, alone or several in one kernel."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from skyrange.assembly.batches import build_batch
from skyrange.assembly.build import Additions, BuiltScenario, build
from skyrange.assembly.placement.flight_plans import make_flight_plan
from skyrange.attack.gnss.drift import Drift
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.components import Sensors, World
from skyrange.contracts.frames import FrameBlock
from skyrange.contracts.monitors import MonitorPlacement
from skyrange.core.ids import link_name, operator_of, vehicle_id
from skyrange.core.time import Time, from_seconds, to_seconds
from skyrange.env.acts import RED, BlueChoices, Clock, RedChoice, blue_agent
from skyrange.env.observations import TelemetryFeatures, place_monitor
from skyrange.env.outcomes import MissionProgress, Outcomes, Rewards
from skyrange.env.parts import make_blue_team, make_red_team
from skyrange.env.task import Choices, Observations
from skyrange.kernel import Kernel
from skyrange.runtime.memory import collect_seldom
from skyrange.runtime.run import Run
from skyrange.scenario.model.scenario import Scenario

BLOCK_S: Final = 10.0
"""How long a BLOCK lasts."""
RED_MODE: Final = "LAND"
"""The flight mode that `RedAct.MODE` commands."""
DRIFT: Final = Drift(vehicles=("any",), rate_mps=(2.0, 0.0, 0.0), largest_m=60.0)
"""The drift of `RedAct.GNSS`: 2 m/s to the east, up to 60 m, with the velocity of the false track."""


@dataclass(slots=True)
class Parts:
    """What the environment adds to a run, and through which it acts."""

    red: RedChoice
    blue: Mapping[str, BlueChoices]
    """By agent."""
    outcomes: Outcomes

    def choose(self, now: Time, choices: Choices) -> None:
        """Take the choices of the step that begins at `now`."""
        vehicle, act = choices.red
        self.red.choose(now, vehicle, act)
        if act is not None:
            self.outcomes.hostile_ns[vehicle] = now
        for agent, acts in choices.blue.items():
            for name, chosen in acts.items():
                self.blue[agent].choose(now, name, chosen, from_seconds(BLOCK_S))

    def rest(self, now: Time) -> None:
        """Do nothing from `now` on."""
        self.red.choose(now, "", None)
        for choices in self.blue.values():
            choices.acts.clear()


class Episode:
    """A run with the parts of both teams, at the beginning of a step."""

    def __init__(self, scenario: Scenario, step_ns: Time, rewards: Rewards, out: Path | None) -> None:
        """Build the run; with `out` it is recorded in that folder. Raises `InputError` before anything is written."""
        self._step_ns = step_ns
        self._monitors = _make_monitors(scenario, step_ns, runs=1)
        self.parts, additions = _make_parts(scenario, step_ns, rewards)
        additions = replace(additions, monitors=_place_monitors(self._monitors))
        self._run: Run | None = None
        self._built: BuiltScenario
        if out is None:
            self._built = build(scenario, additions)
            self._kernel = Kernel(self._built.wiring, [self.parts.outcomes])
        else:
            more = {"environment": {"task": "hold-the-mission", "agents": list(self._monitors), "step_ns": step_ns}}
            additions = replace(additions, observers=[self.parts.outcomes])
            self._run = Run.start(scenario, out, additions=additions, more=more)
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

    def step(self, choices: Choices) -> dict[str, float]:
        """Fly a step with the acts that agents chose; returns `Outcomes.end_step`'s."""
        self.parts.choose(self.now, choices)
        self._advance(self.now + self._step_ns)
        return self.parts.outcomes.end_step(self.world, to_seconds(self._step_ns))

    def observe(self) -> Observations:
        """The observations of all agents at the end of the last step."""
        return {agent: monitor.read() for agent, monitor in self._monitors.items()}

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


class EpisodeGroup:
    """Episodes that begin together and fly in one kernel; each is what it would be alone. They are not recorded."""

    def __init__(self, scenarios: Sequence[Scenario], step_ns: Time, rewards: Rewards) -> None:
        """Build the runs of scenarios that differ in their seeds. Raises `InputError`."""
        self._step_ns = step_ns
        self._monitors = _make_monitors(scenarios[0], step_ns, runs=len(scenarios))
        made = [_make_parts(scenario, step_ns, rewards) for scenario in scenarios]
        self.parts = [parts for parts, _ in made]
        """Of each episode."""
        self._built = built = build_batch(scenarios, [additions for _, additions in made])
        wirings, observers = [run.wiring for run in built.runs], [[parts.outcomes] for parts in self.parts]
        placed = _place_monitors(self._monitors)
        self._kernel = Kernel.of_batch(wirings, observers, built.world, built.engines, placed)
        self._kernel.observe_batch(_Unobserved(), blocks=True)
        for parts, run in zip(self.parts, built.runs, strict=True):
            parts.outcomes.progress = _list_routes(run.scenario)
        self.flight_cpu_s = 0.0
        """Processor time for which the kernel has flown, in seconds."""
        self._closed = False
        self._advance(0)

    @property
    def now(self) -> Time:
        """Simulated time reached, in nanoseconds."""
        return self._kernel.now

    def step(self, choices: Mapping[int, Choices]) -> dict[int, dict[str, float]]:
        """Fly a step of all, with the choices of the episodes that go on; returns `Outcomes.end_step`'s of these.

        The others have ended: nothing is done to them any more, and what becomes of them is not looked at.
        """
        now = self.now
        for number, parts in enumerate(self.parts):
            if number in choices:
                parts.choose(now, choices[number])
            else:
                parts.rest(now)
        self._advance(now + self._step_ns)
        seconds = to_seconds(self._step_ns)
        runs = self._built.runs
        return {number: self.parts[number].outcomes.end_step(_world_of(runs[number]), seconds) for number in choices}

    def observe(self, number: int) -> Observations:
        """The observations of all agents of an episode at the end of the last step."""
        return {agent: monitor.read(number) for agent, monitor in self._monitors.items()}

    def _advance(self, until: Time) -> None:
        began = time.process_time()
        try:
            with collect_seldom():
                self._kernel.advance(until)
        except BaseException:
            self.close()
            raise
        self.flight_cpu_s += time.process_time() - began

    def close(self) -> None:
        """End the runs; again does nothing."""
        if not self._closed:
            self._closed = True
            self._kernel.finish()
            self._built.close()


class _Unobserved:
    """An observer of a batch that nobody asks: what `Outcomes` needs is told of each run."""

    def on_blocks(self, blocks: Sequence[FrameBlock]) -> None:
        """Nothing."""

    def on_truth(self, now: Time, world: World, received: Sensors | None) -> None:
        """Nothing."""


def _world_of(run: BuiltScenario) -> World:
    assert run.wiring.world is not None
    return run.wiring.world


def _make_monitors(scenario: Scenario, step_ns: Time, *, runs: int) -> dict[str, TelemetryFeatures]:
    """The monitor of each agent, for as many runs of a scenario."""
    origin = scenario.origin.datum
    fleet = [vehicle_id(operator.id, vehicle.id) for operator, vehicle in scenario.fleet]
    monitors = {RED: TelemetryFeatures(fleet, origin, step_ns, received=False, runs=runs)}
    for operator in scenario.operators:
        own = [name for name in fleet if operator_of(name) == operator.id]
        monitors[blue_agent(operator.id)] = TelemetryFeatures(own, origin, step_ns, received=True, runs=runs)
    return monitors


def _place_monitors(monitors: Mapping[str, TelemetryFeatures]) -> list[MonitorPlacement]:
    return [place_monitor(agent, monitor) for agent, monitor in monitors.items()]


def _make_parts(scenario: Scenario, step_ns: Time, rewards: Rewards) -> tuple[Parts, Additions]:
    """The parts of both teams but for the monitors, and what puts them into a run."""
    fleet = {vehicle_id(operator.id, vehicle.id): vehicle for operator, vehicle in scenario.fleet}
    clock, systems = Clock(step_ns), {name: vehicle.system_id for name, vehicle in fleet.items()}
    red = RedChoice()
    over_air = {
        link for link in (link_name("gcs", vehicle) for vehicle in fleet) if scenario.over_air(link) is not None
    }
    mode = COPTER_MODE_NUMBERS[RED_MODE]
    plan, taps = make_red_team(systems, red, clock, mode=mode, drift=DRIFT, over_air=over_air)
    plans, defences = [plan], []
    blue = {}
    for operator in scenario.operators:
        operator_systems = {name: system for name, system in systems.items() if operator_of(name) == operator.id}
        agent = blue_agent(operator.id)
        blue[agent] = BlueChoices()
        plan, placed = make_blue_team(agent, operator_systems, blue[agent], clock)
        plans.append(plan)
        defences += placed
    additions = Additions(
        taps=[*defences, *taps],  # on one side, the later one is nearer to the channel
        acts=plans,
    )
    return Parts(red, blue, Outcomes(rewards)), additions


def _list_routes(scenario: Scenario) -> dict[str, MissionProgress]:
    """By aircraft of a built scenario, the route of its plan, of which nothing is done."""
    return {
        vehicle_id(operator.id, vehicle.id): MissionProgress.of(make_flight_plan(scenario.origin.datum, vehicle))
        for operator, vehicle in scenario.fleet
    }
