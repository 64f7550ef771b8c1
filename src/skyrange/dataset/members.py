"""Members of a data set, each with its block, arm, split and factors, and how blocks are split and held out.

Blocks that share a seed or a flight are one cluster: in two splits, a detector would be tested on what it has seen.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from typing import Any, Final, Literal

from pydantic import ConfigDict, with_config
from typing_extensions import TypedDict

from skyrange.core.chance import Chance
from skyrange.core.errors import InputError, Problem
from skyrange.core.files import expand_user, parse_json, read_input
from skyrange.core.ids import ID_PATTERN, hash64
from skyrange.core.typed_json import Finite, Int64, require_type
from skyrange.dataset.families import family_of
from skyrange.metrics.exact_difference import identify_flight
from skyrange.record.manifest import fleet_of, read_manifest
from skyrange.statistics.clusters import find_clusters

Scalar = str | int | float | bool

SCENARIO: Final = "scenario.toml"
NAME: Final = "ids of letters, digits, _ and -, joined with +"
"""What the name of a block or an arm is."""
_MAX_NAME: Final = 200
_MAX_BYTES: Final = 64 * 1024 * 1024
_KEYS: Final = frozenset({"folder", "block", "arm", "split", "factors", "seed", "effects_s"})


@dataclass(frozen=True, slots=True)
class Member:
    """One run of a data set."""

    record: Path
    """The run's folder."""
    block: str
    """All arms of one draw of a scenario have the same block. An id of letters, digits, `_` and `-`."""
    arm: str
    split: str
    """Such as train, validation or test; "" until `assign_splits`."""
    factors: Mapping[str, Scalar]
    """The study's factors, such as the city and the size of the fleet."""
    seed: int
    scenario: str
    """The text of the run's scenario file, from which it is flown again."""
    effects_s: Mapping[str, float | None] | None = field(default=None)
    """By vehicle, when it departed from the nominal twin in seconds, None for never; None if that is not known."""

    @property
    def run(self) -> str:
        """The id of the run in the data set: block and arm."""
        return f"{self.block}.{self.arm}"


def is_name(text: str) -> bool:
    """Whether a block or an arm can have this name, which becomes a part of the names of files."""
    return len(text) <= _MAX_NAME and all(ID_PATTERN.fullmatch(part) for part in text.split("+"))


def read_members(file: Path | str) -> list[Member]:
    """The members in a TOML or JSON file: a list `runs` of tables with `folder`, `block`, `arm` and, if wanted,
    `split`, `factors`, `seed` and `effects_s`.

    Folders are relative to the file. The scenario is that of the folder, and the seed is by default the scenario's.
    Raises `InputError` for what is missing, of another type, unknown, or there twice.
    """
    path = expand_user(file)
    who = str(path)
    data = read_input(path, who, max_bytes=_MAX_BYTES, expected="a TOML or JSON file of runs")
    value = _parse_file_toml(data, who) if path.suffix == ".toml" else parse_json(data, who, path.name)
    rows = value.get("runs") if isinstance(value, dict) else value
    if not isinstance(rows, list) or not rows:
        raise InputError.one(who, "runs", type(rows).__name__, "a list of runs, at least one")
    problems: list[Problem] = []
    members = [member for k, row in enumerate(rows) if (member := _member(path.parent, f"runs[{k}]", row, problems))]
    if problems:
        raise InputError(who, problems)
    check_members(members)
    return members


def _member(base: Path, where: str, row: Any, problems: list[Problem]) -> Member | None:
    before = len(problems)
    if not isinstance(row, dict):
        problems.append(Problem(where, type(row).__name__, "a table"))
        return None
    problems += [Problem(f"{where}.{key}", "unknown", f"one of {', '.join(sorted(_KEYS))}") for key in {*row} - _KEYS]
    for key, kind, default in _SHAPE:
        if not isinstance(row.get(key, default), kind):
            problems.append(Problem(f"{where}.{key}", repr(row.get(key)), f"{kind}"))
    if len(problems) > before:
        return None
    folder = base / expand_user(row["folder"])
    scenario = folder / SCENARIO
    if not os.path.isfile(scenario):  # false for a name that no file can have
        problems.append(Problem(f"{where}.folder", str(folder), "the folder of a run with its scenario.toml"))
        return None
    data = read_input(scenario, str(folder), max_bytes=_MAX_BYTES)
    seed = row.get("seed", _parse_file_toml(data, str(scenario)).get("seed", 0))
    effects = row.get("effects_s")
    given = {"factors": row.get("factors", {}), "seed": seed, "effects_s": effects}
    require_type(given, _Given, str(folder), where)
    text = data.decode()
    return Member(
        folder, row["block"], row["arm"], row.get("split", ""), dict(row.get("factors", {})), int(seed), text,
        None if effects is None else {name: _effect_s(at) for name, at in effects.items()},
    )  # fmt: skip


@with_config(ConfigDict(extra="forbid"))
class _Given(TypedDict):
    """What a member says, but for its folder and names."""

    factors: dict[str, Scalar]
    seed: Int64
    effects_s: dict[str, Finite | Literal["never"] | None] | None


def _parse_file_toml(data: bytes, who: str) -> dict[str, Any]:
    """The tables in the bytes of a TOML file. Raises `InputError`."""
    try:
        return tomllib.loads(data.decode())
    except (ValueError, RecursionError) as error:
        raise InputError.one(who, "file", str(error)[:200], "TOML") from None


def _effect_s(value: Any) -> float | None:
    return None if value in (None, "never") else float(value)


_SHAPE: Final[tuple[tuple[str, Any, Any], ...]] = (
    ("folder", str, None), ("block", str, None), ("arm", str, None), ("split", str, ""), ("factors", dict, {}),
    ("seed", int, 0), ("effects_s", dict, {}),
)  # fmt: skip


def check_members(members: list[Member]) -> None:
    """Raise `InputError` for a block or arm that is no id, and for an arm that a block has twice."""
    problems = []
    seen: set[str] = set()
    for member in members:
        for name, value in (("block", member.block), ("arm", member.arm)):
            if not is_name(value):
                problems.append(Problem(name, value, NAME))
        if member.run in seen:
            problems.append(Problem("runs", member.run, "each arm of a block once"))
        seen.add(member.run)
    if problems:
        raise InputError("dataset", problems)


SHARES: Final[Mapping[str, float]] = {"train": 0.6, "validation": 0.2, "test": 0.2}
_NAME: Final = re.compile(r"(?!all$)[A-Za-z0-9_]{1,64}")
"""What Hugging Face `datasets` takes as the name of a split, and every file system as that of a folder."""
HELD_OUT: Final = "heldout"
"""Splits of held-out blocks are called `heldout_family`, `heldout_city` and `heldout_fleet`."""


@dataclass(frozen=True, slots=True)
class Traits:
    """What may be held out of a run."""

    families: frozenset[str]
    """Mechanism families of its declared attacks; those of a block are the union of its arms'."""
    city: str
    """The factor `city`, or the name of the file of buildings, or "" for open ground."""
    fleet_size: int


@dataclass(frozen=True, slots=True)
class HeldOut:
    """What no block in training, validation or test has."""

    families: frozenset[str] = frozenset()
    cities: frozenset[str] = frozenset()
    fleet_sizes: frozenset[int] = frozenset()


def traits_of(member: Member) -> Traits:
    """The traits of a run by its manifest and its factors. Raises `InputError` for a kind without a family."""
    manifest = read_manifest(member.record)
    named = member.factors.get("city", name_city(manifest))
    families = frozenset(family_of(row) for row in manifest.get("attacks") or ())
    return Traits(families, str(named), len(fleet_of(manifest, str(member.record))))


def name_city(manifest: Mapping[str, Any]) -> str:
    """The name of a run's city: the file of its buildings without its folder, or the size, seed and shape of a
    generated downtown; empty over open ground.
    """
    city = manifest.get("city") or {}
    named = str(city.get("name") or city.get("source") or ("city" if city else ""))
    return PurePath(named).name


def assign_splits(
    members: Sequence[Member],
    seed: int,
    *,
    shares: Mapping[str, float] = SHARES,
    held_out: HeldOut | None = None,
) -> list[Member]:
    """The members with their splits. A cluster's split depends on the name of its first block, `seed` and what is held
    out, on nothing else.

    A cluster of which some run has a held-out trait goes to `heldout_family`, `heldout_city` or `heldout_fleet`, the
    first that applies. The others are drawn by addressed chance: adding clusters moves none. Raises `InputError` for
    shares that are negative or do not sum to 1.
    """
    _check_shares(shares)
    held_out = held_out or HeldOut()
    clusters = cluster_members(members)
    traits: dict[str, list[Traits]] = {}
    for member in members:
        traits.setdefault(clusters[member.block], []).append(traits_of(member))
    splits = {
        cluster: split_of(cluster, cluster_traits, seed, held_out, shares) for cluster, cluster_traits in traits.items()
    }
    return [replace(member, split=splits[clusters[member.block]]) for member in members]


def cluster_members(members: Sequence[Member]) -> dict[str, str]:
    """The cluster of each block, by the name of its first block: blocks that share a seed or a flight."""
    shared: dict[str, list[Hashable]] = {block: [] for block in sorted({member.block for member in members})}
    for member in members:
        shared[member.block] += _shared_by(member)
    return find_clusters(shared)


def _shared_by(member: Member) -> list[tuple[str, str]]:
    """What no run of another split may have: the seed, and the flight, if it is known."""
    flight = identify_flight(read_manifest(member.record))
    return [("seed", str(member.seed)), *([("flight", flight)] if flight else [])]


def _check_shares(shares: Mapping[str, float]) -> None:
    if any(not 0.0 <= share <= 1.0 for share in shares.values()) or abs(sum(shares.values()) - 1.0) > 1e-9:
        raise InputError.one("dataset", "shares", dict(shares), "shares from 0 to 1 with the sum 1")
    wrong = [name for name in shares if name.startswith(HELD_OUT)]
    if wrong:
        raise InputError.one("dataset", "shares", wrong[0], f"a name that does not begin with {HELD_OUT}")


def split_of(
    block: str, traits: Sequence[Traits], seed: int, held_out: HeldOut, shares: Mapping[str, float] = SHARES
) -> str:
    """The split of a cluster, named by its first block, whose runs have `traits`: a held-out one, or `draw_split`'s."""
    return _held_split(traits, held_out) or draw_split(block, seed, shares)


def draw_split(block: str, seed: int, shares: Mapping[str, float] = SHARES) -> str:
    """The split of a cluster by addressed chance: it depends on the name of its first block and the seed alone."""
    drawn = Chance(seed).uniform4("dataset.split", hash64(block), 0)[0]
    total = 0.0
    for name, share in shares.items():
        total += share
        if drawn < total:
            return name
    return list(shares)[-1]


def _held_split(traits: Sequence[Traits], held_out: HeldOut) -> str:
    if any(run_traits.families & held_out.families for run_traits in traits):
        return f"{HELD_OUT}_family"
    if any(run_traits.city in held_out.cities for run_traits in traits):
        return f"{HELD_OUT}_city"
    if any(run_traits.fleet_size in held_out.fleet_sizes for run_traits in traits):
        return f"{HELD_OUT}_fleet"
    return ""


def check_splits(members: Sequence[Member]) -> None:
    """Raise `InputError` where something crosses: a block, seed or flight in two splits, a run without a split, a draw
    in two blocks; and for a split that is no name.
    """
    problems: list[Problem] = []
    splits: dict[str, set[str]] = {}
    draws: dict[tuple[str, int, str], str] = {}
    for member in members:
        splits.setdefault(member.block, set()).add(member.split)
        first = draws.setdefault((member.scenario, member.seed, member.arm), member.block)
        if first != member.block:
            problems.append(
                Problem(f"block {member.block}", first, "another scenario, seed or arm than another block's")
            )
    for block, block_splits in splits.items():
        if "" in block_splits:
            problems.append(Problem(f"block {block}", "no split", "a split for each run, as `assign_splits` gives"))
        elif wrong := [split for split in sorted(block_splits) if not _NAME.fullmatch(split)]:
            expected = "a name of at most 64 letters, digits and _, other than all"
            problems.append(Problem(f"block {block}: split", repr(wrong[0]), expected))
        elif len(block_splits) > 1:
            problems.append(
                Problem(f"block {block}", ", ".join(sorted(block_splits)), "one split for all arms of a block")
            )
    if not problems:
        problems = list(_find_crossings(members))
    if problems:
        raise InputError("dataset", problems)


def _find_crossings(members: Sequence[Member]) -> Iterator[Problem]:
    """What is shared by blocks of two splits."""
    homes: dict[tuple[str, str], Member] = {}
    reported: set[tuple[str, str, str]] = set()
    for member in members:
        for kind, value in _shared_by(member):
            first = homes.setdefault((kind, value), member)
            if first.split != member.split and (kind, value, member.split) not in reported:
                reported.add((kind, value, member.split))
                where = f"{kind} {value} of run {member.run}"
                expected = f"{first.split}, as run {first.run}, which has the same {kind}"
                hint = (
                    "" if len(reported) > 1 else "`assign_splits` keeps blocks that share a seed or a flight together."
                )
                yield Problem(where, member.split, expected, hint)


def check_held_out(members: Sequence[Member]) -> None:
    """Raise `InputError` where a family, city or fleet size of a held-out split is in training, validation or test."""
    inside: dict[str, set[str]] = {"family": set(), "city": set(), "fleet": set()}
    outside: dict[str, set[str]] = {"family": set(), "city": set(), "fleet": set()}
    for member in members:
        traits = traits_of(member)
        values = {"family": set(traits.families), "city": {traits.city}, "fleet": {str(traits.fleet_size)}}
        axis = member.split.removeprefix(f"{HELD_OUT}_")
        if axis == member.split:
            for name, run_values in values.items():
                inside[name] |= run_values
        elif axis in outside:
            outside[axis] |= values[axis]
    # a held-out block may have several families, of which only one has to be unseen
    crossing = [
        Problem(f"{HELD_OUT}_{axis}", ", ".join(sorted(outside_values)), f"a {axis} that is in no other split")
        for axis, outside_values in outside.items()
        if outside_values and not outside_values - inside[axis]
    ]
    if crossing:
        raise InputError("dataset", crossing)
