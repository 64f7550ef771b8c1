"""Matrix file: the rows (scenarios with an attack or a benign fault) and the columns (defences) of a matrix."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from skyrange.contracts.plugins.registry import DEFENCES
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.files import MAX_TEXT_BYTES, expand_user, read_input
from skyrange.scenario.model.base import Id, Model, Whole, items, refuse
from skyrange.scenario.model.defences import DefenceCost, DefenceTable
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import FOLDER, source_of
from skyrange.scenario.shipped import load as load_scenario
from skyrange.scenario.toml_files import parse_toml
from skyrange.scenario.validation.error_messages import input_error
from skyrange.scenario.validation.plugin_params import known

SHIPPED: Final = Path(__file__).parent / "shipped.toml"
"""The matrix of attacks and defences that skyrange ships."""
UNDEFENDED: Final = "none"
"""The column without a defence."""

MeasureName = Literal[
    "departure_m", "strayed_m", "extra_distance_m", "extra_energy_j", "mission", "mishaps", "telemetry",
]  # fmt: skip
_Texts = Annotated[tuple[str, ...], BeforeValidator(items, json_schema_input_type=list[str])]


class Variant(Model):
    """What an adversary who knows defences does instead: the candidates among which it chooses."""

    knows: _Texts = Field(min_length=1, description="Kinds of defences that it knows, such as ['gnss.innovation'].")
    about: str = Field(min_length=1, description="What it does, as a phrase: 'drifts below the gate'.")
    candidates: tuple[_Texts, ...] = Field(
        min_length=1,
        max_length=8,
        description="Changes of the scenario that it tries, each a list of path=value; the one with the largest effect "
        "is reported. Their number is its budget.",
    )


class Row(Model):
    """One row: a scenario with an attack, or with a benign fault, and the measure of its effect."""

    id: Id = Field(description="Name, unique among the rows.")
    scenario: str = Field(min_length=1, description="Name of a shipped scenario or example, or a TOML file.")
    measure: MeasureName = Field(
        description="Effect on the aircraft that is affected most: strayed_m, largest horizontal distance from the "
        "path that it flew in the baseline, whatever the time; departure_m, extra_distance_m or "
        "extra_energy_j as in effects.parquet; mission, 1 if its mission has another outcome; mishaps, additional near "
        "misses and collisions; telemetry, share in percent of the telemetry frames of the baseline that are missing."
    )
    changes: _Texts = Field(default=(), description="Changes of the scenario, each path=value as with --set.")
    adaptive: tuple[Variant, ...] = Field(default=(), description="Adversaries who know defences; default: none.")

    def load(self, changes: tuple[str, ...] = ()) -> Scenario:
        """The scenario with the row's changes, and these. Raises `InputError`."""
        return load_scenario(self.scenario, [*self.changes, *changes])


class Part(Model):
    """One defence of a column: its kind, parameters and cost."""

    kind: Annotated[str, known(DEFENCES, "a kind of defence")] = Field(
        description="Kind of defence, a plugin of skyrange.defences."
    )
    params: dict[str, Any] = Field(default_factory=dict, description="Parameters of the kind.")
    cost: DefenceCost | None = Field(
        default=None, description="Processor time that it takes, as in a scenario; default: none."
    )


class Column(Model):
    """One column: a defence, or several on the same aircraft in this order, or settings of the scenario that defend."""

    id: Id = Field(description="Name, unique among the columns.")
    defences: tuple[Part, ...] = Field(default=(), description="The defences, in order.")
    changes: _Texts = Field(
        default=(),
        description="Changes of each scenario that defend it or that its defences need, such as Remote ID with "
        "signatures; path=value.",
    )

    @model_validator(mode="after")
    def _defends(self) -> Column:
        if not self.defences and not self.changes:
            raise refuse(Problem("defences", "none", "at least one defence, or changes that defend"))
        return self

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of its defences."""
        return tuple(part.kind for part in self.defences)

    @property
    def can_idle(self) -> bool:
        """Whether its cell may be the undefended one, because its defences may have nothing to do.

        Not where they take processor time, act in nominal flights by what their kinds say, or change the scenario.
        """
        acts = any(table.plugin.nominal for table in self.tables())
        return not self.changes and not acts and all(part.cost is None for part in self.defences)

    def tables(self, *, muted: bool = False) -> tuple[DefenceTable, ...]:
        """Its defences as tables of a scenario; their ids begin with that of the column."""
        ids = [self.id] if len(self.defences) == 1 else [f"{self.id}-{k}" for k in range(1, len(self.defences) + 1)]
        return tuple(
            DefenceTable(id=id_, kind=part.kind, params=part.params, cost=part.cost, muted=muted)
            for id_, part in zip(ids, self.defences, strict=True)
        )


class Matrix(Model):
    """A matrix: its rows, its columns, and the number of seeds of each cell."""

    name: Id = Field(description="Name of the matrix.")
    seeds: Whole = Field(default=5, ge=1, le=1_000, description="Number of seeds of each cell.")
    rows: tuple[Row, ...] = Field(min_length=1, description="The rows.")
    columns: tuple[Column, ...] = Field(min_length=1, description="The columns.")

    @model_validator(mode="after")
    def _unique(self) -> Matrix:
        problems = [*_repeated("rows", [row.id for row in self.rows])]
        problems += _repeated("columns", [column.id for column in self.columns])
        problems += [
            Problem(f"columns.{place}.id", UNDEFENDED, "a name that is not that of the undefended column")
            for place, column in enumerate(self.columns)
            if column.id == UNDEFENDED
        ]
        kinds = {kind for column in self.columns for kind in column.kinds}
        problems += [
            Problem(f"rows.{place}.adaptive", kind, "a kind of a column", nearest(kind, kinds))
            for place, row in enumerate(self.rows)
            for variant in row.adaptive
            for kind in variant.knows
            if kind not in kinds
        ]
        if problems:
            raise refuse(*problems)
        return self


def locate_scenarios(matrix: Matrix) -> Matrix:
    """The matrix with the files of its scenarios by absolute paths, so that it is the same from any folder."""
    files = [(row, source_of(row.scenario)) for row in matrix.rows]
    rows = (
        row if file.is_relative_to(FOLDER) else row.model_copy(update={"scenario": str(file.absolute())})
        for row, file in files
    )
    return matrix.model_copy(update={"rows": tuple(rows)})


def _repeated(where: str, ids: Sequence[str]) -> Iterator[Problem]:
    for place, id_ in enumerate(ids):
        if id_ in ids[:place]:
            yield Problem(f"{where}.{place}.id", id_, "a name that no other has")


def read_matrix(file: str | Path | None = None) -> Matrix:
    """The matrix in a TOML file; by default the shipped one. Raises `InputError` with all problems."""
    path = SHIPPED if file is None else expand_user(file)
    who = "matrix" if file is None else str(file)
    text = read_input(path, who, max_bytes=MAX_TEXT_BYTES, expected="a TOML file").decode("utf-8", errors="replace")
    data = parse_toml(text, who)
    try:
        return Matrix.model_validate(data)
    except ValidationError as error:
        raise input_error(who, error, Matrix, data) from None


def select(matrix: Matrix, rows: tuple[str, ...], columns: tuple[str, ...]) -> Matrix:
    """The matrix with some rows and columns alone; all where none is named. Raises `InputError` for unknown ones."""
    problems: list[Problem] = []
    for where, names, ids in (
        ("--row", rows, [row.id for row in matrix.rows]),
        ("--column", columns, [column.id for column in matrix.columns]),
    ):
        unknown = [name for name in names if name not in ids]
        expected = f"the id of a {where[2:]} of the matrix"
        problems += [Problem(where, name, expected, nearest(name, ids)) for name in unknown]
    if problems:
        raise InputError(matrix.name, problems)
    kept_rows = tuple(row for row in matrix.rows if not rows or row.id in rows)
    kept = tuple(column for column in matrix.columns if not columns or column.id in columns)
    kinds = {kind for column in kept for kind in column.kinds}
    kept_rows = tuple(
        row.model_copy(
            update={"adaptive": tuple(candidate for candidate in row.adaptive if set(candidate.knows) & kinds)}
        )
        for row in kept_rows
    )
    return matrix.model_copy(update={"rows": kept_rows, "columns": kept})
