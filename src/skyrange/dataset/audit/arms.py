"""Arms of a data set as an audit sees them: the role of each run, its onset, and when its effect begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.errors import InputError
from skyrange.dataset.contents import RUNS
from skyrange.dataset.labels import ATTACK, INTRUSION, SHAM
from skyrange.dataset.progress import require_whole
from skyrange.dataset.reading import read_runs, read_view

NEVER: Final = 2**62
"""The time of what does not happen, in ns."""
_OF_SHAMS: Final = (SHAM, INTRUSION)


@dataclass(frozen=True, slots=True)
class ArmOfBlock:
    """What an audit has to know of one run; times are in ns since its start."""

    run: str
    block: str
    role: str
    """attacked, sham (also that of a harmless intrusion) or nominal, by its episodes: of a sham that does nothing it is
    nominal."""
    kinds: frozenset[str]
    onset_ns: int
    effect_ns: int
    """When the first aircraft departed from the nominal twin, or earlier a frame was seen that answers an act; of a run
    of which it is not known, the onset: what follows could be the effect."""
    repeats: bool = False
    """Whether the run repeats to the byte."""
    setting: str = ""
    """Equal for arms whose scenarios differ in the states of attacks and faults alone."""
    faults: frozenset[tuple[str, str, int]] = frozenset()
    """Kind, aircraft and onset of each benign fault that acts."""


def read_arms(folder: Path) -> list[ArmOfBlock]:
    """The runs of a data set with their roles, onsets and effects. Raises `InputError` for a folder that is none, or is
    not finished.
    """
    require_whole(folder)
    if not (folder / RUNS).is_file():
        raise InputError.one("dataset", str(folder), f"no {RUNS}", "the folder of a data set")
    episodes: dict[str, list[dict[str, Any]]] = {}
    faults: dict[str, set[tuple[str, str, int]]] = {}
    for path in sorted(folder.glob("view=episodes/split=*/*.parquet")):
        for row in read_view(folder, "episodes", path).to_pylist():
            if row["role"] != "fault":
                episodes.setdefault(row["run"], []).append(row)
            else:
                fault = str(row["kind"]), str(row["vehicle"]), int(row["onset_ns"])
                faults.setdefault(row["run"], set()).add(fault)
    departures, answers = _read_departures(folder), _read_answers(folder)
    arms = []
    for row in read_runs(folder):
        run_episodes = episodes.get(row["run"], [])
        roles = {episode["role"] for episode in run_episodes}
        role = "attacked" if ATTACK in roles else "sham" if roles & {SHAM, INTRUSION} else "nominal"
        onset_ns = min((episode["onset_ns"] for episode in run_episodes), default=NEVER)
        kinds = frozenset(str(episode["kind"]) for episode in run_episodes)
        effect_ns = _effect_ns(run_episodes, departures.get(row["run"], {"": None})) if run_episodes else NEVER
        if effect_ns is None:  # of a sham nobody expects an effect
            effect_ns = onset_ns if role == "attacked" else NEVER
        effect_ns = min(effect_ns, answers.get(row["run"], NEVER))
        arms.append(
            ArmOfBlock(
                row["run"],
                row["block"],
                role,
                kinds,
                onset_ns,
                effect_ns,
                bool(row.get("repeats", False)),
                str(row.get("setting", "")),
                frozenset(faults.get(row["run"], ())),
            )
        )
    return arms


def group_by_block(arms: Sequence[ArmOfBlock]) -> dict[str, list[ArmOfBlock]]:
    """The arms of each block that can be compared, in their order: those of one setting, as many as there are."""
    blocks: dict[str, dict[str, list[ArmOfBlock]]] = {}
    for arm in arms:
        blocks.setdefault(arm.block, {}).setdefault(arm.setting, []).append(arm)
    return {block: max(of_setting.values(), key=_worth) for block, of_setting in blocks.items()}


def _worth(arms: Sequence[ArmOfBlock]) -> tuple[bool, int]:
    """Arms of which some are attacked and others not tell more than arms of one role, and many more than few."""
    return len({arm.role == "attacked" for arm in arms}) == 2, len(arms)


def cut_at_faults(arms: Sequence[ArmOfBlock]) -> list[ArmOfBlock]:
    """Some arms of a block, whose onsets and effects are not after the first fault that acts in some of them alone:
    from then on they differ without a leak.
    """
    every = frozenset[tuple[str, str, int]]().union(*(arm.faults for arm in arms))
    some = every - frozenset.intersection(*(arm.faults for arm in arms))
    first_ns = min((onset_ns for _, _, onset_ns in some), default=NEVER)
    return [replace(arm, onset_ns=min(arm.onset_ns, first_ns), effect_ns=min(arm.effect_ns, first_ns)) for arm in arms]


def _effect_ns(episodes: Sequence[dict[str, Any]], departures: dict[str, int | None]) -> int | None:
    """When the first aircraft departed, None if that is not known of all of them."""
    exact = {episode["vehicle"]: int(episode["effect_ns"]) for episode in episodes if episode["effect_ns"] is not None}
    times = {**departures, **exact}
    known = [time for time in times.values() if time is not None]
    return min(known) if len(known) == len(times) else None


def _read_departures(folder: Path) -> dict[str, dict[str, int | None]]:
    """By run and aircraft, the time up to which the view `aircraft` has no effect; None where it does not know."""
    departures: dict[str, dict[str, int | None]] = {}
    columns = ["run", "vehicle", "time_ns", "effect"]
    for path in sorted(folder.glob("view=aircraft/split=*/*.parquet")):
        table = read_view(folder, "aircraft", path, columns)
        last = pc.if_else(pc.fill_null(table.column("effect"), fill_value=True), -1, table.column("time_ns"))
        ends = pa.table({**{name: table.column(name) for name in columns[:2]}, "last": last,
                         "known": pc.is_valid(table.column("effect")),
                         "departed": pc.fill_null(table.column("effect"), fill_value=False)})  # fmt: skip
        by = ends.group_by(["run", "vehicle"]).aggregate([("last", "max"), ("known", "min"), ("departed", "max")])
        for row in by.to_pylist():
            time_ns = max(row["last_max"], 0) if row["departed_max"] else NEVER
            departures.setdefault(row["run"], {})[row["vehicle"]] = time_ns if row["known_min"] else None
    return departures


def _read_answers(folder: Path) -> dict[str, int]:
    """By run, when the first frame was seen that follows from an act and is none, such as an acknowledgement."""
    first_answers: dict[str, int] = {}
    for path in sorted(folder.glob("view=mavlink/split=*/*.parquet")):
        table = read_view(folder, "mavlink", path, ["run", "time_ns", "steps", "derived", *_OF_SHAMS])
        of_acts = reduce(pc.or_, [table.column(name) for name in ("derived", *_OF_SHAMS)])
        answers = pc.and_(pc.greater(table.column("steps"), 0), of_acts)
        first = table.filter(answers).group_by("run").aggregate([("time_ns", "min")])
        first_answers |= {row["run"]: row["time_ns_min"] for row in first.to_pylist()}
    return first_answers
