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
        for one, other in ((_Placed(first, 0), _Placed(second, 1)), (_Placed(second, 1), _Placed(first, 0))):
            found = next(_find_conflicts(one, other), None)
            if found is None:
                continue
            order = "before" if one.later else "after"
            hints = [f"Declare {one.defence.id} {order} {other.defence.id}."] if works else []
            hints += [found.hint] if found.hint else []
            yield Problem(f"defences.{one.defence.id}", found.what, found.expected, " Or: ".join(hints))
    for defence in declared:
        yield from _find_unsigned(defence, signing)


def _find_taken(first: Declared, second: Declared) -> Iterator[Problem]:
    """Readings that one check takes away, and whose absence a later one would blame on the sensor."""
    taken = sorted(set(first.takes) & set(second.needs))
    if taken:
        both = set(second.takes) & set(first.needs)
        hint = "Have one of them raise alarms only." if both else f"Declare {second.id} before {first.id}."
        what = f"judges whether there are {taken[0]}, which {first.id} takes away"
        yield Problem(f"defences.{second.id}", what, "readings as the sensor has them", hint)


def find_wrong_ends(rules: Sequence[PathRule], links: Sequence[str]) -> Iterator[str]:
    """The ends in the rules of a defence that no link on the path of an aircraft has."""
    for rule in rules:
        for end in (rule.at, getattr(rule, "until", None)):
            if end is not None and ((end.link.partition(":")[0], end.side) not in _PATH or end.link not in links):
                yield f"{end.side} of {end.link}"


def _both_ways(one: _Placed, other: _Placed) -> Iterator[_Conflict]:
    yield from _find_conflicts(one, other)
    yield from _find_conflicts(other, one)


def _find_conflicts(one: _Placed, other: _Placed) -> Iterator[_Conflict]:
    """What `other` disturbs of what `one` does."""
    others: dict[tuple[str, str], list[PathRule]] = {}
    for rule in other.defence.rules:
        others.setdefault((_owner(rule), rule.direction), []).append(rule)
    for mine in one.defence.rules:
        for its in others.get((_owner(mine), mine.direction), ()):
            found = None
            if isinstance(mine, Sends):
                found = _find_lost(one, mine, other, its)
            elif isinstance(mine, Compares) and isinstance(its, Signs):
                found = _find_changed(one, mine, other, its)
            elif isinstance(mine, Holds) and isinstance(its, ExpectsOrder):
                found = _find_overtaken(one, mine, other, its)
            if found is not None:
                yield found


def _find_lost(one: _Placed, mine: Sends, other: _Placed, its: PathRule) -> _Conflict | None:
    """Frames of `mine` that do not pass `its`."""
    start = one.place(mine.at)
    end = one.place(mine.until) if mine.until is not None else _far_end(mine.direction)
    name = other.defence.id
    if isinstance(its, Signs):
        signed, verified = other.place(its.at), other.place(its.until)
        if not (_between(start, verified, end) and _between(signed, start, verified)):
            return None
        what = f"sends {_messages(mine.messages)} on {mine.at.link} behind the end where {name} signs"
        return _Conflict(what, f"frames that {name} signs before it verifies them", "")
    if not isinstance(its, Passes) or not _between(start, other.place(its.at), end):
        return None
    lost = mine.messages & its.drops
    if its.messages is not None:
        lost |= mine.messages - its.messages
    if lost:
        what = f"sends {_messages(lost)}, which {name} drops at {its.at.side} of {its.at.link}"
        hint = "" if its.messages is None else f"Add {_messages(lost)} to the messages of {name}."
        return _Conflict(what, f"messages that {name} lets pass", hint)
    commands = mine.commands - its.commands if its.commands is not None else frozenset()
    if commands:
        what = f"commands {_commands(commands)}, which {name} drops at {its.at.side} of {its.at.link}"
        hint = f"Add {_commands(commands)} to the commands of {name}."
        return _Conflict(what, f"commands that {name} lets pass", hint)
    return None


def _find_changed(one: _Placed, mine: Compares, other: _Placed, its: Signs) -> _Conflict | None:
    """Frames that `its` has signed at one of the ends of `mine` and not at the other."""
    ends = (one.place(mine.at), one.place(mine.until))
    inside = [_between(other.place(its.at), end, other.place(its.until)) for end in ends]
    if inside[0] == inside[1]:
        return None
    what = f"compares frames at {mine.at.side} and {mine.until.side}, of which {other.defence.id} has signed one only"
    return _Conflict(what, "the same bytes at both ends", "")


def _find_overtaken(one: _Placed, mine: Holds, other: _Placed, its: ExpectsOrder) -> _Conflict | None:
    """Frames that wait at `mine` and are late at `its`."""
    if not _between(one.place(mine.at), other.place(its.at), _far_end(mine.direction)):
        return None
    name = other.defence.id
    what = f"holds frames at {mine.at.side} of {mine.at.link} before {name}, which takes late frames for forged ones"
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
        sorted(str(mav.mavlink_map[one].msgname) if one in mav.mavlink_map else str(one) for one in numbers)
    )


def _commands(numbers: frozenset[int]) -> str:
    known = mav.enums["MAV_CMD"]
    return ", ".join(sorted(known[one].name.removeprefix("MAV_CMD_") if one in known else str(one) for one in numbers))
