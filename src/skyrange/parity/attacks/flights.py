"""Flights of the examples of attacks with two kinds of autopilot, each attacked and muted."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from skyrange.assembly.build import build
from skyrange.core.errors import InputError, nearest
from skyrange.core.time import NS_PER_S
from skyrange.metrics.time_series import read_notes
from skyrange.parity.attacks.reactions import (
    NO_EFFECT,
    Flight,
    Reaction,
    alike,
    most_severe,
    ordered_vehicles,
    react,
    read_flights,
)
from skyrange.parity.flights import DEADLINE_S, KINDS
from skyrange.record import RunRecord
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import EXAMPLES, load
from skyrange.study.runs import fly

FOLDERS: Final = (
    "link",
    "mavlink",
    "telemetry",
    "time",
    "identity",
    "signing",
    "gnss",
    "sensor",
    "remote_id",
    "ground",
    "companion",
    "approval",
    "control_link",
    "campaign",
    "lidar",
    "depth",
)
"""The groups of kinds that are compared."""
NOT_CARRIED: Final[Mapping[str, str]] = {
    "sensor.compass": "the JSON interface has no magnetometer; ArduPilot's simulation derives its own from the true "
    "attitude",
}
"""Kinds that do not reach an ArduPilot under this world, and why not."""
ARDUPILOT_PARAMS: Final[Mapping[str, float]] = {"SIM_FLOAT_EXCEPT": 0.0}
"""Parameters of every ArduPilot. By default its simulation ends the process at a floating-point exception, to find
faults (libraries/AP_HAL_SITL/Scheduler.cpp, `feenableexcept`); a flight controller goes on."""

OnFlight = Callable[[str, int, int], None]
"""Callback for progress: what is flown, flights that are done, and all flights."""


@dataclass(frozen=True, slots=True)
class ComparedAttack:
    """One kind of attack and the reactions of two autopilots, in the order of `KINDS`."""

    kind: str
    first: Reaction
    second: Reaction

    @property
    def same(self) -> bool:
        """Whether both react in the same way."""
        return self.first.reaction == self.second.reaction

    @property
    def alike(self) -> bool:
        """Whether both react in the same way at the same time, and are led equally far."""
        return alike(self.first, self.second)

    @property
    def does_not_apply(self) -> str:
        """Why the attack cannot reach an ArduPilot, or "" if it does."""
        return NOT_CARRIED.get(self.kind, "")

    @property
    def undecided(self) -> str:
        """Why the flights say nothing of the attack, or ""."""
        return self.first.undecided or self.second.undecided

    @property
    def effective(self) -> bool:
        """Whether the attack changes a flight of either."""
        return not {self.first.reaction, self.second.reaction} <= NO_EFFECT


@dataclass(frozen=True, slots=True)
class SeededAttack:
    """One kind of attack and the reactions of two autopilots, in the order of `KINDS`, one for each seed."""

    kind: str
    first: tuple[Reaction, ...]
    second: tuple[Reaction, ...]


@dataclass(frozen=True, slots=True)
class AttackAgreement:
    """Number of kinds that reach both autopilots, and of those with an effect on a flight of either; of both, the
    numbers with the same reaction, and with the same reaction at the same time and distance.
    """

    kinds: int
    effective: int
    same: int
    effective_same: int
    alike: int
    effective_alike: int


def agreement(compared: Sequence[ComparedAttack]) -> AttackAgreement:
    """The agreement of all compared kinds that reach both autopilots and are not undecided."""
    both = [attack for attack in compared if not attack.does_not_apply and not attack.undecided]
    return count([(attack.effective, attack.same, attack.alike) for attack in both])


def count(rows: Sequence[tuple[bool, bool, bool]]) -> AttackAgreement:
    """The agreement of kinds of which it is known whether they are effective, the same and alike."""
    return AttackAgreement(
        kinds=len(rows),
        effective=sum(effective for effective, _, _ in rows),
        same=sum(same for _, same, _ in rows),
        effective_same=sum(effective and same for effective, same, _ in rows),
        alike=sum(near for _, _, near in rows),
        effective_alike=sum(effective and near for effective, _, near in rows),
    )


def compared_kinds() -> list[str]:
    """The kinds of attack in `FOLDERS` that have an example."""
    return [kind for folder in FOLDERS for kind in EXAMPLES if kind.partition(".")[0] == folder]


def chosen_kinds(kinds: Sequence[str]) -> list[str]:
    """`kinds`, or all that are compared. Raises `InputError` for a kind without an example."""
    for kind in kinds:
        if kind not in EXAMPLES:
            raise InputError.one(
                "skyrange parity attacks", "KIND", kind, "a kind of attack with an example", nearest(kind, EXAMPLES)
            )
    return list(dict.fromkeys(kinds)) or compared_kinds()


def compare(
    folder: Path,
    kinds: Sequence[str],
    rates: str = "reduced",
    *,
    seed: int | None = None,
    on_flight: OnFlight | None = None,
) -> list[ComparedAttack]:
    """Fly the examples of `kinds` with both autopilots, attacked and nominal, into `folder`, and read the reactions.

    `rates` are ArduPilot's; `seed` replaces the seed of each example. A nominal flight serves all examples that differ
    in their attacks alone, because a muted attack changes nothing. Raises `InputError` before the first flight, such
    as one for a missing ArduCopter, and the errors of `study.runs.fly`.
    """
    chosen = chosen_kinds(kinds)
    changes = [] if seed is None else [f"seed={seed}"]
    flights = [
        (kind, autopilot, _with_autopilot(load(kind, changes), autopilot, rates))
        for kind in chosen
        for autopilot in KINDS
    ]
    for _, _, scenario in flights:
        build(scenario)
    total = len(flights) + len({_twin_key(scenario) for _, _, scenario in flights})
    twins: dict[str, dict[str, Flight]] = {}
    reactions: dict[str, list[Reaction]] = {kind: [] for kind in chosen}
    done = 0

    def flown(name: str, scenario: Scenario) -> RunRecord:
        nonlocal done
        if on_flight is not None:
            on_flight(name, done, total)
        done += 1
        return fly(scenario, folder / name, report=False)

    for kind, autopilot, scenario in flights:
        key = _twin_key(scenario)
        if key not in twins:
            twins[key] = read_flights(flown(f"{kind}-{autopilot}-nominal", _muted(scenario)))
        reactions[kind].append(read(flown(f"{kind}-{autopilot}", scenario), twins[key]))
    return [ComparedAttack(kind, *reactions[kind]) for kind in chosen]


def compare_seeds(
    folder: Path, kinds: Sequence[str], seeds: int, rates: str = "reduced", *, on_flight: OnFlight | None = None
) -> list[SeededAttack]:
    """`compare` with the seeds 1 to `seeds`, each in a folder of its own, `seed-1` …"""
    by_seed = []
    for seed in range(1, seeds + 1):

        def report(name: str, done: int, total: int, seed: int = seed) -> None:
            if on_flight is not None:
                on_flight(f"{name}, seed {seed}", (seed - 1) * total + done, seeds * total)

        by_seed.append(compare(folder / f"seed-{seed}", kinds, rates, seed=seed, on_flight=report))
    return [
        SeededAttack(same[0].kind, tuple(attack.first for attack in same), tuple(attack.second for attack in same))
        for same in zip(*by_seed, strict=True)
    ]


def read(attacked: RunRecord, nominal: Mapping[str, Flight]) -> Reaction:
    """The reaction in an attacked run: that of the aircraft with the most severe one."""
    ordered = ordered_vehicles(attacked)
    starts = [note.time_ns / NS_PER_S for note in read_notes(attacked, "events") if note.kind == "event.attack_start"]
    start_s = min(starts, default=0.0)
    return most_severe(
        [
            react(flight, nominal[vehicle], start_s, ordered=vehicle in ordered)
            for vehicle, flight in read_flights(attacked).items()
        ]
    )


def _muted(scenario: Scenario) -> Scenario:
    attacks = tuple(attack.model_copy(update={"muted": True}) for attack in scenario.attacks)
    return scenario.model_copy(update={"attacks": attacks})


def _twin_key(scenario: Scenario) -> str:
    """The scenario without its attacks and name, as text."""
    return json.dumps(scenario.model_dump(mode="json", exclude={"name", "description", "attacks"}), sort_keys=True)


def _with_autopilot(scenario: Scenario, kind: str, rates: str) -> Scenario:
    more = ARDUPILOT_PARAMS if kind == "ardupilot" else {}
    operators = tuple(
        operator.model_copy(
            update={
                "vehicles": tuple(
                    vehicle.model_copy(update={"autopilot": kind, "params": {**vehicle.params, **more}})
                    for vehicle in operator.vehicles
                )
            }
        )
        for operator in scenario.operators
    )
    autopilots = scenario.autopilots.model_copy(update={"deadline_s": DEADLINE_S})
    if kind == "ardupilot":
        autopilots = autopilots.with_options(kind, {"rates": rates}, f"{scenario.name} at rates {rates}")
    return scenario.model_copy(update={"operators": operators, "autopilots": autopilots})
