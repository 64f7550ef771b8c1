"""Results of a comparison of reactions to attacks: a table in Markdown, and JSON."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any, Final

import numpy as np

from skyrange.parity.attacks.flights import (
    AttackAgreement,
    ComparedAttack,
    SeededAttack,
    agreement,
    compared_kinds,
    count,
)
from skyrange.parity.attacks.reactions import NO_EFFECT, Reaction
from skyrange.report.marked_page import MarkedPart

TABLE: Final = MarkedPart("<!-- skyrange parity attacks: begin -->", "<!-- skyrange parity attacks: end -->")
SEEDS_TABLE: Final = MarkedPart(
    "<!-- skyrange parity attacks --seeds: begin -->", "<!-- skyrange parity attacks --seeds: end -->"
)
_ROW: Final = re.compile(r"^\| `([^`]+)` \|.*\|$", re.MULTILINE)
YES: Final = "yes"
_DOES_NOT_APPLY: Final = "does not apply: "
_UNDECIDED: Final = "undecided: "
_SHOWN: Final = 3
"""Signs that a cell has; JSON has all."""


def lines(compared: Sequence[ComparedAttack]) -> Iterator[str]:
    """The lines of the table and of its summary, in Markdown."""
    return _table([row(attack) for attack in compared], summary(compared))


def _table(rows: Sequence[str], agreement_text: str) -> Iterator[str]:
    yield "| attack | builtin | ArduCopter | what shows it, builtin | what shows it, ArduCopter | agree |"
    yield "|---|---|---|---|---|---|"
    yield from rows
    yield ""
    yield agreement_text
    yield ""


def row(attack: ComparedAttack) -> str:
    """The line of one kind, in Markdown."""
    cells = [words(attack.first), words(attack.second), signs(attack.first), signs(attack.second), verdict(attack)]
    return f"| `{attack.kind}` | {' | '.join(cells)} |"


def summary(compared: Sequence[ComparedAttack]) -> str:
    """The agreement in words."""
    return describe(agreement(compared))


def describe(attack_agreement: AttackAgreement) -> str:
    """An agreement in words."""
    return (
        f"Of {attack_agreement.effective} attacks that change a flight of either, the reaction is the same in "
        f"{attack_agreement.effective_same}, at the same time and distance in {attack_agreement.effective_alike}. "
        f"Of all {attack_agreement.kinds} attacks these are {attack_agreement.same} and {attack_agreement.alike}."
    )


def words(reaction: Reaction) -> str:
    """The reaction, when, and how far the aircraft departed from its twin."""
    if reaction.at_s is None:
        return reaction.reaction
    return f"{reaction.reaction}, {reaction.at_s:.1f} s, {reaction.departed_m:.0f} m"


def signs(reaction: Reaction) -> str:
    """The first signs of a reaction, and its mission's outcome if that differs."""
    timed = [f"{text} {at_s:.1f} s" for at_s, text in reaction.signs if isfinite(at_s)]
    more = ["…"] if len(timed) > _SHOWN else []
    return "; ".join([*timed[:_SHOWN], *more, *(text for at_s, text in reaction.signs if not isfinite(at_s))])


_SEEDS_HEAD: Final = (
    "| attack | autopilot | reactions | first sign after the start | farthest from its twin |",
    "|---|---|---|---|---|",
)


def seeds_rows(attack: SeededAttack) -> list[str]:
    """The two lines of one kind over seeds, in Markdown."""
    sides = (("builtin", attack.first), ("ArduCopter", attack.second))
    return [f"| `{attack.kind}` | {name} | {' | '.join(seeds_words(reactions))} |" for name, reactions in sides]


def seeds_words(reactions: Sequence[Reaction]) -> tuple[str, str, str]:
    """How many seeds have each reaction, and the median, minimum and maximum of times and distances."""
    counts = Counter(reaction.reaction for reaction in reactions).most_common()
    times_s = [reaction.at_s for reaction in reactions if reaction.at_s is not None]
    return (
        ", ".join(f"{reaction} {number}" for reaction, number in counts),
        _spread(times_s, ".1f", "s"),
        _spread([reaction.departed_m for reaction in reactions], ".0f", "m"),
    )


def _spread(values: Sequence[float], digits: str, unit: str) -> str:
    if not values:
        return "none"
    low, middle, high = (format(float(value), digits) for value in (min(values), np.median(values), max(values)))
    return f"{middle} {unit}" if low == high else f"{middle} {unit} ({low} to {high})"


def verdict(attack: ComparedAttack) -> str:
    """Whether two reactions agree, or why they cannot be compared."""
    if attack.does_not_apply:
        return f"{_DOES_NOT_APPLY}{attack.does_not_apply}"
    if attack.undecided:
        return f"{_UNDECIDED}{attack.undecided}"
    if attack.alike:
        return YES
    return "in the reaction" if attack.same else "no"


def results(compared: Sequence[ComparedAttack]) -> dict[str, Any]:
    """All reactions as plain data."""
    rows = [
        {
            "kind": attack.kind, "same": attack.same, "alike": attack.alike,
            "does_not_apply": attack.does_not_apply or None,
            "undecided": attack.undecided or None,
            "builtin": _reaction(attack.first), "ardupilot": _reaction(attack.second),
        }
        for attack in compared
    ]  # fmt: skip
    return {**asdict(agreement(compared)), "attacks": rows}


def seeds_results(compared: Sequence[SeededAttack]) -> dict[str, Any]:
    """All reactions over seeds as plain data; the first is that of seed 1."""
    rows = [
        {"kind": attack.kind, "builtin": [*map(_reaction, attack.first)], "ardupilot": [*map(_reaction, attack.second)]}
        for attack in compared
    ]
    return {"attacks": rows}


def _reaction(reaction: Reaction) -> dict[str, Any]:
    shown = [{"at_s": at_s if isfinite(at_s) else None, "what": text} for at_s, text in reaction.signs]
    return {**asdict(reaction), "signs": shown}


def check_page(page: Path, *, seeds: bool = False) -> None:
    """Raise `InputError` for a page without the marks of the table (over seeds), or one that cannot be read."""
    _table_of(seeds=seeds).read(page)


def renew_page(compared: Sequence[ComparedAttack], page: Path) -> None:
    """Renew the table `TABLE` of a page: the rows of other kinds with an example stay."""
    rows = _merged(page, ((attack.kind, [row(attack)]) for attack in compared), seeds=False)
    lines = [line for (line,) in rows.values()]
    TABLE.write(page, _table(lines, describe(_agreement_of(lines))))


def read_agreement(page: Path) -> AttackAgreement:
    """The agreement of the attacks in a page's table. Raises `InputError` as `check_page` does."""
    return _agreement_of([match[0] for match in _ROW.finditer(TABLE.read(page))])


def _agreement_of(lines: Sequence[str]) -> AttackAgreement:
    return count([parsed for line in lines if (parsed := _parse_agreement(line)) is not None])


def renew_seeds(compared: Sequence[SeededAttack], page: Path) -> None:
    """Renew the table `SEEDS_TABLE` of a page: the rows of other kinds with an example stay."""
    rows = _merged(page, ((attack.kind, seeds_rows(attack)) for attack in compared), seeds=True)
    SEEDS_TABLE.write(page, [*_SEEDS_HEAD, *(line for lines in rows.values() for line in lines), ""])


def _merged(page: Path, new: Iterable[tuple[str, list[str]]], *, seeds: bool) -> dict[str, list[str]]:
    """The rows of each kind of a page's table and `new`, which replace those of the page, in the order of the kinds."""
    rows_by_kind: dict[str, list[str]] = {}
    for match in _ROW.finditer(_table_of(seeds=seeds).read(page)):
        rows_by_kind.setdefault(match[1], []).append(match[0])
    rows_by_kind |= dict(new)
    return {
        kind: rows_by_kind[kind] for kind in dict.fromkeys([*compared_kinds(), *rows_by_kind]) if kind in rows_by_kind
    }


def _table_of(*, seeds: bool) -> MarkedPart:
    return SEEDS_TABLE if seeds else TABLE


def _parse_agreement(line: str) -> tuple[bool, bool, bool] | None:
    """Whether the attack of a row is effective, its reactions the same, and alike; `None` if it is not counted."""
    cells = [cell.strip() for cell in line.strip("|").split(" | ")]
    first, second = (cell.partition(",")[0] for cell in cells[1:3])
    if cells[-1].startswith((_DOES_NOT_APPLY, _UNDECIDED)):
        return None
    return not {first, second} <= NO_EFFECT, first == second, cells[-1] == YES
