"""Page of the results of `uss_qualifier`, the conformance suite of InterUSS, from the report of a run.

    python -m tools.docs.uss_qualifier_results REPORT.json MONITORING

`MONITORING` is the checkout of interuss/monitoring with which the run was made; its sets of requirements are the rows.
"""

from __future__ import annotations

import json
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "utm-conformance.md"
PARTICIPANTS = {"USS": "uss1_core", "DSS": "uss1_dss"}
SETS = {"USS": "scd.md", "DSS": "dss_provider.md"}
ACCEPTED = "DSS instance is publicly addressable"
"""The check that a service on loopback fails, and that the configuration of InterUSS accepts as failed too."""
PREFIX = "astm.f3548.v21."


def find_checks(part: Any) -> Iterator[tuple[bool, dict[str, Any]]]:
    """All checks below a part of the report, and whether they passed."""
    if isinstance(part, dict):
        for kind, passed in (("passed_checks", True), ("failed_checks", False)):
            found = part.get(kind)
            if isinstance(found, list):
                yield from ((passed, one) for one in found if isinstance(one, dict))
        for value in part.values():
            yield from find_checks(value)
    elif isinstance(part, list):
        for value in part:
            yield from find_checks(value)


def count_scenarios(part: Any) -> dict[str, list[int]]:
    """Passed and failed checks by scenario."""
    counts: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0])
    if isinstance(part, dict) and "scenario_type" in part and "cases" in part:
        name = part["scenario_type"].rsplit(".", 1)[-1]
        counts[name][0] += 1
        for passed, _ in find_checks(part):
            counts[name][1 if passed else 2] += 1
        return counts
    for value in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        for name, more in count_scenarios(value).items():
            counts[name] = [one + other for one, other in zip(counts[name], more, strict=True)]
    return counts


def requirements(path: Path) -> tuple[list[str], list[str]]:
    """Requirements of a set that are verified automatically, and those that are verified by hand."""
    by_hand, heading, automatic = path.read_text(encoding="utf-8").partition("## Automated verification")
    if not heading:
        by_hand, automatic = "", by_hand
    names = rf"\*\*{re.escape(PREFIX)}([\w.,\-]+)\*\*"
    return re.findall(names, automatic), re.findall(names, by_hand)


def make_page(report: dict[str, Any], monitoring: Path) -> str:
    """The text of the page."""
    results: dict[tuple[str, str], list[int]] = defaultdict(lambda: [0, 0])
    for passed, check in find_checks(report["report"]):
        for participant in set(check["participants"]):
            for requirement in check["requirements"]:
                if passed or check["name"] != ACCEPTED:
                    results[participant, requirement][0 if passed else 1] += 1
    commit = report["commit_hash"][:12].removesuffix("-dirty")
    lines = [
        "# Conformance of the UTM services to F3548-21",
        "",
        "`uss_qualifier` of InterUSS (suite `suites.astm.utm.f3548_21` of",
        f"interuss/monitoring at commit {commit}) tested a USS and the DSS of skyrange, with `mock_uss` as the other",
        "USS. There is one DSS, so checks that compare several instances do not apply.",
        "[Run the conformance suite](../how-to/run-the-conformance-suite.md) repeats the test, and",
        "`make reproduce WHAT=utm-conformance` names the command that writes this page.",
        "",
        "A requirement is *passed* if at least one check tested it and none failed, with the number of checks in",
        "parentheses. It is *not tested* if no check of the suite tests it with this configuration.",
        "",
    ]
    for role, participant in PARTICIPANTS.items():
        folder = monitoring / "monitoring/uss_qualifier/requirements/astm/f3548/v21"
        automatic, by_hand = requirements(folder / SETS[role])
        found: dict[str, list[str]] = {"passed": [], "failed": [], "not tested": []}
        for name in automatic:
            good, bad = results.get((participant, PREFIX + name), (0, 0))
            if bad:
                found["failed"].append(f"{name} ({bad} of {good + bad})")
            elif good:
                found["passed"].append(f"{name} ({good})")
            else:
                found["not tested"].append(name)
        if by_hand:
            found["not verified: to be verified by hand"] = by_hand
        lines += [f"## {role}", "", "| result | number | requirements |", "|---|---|---|"]
        lines += [f"| {result} | {len(names)} | {'; '.join(names)} |" for result, names in found.items()]
        lines += [""]
    lines += ["## Scenarios", "", "Checks of all participants, `mock_uss` included.", ""]
    lines += ["| scenario | times | checks passed | checks failed |", "|---|---|---|---|"]
    counts = count_scenarios(report["report"])
    lines += [f"| {name} | {times} | {passed} | {failed} |" for name, (times, passed, failed) in counts.items()]
    lines += [
        "",
        f"The failed check is *{ACCEPTED}*: the DSS was on loopback. The configuration of InterUSS accepts it.",
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    report_path, checkout = map(Path, sys.argv[1:3])
    PAGE.write_text(make_page(json.loads(report_path.read_text(encoding="utf-8")), checkout), encoding="utf-8")
    print(PAGE)
