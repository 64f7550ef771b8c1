"""Missions, random or given, flown by two kinds of autopilot: how many agree, and a simple one for each that does not.

Twenty missions are one run. A mission that differs is made simpler, step by step, while it still differs in the same
way.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from skyrange.assembly.build import build
from skyrange.core.errors import InputError, Problem
from skyrange.core.files import atomic_write
from skyrange.gcs.plan.checks import check
from skyrange.gcs.plan.routes import estimated_duration_s
from skyrange.parity.missions.flights import (
    ComparableMission,
    ComparedMission,
    compare_fleet,
    fleet_scenario,
    flight_plan,
)
from skyrange.parity.missions.mission_sources import (
    GivenMission,
    RandomMission,
    RefusedMission,
    random_mission,
    read_missions,
    simpler,
)
from skyrange.runtime.run import OnProgress

FLEET: Final = 20
"""Missions in one run."""
WINDS_MPS: Final = (0.0, 0.0, 3.0, 5.0)
"""Winds that are drawn; in more than 5 m/s ArduCopter does not always detect its landing."""
LONGEST_S: Final = 130.0
"""Missions that are estimated to last longer are not flown."""


@dataclass(frozen=True, slots=True)
class MissionAgreement:
    """All compared missions, the simplest mission found that differs in the same way, by number, and the files that
    were not flown.
    """

    compared: tuple[ComparedMission, ...]
    shrunk: Mapping[int, ComparedMission]
    refused: tuple[RefusedMission, ...] = ()

    @property
    def alike(self) -> int:
        """How many agree."""
        return sum(one.alike for one in self.compared)

    @property
    def decided(self) -> int:
        """How many agree or differ."""
        return sum(not one.undecided for one in self.compared)

    @property
    def share(self) -> float:
        """The share of those decided that agrees; NaN if none is decided."""
        return self.alike / self.decided if self.decided else np.nan

    @property
    def misses(self) -> dict[str, int]:
        """How many differ in each way, most frequent first."""
        return dict(Counter(one.miss for one in self.compared if one.miss).most_common())

    @property
    def undecided(self) -> dict[str, int]:
        """How many are undecided for each reason, most frequent first."""
        return dict(Counter(one.undecided for one in self.compared if one.undecided).most_common())


def legal_missions(count: int, first: int = 0) -> list[RandomMission]:
    """The first `count` random missions from number `first` on that can be flown and are not too long."""
    found: list[RandomMission] = []
    number = first
    while len(found) < count:
        mission = random_mission(number)
        if is_legal(mission):
            found.append(mission)
        number += 1
    return found


def given_missions(files: Sequence[Path]) -> tuple[list[GivenMission], list[RefusedMission]]:
    """The missions in files that can be flown, and the files that cannot, in the order of `files`.

    Raises `InputError` with all problems if none can.
    """
    missions, refused = read_missions(files)
    flyable = []
    for mission in missions:
        problems = _problems(mission)
        if problems:
            refused.append(RefusedMission.of(mission.file, problems))
        else:
            flyable.append(mission)
    refused.sort(key=lambda one: files.index(one.file))
    if refused and not flyable:
        problems = [Problem(str(one.file), one.reason, "a mission that can be flown") for one in refused]
        raise InputError("missions", problems)
    return flyable, refused


def _problems(mission: GivenMission) -> Sequence[Problem]:
    """What is wrong with a mission, by its ground station or in its run; the builtin stands for both autopilots."""
    try:
        if found := check(flight_plan(mission), "mission"):
            return found
        with TemporaryDirectory() as scratch:
            scenario = fleet_scenario([mission], (0.0, 0.0), Path(scratch))
            build(scenario.model_copy(update={"operators": scenario.operators[:1]}))
    except InputError as error:
        return error.problems
    return []


def is_legal(mission: RandomMission) -> bool:
    """Whether the ground station finds no problem in a mission, and it is not too long."""
    plan = flight_plan(mission)
    return not check(plan, "plan") and estimated_duration_s(plan) <= LONGEST_S


def compare(
    folder: Path,
    count: int,
    *,
    first: int = 0,
    given: Sequence[GivenMission] = (),
    refused: Sequence[RefusedMission] = (),
    rates: str = "reduced",
    shrink: bool = True,
    on_fleet: Callable[[int, int], OnProgress | None] | None = None,
) -> MissionAgreement:
    """Fly `count` random missions from number `first` on with both autopilots, in fleets, into run folders in `folder`.

    `given` are flown instead, in calm air; `refused` are listed in the results. With `shrink`, random missions that
    differ are made simpler, which takes more runs. `on_fleet` is called with the number of each run and the number of
    missions in it, and returns what is told of its progress. `folder` gets `missions.json` and `missions.md` after each
    fleet. Raises the errors of `study.runs.fly`.
    """
    missions: Sequence[ComparableMission] = given or legal_missions(count, first)
    compared: list[ComparedMission] = []
    shrunk: dict[int, ComparedMission] = {}
    runs = 0

    def fly_fleet(fleet: Sequence[ComparableMission], wind: tuple[float, float]) -> list[ComparedMission]:
        nonlocal runs
        runs += 1
        progress = on_fleet(runs, len(fleet)) if on_fleet is not None else None
        return compare_fleet(folder / f"fleet-{runs:03}", fleet, wind, rates, on_progress=progress)

    def found() -> MissionAgreement:
        return MissionAgreement(tuple(compared), shrunk, tuple(refused))

    folder.mkdir(parents=True, exist_ok=True)
    for start in range(0, len(missions), FLEET):
        fleet = missions[start : start + FLEET]
        compared += fly_fleet(fleet, (0.0, 0.0) if given else draw_wind(fleet[0].number))
        write_results(folder, found())
    if shrink and not given:
        for one in [one for one in compared if one.miss]:
            shrunk[one.mission.number] = shrink_mission(one, fly_fleet)
            write_results(folder, found())
    return found()


def draw_wind(number: int) -> tuple[float, float]:
    """The wind of the fleet whose first mission has this number: m/s, and degrees that it comes from."""
    chance = Random(f"wind {number}")  # noqa: S311  # the same number gives the same wind
    return chance.choice(WINDS_MPS), float(chance.randrange(0, 360, 15))


ShrinkFleet = Callable[[Sequence[ComparableMission], tuple[float, float]], list[ComparedMission]]


def shrink_mission(one: ComparedMission, fly_fleet: ShrinkFleet, most_runs: int = 8) -> ComparedMission:
    """The simplest mission found that differs as `one` does, in at most `most_runs` runs.

    Each run flies up to `FLEET` missions that are one step simpler; the first of them that still differs in the same
    way is the next to be made simpler. A mission that differs without wind too is shown without.
    """
    wind = (one.wind_mps, one.wind_from_deg)
    tried: set[tuple[object, ...]] = set()
    for _ in range(most_runs):
        whole = one.mission
        assert isinstance(whole, RandomMission)
        candidates = []
        calm = (wind[0] > 0.0) and whole.items not in tried
        for mission in simpler(whole):
            if mission.items not in tried and is_legal(mission):
                tried.add(mission.items)
                candidates.append(mission)
            if len(candidates) == FLEET:
                break
        if calm:
            tried.add(whole.items)
            still = fly_fleet([whole, *candidates[: FLEET - 1]], (0.0, 0.0))
            found = [each for each in still if each.miss == one.miss]
            if found:
                wind = (0.0, 0.0)
                one = found[-1] if len(found) == 1 else found[1]
                continue
        if not candidates:
            break
        found = [each for each in fly_fleet(candidates, wind) if each.miss == one.miss]
        if not found:
            break
        one = found[0]
    return one


def write_results(folder: Path, agreement: MissionAgreement) -> None:
    """Write `missions.json` and `missions.md` into `folder`."""
    for name, text in (
        ("missions.json", json.dumps(results(agreement), indent=1)),
        ("missions.md", "\n".join(page(agreement))),
    ):
        with atomic_write(folder / name) as file:
            file.write(f"{text}\n".encode())


def results(agreement: MissionAgreement) -> dict[str, Any]:
    """The results as plain data."""
    return {
        "missions": len(agreement.compared),
        "decided": agreement.decided,
        "alike": agreement.alike,
        "share": round(agreement.share, 4) if agreement.decided else None,
        "misses": agreement.misses,
        "undecided": agreement.undecided,
        "refused": [{"file": str(one.file), "reason": one.reason} for one in agreement.refused],
        "compared": [_facts(one) for one in agreement.compared],
        "shrunk": {str(number): _facts(one) for number, one in agreement.shrunk.items()},
    }


def _facts(one: ComparedMission) -> dict[str, Any]:
    return {
        "number": one.mission.number,
        "items": one.mission.words,
        "wind_mps": one.wind_mps,
        "wind_from_deg": one.wind_from_deg,
        "miss": one.miss,
        "undecided": one.undecided,
        "detail": one.detail,
        "path_apart_m": None if np.isnan(one.path_apart_m) else round(one.path_apart_m, 3),
        "time_apart_s": round(one.time_apart_s, 3),
    }


def page(agreement: MissionAgreement) -> Iterator[str]:
    """The results as lines of a page in Markdown."""
    compared = agreement.compared
    share = f" ({agreement.share:.1%})" if agreement.decided else ""
    yield f"# {agreement.alike} of {agreement.decided} missions agree{share}"
    yield ""
    yield count_files(len(compared), agreement.refused) + f" {len(compared) - agreement.decided} undecided."
    yield from (f"- not flown: {one.file}: {one.reason}" for one in agreement.refused)
    yield ""
    alike = [one for one in compared if one.alike]
    if alike:
        paths = np.array([one.path_apart_m for one in alike])
        times = np.array([one.time_apart_s for one in alike])
        yield (
            f"Of those alike, the tracks are {np.median(paths):.2f} m apart in the median and {paths.max():.2f} m at "
            f"most; the times of items differ by {np.median(times):.2f} s and {times.max():.2f} s."
        )
        yield ""
    yield "| difference | missions |"
    yield "|---|---|"
    for miss, count in agreement.misses.items():
        yield f"| {miss} | {count} |"
    for why, count in agreement.undecided.items():
        yield f"| undecided: {why} | {count} |"
    yield ""
    yield "| mission | wind | difference | builtin / ArduPilot | shrunk to |"
    yield "|---|---|---|---|---|"
    for one in compared:
        if not one.alike:
            small = agreement.shrunk.get(one.mission.number, one)
            wind = f"{small.wind_mps:g} m/s from {small.wind_from_deg:g}°" if small.wind_mps else "none"
            what = one.miss or f"undecided: {one.undecided}"
            yield f"| {one.mission.number} | {wind} | {what} | {one.detail} | {small.mission.words} |"


def count_files(flown: int, refused: Sequence[RefusedMission]) -> str:
    """How many missions are flown and how many are not, in words."""
    return f"{flown + len(refused)} missions: {flown} flown, {len(refused)} refused."
