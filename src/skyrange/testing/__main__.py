"""Rules of all conformance checks: `python -m skyrange.testing` prints the page docs/reference/conformance.md."""

from __future__ import annotations

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
from skyrange.testing.rules import RuleBook

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

What `skyrange.testing` checks, in this order. `NonConformance` names the broken rule, who broke it, what was seen and
what was expected. [Write a plugin](../how-to/write-a-plugin.md) says how to run the checks.
`python -m skyrange.testing` prints this page.
"""


def page() -> str:
    """The reference page, in Markdown."""
    parts = [_HEAD]
    for title, book in BOOKS.items():
        rows = "".join(f"| `{rule.id}` | {rule.statement} |\n" for rule in book.rules)
        parts.append(f"## {title}\n\n| rule | a conforming component |\n|---|---|\n{rows}")
    return "\n".join(parts)


if __name__ == "__main__":
    print(page(), end="")
