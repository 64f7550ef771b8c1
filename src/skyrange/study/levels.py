"""Levels of the record that a study of runs needs."""

from __future__ import annotations

from skyrange.core.errors import InputError
from skyrange.record.schema import LEVELS, keeps
from skyrange.scenario.model.scenario import Scenario


def require_level(scenario: Scenario, table: str, who: str) -> None:
    """Raise `InputError` for `who` if runs of a scenario would not keep a table that it reads."""
    level = scenario.record.level
    if not keeps({"record": {"level": level}}, table):
        enough = [one for one in LEVELS if keeps({"record": {"level": one}}, table)]
        hint = f"It reads the {table} of each run. Add --set record.level={enough[-1]}."
        raise InputError.one(who, "record.level", level, " or ".join(reversed(enough)), hint)
