"""Defences of a scenario made: taps, sensor checks; and what is wrong with them, or with several beside each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from itertools import combinations
from math import inf
from typing import Any, Final, NamedTuple

from skyrange.assembly.acts.conflicts import Acting, Window, find_exclusions, find_unread, window_of
from skyrange.assembly.control_links import LinksOverAir, make_channel_agent
from skyrange.attack.contract import AttackContext
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.components import Agent
from skyrange.contracts.links import Act, Schedule, TapPlacement
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.ids import operator_of
from skyrange.core.time import NEVER, NS_PER_US, from_seconds
from skyrange.defence.contract import Defence
from skyrange.defence.path_rules import Compares, ExpectsOrder, Holds, Passes, PathEnd, PathRule, Sends, Signs
from skyrange.scenario.model.defences import DefenceTable
from skyrange.scenario.model.scenario import Scenario


@dataclass(slots=True)
class MadeDefences:
    """All defences of a scenario, made: what is added to its wiring and its manifest."""

    plans: list[Act] = field(default_factory=list)
    taps: list[TapPlacement] = field(default_factory=list)
    """In the order of the wiring: the last declared defence is nearest to the endpoint."""
    rows: list[dict[str, Any]] = field(default_factory=list)
    """What the manifest says of each."""
    problems: list[Problem] = field(default_factory=list)
    exclusive: list[Acting] = field(default_factory=list)
    """What those that are not muted decide as the only ones."""
    declared: list[Declared] = field(default_factory=list)
    """Those that are not muted, as far as they disturb each other, in the order of declaration."""


def make_defences(
    scenario: Scenario, context: AttackContext, over_air: LinksOverAir, own_sensors: Sequence[str]
) -> MadeDefences:
    """Make every defence; what is wrong with them is in `problems`.

    `over_air` has the control links that their channel plans are about; `own_sensors` are vehicles that do not fly by
    the range's sensors. `context` is that of all attacks, problems and
    defences; id and schedule are filled in for each.
    """
    made = MadeDefences()
    for table in scenario.defences:
        own_context = replace(context, id=table.id, schedule=Schedule(), sham=False, honest=False, keys=None)
        where = f"defences.{table.id}"
        try:
            made_defence = table.plugin(table.settings, own_context)
        except InputError as error:
            made.problems += [
                Problem(f"{where}.params.{problem.where}", problem.value, problem.expected, problem.hint)
                for problem in error.problems
            ]
            continue
        for tap in made_defence.taps:
            if not any(fnmatchcase(name, tap.match) for name in context.links):
                hint = nearest(tap.match, context.links)
                made.problems.append(Problem(f"{where}.params", tap.match, "a link of the scenario", hint))
        made.problems += find_unread(made_defence.checks, own_sensors, f"{where}.params.vehicles")
        wrong = list(find_wrong_ends(made_defence.path_rules, context.links))
        made.problems += [Problem(f"{where}.params", end, "an end of a gcs, log or autopilot link") for end in wrong]
        if not table.muted and not wrong:
            window = window_of(table, context.duration_ns, scenario.manual_acts)
            made.exclusive.append((where, window, made_defence.exclusive))
            made.declared.append(
                Declared(table.id, window, made_defence.path_rules, made_defence.takes, made_defence.needs)
            )
        agents = (
            [make_channel_agent(table.id, made_defence.channel_plans, over_air)] if made_defence.channel_plans else []
        )
        made.plans.append(plan_of(table, made_defence, own_context.schedule, agents))
        cost_ns = 0 if table.cost is None else table.cost.ns_per_frame
        if cost_ns and not made_defence.taps:
            made.problems.append(
                Problem(
                    f"{where}.cost",
                    f"{cost_ns / NS_PER_US:g} µs for each frame",
                    f"a defence that inspects frames: {table.kind} has none",
                    "Time for checks of sensors and of channels is not modelled.",
                )
            )
        made.taps = [*(replace(tap, attack=table.id, cost_ns=cost_ns) for tap in made_defence.taps), *made.taps]
        made.rows.append(_row(table, made_defence))
    made.problems += find_exclusions(made.exclusive, "a defence", "decide")
    made.problems += check_paths(made.declared, context.signed)
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
        manual=table.manual,
    )


def _row(table: DefenceTable, made: Defence) -> dict[str, Any]:
    """A defence in the manifest: as declared, and where it is."""
    touches = list(dict.fromkeys(f"{tap.match} at {tap.side}" for tap in made.taps))
    touches += [f"channel of {link}" for plan in made.channel_plans for link in plan.links]
    touches += [f"sensors of {vehicle}" for check in made.checks for vehicle in check.vehicles]
    return {**table.model_dump(exclude_none=True, mode="json"), "touches": touches}


_PATH: Final = (
    ("gcs", "gcs"), ("gcs", "companion"), ("log", "companion"), ("log", "proxy"), ("autopilot", "proxy"),
    ("autopilot", "autopilot"),
)  # fmt: skip
"""The ends of the MAVLink links of an aircraft, by link and side, from station to autopilot."""
_Place = tuple[float, int]
"""A place on that path; the smaller is nearer to the station."""


class Declared(NamedTuple):
    """A defence that is not muted."""

    id: str
    window: Window
    rules: Sequence[PathRule]
    takes: Sequence[str] = ()
    needs: Sequence[str] = ()


class _Conflict(NamedTuple):
    """What a defence does and another disturbs, what is expected instead, and what to do beside another order."""

    what: str
    expected: str
    hint: str


class _Placed(NamedTuple):
    """A defence of two, and its place among them where both share an end."""

    defence: Declared
    later: int
    """0 for the one that is declared first, 1 for the other."""

    def place(self, end: PathEnd) -> _Place:
        """Where its tap at an end is. Towards the autopilot, the last declared defence is first at a sending end."""
        role = end.link.partition(":")[0]
        rank = _PATH.index((role, end.side))
        return rank, self.later if rank % 2 else -self.later


def check_paths(declared: Sequence[Declared], signing: Sequence[str]) -> Iterator[Problem]:
    """A problem for each defence that another one disturbs, with the order that works if there is one, and for each
    whose frames the operator's own signing refuses; `signing` has the operators that sign.

    `declared` is in the order of declaration.
    """
    for first, second in combinations(declared, 2):
        if max(first.window[0], second.window[0]) >= min(first.window[1], second.window[1]):
            continue
        yield from _find_taken(first, second)
        works = not any(_both_ways(_Placed(second, 0), _Placed(first, 1)))
        for disturbed, other in ((_Placed(first, 0), _Placed(second, 1)), (_Placed(second, 1), _Placed(first, 0))):
            conflict = next(_find_conflicts(disturbed, other), None)
            if conflict is None:
                continue
            order = "before" if disturbed.later else "after"
            hints = [f"Declare {disturbed.defence.id} {order} {other.defence.id}."] if works else []
            hints += [conflict.hint] if conflict.hint else []
            yield Problem(f"defences.{disturbed.defence.id}", conflict.what, conflict.expected, " Or: ".join(hints))
    for defence in declared:
        yield from _find_unsigned(defence, signing)


def _find_taken(first: Declared, second: Declared) -> Iterator[Problem]:
    """Readings that one check takes away, and whose absence a later one would blame on the sensor."""
    taken_readings = sorted(set(first.takes) & set(second.needs))
    if taken_readings:
        both = set(second.takes) & set(first.needs)
        hint = "Have one of them raise alarms only." if both else f"Declare {second.id} before {first.id}."
        what = f"judges whether there are {taken_readings[0]}, which {first.id} takes away"
        yield Problem(f"defences.{second.id}", what, "readings as the sensor has them", hint)


def find_wrong_ends(rules: Sequence[PathRule], links: Sequence[str]) -> Iterator[str]:
    """The ends in the rules of a defence that no link on the path of an aircraft has."""
    for rule in rules:
        for end in (rule.at, getattr(rule, "until", None)):
            if end is not None and ((end.link.partition(":")[0], end.side) not in _PATH or end.link not in links):
                yield f"{end.side} of {end.link}"


def _both_ways(first: _Placed, second: _Placed) -> Iterator[_Conflict]:
    yield from _find_conflicts(first, second)
    yield from _find_conflicts(second, first)


def _find_conflicts(disturbed: _Placed, other: _Placed) -> Iterator[_Conflict]:
    """What `other` disturbs of what `disturbed` does."""
    others: dict[tuple[str, str], list[PathRule]] = {}
    for rule in other.defence.rules:
        others.setdefault((_owner(rule), rule.direction), []).append(rule)
    for own_rule in disturbed.defence.rules:
        for other_rule in others.get((_owner(own_rule), own_rule.direction), ()):
            conflict = None
            if isinstance(own_rule, Sends):
                conflict = _find_lost(disturbed, own_rule, other, other_rule)
            elif isinstance(own_rule, Compares) and isinstance(other_rule, Signs):
                conflict = _find_changed(disturbed, own_rule, other, other_rule)
            elif isinstance(own_rule, Holds) and isinstance(other_rule, ExpectsOrder):
                conflict = _find_overtaken(disturbed, own_rule, other, other_rule)
            if conflict is not None:
                yield conflict


def _find_lost(disturbed: _Placed, rule: Sends, other: _Placed, other_rule: PathRule) -> _Conflict | None:
    """Frames of `rule` that do not pass `other_rule`."""
    start = disturbed.place(rule.at)
    end = disturbed.place(rule.until) if rule.until is not None else _far_end(rule.direction)
    name = other.defence.id
    if isinstance(other_rule, Signs):
        signed, verified = other.place(other_rule.at), other.place(other_rule.until)
        if not (_between(start, verified, end) and _between(signed, start, verified)):
            return None
        what = f"sends {_messages(rule.messages)} on {rule.at.link} behind the end where {name} signs"
        return _Conflict(what, f"frames that {name} signs before it verifies them", "")
    if not isinstance(other_rule, Passes) or not _between(start, other.place(other_rule.at), end):
        return None
    lost = rule.messages & other_rule.drops
    if other_rule.messages is not None:
        lost |= rule.messages - other_rule.messages
    if lost:
        what = f"sends {_messages(lost)}, which {name} drops at {other_rule.at.side} of {other_rule.at.link}"
        hint = "" if other_rule.messages is None else f"Add {_messages(lost)} to the messages of {name}."
        return _Conflict(what, f"messages that {name} lets pass", hint)
    commands = rule.commands - other_rule.commands if other_rule.commands is not None else frozenset()
    if commands:
        what = f"commands {_commands(commands)}, which {name} drops at {other_rule.at.side} of {other_rule.at.link}"
        hint = f"Add {_commands(commands)} to the commands of {name}."
        return _Conflict(what, f"commands that {name} lets pass", hint)
    return None


def _find_changed(disturbed: _Placed, rule: Compares, other: _Placed, other_rule: Signs) -> _Conflict | None:
    """Frames that `other_rule` has signed at one of the ends of `rule` and not at the other."""
    ends = (disturbed.place(rule.at), disturbed.place(rule.until))
    inside = [_between(other.place(other_rule.at), end, other.place(other_rule.until)) for end in ends]
    if inside[0] == inside[1]:
        return None
    what = f"compares frames at {rule.at.side} and {rule.until.side}, of which {other.defence.id} has signed one only"
    return _Conflict(what, "the same bytes at both ends", "")


def _find_overtaken(disturbed: _Placed, rule: Holds, other: _Placed, other_rule: ExpectsOrder) -> _Conflict | None:
    """Frames that wait at `rule` and are late at `other_rule`."""
    if not _between(disturbed.place(rule.at), other.place(other_rule.at), _far_end(rule.direction)):
        return None
    name = other.defence.id
    what = f"holds frames at {rule.at.side} of {rule.at.link} before {name}, which takes late frames for forged ones"
    return _Conflict(what, f"{name} nearer to the sender than what holds frames", "")


def _find_unsigned(defence: Declared, signing: Sequence[str]) -> Iterator[Problem]:
    """Frames of a defence that reach a component of an operator that signs: nobody has signed them."""
    for rule in defence.rules:
        operator = operator_of(_owner(rule))
        if isinstance(rule, Sends) and rule.until is None and operator in signing:
            yield Problem(
                f"defences.{defence.id}",
                f"sends {_messages(rule.messages)} unsigned on {rule.at.link}, and {operator} signs",
                "an operator whose aircraft accept unsigned frames",
                f'Set signing = "off" for the operator {operator}; a defence mavlink.signing signs its links.',
            )
            return


def _between(low: _Place, place: _Place, high: _Place) -> bool:
    """Whether a place is strictly between two others, in either direction."""
    return low < place < high or high < place < low


def _far_end(direction: str) -> _Place:
    """Behind all taps in a direction."""
    return (inf, 0) if direction == "fwd" else (-inf, 0)


def _owner(rule: PathRule) -> str:
    """The aircraft whose link a rule is about."""
    return rule.at.link.partition(":")[2]


def _messages(numbers: frozenset[int]) -> str:
    return ", ".join(
        sorted(str(mav.mavlink_map[number].msgname) if number in mav.mavlink_map else str(number) for number in numbers)
    )


def _commands(numbers: frozenset[int]) -> str:
    known = mav.enums["MAV_CMD"]
    return ", ".join(
        sorted(known[number].name.removeprefix("MAV_CMD_") if number in known else str(number) for number in numbers)
    )
