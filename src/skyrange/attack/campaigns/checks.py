"""Checks of declared stages: each ends, names acts that there are, and waits for what the adversary can observe."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from skyrange.attack.campaigns.params import Stage
from skyrange.core.errors import Problem, nearest


def find_problems(stages: Sequence[Stage], acts: Collection[str], *, taps: bool, receiver: bool) -> Iterator[Problem]:
    """What is wrong with the stages of a campaign with these acts, whose adversary has taps or a receiver."""
    if not acts:
        yield Problem("acts", "{}", "one act or more")
        return
    names = [stage.name for stage in stages]
    for place, stage in enumerate(stages):
        where = f"stages.{place}"
        if names.index(stage.name) != place:
            yield Problem(f"{where}.name", stage.name, "a name that no other stage has")
        for act in stage.acts:
            if act not in acts:
                yield Problem(f"{where}.acts", act, "the name of an act", nearest(act, acts))
        if not stage.bounded:
            yield Problem(f"{where}.timeout_s", "missing", "a longest duration", "Without one it may never end.")
        yield from _find_unobservable(where, stage, taps, receiver)
    yield from _find_idle(stages, acts)


def _find_unobservable(where: str, stage: Stage, taps: bool, receiver: bool) -> Iterator[Problem]:
    """Conditions on what the adversary has no means to observe."""
    until = stage.until
    if until is None:
        return
    sighting = until.sighting
    by_radio = until.broadcasts is not None or (sighting is not None and sighting.vehicle is None)
    if by_radio and not receiver:
        yield Problem(f"{where}.until", "Remote ID", "receiver_m, with which to receive it")
    by_tap = bool(until.messages) or until.mission_item is not None
    by_tap = by_tap or (sighting is not None and sighting.vehicle is not None)
    if by_tap and not taps:
        yield Problem(f"{where}.until", "MAVLink", "taps, on which to read it")
    if sighting is not None and sighting.vehicle is not None and sighting.uas_id is not None:
        yield Problem(f"{where}.until.sighting", sighting.uas_id, "vehicle or uas_id, not both")


def _find_idle(stages: Sequence[Stage], acts: Collection[str]) -> Iterator[Problem]:
    """Acts that are in no stage, or in stages that do not follow each other."""
    idle = set(acts) - {act for stage in stages for act in stage.acts}
    for act in sorted(idle):
        yield Problem(f"acts.{act}", "in no stage", "a stage in which it acts")
    for act in sorted(set(acts) - idle):
        places = [place for place, stage in enumerate(stages) if act in stage.acts]
        if places[-1] - places[0] >= len(places):
            expected = "stages that follow each other"
            yield Problem(f"acts.{act}", "stops and starts again", expected, "Declare it twice, under two names.")
