"""Defences of a scenario made: taps, sensor checks, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Any

from skyrange.assembly.acts.exclusions import Acting, find_exclusions, window_of
from skyrange.assembly.acts.own_sensors import find_unread
from skyrange.assembly.acts.path_checks import Declared, check_paths, find_wrong_ends
from skyrange.assembly.control_links import LinksOverAir, make_channel_agent
from skyrange.attack.contract import AttackContext
from skyrange.contracts.components import Agent
from skyrange.contracts.links import Act, Schedule, TapPlacement
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.time import NEVER, NS_PER_US, from_seconds
from skyrange.defence.contract import Defence
from skyrange.scenario.model.defences import DefenceTable


@dataclass(slots=True)
class MadeDefences:
    """All defences of a scenario, made: what is added to its wiring and its manifest."""

    plans: list[Act] = field(default_factory=list)
    taps: list[TapPlacement] = field(default_factory=list)
    """In the order of the wiring: the last declared defence is nearest to the endpoint."""
    rows: list[dict[str, Any]] = field(default_factory=list)
    """What the manifest says of each."""
    problems: list[Problem] = field(default_factory=list)


def make_defences(
    tables: Sequence[DefenceTable], context: AttackContext, over_air: LinksOverAir, own_sensors: Sequence[str]
) -> MadeDefences:
    """Make every defence; what is wrong with them is in `problems`.

    `over_air` has the control links that their channel plans are about; `own_sensors` are vehicles that do not fly by
    the range's sensors. `context` is that of all attacks, problems and
    defences; id and schedule are filled in for each.
    """
    made = MadeDefences()
    exclusive: list[Acting] = []
    declared: list[Declared] = []
    for table in tables:
        own = replace(context, id=table.id, schedule=Schedule(), sham=False, honest=False, keys=None)
        where = f"defences.{table.id}"
        try:
            found = table.plugin(table.settings, own)
        except InputError as error:
            made.problems += [
                Problem(f"{where}.params.{one.where}", one.value, one.expected, one.hint) for one in error.problems
            ]
            continue
        for tap in found.taps:
            if not any(fnmatchcase(name, tap.match) for name in context.links):
                hint = nearest(tap.match, context.links)
                made.problems.append(Problem(f"{where}.params", tap.match, "a link of the scenario", hint))
        made.problems += find_unread(found.checks, own_sensors, f"{where}.params.vehicles")
        wrong = list(find_wrong_ends(found.path_rules, context.links))
        made.problems += [Problem(f"{where}.params", one, "an end of a gcs, log or autopilot link") for one in wrong]
        if not table.muted and not wrong:
            window = window_of(table, context.duration_ns)
            exclusive.append((where, window, found.exclusive))
            declared.append(Declared(table.id, window, found.path_rules, found.takes, found.needs))
        agents = [make_channel_agent(table.id, found.channel_plans, over_air)] if found.channel_plans else []
        made.plans.append(plan_of(table, found, own.schedule, agents))
        cost_ns = 0 if table.cost is None else table.cost.ns_per_frame
        if cost_ns and not found.taps:
            made.problems.append(
                Problem(
                    f"{where}.cost",
                    f"{cost_ns / NS_PER_US:g} µs for each frame",
                    f"a defence that inspects frames: {table.kind} has none",
                    "Time for checks of sensors and of channels is not modelled.",
                )
            )
        made.taps = [*(replace(tap, attack=table.id, cost_ns=cost_ns) for tap in found.taps), *made.taps]
        made.rows.append(_row(table, found))
    made.problems += find_exclusions(exclusive, "a defence", "decide")
    made.problems += check_paths(declared, context.signed)
    return made


def plan_of(table: DefenceTable, made: Defence, schedule: Schedule, agents: Sequence[Agent] = ()) -> Act:
    """A defence as a kernel runs it."""
    return Act(
        table.id,
        start_ns=from_seconds(table.start_s),
        stop_ns=NEVER if table.stop_s is None else from_seconds(table.stop_s),
        muted=table.muted,
        role="defence",
        agents=agents,
        sensor_hooks=made.checks,
        one_process=made.one_process,
        schedule=schedule,
    )


def _row(table: DefenceTable, made: Defence) -> dict[str, Any]:
    """A defence in the manifest: as declared, and where it is."""
    touches = list(dict.fromkeys(f"{tap.match} at {tap.side}" for tap in made.taps))
    touches += [f"channel of {link}" for plan in made.channel_plans for link in plan.links]
    touches += [f"sensors of {vehicle}" for check in made.checks for vehicle in check.vehicles]
    return {**table.model_dump(exclude_none=True, mode="json"), "touches": touches}
