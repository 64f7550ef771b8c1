"""The record of the lines that each test executed: an SQLite file, written by `record_contexts`."""

from __future__ import annotations

import sqlite3
import zlib
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from hashlib import sha1
from pathlib import Path

ROOT = Path(__file__).parents[1]
RECORD = ROOT / ".contexts" / "contexts.sqlite"

SCHEMA = """
CREATE TABLE test (id INTEGER PRIMARY KEY, node TEXT NOT NULL UNIQUE, lines INTEGER NOT NULL, seconds REAL NOT NULL);
CREATE TABLE file (id INTEGER PRIMARY KEY, path TEXT NOT NULL UNIQUE, digest TEXT NOT NULL);
CREATE TABLE line (file INTEGER, line INTEGER, tests BLOB NOT NULL, PRIMARY KEY (file, line)) WITHOUT ROWID;
"""


@dataclass(frozen=True)
class TracedTest:
    """A test: its node id, how many lines of functions it executed, and its processor time without compilation."""

    node: str
    lines: int
    seconds: float

    @property
    def file(self) -> str:
        """The test file, relative to the root."""
        return self.node.partition("::")[0]


class Contexts:
    """The record at `path`. Files are named relative to the root of the repository.

    Raises FileNotFoundError if there is none.
    """

    def __init__(self, path: Path = RECORD) -> None:
        if not path.is_file():
            raise FileNotFoundError(f"{path} is not there; record the lines that each test executes: make contexts")
        self._database = sqlite3.connect(path)
        self.tests = {
            number: TracedTest(node, lines, seconds)
            for number, node, lines, seconds in self._database.execute("SELECT id, node, lines, seconds FROM test")
        }
        self._files = {
            name: (number, digest)
            for number, name, digest in self._database.execute("SELECT id, path, digest FROM file")
        }
        self._lines: dict[str, dict[int, int]] = {}
        self._named: dict[tuple[str, str], set[int]] = defaultdict(set)
        for number, test in self.tests.items():
            self._named[test.file, test.node.partition("[")[0].rpartition("::")[2]].add(number)

    def digest(self, path: str) -> str | None:
        """The digest by `blob_digest` of the file as it was executed; None if no line of it was."""
        return self._files[path][1] if path in self._files else None

    def lines(self, path: str) -> Mapping[int, int]:
        """The tests of each executed line of the file, as a number whose bit n stands for the test with the id n."""
        if path not in self._lines:
            number = self._files[path][0] if path in self._files else -1
            rows = self._database.execute("SELECT line, tests FROM line WHERE file = ?", (number,))
            self._lines[path] = {line: int.from_bytes(zlib.decompress(tests), "little") for line, tests in rows}
        return self._lines[path]

    def named(self, path: str, function: str) -> set[int]:
        """The ids of the tests that a function of a test file is, one for each of its parameters."""
        return self._named.get((path, function), set())

    def executed(self, path: str, lines: Iterable[int]) -> set[int]:
        """The ids of the tests that executed any of these lines of the file."""
        known, together = self.lines(path), 0
        for line in lines:
            together |= known.get(line, 0)
        return members(together)


def members(bits: int) -> set[int]:
    """The numbers of the bits that are set."""
    found = set()
    while bits:
        low = bits & -bits
        found.add(low.bit_length() - 1)
        bits ^= low
    return found


def blob_digest(content: bytes) -> str:
    """The name by which git keeps a file with this content."""
    return sha1(b"blob %d\0" % len(content) + content, usedforsecurity=False).hexdigest()


def write(
    path: Path,
    tests: Mapping[str, tuple[int, float]],
    lines: Mapping[str, Mapping[int, int]],
    digests: Mapping[str, str],
) -> None:
    """Write a record: by node id the count of lines and the seconds; by file and line the bits of the tests.

    Bit n stands for the nth test of `tests`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".draft")
    draft.unlink(missing_ok=True)
    database = sqlite3.connect(draft)
    with database:
        database.executescript(SCHEMA)
        database.executemany(
            "INSERT INTO test VALUES (?, ?, ?, ?)",
            ((number, node, count, seconds) for number, (node, (count, seconds)) in enumerate(tests.items())),
        )
        for number, (name, rows) in enumerate(sorted(lines.items())):
            database.execute("INSERT INTO file VALUES (?, ?, ?)", (number, name, digests[name]))
            packed = (
                (number, line, zlib.compress(bits.to_bytes((bits.bit_length() + 7) // 8, "little")))
                for line, bits in rows.items()
            )
            database.executemany("INSERT INTO line VALUES (?, ?, ?)", packed)
    database.close()
    draft.replace(path)
