"""Which tests of a catalogue does a run of the fast tier take?"""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from skyrange.attack.mavlink.mode import HeldMode
from tests import catalogue
from tests.catalogue import IN_TURN, MOST_CHANGED, SHARES, Choice, draw, files_of, in_turn

CATALOGUE = {f"tests/test_kinds.py::test_kind[{number}]": [f"src/kind_{number}.py"] for number in range(3000)}
FEW, MANY = (frozenset(f"src/kind_{number}.py" for number in range(count)) for count in (5, 10 * MOST_CHANGED))


def test_the_share_is_taken_and_another_one_after_another_commit() -> None:
    taken = [Choice(commit, frozenset()).take(CATALOGUE).tests for commit in ("0a", "0a", "0b")]
    assert taken[0] == taken[1]
    assert all(
        len(CATALOGUE) / SHARES["catalogue"] * 0.7 < len(one) < len(CATALOGUE) / SHARES["catalogue"] * 1.3
        for one in taken
    )
    assert len(taken[0] & taken[2]) < len(taken[0]) / 3


def test_as_many_commits_as_the_share_see_most_kinds() -> None:
    share = SHARES["catalogue"]
    seen = frozenset().union(*(Choice(str(commit), frozenset()).take(CATALOGUE).tests for commit in range(share)))
    assert len(seen) > 0.55 * len(CATALOGUE)  # 1 - (1 - 1/n)**n is 0.63 to 0.65


def test_the_rotating_tests_of_a_file_run_together_in_the_share_of_commits() -> None:
    files = [f"tests/test_{number}.py" for number in range(1000)]
    tests = {f"{file}::test_{number}": [file] for file in files for number in range(3)}
    turns = [Choice(str(commit), frozenset()).take(tests, "rotating").tests for commit in range(30)]
    usual = len(tests) / SHARES["rotating"]
    assert all(usual * 0.7 < len(one) < usual * 1.3 for one in turns)
    assert all(
        len({test in one for test in tests if test.startswith(file)}) == 1 for one in turns for file in files[:9]
    )
    assert len(frozenset().union(*turns)) > 0.98 * len(tests)  # 1 - (5/6)**30 is 0.996


def test_a_rotating_test_is_about_its_own_file(request: pytest.FixtureRequest) -> None:
    assert files_of(request.node, "rotating") == {"tests/unit/test_catalogue_choice.py"}


def test_kinds_that_changed_are_taken_too_unless_there_are_many() -> None:
    none, few, many = (Choice("0a", changed).take(CATALOGUE) for changed in (frozenset[str](), FEW, MANY))
    changed = {test for test, files in CATALOGUE.items() if not FEW.isdisjoint(files)}
    assert few.tests == none.tests | changed
    assert few.left == 0
    assert many.tests == none.tests
    assert MOST_CHANGED < many.left <= 10 * MOST_CHANGED


def test_what_changed_since_the_commit_before_head_counts_committed_or_not(tmp_path: Path) -> None:
    def git(*words: str) -> str:
        command = ["git", "-c", "user.name=n", "-c", "user.email=e", *words]
        return subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True).stdout.strip()

    assert Choice.of_checkout(tmp_path) == Choice("", frozenset())
    git("init", "-q")
    for name in ("old.py", "committed.py", "edited.py", "new.py"):
        (tmp_path / name).write_text("1")
        if name != "new.py":
            git("add", ".")
            git("commit", "-q", "-m", name)
        if name == "old.py":
            assert Choice.of_checkout(tmp_path) == Choice(git("rev-parse", "HEAD"), frozenset())
    (tmp_path / "committed.py").write_text("2")
    assert Choice.of_checkout(tmp_path) == Choice(
        git("rev-parse", "HEAD^"), frozenset({"committed.py", "edited.py", "new.py"})
    )


@pytest.mark.parametrize("kind", [HeldMode.plugin, "mavlink.mode"])
def test_a_kind_is_found_by_its_plugin_and_by_its_name(kind: object, request: pytest.FixtureRequest) -> None:
    files = {f"src/skyrange/attack/{name}.py" for name in ("mavlink/mode", "bases/mavlink/injection")}
    assert files <= files_of(request.node)


def test_without_a_kind_nothing_is_found(request: pytest.FixtureRequest) -> None:
    assert files_of(request.node) == set()


def test_dear_tests_take_turns_and_each_has_its_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SAMPLES", raising=False)
    for group, (count, members) in IN_TURN.items():
        seen: set[str] = set()
        for commit in range(40):
            monkeypatch.setattr(catalogue, "_this_checkout", lambda commit=commit: Choice(str(commit), frozenset()))
            drawn = draw(members, count)
            assert len(drawn) == count
            assert [in_turn(group, one).args[0] for one in members] == [one not in drawn for one in members]
            seen |= set(drawn)
        assert seen == set(members)
    monkeypatch.setenv("SAMPLES", "all")
    assert not any(in_turn(group, one).args[0] for group, (_, members) in IN_TURN.items() for one in members)


def test_every_member_of_a_group_is_a_test() -> None:
    text = "".join(path.read_text() for path in Path(catalogue.__file__).parent.rglob("test_*.py"))
    for group, (_, members) in IN_TURN.items():
        assert [one for one in members if f'in_turn("{group}", "{one}")' not in text] == []
