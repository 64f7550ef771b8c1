"""axe-core in pages of tests: what breaks the rules of WCAG 2.2 A and AA, as far as a program can tell."""

from __future__ import annotations

from typing import Final

from tests.browser.chromium import Opened
from tools.node_packages import FOLDER, are_packages_installed

SOURCE: Final = FOLDER / "node_modules" / "axe-core" / "axe.min.js"
RULES: Final = ("wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa")


def missing_axe() -> str:
    """Why axe-core cannot run here; "" if it can."""
    return "" if are_packages_installed() else "axe-core is not installed (make check)"


def find_violations(opened: Opened) -> list[str]:
    """A line for each element that breaks a rule."""
    opened.page.evaluate(SOURCE.read_text(encoding="utf-8"))
    found: list[str] = opened.page.evaluate(
        """async (rules) => {
          const { violations } = await axe.run(document, { runOnly: { type: "tag", values: rules } });
          return violations.flatMap(({ id, nodes }) =>
            nodes.map((node) => `${id}: ${node.target.join(" ")}: ${node.failureSummary.replace(/\\s+/g, " ")}`));
        }""",
        list(RULES),
    )
    return found
