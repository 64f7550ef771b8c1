"""Runs of tests against a planted fault, in a copy of the project."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock

from tools.contexts import TracedTest
from tools.faults import Fault

BUDGET_S = 60.0
"""Seconds of processor time that the tests of a fault may take, without compilation and the start of pytest."""

BATCHES = (15, 75, 400)
"""How many tests run in the first processes; later ones run as many as the last."""

SLACK_S = 20.0
"""A test hangs if it takes as many seconds of processor time more than ten times what it took without a fault."""

WALL_S = 1800
"""Seconds after which a process is ended however it looks; a compilation may take minutes."""

KERNELS = "src/skyrange/__pycache__"


@dataclass
class Verdict:
    """What became of a fault: found (by which test), survived, budget, not covered, or timeout.

    `timeout` is a fault that is found because a test hangs.
    """

    verdict: str
    test: str = ""
    seconds: float = 0.0
    tests_run: int = 0
    unusable: list[str] = field(default_factory=list)
    """Tests that fail without the fault as well, so that they say nothing."""


def order(tests: Iterable[TracedTest]) -> list[TracedTest]:
    """The most specific tests first, which executed the fewest lines; of equal ones the cheaper."""
    return sorted(tests, key=lambda test: (test.lines, test.seconds, test.node))


def group_by_file(tests: Sequence[TracedTest]) -> list[TracedTest]:
    """The same tests, those of a file together, so that what they share is set up once."""
    files = {test.file: number for number, test in reversed(list(enumerate(tests)))}
    return sorted(tests, key=lambda test: files[test.file])


def take_batch(tests: Sequence[TracedTest], number: int, budget_s: float) -> list[TracedTest]:
    """The first of the tests, for the process with this number: no more than the budget is likely to reach for."""
    batch: list[TracedTest] = []
    seconds = 0.0
    for test in tests[: BATCHES[min(number, len(BATCHES) - 1)]]:
        if batch and seconds > budget_s:
            break
        seconds += test.seconds
        batch.append(test)
    return group_by_file(batch)


def list_files(root: Path) -> list[str]:
    """The files of the project that git knows or would add."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout
    return [name for name in listed.split("\0") if name and (root / name).is_file()]


class Copy:
    """A copy of the project at `root`, in which one fault after the other is planted."""

    def __init__(self, root: Path, folder: Path, files: Iterable[str], slack_s: float = SLACK_S) -> None:
        self._slack_s = slack_s
        self._root = root
        self._folder = folder
        self._scratch = folder.with_name(folder.name + "-runs")
        self._scratch.mkdir(parents=True)
        for name in files:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, folder / name)
        for kernels in (root / KERNELS).glob("kernels*"):
            shutil.copytree(kernels, folder / KERNELS / kernels.name)  # with the times of the files
        # Python files are recognised by their content: a fault may change neither size nor time of its file.
        command = [sys.executable, "-m", "compileall", "-q", "--invalidation-mode", "checked-hash", "src"]
        subprocess.run(command, cwd=folder, check=False)

    def try_fault(self, fault: Fault, tests: Sequence[TracedTest], known: dict[str, bool], lock: Lock) -> Verdict:
        """Run the tests, most specific first, until one fails or the budget is used up.

        `known` says which tests pass without a fault, and learns about others that fail with it.
        """
        verdict = Verdict("survived")
        if not tests:
            return Verdict("not covered")
        done: set[str] = set()
        while (stopped := self._run_batches(fault, tests, verdict, done)) is not None:
            test, outcome = stopped
            if self._passes(test, tests, known, lock):
                verdict.verdict, verdict.test = "timeout" if outcome == "hangs" else "found", test
                break
            verdict.unusable.append(test)
        return verdict

    def _run_batches(
        self, fault: Fault, tests: Sequence[TracedTest], verdict: Verdict, done: set[str]
    ) -> tuple[str, str] | None:
        """The test that failed or hangs, and which; None if none does. Seconds and tests are added up."""
        source = self._folder / fault.path
        status, text = source.stat(), source.read_bytes()
        try:
            source.write_bytes(fault.plant(text))
            for number in itertools.count():
                left = [test for test in tests if not done & {test.node, test.file}]
                if not left:
                    return None
                if verdict.seconds >= BUDGET_S:
                    verdict.verdict = "budget"
                    return None
                batch = take_batch(left, number, BUDGET_S - verdict.seconds)
                for test, outcome, seconds in self.run(batch, BUDGET_S - verdict.seconds):
                    verdict.seconds = round(verdict.seconds + seconds, 3)
                    if outcome != "unfinished":
                        verdict.tests_run += 1
                        done.add(test)
                    if outcome in ("failed", "hangs"):
                        return test, outcome
                if verdict.seconds < BUDGET_S:
                    done.update(test.node for test in batch)  # those that are gone as well
        finally:
            source.write_bytes(text)
            os.utime(source, ns=(status.st_atime_ns, status.st_mtime_ns))
        return None

    def _passes(self, test: str, tests: Sequence[TracedTest], known: dict[str, bool], lock: Lock) -> bool:
        """Whether a test, or the collection of a test file, succeeds without a fault."""
        with lock:
            if test in known:
                return known[test]
        alone = [one for one in tests if one.node == test] or [TracedTest(f"{test}::", 0, 0.0)]
        passes = not any(outcome != "passed" for _, outcome, _ in self.run(alone, 5 * BUDGET_S))
        with lock:
            known[test] = passes
        return passes

    def run(self, tests: Sequence[TracedTest], budget_s: float, *, stop: bool = True) -> list[tuple[str, str, float]]:
        """Run tests in a process of their own: of each that ran the node id, the outcome and the seconds.

        `stop` ends the process at the first that fails.
        """
        names = ("plan.json", "selected.json", "outcomes.jsonl", "log.txt")
        plan, selected, outcomes, log = (self._scratch / name for name in names)
        outcomes.write_text("")
        longest: dict[str, float] = {}
        for test in tests:  # the first test of a file also sets up what all share
            longest[test.file] = max(longest.get(test.file, 0.0), test.seconds)
        expected = {test.node: test.seconds + longest[test.file] for test in tests}
        plan.write_text(json.dumps({"budget_s": budget_s, "slack_s": self._slack_s, "tests": expected}))
        selected.write_text(json.dumps(list(expected)))
        files = [name for name in dict.fromkeys(test.file for test in tests) if (self._folder / name).is_file()]
        if not files:
            return []
        command = [sys.executable, "-m", "pytest", *(["-x"] if stop else []), "--tb=short", "-p", "no:cacheprovider"]
        command += ["--hypothesis-profile", "quick", "--hypothesis-seed", "0", "-p", "tests.processor_time"]
        command += ["-p", "tools.select_tests", "--select-tests", str(selected)]
        command += ["-p", "tools.limit_tests", "--test-plan", str(plan), "--test-outcomes", str(outcomes)]
        environment = os.environ | {"PYTHONPATH": str(self._folder / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
        with log.open("w") as output:
            process = subprocess.Popen(
                [*command, "--basetemp", str(self._scratch / "tmp"), *files],
                cwd=self._folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            try:
                process.wait(WALL_S)
            except subprocess.TimeoutExpired:
                with outcomes.open("a") as file:
                    file.write(json.dumps([tests[0].node, "hangs", 0.0]) + "\n")
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)  # with what its tests have started
                process.wait()
        shutil.rmtree(self._folder / ".hypothesis", ignore_errors=True)
        found = [(str(test), str(outcome), float(s)) for test, outcome, s in map(json.loads, outcomes.open())]
        if not found and process.returncode not in (0, 5):  # not even the collection began
            found = [(tests[0].file, "failed", 0.0)]
        return found
