"""Are the documents true? Links lead somewhere, examples run, commands exist, references are what the code says.

Examples are fenced blocks whose first line says more than the language: `toml scenario NAME` is a whole scenario and is
written to NAME; `json`, `toml` and `python file NAME` are files, `python run` and `console run` are executed, in
order, each page in a folder of its own that holds the run `runs/squares`.
"""

from __future__ import annotations

import ast
import importlib
import json
import re
import shlex
import shutil
import sys
import tomllib
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, cast

import pytest

from tests.cases import each_case
from tools.docs import api_reference, generate, navigation

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [*sorted(ROOT.glob("*.md")), ROOT / "changes" / "README.md", *sorted(DOCS.rglob("*.md"))]
PARAMS = [pytest.param(page, id=str(page.relative_to(ROOT))) for page in PAGES]
FENCE = re.compile(r"^( *)```([^\n]*)\n(.*?)^\1```[ ]*$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
KINDS = re.compile(r'"((?:event|decision)\.[a-z_]+)')


FACADE = set(api_reference.FACADE)
"""The public modules."""


class Block(NamedTuple):
    """A fenced block: the words after the fence, the text, and the line where it begins."""

    words: tuple[str, ...]
    text: str
    line: int


def blocks(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    found = []
    for match in FENCE.finditer(text):
        body = re.sub(rf"^{match[1]}", "", match[3], flags=re.MULTILINE)
        found.append(Block(tuple(match[2].split()), body, text.count("\n", 0, match.start()) + 1))
    return found


def prose(page: Path) -> str:
    """A page without its fenced blocks."""
    return FENCE.sub("", page.read_text(encoding="utf-8"))


@cache
def anchors(page: Path) -> frozenset[str]:
    """The anchors of a page's headings, by GitHub's rule: lower case, punctuation gone, spaces to hyphens."""
    found: list[str] = []
    for heading in re.findall(r"^#{1,6} +(.+?) *$", prose(page), re.MULTILINE):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        anchor = re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")
        found.append(f"{anchor}-{found.count(anchor)}" if anchor in found else anchor)
    return frozenset(found)


def console_lines(block: Block) -> list[list[str]]:
    """The arguments of every `skyrange …` of a console block or a shell block."""
    lines = [line.removeprefix("$ ") for line in block.text.replace("\\\n", " ").splitlines()]
    return [shlex.split(line, comments=True)[1:] for line in lines if line.startswith("skyrange ")]


# ---------------------------------------------------------------- what holds of every page


@each_case("page", PAGES)
def test_links_lead_somewhere(page: Path) -> None:
    broken = []
    for target in LINK.findall(prose(page)):
        if target.startswith(("https://", "http://", "mailto:")):
            continue
        name, _, anchor = target.partition("#")
        there = (page.parent / name).resolve() if name else page
        known = not anchor or there.suffix != ".md" or (there.exists() and anchor in anchors(there))
        if not (there.exists() and known):
            broken.append(target)
    assert not broken


@pytest.mark.parametrize("third", range(3))
def test_generated_parts_are_up_to_date(third: int) -> None:
    each_case("page", PAGES[third::3])(_check_generated_parts)()


def _check_generated_parts(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert text == generate.renewed(text), "run: python -m tools.docs.generate"
    assert text.count("<!-- generated:") == len(generate.BLOCK.findall(text))
    assert text.count("<!-- count:") == text.count("<!-- /count -->") == len(generate.COUNT.findall(text))


@each_case("page", PAGES)
def test_blocks_are_closed_and_known(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert "```" not in FENCE.sub("", text)
    known = {
        "console",
        "console run",
        "json",
        "json file",
        "python",
        "python file",
        "python run",
        "sh",
        "text",
        "toml",
        "toml file",
        "toml scenario",
    }
    assert {" ".join(block.words[:2]) for block in blocks(page)} <= known | {f"api {module}" for module in FACADE}


def skyrange_imports(code: str) -> set[str]:
    """The modules of this project from which some code imports; of `from skyrange import x` the module, not x."""
    found = set()
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            found.add(node.module)
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {name for name in found if name.split(".")[0] == "skyrange"}


@each_case("page", PAGES)
def test_examples_use_the_public_modules_alone(page: Path) -> None:
    code = [block.text for block in blocks(page) if block.words[:1] == ("python",)]
    assert set().union(*map(skyrange_imports, code)) <= FACADE


def test_notebooks_use_the_public_modules_alone() -> None:
    books = sorted(DOCS.rglob("*.ipynb"))
    assert books
    for book in books:
        cells = json.loads(book.read_text(encoding="utf-8"))["cells"]
        code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
        code = [text for text in code if not text.startswith("%pip ")]
        assert set().union(*map(skyrange_imports, code)) <= FACADE, book.name


@each_case("page", PAGES)
def test_toml_is_toml(page: Path) -> None:
    for block in blocks(page):
        if block.words[0] == "toml":
            tomllib.loads(block.text)


@each_case("page", PAGES)
def test_commands_exist(page: Path) -> None:
    """Command, options and number of arguments are parsed as the command line parses them; nothing is executed."""
    import click

    known = generate.commands()
    lines = [line for block in blocks(page) if block.words[0] in ("console", "sh") for line in console_lines(block)]
    spoken = [shlex.split(code)[1:] for code in re.findall(r"`(skyrange [a-z][^`]*)`", prose(page)) if "'" not in code]
    for arguments in lines:
        words = " ".join(arguments[:2]) if " ".join(arguments[:2]) in known else arguments[0]
        assert words in known, f"{page.name}: skyrange {' '.join(arguments)}"
        with suppress(click.exceptions.Exit):
            known[words].make_context(words, arguments[len(words.split()) :])
    for arguments in spoken:
        assert any(words.split()[0] == arguments[0] for words in known), f"{page.name}: skyrange {' '.join(arguments)}"


def test_every_page_is_reached_from_the_index() -> None:
    index = DOCS / "README.md"
    reached, waiting = {index}, [index]
    while waiting:
        page = waiting.pop()
        for target in LINK.findall(prose(page)):
            there = (page.parent / target.partition("#")[0]).resolve()
            if there.suffix == ".md" and there.is_relative_to(DOCS) and there not in reached:
                reached.add(there)
                waiting.append(there)
    assert {page for page in PAGES if page.is_relative_to(DOCS)} <= reached


def test_every_page_is_in_the_navigation_of_the_site_once() -> None:
    listed, waiting = [navigation.INDEX], [page for section in navigation.read_sections() for page in section.pages]
    while waiting:
        listed.append(waiting.pop())
        waiting.extend(navigation.children_of(listed[-1]))
    names = ("CHANGELOG", "CODE_OF_CONDUCT", "CONTRIBUTING", "RELEASE", "SECURITY", "changes/README")
    pages = {*DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb"), *(ROOT / f"{name}.md" for name in names)}
    assert sorted(listed) == sorted(pages), "list the page in docs/README.md, or put it in the folder of a page"


def test_pictures_are_small() -> None:
    for picture in (DOCS / "images").iterdir():
        assert picture.stat().st_size < 400_000, picture


# ---------------------------------------------------------------- examples


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which `squares` has been flown."""
    from skyrange import run

    folder = tmp_path_factory.mktemp("flown")
    run("squares", folder / "runs" / "squares", changes=["duration_s=40"])
    return folder


RUN_ELSEWHERE = {DOCS / "how-to" / name for name in ("add-an-approval-service.md", "add-an-autopilot.md")}
"""Pages whose examples tests/conformance/test_docs_plugin.py runs."""
RUNNABLE = [
    param
    for param in PARAMS
    if param.values[0] not in RUN_ELSEWHERE
    and any(block.words[1:2] in (("run",), ("scenario",), ("file",)) for block in blocks(cast(Path, param.values[0])))
]


DEAR_PAGES = {
    ROOT / "README.md", DOCS / "how-to" / "attack-and-compare.md", DOCS / "how-to" / "make-links-bad.md",
    DOCS / "how-to" / "run-a-campaign.md", DOCS / "how-to" / "run-a-study.md", DOCS / "how-to" / "train-agents.md",
    DOCS / "tutorials" / "first-attack.md", DOCS / "tutorials" / "first-flight.md",
}  # fmt: skip
"""Pages whose flights take long."""


@pytest.mark.catalogue
@pytest.mark.parametrize("page", [one for one in RUNNABLE if one.values[0] not in DEAR_PAGES])
def test_examples_run(
    page: Path, flown: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a page tells its reader to do works, in the order in which it is told."""
    _run_examples(page, flown, tmp_path, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("page", [one for one in RUNNABLE if one.values[0] in DEAR_PAGES])
def test_examples_with_long_flights_run(
    page: Path, flown: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _run_examples(page, flown, tmp_path, monkeypatch)


def _run_examples(page: Path, flown: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(flown / "runs", folder / "runs")
    if page.parent == DOCS / "tutorials" or page == ROOT / "README.md":
        shutil.rmtree(folder / "runs")  # a tutorial starts from nothing
    run_page(page, folder, monkeypatch, {})


def run_page(page: Path, folder: Path, monkeypatch: pytest.MonkeyPatch, names: dict[str, Any]) -> None:
    """Do what a page says, in `folder`, its Python in the namespace `names`; then forget the plugins of the page."""
    from skyrange.assembly.build import build
    from skyrange.contracts.plugins import registry as plugins
    from skyrange.scenario.toml_files import load_file

    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setattr(plugins, "_registered", dict(plugins._registered))
    monkeypatch.setattr(plugins, "_loaded_files", {})
    before = set(sys.modules)
    names["__name__"] = "__main__"
    try:
        for block in blocks(page):
            where = f"{page.relative_to(ROOT)}:{block.line}"
            if block.words[1:2] == ("scenario",):
                path = folder / block.words[2]
                path.write_text(block.text, encoding="utf-8")
                build(load_file(path))
            elif block.words[1:2] == ("file",):
                (folder / block.words[2]).write_text(block.text, encoding="utf-8")
            elif block.words == ("python", "run"):
                exec(compile("\n" * block.line + block.text, where, "exec", dont_inherit=True), names)
            elif block.words == ("console", "run"):
                for arguments in console_lines(block):
                    _command_line(arguments, where)
    finally:
        for name in set(sys.modules) - before:
            if str(getattr(sys.modules[name], "__file__", "")).startswith(str(folder)):
                del sys.modules[name]


def _command_line(arguments: list[str], where: str) -> None:
    from skyrange.cli.app import app

    code: object = 0
    try:
        app(arguments, standalone_mode=False)
    except SystemExit as ended:
        code = ended.code
    assert not code, f"{where}: skyrange {' '.join(arguments)} exits with {code}"


@pytest.mark.rotating
def test_readme_scenario_and_python_are_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The README says that its TOML and its Python give the same fingerprint."""
    from skyrange import run

    monkeypatch.chdir(tmp_path)
    found = {block.words[:2]: block.text for block in blocks(ROOT / "README.md")}
    Path("first.toml").write_text(found["toml", "scenario"], encoding="utf-8")
    names: dict[str, Any] = {}
    exec(found["python", "run"], names)
    assert names["record"].manifest["digests"] == run("first.toml").manifest["digests"]


# ---------------------------------------------------------------- references that are written by hand


def test_manifest_keys_are_described(flown: Path) -> None:
    manifest = json.loads((flown / "runs" / "squares" / "manifest.json").read_text(encoding="utf-8"))
    page = (DOCS / "reference" / "run-folder.md").read_text(encoding="utf-8")
    assert not [key for key in manifest if f"`{key}`" not in page]


def test_files_of_a_run_are_described(flown: Path) -> None:
    page = (DOCS / "reference" / "run-folder.md").read_text(encoding="utf-8")
    folder = flown / "runs" / "squares"
    for path in folder.iterdir():
        assert f"`{path.name}" in page, path.name


def test_kinds_of_notes_are_described() -> None:
    """Every `event.…` and `decision.…` that the sources name stands in the reference, and no other."""
    said: set[str] = set()
    for source in (ROOT / "src" / "skyrange").rglob("*.py"):
        if "testing" not in source.parts:
            said |= set(KINDS.findall(source.read_text(encoding="utf-8")))
    page = (DOCS / "reference" / "run-notes.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^\| `((?:event|decision)\.[a-z_]+)", page, re.MULTILINE))
    assert listed == said


def test_exports_are_listed_once_on_the_pages_of_their_modules() -> None:
    pages = (DOCS / "reference" / "api").glob("*.md")
    listed: dict[str, list[str]] = {}
    for block in (block for page in pages for block in blocks(page) if block.words[:1] == ("api",)):
        listed.setdefault(block.words[1], []).extend(block.text.split())
    for module in FACADE:
        public = [name for name in importlib.import_module(module).__all__ if not name.startswith("_")]
        assert sorted(listed[module]) == sorted(public), module


def test_decisions_are_numbered_once_and_without_a_gap_that_the_index_does_not_name() -> None:
    pages = sorted((DOCS / "decisions").glob("0*.md"))
    index = (DOCS / "decisions" / "README.md").read_text(encoding="utf-8")
    listed = re.findall(r"^- \[(.+?)\]\(([^)]+)\)", index, re.MULTILINE)
    assert sorted(listed) == [(page.read_text(encoding="utf-8").partition("\n")[0][2:], page.name) for page in pages]
    left_out = re.findall(r"\b0\d{3}\b", index.partition("\n- ")[0])
    archived = [title[:4] for title, _ in archived_decisions()]
    numbers = sorted([*left_out, *archived, *(page.name[:4] for page in pages)])
    assert numbers == [f"{number:04}" for number in range(1, len(numbers) + 1)]


def test_decisions_are_whole_and_short() -> None:
    """Each page of the decisions says the choice, reasons, costs, and how to undo it, on half a page."""
    for page in sorted((DOCS / "decisions").glob("0*.md")):
        text = page.read_text(encoding="utf-8")
        heads = re.findall(r"^## (.+)$", text, re.MULTILINE)
        assert heads == ["Decision", "Reasons", "Costs", "How to undo it"], page.name
        assert len(text.split()) < 320, page.name
    for title, text in archived_decisions():
        assert 20 < len(text.split()) < 160, title


def archived_decisions() -> list[tuple[str, str]]:
    """Title and text of each decision in the archive, in the order of their numbers."""
    archive = (DOCS / "decisions" / "archive.md").read_text(encoding="utf-8")
    return re.findall(r"^## (\d{4}\. .+)\n\n((?:(?!^## ).*\n)+)", archive, re.MULTILINE)


def test_the_conformance_suite_is_run_at_the_commit_of_the_results() -> None:
    howto, results = (
        (DOCS / page).read_text(encoding="utf-8")
        for page in ("how-to/run-the-conformance-suite.md", "reference/utm-conformance.md")
    )
    commit = re.search(r"interuss/monitoring at commit (\w+)", results)
    assert commit is not None
    assert f"checkout --recurse-submodules {commit[1]}\n" in howto
