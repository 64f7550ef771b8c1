"""Conformance check of avoidance (`skyrange.vehicle.avoidance.contract.Avoidance`), by encounters over open country."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from skyrange.core.time import NS_PER_S, Time, from_seconds
from skyrange.testing.drivers.agent_driver import copied
from skyrange.testing.drivers.purity import Call, plainly, watched
from skyrange.testing.rules import Broken, RuleBook, need, same, short
from skyrange.vehicle.avoidance.contract import (
    NO_TRACKS,
    Avoidance,
    AvoidanceAction,
    AvoidanceContext,
    AvoidanceDecision,
    AvoidanceLimits,
    AvoidancePlugin,
    Episode,
    Own,
    Tracks,
    Vector,
)

STEP_NS: Time = NS_PER_S // 4
"""How often it is asked: as often as companions ask."""
CRUISE_MPS = 10.0
GOAL: Vector = (400.0, 0.0, 30.0)
OTHERS_S = 40.0
"""How long the other aircraft are there in an encounter; then they are gone."""
OTHERS_NS: Time = from_seconds(OTHERS_S)
SETTLED_S = 60.0
"""How long after all others are gone, and after `AvoidanceLimits.longest_s`, an episode may go on."""
_FLYING = (AvoidanceAction.KEEP, AvoidanceAction.RESUME, AvoidanceAction.RETURN)
"""Actions that end an episode, or begin none."""

AVOIDANCE: RuleBook[AvoidanceCase] = RuleBook("avoidance")

Others = Sequence[tuple[float, ...]]
"""(east, north, up, and velocities) of each other aircraft at first."""
Row = tuple[Time, Own, AvoidanceDecision]


ENCOUNTERS: Mapping[str, Others] = {
    "nobody": (),
    "head-on": ((200.0, 0.0, 30.0, -10.0, 0.0, 0.0),),
    "from the right": ((100.0, -100.0, 30.0, 0.0, 10.0, 0.0),),
    "standing in the way": ((120.0, 0.0, 30.0, 0.0, 0.0, 0.0),),
    "of unknown height": ((150.0, 5.0, math.nan, -8.0, 0.0, 0.0),),
    "on top": ((0.5, 0.0, 30.0, 0.0, 0.0, 0.0),),
    "many": tuple((60.0 + 15.0 * k, 30.0 * math.sin(k), 30.0 + k % 3, -5.0, 3.0 * math.cos(k), 0.0) for k in range(20)),
}
"""Other aircraft that it meets on the way to its goal, which is 400 m east."""


@dataclass
class AvoidanceCase:
    """An avoidance to be checked: how a fresh one is made."""

    make: Callable[[], Avoidance]
    plugin: AvoidancePlugin | None = None


def check_avoidance(
    avoidance: AvoidancePlugin | Callable[[], Avoidance],
    params: Mapping[str, Any] | None = None,
    *,
    name: str | None = None,
) -> None:
    """Check that the avoidance of a plugin with `params`, or that of a function, keeps every rule of `AVOIDANCE`.

    A function returns a fresh one at each call, all alike. Raises `NonConformance` at the first broken rule; `name`
    stands in it for the avoidance's class.
    """
    if isinstance(avoidance, AvoidancePlugin):
        plugin, limits = avoidance, avoidance.params.model_validate(dict(params or {}))
        case = AvoidanceCase(lambda: plugin(limits, AvoidanceContext()), plugin)
    else:
        case = AvoidanceCase(avoidance)
    AVOIDANCE.check(f"avoidance {name or type(case.make()).__name__}", case)


def fly_encounter(
    avoidance: Avoidance,
    others: Others,
    *,
    begin: Time = 0,
    until: Time = OTHERS_NS,
    own: Own | None = None,
    episode: Episode | None = None,
    call: Call = plainly,
) -> list[Row]:
    """Fly towards the goal and do what is decided; every decision with what it was made of."""
    at = Own((0.0, 0.0, 30.0), (CRUISE_MPS, 0.0, 0.0), GOAL, CRUISE_MPS) if own is None else own
    table = np.array(others, dtype=np.float64).reshape(-1, 6)
    rows: list[Row] = []
    for now in range(begin, until, STEP_NS):
        others_present = now < OTHERS_NS
        moved = table[:, :3] + table[:, 3:] * (now / NS_PER_S)
        tracks = Tracks(moved, table[:, 3:].copy()) if others_present and len(table) else NO_TRACKS
        try:
            decision = call(avoidance.decide, now, at, tracks, episode)
        except Broken:
            raise
        except Exception as error:
            raise Broken(f"decide({now}, {short(at)}, {short(tracks)}) raised {error!r}", "a Decision") from error
        _check(now, tracks, decision)
        rows.append((now, at, decision))
        episode = decision.episode
        if decision.action is AvoidanceAction.RETURN:
            return rows
        target = decision.waypoint_enu_m if decision.action is AvoidanceAction.GO else GOAL
        at = at._replace(pos_enu_m=_moved(at.pos_enu_m, at.vel_enu_mps))
        still = decision.action is AvoidanceAction.STOP
        at = at._replace(vel_enu_mps=(0.0, 0.0, 0.0) if still or target is None else _velocity(at.pos_enu_m, target))
    return rows


def _moved(place: Vector, velocity: Vector) -> Vector:
    seconds = STEP_NS / NS_PER_S
    return (
        place[0] + seconds * velocity[0],
        place[1] + seconds * velocity[1],
        place[2] + seconds * velocity[2],
    )


def _velocity(place: Vector, target: Vector) -> Vector:
    away = math.dist(place, target)
    speed = min(CRUISE_MPS, away) / away if away > 0.0 else 0.0
    return (speed * (target[0] - place[0]), speed * (target[1] - place[1]), speed * (target[2] - place[2]))


def _check(now: Time, tracks: Tracks, decision: Any) -> None:
    """`Broken` (rules `decides` and `episodes`) unless this is a whole decision."""
    if not (isinstance(decision, AvoidanceDecision) and isinstance(decision.action, AvoidanceAction)):
        raise Broken(f"answered {short(decision)}", "a Decision with an Action", "decides")
    place, goes = decision.waypoint_enu_m, decision.action is AvoidanceAction.GO
    if goes != (place is not None):
        raise Broken(f"said {decision.action} with the waypoint {place}", "a waypoint with GO alone", "decides")
    if place is not None and not (len(place) == 3 and all(math.isfinite(part) for part in place)):
        raise Broken(f"flies to {place}", "three finite numbers", "decides")
    count = len(tracks.pos_enu_m)
    if not all(isinstance(row, int) and 0 <= row < count for row in decision.tracks):
        raise Broken(f"names the tracks {decision.tracks} of {count}", "rows of the tracks", "decides")
    over, episode = decision.action in _FLYING, decision.episode
    if over != (episode is None) or not (over or isinstance(episode, Episode)):
        raise Broken(f"said {decision.action} with {short(episode)}", "an Episode with STOP and GO", "episodes")
    if episode is not None and episode.begun_ns > now:
        raise Broken(f"says at {now} that it begins at {episode.begun_ns}", "an episode that has begun", "episodes")


@AVOIDANCE.rule("described", "Describes each of its parameters, and in one sentence what it does.")
def _described(case: AvoidanceCase) -> None:
    if case.plugin is None:
        return
    for name, info in case.plugin.params.model_fields.items():
        need(bool(info.description), f"says nothing about its parameter {name}", "a description of each")
    need(case.plugin.about.endswith("."), f"says {case.plugin.about!r}", "a sentence")


@AVOIDANCE.rule("limits", "Has the limits that it was made with.")
def _limits(case: AvoidanceCase) -> None:
    limits = getattr(case.make(), "limits", None)
    need(isinstance(limits, AvoidanceLimits), f"limits are {short(limits)}", "Limits, or a subclass of it")


@AVOIDANCE.rule(
    "decides", "Answers with a Decision: a waypoint of finite metres with GO alone, and rows of the tracks."
)
def _decides(case: AvoidanceCase) -> None:
    for others in ENCOUNTERS.values():
        fly_encounter(case.make(), others)


@AVOIDANCE.rule("episodes", "Returns an Episode with STOP and GO, and none with KEEP, RESUME and RETURN.")
def _episodes(case: AvoidanceCase) -> None:
    for others in ENCOUNTERS.values():
        fly_encounter(case.make(), others)


@AVOIDANCE.rule("alone", "Flies on if it receives nobody.")
def _alone(case: AvoidanceCase) -> None:
    for now, _, decision in fly_encounter(case.make(), ()):
        need(decision.action is AvoidanceAction.KEEP, f"said {decision.action} at {now}", "KEEP")


@AVOIDANCE.rule("ends", "Ends every episode when all others are gone, or a minute after its longest time.")
def _ends(case: AvoidanceCase) -> None:
    for name, others in ENCOUNTERS.items():
        avoidance = case.make()
        until = from_seconds(OTHERS_S + avoidance.limits.longest_s + SETTLED_S)
        last = fly_encounter(avoidance, others, until=until)[-1][2]
        need(last.episode is None, f"({name}) still says {last.action} after {until / NS_PER_S:g} s", "an end")


@AVOIDANCE.rule("repeatable", "Decides the same from the same input, twice or in a new instance: it keeps no state.")
def _repeatable(case: AvoidanceCase) -> None:
    for name, others in ENCOUNTERS.items():
        once, twice = case.make(), case.make()
        fly_encounter(twice, others)
        expected = "a pure function; what must outlive a call is in the Episode"
        same(
            fly_encounter(once, others),
            fly_encounter(twice, others),
            f"({name}) decisions of two instances differ",
            expected,
        )


@AVOIDANCE.rule(
    "pure", "Reads no clock, draws no random numbers of its own, never sleeps, and opens no file, socket or thread."
)
def _pure(case: AvoidanceCase) -> None:
    for others in ENCOUNTERS.values():
        fly_encounter(case.make(), others)
        fly_encounter(case.make(), others, call=watched)


@AVOIDANCE.rule("copies", "A copy or fork made midway continues like the original, and shares no state with it.")
def _copies(case: AvoidanceCase) -> None:
    for name, others in ENCOUNTERS.items():
        straight = fly_encounter(case.make(), others)
        middle = len(straight) // 2
        now, own, _ = straight[middle]
        rest, trunk = straight[middle:], case.make()
        fly_encounter(trunk, others, until=now)
        before = straight[middle - 1][2].episode if middle else None
        for each in (copied(trunk), trunk):
            later = fly_encounter(each, others, begin=now, own=own, episode=before)
            same(rest, later, f"({name}) the straight run and a copy differ", "a copy that goes on alike")
