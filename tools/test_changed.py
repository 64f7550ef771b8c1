"""The fast tests that executed what has changed: `python -m tools.test_changed`, or `make test-changed`.

A changed module has the tests that executed the changed lines, by the record of `make contexts`. Changed tests are run
whole, and so are the tests that import a changed helper, or name a changed file of data.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from tools.contexts import RECORD, ROOT, Contexts, blob_digest
from tools.record_contexts import FAST
from tools.source import PACKAGE, TESTS, References, find_places, module_of, read_sources

HUNK = re.compile(rb"^@@ -(\d+)(?:,(\d+))? \+(\d+)(?:,(\d+))? @@", re.MULTILINE)
UNSEEN = "Not seen: tests that reach the change through files of data, other programs or results that are cached."


def main(words: list[str] | None = None) -> int:
    """Find the tests of what changed, say how many they are and how long they took, and run them."""
    parser = argparse.ArgumentParser(prog="python -m tools.test_changed", description=__doc__)
    parser.add_argument("base", nargs="?", default="HEAD", help="compare with this commit (default: %(default)s)")
    parser.add_argument("--contexts", type=Path, default=RECORD, help="the record of `make contexts`")
    parser.add_argument("--workers", default="2", help="pytest processes (default: %(default)s)")
    parser.add_argument("--list", action="store_true", help="print the tests and run nothing")
    given = parser.parse_args(words)
    contexts = None
    try:
        contexts = Contexts(given.contexts)
    except FileNotFoundError as error:
        print(f"{error}\nWithout it, the tests run that import a changed module directly.")
    changed = list_changed(ROOT, given.base)
    selected = select(ROOT, given.base, changed, contexts)
    if not selected:
        print(f"No fast test is known to execute any of {len(changed)} changed files.")
        return 0
    files = sorted({name.partition("::")[0] for name in selected})
    if contexts is not None:
        took = [t for t in contexts.tests.values() if t.node in selected or t.file in selected]
        minutes = sum(test.seconds for test in took) / 60
        print(f"{len(took)} known tests of {len(files)} files, {minutes:.1f} min of processor time when recorded.")
    print(UNSEEN)
    if given.list:
        print("\n".join(sorted(selected)))
        return 0
    with tempfile.NamedTemporaryFile("w", suffix=".json") as listed:
        json.dump(sorted(selected), listed)
        listed.flush()
        command = [sys.executable, "-m", "pytest", "-rsfE", "-n", given.workers, "-m", FAST]
        command += ["--hypothesis-profile", "quick", "-p", "tools.select_tests", "--select-tests", listed.name, *files]
        return subprocess.run(command, cwd=ROOT, check=False).returncode


def list_changed(root: Path, base: str) -> list[str]:
    """The files that differ from `base`, and those that git does not know yet."""
    changed = _git(root, "diff", "--name-only", "--no-renames", "-z", base).split(b"\0")
    new = _git(root, "ls-files", "--others", "--exclude-standard", "-z").split(b"\0")
    return sorted({name.decode() for name in (*changed, *new) if name})


def select(root: Path, base: str, changed: Iterable[str], contexts: Contexts | None) -> set[str]:
    """The node ids of the tests to run, and the test files to run whole."""
    modules = [name for name in changed if name.startswith(f"{PACKAGE}/") and name.endswith(".py")]
    selected: set[str] = set()
    unknown = set(modules)
    if contexts is not None:
        unknown = {name for name in modules if contexts.digest(name) is None}
        selected = {
            node for node in _executed(root, base, modules, contexts) if (root / node.partition("::")[0]).exists()
        }
    texts = {str(path.relative_to(root)): path.read_text() for path in sorted((root / "tests").rglob("*.py"))}
    others = {name for name in changed if name not in modules}
    return selected | {name for name in _mention(texts, unknown | others) if Path(name).name.startswith("test_")}


def _executed(root: Path, base: str, modules: Iterable[str], contexts: Contexts) -> Iterator[str]:
    """The tests that executed the changed lines of modules; of all lines if the record is of neither version."""
    sources = read_sources(root)
    lines: dict[str, set[int]] = {}
    for name in modules:
        new = sources.get(name, b"")
        hunks = HUNK.findall(_git(root, "diff", "-U0", "--no-renames", base, "--", name))
        old = _git(root, "show", f"{base}:{name}") if hunks else b""
        sides = [(_lines(*hunk[:2]), _lines(*hunk[2:])) for hunk in hunks]
        sides = [side for side in sides if _has_code(old, side[0]) or _has_code(new, side[1])]
        if hunks and contexts.digest(name) == blob_digest(old):
            sources[name] = old
            lines[name] = {line for before, _ in sides for line in before or _around(before)}
        elif hunks and contexts.digest(name) == blob_digest(new):
            lines[name] = {line for _, after in sides for line in after or _around(after)}
        else:
            yield from (contexts.tests[test].node for test in contexts.executed(name, contexts.lines(name)))
    if lines:
        references = References(sources | read_sources(root, TESTS))
        for name, numbers in lines.items():
            found = contexts.executed(name, numbers)
            for place in find_places(name, sources[name], numbers):
                found |= references.tests_at(place, contexts)
            yield from (contexts.tests[test].node for test in found)


def _lines(start: bytes, count: bytes) -> range:
    """The lines of one side of a hunk; where there are none, the range is empty and begins after the line before."""
    first, size = int(start), int(count or b"1")
    return range(first, first + size) if size else range(first + 1, first + 1)


def _around(nothing: range) -> range:
    return range(nothing.start - 1, nothing.start + 1)


def _has_code(text: bytes, lines: range) -> bool:
    """Whether any of the lines is neither blank nor a comment."""
    whole = text.splitlines()
    return any(whole[line - 1].strip() and not whole[line - 1].lstrip().startswith(b"#") for line in lines)


def _mention(texts: Mapping[str, str], changed: set[str]) -> set[str]:
    """The files of tests among the changed files, and those that import or name one, or import one that does."""
    found = {name for name in changed if name in texts}
    folders = [str(Path(name).parent) + "/" for name in changed if Path(name).name == "conftest.py"]
    found |= {name for name in texts if any(name.startswith(folder) for folder in folders)}
    waiting = list(changed)
    seen = set(waiting)
    while waiting:
        word = _word(waiting.pop())
        for name, text in texts.items():
            if name not in found and word.search(text):
                found.add(name)
            if name in found and name not in seen and not Path(name).name.startswith("test_"):
                seen.add(name)
                waiting.append(name)
    return found


def _word(name: str) -> re.Pattern[str]:
    """What a test says that uses a file: a module's import, the name of other files, without ending if it is data."""
    path = Path(name)
    if path.suffix == ".py":
        module = module_of(name) if name.startswith("src/") else ".".join(path.with_suffix("").parts)
        package, _, last = module.rpartition(".")
        return re.compile(rf"\b{re.escape(module)}\b|\bfrom {re.escape(package)} import [^\n]*\b{re.escape(last)}\b")
    if path.parts[0] == "docs":
        return re.compile(r'ROOT / "docs"')
    stem = path.stem if name.startswith(("src/", "tests/")) else path.name
    return re.compile(rf"""["'/]{re.escape(stem)}["'./]""")


def _git(root: Path, *words: str) -> bytes:
    return subprocess.run(["git", *words], cwd=root, check=True, stdout=subprocess.PIPE).stdout  # noqa: S607


if __name__ == "__main__":
    sys.exit(main())
