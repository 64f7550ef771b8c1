"""Choice of the tests that take turns in the fast tier: a 20th of the catalogue tests, a sixth of the rotating files.

A catalogue test checks one kind of attack, defence, detector or fault by flights, and all of them together take half an
hour. Rotating tests are dear ones of other subjects; those of a file run together, because they share flights. Both are
chosen by the commit before HEAD, so that one commit is tested alike everywhere, and some commits in a row see most of
them. Tests that, or whose kinds, have changed since then, committed or not, are taken too, unless there are many.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any, TypeVar

import pytest

from skyrange.contracts.plugins import registry as plugins
from skyrange.contracts.plugins.form import MakeKind
from skyrange.contracts.plugins.registry import Plugin

ROOT = Path(__file__).parents[1]
SHARES: Mapping[str, int] = {"catalogue": 20, "rotating": 6}
"""By mark, one of so many is chosen: of catalogue tests a test, of rotating tests a file."""
MOST_CHANGED = 10
"""So many tests of changed kinds are taken besides; of more, none."""


@dataclass(frozen=True)
class Choice:
    """What chooses: the commit, and the files that have changed since then, from the checkout's root."""

    commit: str
    changed: frozenset[str]

    @classmethod
    def of_checkout(cls, root: Path = ROOT) -> Choice:
        """The commit before HEAD, or HEAD without history, or none without git; and what has changed since."""
        for name in ("HEAD^", "HEAD"):
            if commit := _git(root, "rev-parse", "--verify", "--quiet", f"{name}^{{commit}}"):
                changed = _git(root, "diff", "--name-only", commit[0])
                changed += _git(root, "ls-files", "--others", "--exclude-standard")
                return cls(commit[0], frozenset(changed))
        return cls("", frozenset())

    def take(self, tests: Mapping[str, Iterable[str]], mark: str = "catalogue") -> Taken:
        """Choose among the tests of a mark, by id, each with the files that hold what it is about."""
        changed = {test for test, files in tests.items() if not self.changed.isdisjoint(files)}
        drawn = {test for test in tests if self.number_of(_case(test, mark)) % SHARES[mark] == 0}
        few = len(changed - drawn) <= MOST_CHANGED
        return Taken(frozenset(drawn | changed if few else drawn), 0 if few else len(changed - drawn))

    def number_of(self, test: str) -> int:
        """A number that this commit gives a test or a case, as good as random."""
        return int.from_bytes(blake2b(f"{self.commit} {test}".encode(), digest_size=8).digest(), "big")


def _case(test: str, mark: str) -> str:
    return test.partition("::")[0] if mark == "rotating" else test


T = TypeVar("T")
_this_checkout = cache(Choice.of_checkout)


def draw(cases: Iterable[T], count: int = 1) -> list[T]:
    """`count` of the cases of a dear slow test, by the commit before HEAD; all with SAMPLES=all in the environment."""
    every = list(cases)
    if os.environ.get("SAMPLES") == "all":
        return every
    choice = _this_checkout()
    chosen = sorted(range(len(every)), key=lambda number: choice.number_of(f"{number} {every[number]}"))[:count]
    return [every[number] for number in sorted(chosen)]


IN_TURN: Mapping[str, tuple[int, tuple[str, ...]]] = {
    "parity": (2, ("attacks", "gnss", "hover", "walls", "cheaper rates", "no wind", "engine", "paths of rid-city")),
    "live ranges": (2, ("our station", "mavproxy", "as in virtual time")),
    "far ranges": (1, ("machines", "networks")),
    "live faults": (2, ("station anew", "cut link", "full disk", "idle connections")),
}
"""By group of dear slow tests, how many of its members one commit runs."""


def in_turn(group: str, member: str) -> pytest.MarkDecorator:
    """The mark of a test that is a member of a group of `IN_TURN`: it is skipped by commits that do not draw it."""
    count, members = IN_TURN[group]
    assert member in members
    reason = f"of the dear tests {group!r} this commit runs {count} others; SAMPLES=all runs every one"
    return pytest.mark.skipif(member not in draw(members, count), reason=reason)


@dataclass(frozen=True)
class Taken:
    """The tests that run, and the number of tests of changed kinds that do not, because there are too many."""

    tests: frozenset[str]
    left: int


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--kinds",
        choices=["all", "some"],
        default="all",
        help="tests marked `catalogue` or `rotating`: all (default), or a 20th and a sixth, and those that changed",
    )


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--kinds") == "some":
        config.pluginmanager.register(Sample())


class Sample:
    """A plugin of pytest that deselects the tests that are not taken, and says which those are."""

    def __init__(self) -> None:
        self._choice = Choice.of_checkout()
        self._left = dict.fromkeys(SHARES, 0)

    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        for mark in SHARES:
            marked = {item.nodeid: files_of(item, mark) for item in items if mark_of(item) == mark}
            taken = self._choice.take(marked, mark)
            config.hook.pytest_deselected(items=[one for one in items if one.nodeid in marked.keys() - taken.tests])
            items[:] = [one for one in items if one.nodeid not in marked or one.nodeid in taken.tests]
            self._left[mark] = taken.left

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if isinstance(output := getattr(session.config, "workeroutput", None), dict):
            output["left_by_mark"] = self._left

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """A worker of xdist has ended; all have chosen alike."""
        self._left = node.workeroutput["left_by_mark"] if hasattr(node, "workeroutput") else self._left

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        commit = self._choice.commit[:12] or "none"
        for mark, share in SHARES.items():
            terminalreporter.write_line(
                f"{mark} tests: one of {share} ran, chosen by commit {commit}; KINDS=all runs all"
            )
            if left := self._left[mark]:
                terminalreporter.write_line(
                    f"{mark} tests: {left} that have changed did not run, being more than {MOST_CHANGED}"
                )


def mark_of(item: pytest.Item) -> str:
    """The mark of `SHARES` that chooses a test, or none: a catalogue test in a rotating file is the former."""
    return next((mark for mark in SHARES if item.get_closest_marker(mark)), "")


def files_of(item: pytest.Item, mark: str = "catalogue") -> set[str]:
    """The files that a test of a mark is about, from the checkout's root.

    A rotating test is about its own file; a catalogue test about the files and the kinds that are its parameters.
    """
    if mark == "rotating":
        return {item.nodeid.partition("::")[0]}
    found: set[str] = set()
    callspec = getattr(item, "callspec", None)
    for value in callspec.params.values() if callspec else ():
        if isinstance(value, Path) and value.is_relative_to(ROOT):
            found.add(str(value.relative_to(ROOT)))
        for plugin in _plugins_of(value):
            modules = [part.__module__ for part in (plugin.params, plugin.make)]
            if isinstance(plugin.make, MakeKind):
                modules += [base.__module__ for base in plugin.make.kind.__mro__ if base is not object]
            for module in modules:
                found |= {f"src/{name.replace('.', '/')}.py" for name in _family(module)}
    return found


def _family(module: str) -> set[str]:
    """A module, and those of its own package from which it imports."""
    names = {str(getattr(value, "__module__", "")) for value in vars(sys.modules[module]).values()}
    return {module} | {name for name in names if name.rpartition(".")[0] == module.rpartition(".")[0]}


def _plugins_of(value: Any) -> list[Plugin[Any, Any]]:
    """The plugins that a parameter is, or that are registered under its name."""
    if isinstance(value, Plugin):
        return [value]
    if not isinstance(value, str):
        return []
    return [plugins.find(group, value) for group in plugins.GROUPS if value in plugins.kinds(group)]


def _git(root: Path, *words: str) -> list[str]:
    try:
        done = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=False)
    except OSError:
        return []
    return done.stdout.split("\n")[:-1] if done.returncode == 0 else []
