"""Study file: a base scenario, its factors and draws, arms, seeds, what is kept of each run, and changes of it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, BeforeValidator, Field, ValidationError, model_validator

from skyrange.attack.contract import AttackPlugin
from skyrange.contracts.plugins.registry import ATTACKS, kinds
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.files import MAX_TEXT_BYTES, expand_user, read_input
from skyrange.dataset.families import FAMILIES
from skyrange.detect.learned.model_file import GRADIENT_BOOSTING, ISOLATION_FOREST, Algorithm
from skyrange.record.schema import FULL, STUDY, TABLES, keeps
from skyrange.scenario.model.base import Id, Model, Number, Whole, items, refuse
from skyrange.scenario.model.defences import DetectorTable
from skyrange.scenario.named_files import locate_files as locate_named_files
from skyrange.scenario.overrides import apply_overrides, locate_assignment
from skyrange.scenario.shipped import source_of
from skyrange.scenario.toml_files import parse_toml
from skyrange.scenario.validation.error_messages import input_error
from skyrange.study.columns import reserved_names
from skyrange.study.design.factors import BUILDINGS, CITY, SCENARIO, WHOLE_KEYS, Factor, is_city_file, names_files
from skyrange.study.matrix.model import Part
from skyrange.study.plan_size import MAX_RUNS

_WAYS: Final[Mapping[str, tuple[str, ...]]] = {
    "values": ("values", "named"),
    "named": ("named",),
    "low": ("low", "high", "steps", "log", "mean", "deviation", "whole"),
}
"""Ways to say what a factor's values are, by their first key."""


def change_data(data: Mapping[str, Any], changes: Iterable[str], root: type[BaseModel]) -> dict[str, Any]:
    """The table of a study, whose model is `root`, with every `path=value` applied as `scenario.overrides` does.

    Factors, draws, arms and detectors are named by their names or ids. Names of files are relative to the working
    directory. Values that a change gives a factor replace those of another kind, such as a range; `values` of a factor
    with `named` choose among its names, and may add cities. Raises `InputError` with one problem for each change that
    is malformed or matches nothing.
    """
    changes = list(changes)
    if not changes:
        return dict(data)
    changed = locate_files(apply_overrides(data, changes, root), Path.cwd())
    for kind in ("factors", "draws"):
        before, after = data.get(kind), changed.get(kind)
        if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
            changed[kind] = [_keep_one_way(old, new) for old, new in zip(before, after, strict=True)]
    return changed


def locate_files(data: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The table of a study with absolute names of all files that it names, from `folder`: scenarios, cities, and the
    files that its changes, factors, detectors and defences name.
    """
    located = dict(data)
    if isinstance(data.get("scenario"), str):
        located["scenario"] = _beside(folder, data["scenario"], SCENARIO)
    for kind in ("factors", "draws"):
        if isinstance(data.get(kind), list):
            located[kind] = [_locate_values(value, folder) for value in data[kind]]
    if isinstance(data.get("arms"), list):
        located["arms"] = [_locate_arm(arm, folder) for arm in data["arms"]]
    located |= _locate_changes(data, folder)
    return located | locate_named_files({"detectors": data["detectors"]}, folder)[0] if "detectors" in data else located


def _locate_changes(data: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The key `changes` of a study or an arm, if it has one that is a text or a list."""
    changes = data.get("changes")
    if isinstance(changes, str):
        return {"changes": locate_assignment(changes, folder)}
    if not isinstance(changes, list):
        return {}
    return {"changes": [locate_assignment(change, folder) if isinstance(change, str) else change for change in changes]}


def _locate_arm(arm: Any, folder: Path) -> Any:
    return locate_named_files(arm, folder)[0] | _locate_changes(arm, folder) if isinstance(arm, dict) else arm


def _locate_values(factor: Any, folder: Path) -> Any:
    if not isinstance(factor, dict) or not names_files(str(factor.get("key"))):
        return factor
    located, key = dict(factor), str(factor["key"])
    if isinstance(factor.get("values"), list):
        names = factor.get("named", ())
        located["values"] = [value if value in names else _beside(folder, value, key) for value in factor["values"]]
    if isinstance(factor.get("named"), dict):
        located["named"] = {name: _beside(folder, value, key) for name, value in factor["named"].items()}
    return located


def _beside(folder: Path, value: Any, key: str) -> Any:
    """The path of a file that is named relative to `folder`; what names no file as it is."""
    if not isinstance(value, str):
        return value
    is_file = is_city_file(value) if key != SCENARIO else "/" in value or Path(value).suffix == ".toml"
    return str((folder / expand_user(value)).absolute()) if is_file else value


def _keep_one_way(before: Any, after: Any) -> Any:
    """A factor without the values that it had, if a change gave it others of another kind."""
    if not isinstance(before, dict) or not isinstance(after, dict):
        return after
    for first, keys in _WAYS.items():
        if first in after and first not in before:
            return {name: value for name, value in after.items() if name in ("name", "key", *keys)}
    return after


_Texts = Annotated[tuple[str, ...], BeforeValidator(items, json_schema_input_type=list[str])]
Sampling = Literal["grid", "latin-hypercube", "sobol", "random"]

EVERYTHING: Final = "everything"
FEATURES: Final = "features"
RESULTS: Final = "results"
SHIPPED: Final = {path.stem: path for path in sorted((Path(__file__).parents[1] / "shipped").glob("*.toml"))}
"""Files of the shipped studies by name."""
_KEPT: Final = (EVERYTHING, FEATURES, RESULTS)


class StudyArm(Model):
    """One of the runs of which each block consists: with attacks or without, defended or not."""

    id: Id = Field(description="Name, unique among the arms.")
    attacks: Literal["active", "muted", "sham"] = Field(
        default="active",
        description="active: attacks act; muted: they are present and without effect; sham: they send as much, with "
        "harmless content, or are muted where their kind works by load.",
    )
    faults: Literal["active", "muted"] | None = Field(
        default=None, description="Whether benign faults act. Default: as the attacks do; muted in a sham arm."
    )
    defences: tuple[Part, ...] = Field(default=(), description="Defences that this arm has in addition.")
    changes: _Texts = Field(default=(), description="Changes of the scenario in this arm, each path=value.")


_SHORT: Final = {"nominal": "muted", "attacked": "active", "sham": "sham"}


def _arm(value: Any) -> Any:
    """An arm that is given by its name alone."""
    if not isinstance(value, str):
        return value
    if value not in _SHORT:
        raise refuse(Problem("", value, f"one of {', '.join(_SHORT)}, or a table with an id", nearest(value, _SHORT)))
    return {"id": value, "attacks": _SHORT[value]}


class LearnedTable(Model):
    """Learned baselines: their windows are collected in all runs; scoring trains them on the training blocks."""

    algorithms: Annotated[tuple[Algorithm, ...], BeforeValidator(items, json_schema_input_type=list[str])] = Field(
        default=(ISOLATION_FOREST, GRADIENT_BOOSTING),
        min_length=1,
        description="isolation_forest, which learns nominal flights; gradient_boosting, which learns attacks by their "
        "labels. Their names in the scores are the same with a hyphen.",
    )
    window_s: Number = Field(default=5.0, ge=0.5, le=600, description="Length of a window, in seconds.")
    links: Annotated[tuple[str, ...], BeforeValidator(items, json_schema_input_type=list[str])] = Field(
        default=("gcs:*",), min_length=1, description="Links to listen to, as those of a detector."
    )
    side: str = Field(default="gcs", min_length=1, description="End of those links, as that of a detector.")

    @property
    def names(self) -> dict[str, Algorithm]:
        """The algorithms by their names in the scores."""
        return {algorithm.replace("_", "-"): algorithm for algorithm in self.algorithms}


class Registration(Model):
    """What is written down before the first flight, with `skyrange study register`: only that is a test."""

    question: str = Field(min_length=1, max_length=2_000, description="What the study asks.")
    measures: _Texts = Field(
        min_length=1, description="Measures that answer it, such as ['departure_m']; all others are exploratory."
    )
    rule: str = Field(
        min_length=1,
        max_length=2_000,
        description="By what the answer is yes or no: 'the interval of departure_m is above 5 m'.",
    )


class HeldOutTraits(Model):
    """What blocks of the test split alone may have, so that scores say how detectors do on what they have not seen."""

    families: _Texts = Field(default=(), description="Mechanism families of attacks, such as gnss_false_position.")
    cities: _Texts = Field(default=(), description="Cities, as the column city of the results has them.")
    aircraft: Annotated[
        tuple[Annotated[Whole, Field(ge=1)], ...], BeforeValidator(items, json_schema_input_type=list[int])
    ] = Field(default=(), description="Numbers of aircraft of a run.")


class Study(Model):
    """A study: each point of the design is flown with each seed in each arm."""

    name: Id = Field(description="Name of the study.")
    scenario: str = Field(min_length=1, description="Name of a shipped scenario or example, or a TOML file.")
    changes: _Texts = Field(default=(), description="Changes of the scenario in all runs, each path=value.")
    factors: tuple[Factor, ...] = Field(default=(), description="What varies from point to point.")
    sampling: Sampling = Field(
        default="grid",
        description="How points are chosen: grid, every combination; latin-hypercube and sobol, points that fill the "
        "space evenly; random, independent points.",
    )
    points: Whole | None = Field(
        default=None, ge=1, le=1_000_000, description="Number of points, for all kinds of sampling but grid."
    )
    draws: tuple[Factor, ...] = Field(
        default=(), description="What varies from seed to seed as well: geometry, onset, wind, the attacker's place."
    )
    seeds: Whole = Field(default=1, ge=1, le=1_000_000, description="Number of seeds of each point.")
    first_seed: Whole = Field(default=1, ge=0, description="The first seed; the others follow it.")
    shared_seeds: bool = Field(
        default=True,
        description="Whether all points are flown with the same seeds. Then points are compared by flights with the "
        "same chance, and all blocks of one seed are one independent sample. With false, each block has a seed of its "
        "own: detectors are scored and data sets split by many blocks.",
    )
    arms: tuple[Annotated[StudyArm, BeforeValidator(_arm)], ...] = Field(
        default=("nominal", "attacked"),
        validate_default=True,
        min_length=1,
        description="The arms: 'nominal', 'attacked' and 'sham' by name, others as tables. All arms of a block have "
        "the same point, seed and draws.",
    )
    baseline: Id | None = Field(
        default=None, description="The arm with which effects are compared. Default: the first."
    )
    held_out: HeldOutTraits = Field(
        default_factory=HeldOutTraits,
        description="What is held out of training and validation when detectors are scored and data sets are built.",
    )
    detectors: tuple[DetectorTable, ...] = Field(default=(), description="Detectors that listen in all runs.")
    learned: LearnedTable | None = Field(default=None, description="Learned detectors, trained when it is scored.")
    registration: Registration | None = Field(
        default=None, description="Question, measures and rule, for `skyrange study register`."
    )
    keep: str | tuple[str, ...] = Field(
        default=RESULTS,
        description="What is kept of each run: results, its measures alone; features, its folder at level study; "
        "everything, its folder as recorded; or a list of tables by name.",
    )
    max_disk_mb: Number | None = Field(default=None, gt=0, description="Most disk that runs may take, in MB.")
    max_runs: Whole = Field(
        default=MAX_RUNS,
        ge=1,
        le=2**53,
        description="Most runs that it may have: points times seeds times arms.",
    )
    run_limit_s: Number = Field(
        default=600.0, gt=0, description="Longest wall time of one run, in s; the process of a longer one is ended."
    )

    @model_validator(mode="after")
    def _whole(self) -> Study:
        problems = [*_repeated("arms", [arm.id for arm in self.arms])]
        named = self.varying
        problems += _repeated("factors and draws", [factor.name for factor in named])
        problems += [
            Problem("factors", factor.name, "a name that is not that of a column of the results")
            for factor in named
            if factor.name in reserved_names() and (factor.name, factor.key) != (CITY, BUILDINGS)
        ]
        problems += [
            Problem("factors", key, "a key of at most one factor or draw")
            for key in WHOLE_KEYS
            if sum(factor.key == key for factor in named) > 1
        ]
        ids = [arm.id for arm in self.arms]
        if self.baseline is not None and self.baseline not in ids:
            problems.append(Problem("baseline", self.baseline, "the id of an arm", nearest(self.baseline, ids)))
        if self.sampling == "grid":
            if self.points is not None:
                problems.append(Problem("points", str(self.points), "none, because a grid has as many as its values"))
            problems += [
                Problem(f"factors.{place}.steps", "none", "values, or the number of steps of the range in the grid")
                for place, factor in enumerate(self.factors)
                if not factor.levels and factor.steps is None
            ]
        elif self.points is None:
            problems.append(Problem("points", "none", f"the number of points of {self.sampling}"))
        elif self.sampling == "sobol" and self.points & (self.points - 1):
            problems.append(Problem("points", str(self.points), "a power of two, as Sobol's points need"))
        tables = (self.keep,) if isinstance(self.keep, str) else self.keep
        known = _KEPT if isinstance(self.keep, str) else tuple(TABLES)
        problems += [
            Problem("keep", name, f"{', '.join(_KEPT)}, or a list of tables", nearest(name, known))
            for name in tables
            if name not in known
        ]
        if problems:
            raise refuse(*problems)
        return self

    @property
    def varying(self) -> tuple[Factor, ...]:
        """The factors, then the draws."""
        return (*self.factors, *self.draws)

    @property
    def against(self) -> str:
        """The arm with which effects are compared."""
        return self.baseline or self.arms[0].id

    @property
    def level(self) -> str | None:
        """The level at which runs are recorded; None for that of the scenario."""
        if self.keep == EVERYTHING:
            return None
        tables = () if isinstance(self.keep, str) else self.keep
        enough = all(keeps({"record": {"level": STUDY}}, table) for table in tables)
        return STUDY if enough else FULL


def _repeated(where: str, ids: Sequence[str]) -> Iterator[Problem]:
    for place, id_ in enumerate(ids):
        if id_ in ids[:place]:
            yield Problem(f"{where}.{place}", id_, "a name that no other has")


def read_study(file: str | Path, changes: Iterable[str] = ()) -> Study:
    """The shipped study of a name, or the one in a TOML file, whose scenarios and cities are relative to it.

    `changes` are those of `change_data`. Raises `InputError` with all problems.
    """
    path, who = SHIPPED.get(str(file)) or expand_user(file), str(file)
    if path.suffix != ".toml" and not os.path.exists(path):
        raise InputError.one("study", "name", who, "a shipped study or a TOML file", nearest(who, SHIPPED))
    text = read_input(path, who, max_bytes=MAX_TEXT_BYTES, expected="a TOML file").decode("utf-8", errors="replace")
    return parse_study(text, who, path.parent, changes)


def parse_study(text: str, who: str, folder: Path, changes: Iterable[str] = ()) -> Study:
    """The study in TOML text; files are relative to `folder`, those in `changes` to the working directory.

    Raises `InputError` with all problems.
    """
    return _check_data(change_data(locate_files(parse_toml(text, who), folder), changes, Study), who)


def change_study(study: Study, changes: Iterable[str]) -> Study:
    """A study with `changes` as `change_data` has them. Raises `InputError` with all problems."""
    changes = list(changes)
    if not changes:
        return study
    return _check_data(change_data(study.model_dump(mode="json", exclude_defaults=True), changes, Study), study.name)


def _check_data(data: dict[str, Any], who: str) -> Study:
    try:
        study = Study.model_validate(data)
    except ValidationError as error:
        raise input_error(who, error, Study, data) from None
    named = [family for family in study.held_out.families if family not in FAMILIES and "." not in family]
    if named:
        declared = {AttackPlugin.find(kind).family for kind in kinds(ATTACKS)}  # by plugins
        problems = [
            Problem("held_out.families", family, "a family of attack kinds, or a kind", nearest(family, FAMILIES))
            for family in named
            if family not in declared
        ]
        if problems:
            raise InputError(who, problems)
    for name in scenarios_of(study):
        if not os.path.isfile(source_of(name)):  # false for a name that no file can have
            raise InputError.one(who, "scenario", name, "a shipped scenario or a TOML file")
    for file in cities_of(study):
        if not os.path.isfile(file):
            raise InputError.one(who, "buildings", file, "a file of buildings, 'grid:SEED', or '' for the scenario's")
    return study


def scenarios_of(study: Study) -> list[str]:
    """The names or files of all scenarios of a study."""
    chosen = [
        str(factor.value_of(level)) for factor in study.varying for level in factor.levels if factor.key == SCENARIO
    ]  # fmt: skip
    return chosen or [study.scenario]


def cities_of(study: Study) -> list[str]:
    """The files of buildings that a study flies over by its factors."""
    values = [factor.value_of(level) for factor in study.varying for level in factor.levels if factor.key == BUILDINGS]
    return [value for value in values if isinstance(value, str) and is_city_file(value)]
