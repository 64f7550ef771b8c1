"""Factors of a study: what varies, and the values it takes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from pydantic import Field, model_validator

from skyrange.core.errors import Problem, nearest
from skyrange.scenario.model.base import Id, Model, Number, Whole, refuse
from skyrange.scenario.named_files import FILE_KEYS

SCENARIO: Final = "scenario"
BUILDINGS: Final = "buildings"
WHOLE_KEYS: Final = (SCENARIO, BUILDINGS)
"""Keys of factors that choose the scenario and its city instead of changing a value."""
CITY: Final = "city"
"""Name of a factor of cities, which has the column of the results that they have anyway."""
OWN: Final = "own"
"""Name of the scenario's own city among those of a factor."""
GRID: Final = "grid:"
"""What the text begins with that stands for the scenario's own generated downtown with another seed."""
_LONGEST_NAME: Final = 64


class Factor(Model):
    """What varies from point to point, or from seed to seed: among values, over a range, or by a normal distribution
    within a range.
    """

    name: Id = Field(description="Name, the column of its values in the results.")
    key: str = Field(
        min_length=1,
        description="What it sets, a path as with --set, such as 'attacks.drift.params.speed_mps'; scenario, whose "
        "values are names or files of scenarios; or buildings, whose values are cities: a file as with --buildings, "
        "'grid:SEED' for the generated downtown of the scenario with another seed, a table as city.grid for another "
        "downtown, '' for that of the scenario.",
    )
    values: tuple[Any, ...] = Field(
        default=(),
        description="Values among which it varies; names of named, if there is that. One that is there twice is drawn "
        "twice as often.",
    )
    named: dict[str, Any] = Field(
        default_factory=dict,
        description="Values by name: the results have the names, the scenario gets what they stand for, such as tables "
        "and lists. It varies among all of them, or among those in values.",
    )
    low: Number | None = Field(default=None, description="Least value of a range.")
    high: Number | None = Field(default=None, description="Greatest value of a range.")
    steps: Whole | None = Field(
        default=None, ge=2, le=10_000, description="Values of the range in a grid, at equal distances."
    )
    log: bool = Field(default=False, description="Whether the range is divided by ratios instead of differences.")
    mean: Number | None = Field(default=None, description="Mean of a normal distribution, cut off at low and high.")
    deviation: Number | None = Field(default=None, gt=0, description="Standard deviation of that distribution.")
    whole: bool = Field(default=False, description="Whether values of the range are rounded to whole numbers.")

    @property
    def levels(self) -> tuple[Any, ...]:
        """What the results have of it: its names or its values; empty for a range."""
        return self.values or tuple(self.named)

    def value_of(self, level: Any) -> Any:
        """What the scenario gets for one of its levels."""
        return self.named[level] if self.named else level

    @model_validator(mode="before")
    @classmethod
    def _name_files(cls, data: Any) -> Any:
        """Values that are files are named by these, so that results do not depend on where the files are."""
        if not isinstance(data, dict) or data.get("key") == SCENARIO or not names_files(str(data.get("key"))):
            return data
        values, named = data.get("values"), data.get("named", {})
        if not isinstance(values, (list, tuple)) or not values or not all(isinstance(file, str) for file in values):
            return data
        if not isinstance(named, dict):
            return data
        names = [value if value in named else name_buildings(value) for value in values]
        for name, value in zip(names, values, strict=True):
            if name != value and named.get(name, value) != value:
                raise refuse(Problem("values", name, "files of different names, or named instead of values"))
            named = named if name in named else {**named, name: value}
        return {**data, "values": tuple(names), "named": named}

    @model_validator(mode="after")
    def _one_way(self) -> Factor:
        problems = []
        ranged = self.low is not None and self.high is not None
        if "named" in self.model_fields_set and not self.named and not self.values and not ranged:
            problems.append(Problem("named", "an empty table", "at least one name with its value"))
        elif bool(self.levels) == ranged or (self.low is None) != (self.high is None):
            problems.append(Problem("values", repr(list(self.levels)), "either values, named, or low and high"))
        elif self.low is not None and self.high is not None and self.low >= self.high:
            problems.append(Problem("high", repr(self.high), f"more than low, {self.low!r}"))
        if self.log and (self.low is None or self.low <= 0):
            problems.append(Problem("low", repr(self.low), "more than 0, because log is true"))
        if (self.mean is None) != (self.deviation is None) or (self.mean is not None and (self.log or not ranged)):
            problems.append(Problem("mean", repr(self.mean), "mean and deviation together, with low and high, no log"))
        problems += self._wrong_names()
        if self.key in WHOLE_KEYS:
            problems += self._wrong_choices()
        if problems:
            raise refuse(*problems)
        return self

    def _wrong_names(self) -> Iterator[Problem]:
        for value in self.values if self.named else ():
            if not isinstance(value, str) or value not in self.named:
                hint = nearest(value, self.named) if isinstance(value, str) else ""
                yield Problem("values", repr(value), f"names of named: {', '.join(self.named)}", hint)
        for name in self.named:
            if not name.strip() or not name.isprintable() or len(name) > _LONGEST_NAME:
                yield Problem("named", repr(name), f"names of 1 to {_LONGEST_NAME} printable characters")

    def _wrong_choices(self) -> Iterator[Problem]:
        """The problems of values that choose the scenario or its city."""
        chosen = self.named.items() if self.named else (("", value) for value in self.values)
        for name, value in chosen:
            where = f"named.{name}" if self.named else "values"
            if self.key == SCENARIO and not isinstance(value, str):
                yield Problem(where, repr(value), "the name or the file of a scenario")
            elif self.key == BUILDINGS and not isinstance(value, (str, dict)):
                yield Problem(where, repr(value), "a file of buildings, 'grid:SEED', a table as city.grid, or ''")
            elif isinstance(value, str) and value.startswith(GRID) and not value.removeprefix(GRID).isdecimal():
                yield Problem(where, value, "grid:SEED, where SEED is a whole number")


def name_buildings(value: str) -> str:
    """The name of a city among those of a factor, which has no folder."""
    return Path(value).name if is_city_file(value) else value or OWN


def names_files(key: str) -> bool:
    """Whether the values of a factor with this key may be names of files."""
    return key in WHOLE_KEYS or key.rpartition(".")[2] in FILE_KEYS


def is_city_file(value: str) -> bool:
    """Whether a text among cities is the name of a file."""
    return bool(value) and not value.startswith(GRID)
