"""Starts and stops by hand in a scenario: the model of `[[manual_acts]]`, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final, Literal

from pydantic import Field

from skyrange.contracts.links import ManualAct
from skyrange.core.errors import Problem, nearest
from skyrange.core.time import from_seconds, to_seconds
from skyrange.scenario.model.attacks import ActTable
from skyrange.scenario.model.base import Model, Number
from skyrange.scenario.model.defences import DefenceTable

MAX_BY: Final = 64
"""Characters of who did it."""
BY_PATTERN: Final = r"^[^\x00-\x1f\x7f-\x9f\u2028\u2029]+$"
"""One line of text."""
Table = ActTable | DefenceTable


class ManualActTable(Model):
    """One start or stop by hand, as in a run in which it was done. The parts of the act do not know it before."""

    at_s: Number = Field(
        ge=0,
        le=31_536_000,
        description="Simulated time in seconds; it happens at the first tick of the world then or later.",
    )
    act: str = Field(min_length=1, description="Id of the attack, fault or defence.")
    action: Literal["start", "stop"] = Field(
        description="start, of an act with manual = true; or stop, of any that acts."
    )
    by: str = Field(
        default="scenario",
        min_length=1,
        max_length=MAX_BY,
        pattern=BY_PATTERN,
        description="Who did it: text for the record.",
    )

    @classmethod
    def of_act(cls, act: ManualAct) -> ManualActTable:
        """The table of an act by hand of a run."""
        return cls(at_s=to_seconds(act.at_ns), act=act.act, action=act.action, by=act.by)

    @property
    def manual_act(self) -> ManualAct:
        """As a kernel has it."""
        return ManualAct(from_seconds(self.at_s), self.act, self.action, self.by)


def find_manual_problems(acts: Sequence[ManualActTable], tables: Mapping[str, Table]) -> Iterator[Problem]:
    """Acts by hand that are of no declared act, come twice, or come when the act cannot be started or stopped.

    `tables` are the attacks, faults and defences by id.
    """
    seen: dict[tuple[str, str], int] = {}
    for place, act in sorted(enumerate(acts), key=lambda pair: pair[1].at_s):
        where, table = f"manual_acts.{place}", tables.get(act.act)
        if table is None:
            yield Problem(f"{where}.act", act.act, "an attack, a fault or a defence", nearest(act.act, tables))
            continue
        first = seen.setdefault((act.act, act.action), place)
        if first != place:
            hint = f"manual_acts.{first} does so too. Declare {act.act} twice, under two names."
            yield Problem(f"{where}.act", act.act, f"an act that nothing else {act.action}s", hint)
        elif act.action == "start" and not table.manual:
            hint = f"Set manual = true for {act.act}, or use its start_s."
            yield Problem(f"{where}.act", act.act, "an act with manual = true", hint)
        elif act.action == "start" and act.at_s < table.start_s:
            yield Problem(f"{where}.at_s", f"{act.at_s:g}", f"{table.start_s:g} or more, start_s of {act.act}")
        elif act.action == "start" and table.stop_s is not None and act.at_s >= table.stop_s:
            yield Problem(f"{where}.at_s", f"{act.at_s:g}", f"less than {table.stop_s:g}, stop_s of {act.act}")
        elif act.action == "stop":
            yield from _find_early_stop(where, act, table, acts)


def _find_early_stop(
    where: str, act: ManualActTable, table: Table, acts: Sequence[ManualActTable]
) -> Iterator[Problem]:
    """A stop before the act has started."""
    starts = [other.at_s for other in acts if (other.act, other.action) == (act.act, "start")]
    if table.manual and not starts:
        yield Problem(f"{where}.act", act.act, "an act that is started by hand before", "Add its start.")
    earliest_s = min(starts) if table.manual and starts else table.start_s
    if act.at_s <= earliest_s:
        yield Problem(f"{where}.at_s", f"{act.at_s:g}", f"more than {earliest_s:g}, when {act.act} starts")
