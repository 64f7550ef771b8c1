"""Do the tools plant the faults that they say, and do tests of a small package find them?"""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from textwrap import dedent

import pytest

from tools import contexts, plant_faults, record_contexts, test_changed
from tools.contexts import Contexts, TracedTest
from tools.fault_runs import Copy, Verdict, group_by_file, order, take_batch
from tools.faults import KINDS, Fault, choose, count_code_lines, divide, find_faults, is_fault
from tools.source import References

ROOT = Path(__file__).parents[2]
PATH = "src/skyrange/small/module.py"


def planted(text: str, kind: str) -> list[str]:
    """The text with each fault of a kind."""
    whole = dedent(text).encode()
    return [fault.plant(whole).decode() for fault in find_faults(PATH, whole) if fault.kind == kind]


def changed_lines(text: str, kind: str) -> list[str]:
    """The changed line of each fault of a kind; all others are the same."""
    lines = dedent(text).splitlines()
    found = []
    for other in planted(text, kind):
        differing = [new for old, new in zip(lines, other.splitlines(), strict=True) if old != new]
        assert len(differing) == 1
        found.append(differing[0].strip())
    return found


# ---------------------------------------------------------------- the kinds


def test_comparisons_are_swapped_one_at_a_time() -> None:
    assert changed_lines("ü = 'ä' if a  <  b == (c) else d  # <\n", "comparison") == [
        "ü = 'ä' if a  <=  b == (c) else d  # <",
        "ü = 'ä' if a  <  b != (c) else d  # <",
    ]
    assert changed_lines("x = a is not b, c not in d, e in f, g is h\n", "comparison") == [
        "x = a is b, c not in d, e in f, g is h",
        "x = a is not b, c in d, e in f, g is h",
        "x = a is not b, c not in d, e not in f, g is h",
        "x = a is not b, c not in d, e in f, g is not h",
    ]


def test_integers_are_one_off_and_floats_are_scaled() -> None:
    assert changed_lines("x = f(0x0F, 2.0, True, 'a')\n", "constant") == [
        "x = f(0x10, 2.0, True, 'a')",
        "x = f(0xe, 2.0, True, 'a')",
        "x = f(0x0F, 3.0, True, 'a')",
    ]
    assert changed_lines("x = 0, 0.0\n", "constant") == ["x = 1, 0.0", "x = 0, 1.5"]


def test_signs_are_changed_but_not_of_strings() -> None:
    assert changed_lines("x = a + b - c, -d, 'e' + f, f'{g}' + h\n", "sign") == [
        "x = a + b + c, -d, 'e' + f, f'{g}' + h",
        "x = a - b - c, -d, 'e' + f, f'{g}' + h",
        "x = a + b - c, d, 'e' + f, f'{g}' + h",
    ]
    assert changed_lines("x += 1\ny += 'a'\n", "sign") == ["x -= 1"]


def test_statements_of_functions_are_left_out() -> None:
    text = '''\
    one = 1
    def f(self):
        """A docstring."""
        self.a = g(
            1,
        )
        log.info("text")
        h()
        yield 1
    '''
    assert [dedent(text).replace(old, "pass") for old in ("self.a = g(\n        1,\n    )", "h()")] == planted(
        text, "statement"
    )


def test_neighbouring_arguments_are_swapped() -> None:
    assert changed_lines("x = f(a, b + 1, *c, d=1), max(a, b), g(a, a)\n", "arguments") == [
        "x = f(b + 1, a, *c, d=1), max(a, b), g(a, a)"
    ]


def test_guards_are_never_taken() -> None:
    text = """\
    def f(a):
        if a > 1: return 1
        if (b := g(a)):
            raise ValueError
        if a:
            h()
        assert a != 2
        assert a is not None
    """
    assert changed_lines(text, "guard") == ["if False: return 1", "if ((b := g(a)) and False):", "pass"]


def test_what_is_no_code_is_left_alone() -> None:
    text = '''\
    """A module: 1 < 2."""
    from typing import TYPE_CHECKING
    __all__ = ["a"] + ["b"]
    if TYPE_CHECKING:
        x = 1
    @mark(1, 2)
    def f(a: Literal[1], *, b: Literal[2]) -> Literal[3]:
        """1 + 1."""
        c: Literal[4]
        logging.info("%s %s", 1, 2)
        return f"{1 + 1}"
    field = Field(description="a" + g(1, 2))
    option = typer.Option(1, 2, help=-1)
    '''
    assert {fault.kind for fault in find_faults(PATH, dedent(text).encode())} == set()


def test_a_fault_that_is_the_same_program_or_none_is_not_planted() -> None:
    text = b"x = 1\n"
    fault = find_faults(PATH, text)[0]
    assert is_fault(fault, text)
    for after in ("1", "0x1", "(1", "return"):
        other = Fault(*(*fault.identity[:5], after, 1), fault.line, fault.start, fault.end, fault.place)
        assert not is_fault(other, text)


# ---------------------------------------------------------------- the choice


def test_code_lines_are_counted_and_divided_by_largest_remainders() -> None:
    assert count_code_lines(b'"""Text\n\nof two lines."""\n\n# a comment\nx = (\n    1\n)  # one\n') == 3
    assert divide({"a": 50, "b": 30, "c": 20}, 7) == {"a": 4, "b": 2, "c": 1}


def sources() -> dict[str, bytes]:
    """Two packages, one with twice as many lines."""
    lines = (
        "def f(a, b):",
        "    if a < b:",
        "        return 1",
        "    c = g(a, b)",
        "    d = a - c",
        "    return d != 7",
        "",
    )
    return {f"src/skyrange/{name}.py": "\n".join(lines).encode() for name in ("one/a", "two/a", "two/b")}


def test_the_choice_is_spread_balanced_and_the_same_for_a_seed() -> None:
    chosen = choose(sources(), 12, 3)
    assert [fault.package for fault in chosen] == ["one"] * 4 + ["two"] * 8
    assert len({(fault.path, fault.place) for fault in chosen}) == 12
    assert {fault.kind for fault in chosen} == set(KINDS)
    assert choose(sources(), 12, 3) == chosen
    assert choose(sources(), 12, 4) != chosen


def test_faults_are_found_again_where_lines_have_moved() -> None:
    texts = sources()
    chosen = choose(texts, 12, 3)
    rows = [plant_faults._row(fault) for fault in chosen]
    moved = {path: b"# a line more\n" + text for path, text in texts.items()}
    again = plant_faults.find_again(rows, moved)
    assert [again[row["id"]].line for row in rows] == [fault.line + 1 for fault in chosen]
    changed = {path: text.replace(b"a < b", b"a < b + 1") for path, text in texts.items()}
    gone = {fault.id for fault in chosen if fault.statement == "if a < b:"}
    assert gone
    assert set(plant_faults.find_again(rows, changed)) == {fault.id for fault in chosen} - gone


def test_results_are_compared() -> None:
    rows = [plant_faults._row(fault) for fault in choose(sources(), 4, 3)]
    old = [row | {"verdict": word} for row, word in zip(rows, ("found", "survived", "timeout", "budget"), strict=True)]
    new = [row | {"verdict": word} for row, word in zip(rows, ("survived", "found", "found", "survived"), strict=True)]
    lines = plant_faults.compare(old, new)
    assert [lines[0], lines[2]] == ["found before, not found now: 1", "not found before, found now: 1"]
    assert rows[0]["id"] in lines[1]
    assert rows[1]["id"] in lines[3]


# ---------------------------------------------------------------- the tests of a fault


def test_specific_tests_come_first_then_cheap_ones() -> None:
    tests = [
        TracedTest("t.py::c", 2, 0.2),
        TracedTest("t.py::b", 2, 0.1),
        TracedTest("t.py::a", 9, 0.0),
        TracedTest("u.py::d", 1, 5.0),
    ]
    assert [test.node[-1] for test in order(tests)] == ["d", "b", "c", "a"]


def test_batches_keep_files_together_and_end_with_the_budget() -> None:
    tests = [TracedTest(f"{'ab'[number % 2]}.py::{number}", number, 1.0) for number in range(40)]
    assert [len(take_batch(tests, number, 100.0)) for number in (0, 1, 9)] == [15, 40, 40]
    assert [len(take_batch(tests, 1, budget)) for budget in (0.0, 25.5)] == [1, 26]
    assert [test.file for test in group_by_file(tests[:5])] == ["a.py"] * 3 + ["b.py"] * 2


def record(folder: Path, lines: dict[str, dict[int, set[str]]], digests: dict[str, str] | None = None) -> Contexts:
    """A record of the tests of each line."""
    nodes = sorted({node for rows in lines.values() for tests in rows.values() for node in tests})
    bits = {
        path: {line: sum(1 << nodes.index(t) for t in tests) for line, tests in rows.items()}
        for path, rows in lines.items()
    }
    contexts.write(folder / "c.sqlite", dict.fromkeys(nodes, (1, 0.1)), bits, digests or dict.fromkeys(lines, ""))
    return Contexts(folder / "c.sqlite")


def test_compiled_functions_constants_and_classes_have_the_tests_of_what_uses_them(tmp_path: Path) -> None:
    texts = {
        "src/skyrange/a.py": """\
            LIMIT = 3

            @compiled
            def low(x):
                return x < LIMIT

            class Base:
                SIZE = 4
            """,
        "src/skyrange/b.py": """\
            from skyrange.a import Base, low as lower

            @inlined
            def middle(x):
                return lower(x)

            def high(x):
                return middle(x)

            def size():
                return Base.SIZE
            """,
    }
    sources = {path: dedent(text).encode() for path, text in texts.items()}
    known = record(tmp_path, {"src/skyrange/b.py": {8: {"t.py::high"}, 11: {"t.py::size"}}})
    references = References(sources)

    places = {fault.before: fault.place for fault in find_faults("src/skyrange/a.py", sources["src/skyrange/a.py"])}

    def tests_of(before: str) -> set[str]:
        return {known.tests[number].node for number in references.tests_at(places[before], known)}

    assert tests_of("x < LIMIT") == {"t.py::high"}
    assert tests_of("3") == {"t.py::high"}
    assert tests_of("4") == {"t.py::size"}


def test_tests_that_call_compiled_code_themselves_are_found_by_their_references(tmp_path: Path) -> None:
    texts = {
        "src/skyrange/a.py": """\
            LIMIT = 3

            @compiled
            def low(x):
                return x < LIMIT
            """,
        "tests/t.py": """\
            from skyrange.a import LIMIT, low

            WORDS = [low(2)]

            def helper(x):
                return low(x)

            @pytest.fixture
            def made():
                return low(1)

            def test_a():
                assert helper(2)

            @pytest.mark.parametrize("x", [1, LIMIT])
            def test_b(x):
                pass

            def test_c(made):
                pass

            def test_d():
                assert WORDS

            def test_e():
                pass
            """,
    }
    sources = {path: dedent(text).encode() for path, text in texts.items()}
    nodes = [
        "tests/t.py::test_a",
        "tests/t.py::test_b[a::b]",
        "tests/t.py::test_b[3]",
        *(f"tests/t.py::test_{k}" for k in "cde"),
    ]
    known = record(tmp_path, {"src/skyrange/other.py": {1: set(nodes)}})
    faults = {fault.before: fault.place for fault in find_faults("src/skyrange/a.py", sources["src/skyrange/a.py"])}

    def tests_of(before: str) -> set[str]:
        tests = References(sources).tests_at(faults[before], known)
        return {known.tests[number].node.removeprefix("tests/t.py::test_") for number in tests}

    assert tests_of("x < LIMIT") == {"a", "c", "d"}
    assert tests_of("3") == {"a", "b[a::b]", "b[3]", "c", "d"}


def test_shared_contexts_stand_for_the_tests_of_a_file_or_the_users_of_a_fixture(tmp_path: Path) -> None:
    (tmp_path / "m.py").write_text("X = 1\ndef f():\n    return 2\n")
    lines = {"m.py": {1: [0, 3], 3: [1, 2]}}
    shared = "tests::fixture flight"
    (tmp_path / "fixtures.7").write_text(json.dumps(["t.py::b", [shared]]) + "\n")
    users = record_contexts.read_users(tmp_path)
    costs = {"t.py::b": {"call": {"total": 3.0, "compiled": 1.0}, "setup": {"total": 0.5, "compiled": 0.0}}}
    record_contexts.condense(
        tmp_path / "c.sqlite", tmp_path, lines, ["t.py::a", "t.py", "u.py::c", shared], costs, users
    )
    known = Contexts(tmp_path / "c.sqlite")
    assert {known.tests[number].node for number in known.executed("m.py", [1])} == {"t.py::a", "t.py::b"}
    assert {known.tests[number].node for number in known.executed("m.py", [3])} == {"t.py::a", "t.py::b", "u.py::c"}
    assert {test.node: (test.lines, test.seconds) for test in known.tests.values()} == {
        "t.py::a": (1, 0.0),
        "t.py::b": (1, 2.5),
        "u.py::c": (1, 0.0),
    }


# ---------------------------------------------------------------- the tests of a change


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A repository with a module that two tests execute, a helper, and a file of data."""
    files = {
        PATH: "def f():\n    return 1\n\n\ndef g():\n    return 2\n",
        "src/skyrange/small/limits.toml": "limit = 1\n",
        "tests/helper.py": "",
        "tests/deeper.py": "from tests.helper import x\n",
        "tests/test_f.py": "from tests import deeper\n",
        "tests/test_g.py": "LIMITS = 'limits'\n",
        "tests/test_new.py": "import skyrange.small.new\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    who = ["-c", "user.name=a", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false"]
    for words in (["init", "-q"], ["add", "."], [*who, "commit", "-qm", "All"]):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    return tmp_path


def selected(root: Path, known: Contexts | None) -> set[str]:
    """The tests of what differs from the last commit."""
    return test_changed.select(root, "HEAD", test_changed.list_changed(root, "HEAD"), known)


def test_changed_lines_have_the_tests_that_executed_them(
    repository: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    text = (repository / PATH).read_text()
    lines = {PATH: {2: {"tests/test_f.py::f"}, 6: {"tests/test_g.py::g", "tests/test_gone.py::g"}}}
    folder = tmp_path_factory.mktemp("record")
    digests = {PATH: contexts.blob_digest(text.encode())}
    known = record(folder, lines, digests)
    assert selected(repository, known) == set()
    (repository / PATH).write_text("# One line more.\n" + text.replace("return 2", "return 3"))
    assert selected(repository, known) == {"tests/test_g.py::g"}
    (repository / PATH).write_text(text.replace("def f():\n", "def f():\n    x = 1\n"))
    assert selected(repository, known) == {"tests/test_f.py::f"}
    assert selected(repository, record(folder, lines)) == {"tests/test_f.py::f", "tests/test_g.py::g"}


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ("tests/test_g.py", {"tests/test_g.py"}),
        ("tests/helper.py", {"tests/test_f.py"}),
        ("tests/conftest.py", {"tests/test_f.py", "tests/test_g.py", "tests/test_new.py"}),
        ("src/skyrange/small/limits.toml", {"tests/test_g.py"}),
        ("src/skyrange/small/new.py", {"tests/test_new.py"}),
    ],
)
def test_changed_tests_helpers_and_data_have_the_test_files_that_use_them(
    repository: Path, changed: str, expected: set[str]
) -> None:
    (repository / changed).write_text("# new\n")
    assert selected(repository, None) == expected


# ---------------------------------------------------------------- a small project


MODULE = """\
def is_small(number):
    if number < 0:
        return False
    return number < 10


def count(number):
    while number > 0:
        number -= 1
    return number


def unused():
    return 1
"""

TESTS = """\
import pytest
from skyrange.small.module import count, is_small

def test_nine():
    assert is_small(9)

def test_ten():
    assert not is_small(10)

def test_count():
    assert count(3) == 0

def test_that_always_fails():
    assert is_small(11)
"""


@pytest.fixture
def project(tmp_path: Path) -> tuple[Copy, Path]:
    """A copy of a small project, and its root."""
    root = tmp_path / "root"
    files = {PATH: MODULE, "tests/test_small.py": TESTS, "tests/conftest.py": "import tests.tiers\n"}
    files |= dict.fromkeys(("src/skyrange/__init__.py", "src/skyrange/small/__init__.py", "tests/__init__.py"), "")
    files["pytest.ini"] = "[pytest]\ntimeout = 100\n"
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    for name in ("tests/tiers.py", "tests/processor_time.py"):
        shutil.copy(ROOT / name, root / name)
    shutil.copytree(ROOT / "tools", root / "tools", ignore=shutil.ignore_patterns("__pycache__"))
    listed = [str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()]
    return Copy(root, tmp_path / "copy", listed, slack_s=1.0), root


@pytest.mark.slow
def test_planted_faults_are_found_by_the_tests_of_their_lines(project: tuple[Copy, Path], tmp_path: Path) -> None:
    copy, root = project
    node = "tests/test_small.py::test_{}".format
    small = {node("nine"), node("ten"), node("that_always_fails")}
    known = record(tmp_path, {PATH: {2: small, 4: small, 8: {node("count")}, 9: {node("count")}}})
    texts = {PATH: (root / PATH).read_bytes()}
    faults = {fault.before + " -> " + fault.after: fault for fault in find_faults(PATH, texts[PATH])}
    wanted = ("number < 10 -> number <= 10", "number < 0 -> number <= 0", "number -= 1 -> number += 1", "1 -> 2")
    chosen = [faults[name] for name in wanted]
    verdicts: dict[str, Verdict] = {}

    def keep(fault: Fault, verdict: Verdict) -> None:
        verdicts[fault.before] = verdict

    plant_faults.try_all([copy], chosen, known, References(texts), keep)
    assert (verdicts["number < 10"].verdict, verdicts["number < 10"].test) == ("found", node("ten"))
    assert (verdicts["number < 0"].verdict, verdicts["number < 0"].tests_run) == ("survived", 3)
    assert verdicts["number < 0"].unusable == [node("that_always_fails")]
    assert (verdicts["number -= 1"].verdict, verdicts["number -= 1"].test) == ("timeout", node("count"))
    assert verdicts["1"].verdict == "not covered"
    assert (root / PATH).read_text() == MODULE


def test_an_id_of_no_fault_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plant_faults, "read_sources", dict)
    monkeypatch.setattr(plant_faults, "_select", lambda given, sources: ([{"id": "a1"}, {"id": "b2"}], {}))
    with pytest.raises(SystemExit, match=r"--only c3: expected ids of these faults; `--list` prints them"):
        plant_faults.main(["--only", "a1,c3"])
