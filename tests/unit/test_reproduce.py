"""Is each figure and each measured table of the documentation made by a command that its page names?"""

from __future__ import annotations

import importlib.util
import re
import shlex
from collections import Counter

import pytest

from tools.docs import generate
from tools.docs.reproduce import (
    DOCS,
    DRAWN_BY_HAND,
    KIND,
    Result,
    find_commands,
    find_part,
    list_images,
    list_results,
)

MEASURED = re.compile(
    r"^<!-- (?:measured: \S+|faults|(?:python -m|skyrange) [^:]+: begin"
    r"|generated: (?:parity-(?!summary)|benchmark-results|gazebo-benchmark)\S*) -->$",
    re.MULTILINE,
)
"""What stands before a table of measured results."""

each_result = pytest.mark.parametrize("result", list_results(), ids=lambda result: result.name)


def test_each_figure_is_made_by_one_result() -> None:
    files = [path.relative_to(DOCS).as_posix() for path in list_images()]
    made = Counter(
        file for file in files for result in list_results() if file in result.files or find_part(result, file)
    )
    assert made == Counter(file for file in files if file not in DRAWN_BY_HAND)
    named = {file for result in list_results() for file in result.files if KIND not in file}
    assert named <= set(files)


def test_each_page_with_measured_tables_is_the_page_of_a_result() -> None:
    measured = {page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md") if MEASURED.search(page.read_text())}
    assert "reference/attack-effects.md" in measured
    shared = {"reference/fault-effects.md", "reference/published-attacks.md"}  # by the commands of attack-effects
    assert measured - shared <= {result.page for result in list_results()}


@each_result
def test_the_page_names_the_command(result: Result) -> None:
    text = (DOCS / result.page).read_text(encoding="utf-8")
    assert f"make reproduce WHAT={result.name}`" in text or f"make reproduce WHAT={result.name}\n" in text


@each_result
def test_the_commands_exist(result: Result) -> None:
    for command in result.commands:
        program, *arguments = shlex.split(command)
        if program == "python":
            assert arguments[0] == "-m"
            assert importlib.util.find_spec(arguments[1]) is not None
        else:
            assert program == "skyrange"
            assert {arguments[0], " ".join(arguments[:2])} & generate.commands().keys()


def test_a_figure_is_found_by_its_file() -> None:
    assert find_commands("chain") == find_commands("chain-path.svg") == ("python -m tools.docs.pictures chain",)
    assert find_commands("docs/images/chain.svg") == find_commands("chain")
    assert find_commands("gnss.jump.svg") == ("python -m tools.docs.measure_attacks gnss.jump",)
    assert find_commands("defences/remote_id.replay.svg") == ("python -m tools.docs.measure_defences remote_id.replay",)


@pytest.mark.parametrize(
    ("what", "reason"),
    [("remote_id.replay.svg", "several figures"), ("live.svg", "by hand"), ("nothing", "not in the list")],
)
def test_what_is_not_found_says_why(what: str, reason: str) -> None:
    with pytest.raises(LookupError, match=reason):
        find_commands(what)
