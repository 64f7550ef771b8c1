"""Rules of all conformance checks: `python -m skyrange.testing` prints the page docs/reference/conformance.md."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

from skyrange.testing.checks.agents import AGENT
from skyrange.testing.checks.approval_policies import APPROVAL
from skyrange.testing.checks.approval_services import SERVICE
from skyrange.testing.checks.attacks import ATTACK, FAULT
from skyrange.testing.checks.avoidance import AVOIDANCE
from skyrange.testing.checks.defences import DEFENCE
from skyrange.testing.checks.engines import ENGINE
from skyrange.testing.checks.media import MEDIUM
from skyrange.testing.checks.monitors import MONITOR
from skyrange.testing.checks.taps import TAP
from skyrange.testing.rules import Rule, RuleBook

BOOKS: dict[str, RuleBook[Any]] = {
    "Agents: `check_agent`": AGENT,
    "Taps: `check_tap`": TAP,
    "Autopilot engines: `check_engine`": ENGINE,
    "Approval policies: `check_approval`": APPROVAL,
    "Approval services: `check_approval`": SERVICE,
    "Attacks: `check_attack`": ATTACK,
    "Faults: `check_fault`": FAULT,
    "Defences: `check_defence`": DEFENCE,
    "Radio media: `check_medium`": MEDIUM,
    "Avoidance: `check_avoidance`": AVOIDANCE,
    "Monitors: `check_monitor`": MONITOR,
}
_HEAD = """\
# Conformance rules

What `skyrange.testing` checks. `NonConformance` names the broken rule, who broke it, what was seen and
what was expected. [Write a plugin](../how-to/write-a-plugin.md) says how to run the checks.
`python -m skyrange.testing` prints this page.
"""


_LEAST = 3
"""Rules that so many components have alike stand in one table before the others."""


def page() -> str:
    """The reference page, in Markdown."""
    counts = Counter((_name(rule), rule.statement) for book in BOOKS.values() for rule in book.rules)
    shared = {named: count for named, count in counts.items() if count >= _LEAST}
    parts = [_HEAD, f"## Rules of several components\n\n{_table((f'….{name}', text) for name, text in shared)}"]
    for title, book in BOOKS.items():
        own = [rule for rule in book.rules if (_name(rule), rule.statement) not in shared]
        others = [f"`{rule.id}`" for rule in book.rules if (_name(rule), rule.statement) in shared]
        more = f"\n[Rules of several components](#rules-of-several-components): {', '.join(others)}\n" if others else ""
        parts.append(f"## {title}\n\n{_table((rule.id, rule.statement) for rule in own)}{more}")
    return "\n".join(parts)


def _name(rule: Rule[Any]) -> str:
    """What follows the component in the id of a rule."""
    return rule.id.partition(".")[2]


def _table(rows: Iterable[tuple[str, str]]) -> str:
    lines = "".join(f"| `{rule}` | {statement} |\n" for rule, statement in rows)
    return f"| rule | a conforming component |\n|---|---|\n{lines}"


if __name__ == "__main__":
    print(page(), end="")
