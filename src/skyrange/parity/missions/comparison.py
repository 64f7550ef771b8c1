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
        return sum(mission.alike for mission in self.compared)

    @property
    def decided(self) -> int:
        """How many agree or differ."""
        return sum(not mission.undecided for mission in self.compared)

    @property
    def share(self) -> float:
        """The share of those decided that agrees; NaN if none is decided."""
        return self.alike / self.decided if self.decided else np.nan

    @property
    def misses(self) -> dict[str, int]:
        """How many differ in each way, most frequent first."""
        return dict(Counter(mission.miss for mission in self.compared if mission.miss).most_common())

    @property
    def undecided(self) -> dict[str, int]:
        """How many are undecided for each reason, most frequent first."""
        return dict(Counter(mission.undecided for mission in self.compared if mission.undecided).most_common())


def legal_missions(count: int, first: int = 0) -> list[RandomMission]:
    """The first `count` random missions from number `first` on that can be flown and are not too long."""
    missions: list[RandomMission] = []
    number = first
    while len(missions) < count:
        mission = random_mission(number)
        if is_legal(mission):
            missions.append(mission)
        number += 1
    return missions


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
    refused.sort(key=lambda refusal: files.index(refusal.file))
    if refused and not flyable:
        problems = [Problem(str(refusal.file), refusal.reason, "a mission that can be flown") for refusal in refused]
        raise InputError("missions", problems)
    return flyable, refused


def _problems(mission: GivenMission) -> Sequence[Problem]:
    """What is wrong with a mission, by its ground station or in its run; the builtin stands for both autopilots."""
    try:
        if problems := check(flight_plan(mission), "mission"):
            return problems
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

    def agreement() -> MissionAgreement:
        return MissionAgreement(tuple(compared), shrunk, tuple(refused))

    folder.mkdir(parents=True, exist_ok=True)
    for start in range(0, len(missions), FLEET):
        fleet = missions[start : start + FLEET]
        compared += fly_fleet(fleet, (0.0, 0.0) if given else draw_wind(fleet[0].number))
        write_results(folder, agreement())
    if shrink and not given:
        for differing in [mission for mission in compared if mission.miss]:
            shrunk[differing.mission.number] = shrink_mission(differing, fly_fleet)
            write_results(folder, agreement())
    return agreement()


def draw_wind(number: int) -> tuple[float, float]:
    """The wind of the fleet whose first mission has this number: m/s, and degrees that it comes from."""
    chance = Random(f"wind {number}")  # noqa: S311  # the same number gives the same wind
    return chance.choice(WINDS_MPS), float(chance.randrange(0, 360, 15))


ShrinkFleet = Callable[[Sequence[ComparableMission], tuple[float, float]], list[ComparedMission]]


def shrink_mission(compared: ComparedMission, fly_fleet: ShrinkFleet, most_runs: int = 8) -> ComparedMission:
    """The simplest mission found that differs as `compared` does, in at most `most_runs` runs.

    Each run flies up to `FLEET` missions that are one step simpler; the first of them that still differs in the same
    way is the next to be made simpler. A mission that differs without wind too is shown without.
    """
    wind = (compared.wind_mps, compared.wind_from_deg)
    tried: set[tuple[object, ...]] = set()
    for _ in range(most_runs):
        whole = compared.mission
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
            similar = [candidate for candidate in still if candidate.miss == compared.miss]
            if similar:
                wind = (0.0, 0.0)
                compared = similar[-1] if len(similar) == 1 else similar[1]
                continue
        if not candidates:
            break
        similar = [candidate for candidate in fly_fleet(candidates, wind) if candidate.miss == compared.miss]
        if not similar:
            break
        compared = similar[0]
    return compared


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
        "refused": [{"file": str(refusal.file), "reason": refusal.reason} for refusal in agreement.refused],
        "compared": [_facts(mission) for mission in agreement.compared],
        "shrunk": {str(number): _facts(mission) for number, mission in agreement.shrunk.items()},
    }


def _facts(compared: ComparedMission) -> dict[str, Any]:
    return {
        "number": compared.mission.number,
        "items": compared.mission.words,
        "wind_mps": compared.wind_mps,
        "wind_from_deg": compared.wind_from_deg,
        "miss": compared.miss,
        "undecided": compared.undecided,
        "detail": compared.detail,
        "path_apart_m": None if np.isnan(compared.path_apart_m) else round(compared.path_apart_m, 3),
        "time_apart_s": round(compared.time_apart_s, 3),
    }


def page(agreement: MissionAgreement) -> Iterator[str]:
    """The results as lines of a page in Markdown."""
    compared = agreement.compared
    share = f" ({agreement.share:.1%})" if agreement.decided else ""
    yield f"# {agreement.alike} of {agreement.decided} missions agree{share}"
    yield ""
    yield count_files(len(compared), agreement.refused) + f" {len(compared) - agreement.decided} undecided."
    yield from (f"- not flown: {refusal.file}: {refusal.reason}" for refusal in agreement.refused)
    yield ""
    alike = [mission for mission in compared if mission.alike]
    if alike:
        paths = np.array([mission.path_apart_m for mission in alike])
        times = np.array([mission.time_apart_s for mission in alike])
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
    for mission in compared:
        if not mission.alike:
            small = agreement.shrunk.get(mission.mission.number, mission)
            wind = f"{small.wind_mps:g} m/s from {small.wind_from_deg:g}°" if small.wind_mps else "none"
            what = mission.miss or f"undecided: {mission.undecided}"
            yield f"| {mission.mission.number} | {wind} | {what} | {mission.detail} | {small.mission.words} |"


def count_files(flown: int, refused: Sequence[RefusedMission]) -> str:
    """How many missions are flown and how many are not, in words."""
    return f"{flown + len(refused)} missions: {flown} flown, {len(refused)} refused."
