"""Do the tutorials' notebooks run as their readers run them, and do they keep the outputs of their code?"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from skyrange.study.design.blocks import check_blocks, list_blocks
from tools.docs.run_notebooks import DIGEST, code_cells, count_figures, digest_code, execute, list_notebooks

nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed: pip install 'skyrange[dev]'")
pytest.importorskip("nbclient", reason="nbclient is not installed: pip install 'skyrange[dev]'")
pytest.importorskip("ipykernel", reason="ipykernel is not installed: pip install 'skyrange[dev]'")

TUTORIALS = Path(__file__).parents[2] / "docs" / "tutorials"
NOTEBOOK = TUTORIALS / "squares.ipynb"
STUDY = TUTORIALS / "a-study.ipynb"
MAX_BYTES = 300_000

each_notebook = pytest.mark.parametrize("path", list_notebooks(), ids=lambda path: path.stem)


_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")


def read_texts(notebook: Any) -> list[tuple[str, list[float]]]:
    """The text that each cell printed or returned, without spaces and with `#` for each number; and the numbers."""
    texts = []
    for cell in code_cells(notebook):
        shown = [output.get("text") or output.get("data", {}).get("text/plain", "") for output in cell.outputs]
        text = "".join("".join(shown).split())
        texts.append((_NUMBER.sub("#", text), [float(number) for number in _NUMBER.findall(text)]))
    return texts


@each_notebook
def test_notebook_keeps_the_outputs_of_its_code(path: Path) -> None:
    """After a change: python -m tools.docs.run_notebooks NAME."""
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert notebook.metadata[DIGEST] == digest_code(notebook), "the code was changed; run the notebook again"
    cells = code_cells(notebook)
    assert [cell.execution_count for cell in cells] == [*range(1, len(cells) + 1)]
    assert count_figures(notebook) >= 1
    assert path.stat().st_size < MAX_BYTES


@each_notebook
def test_the_first_code_of_a_notebook_installs_skyrange(path: Path) -> None:
    """Readers in Colab run it; nbclient skips it."""
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    assert cells[0].source.startswith("%pip install --quiet ")
    assert cells[0].metadata.tags == ["skip-execution"]
    assert not any(line.startswith(("%", "!")) for cell in cells[1:] for line in cell.source.splitlines())


def read_tree(path: Path) -> ast.Module:
    """The code of a notebook, cell after cell."""
    return ast.parse("\n".join(cell.source for cell in code_cells(nbformat.read(path, as_version=4))))


def read_imports(tree: ast.Module) -> dict[str, Any]:
    """What the code imports, by name."""
    names: dict[str, Any] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.asname or alias.name: importlib.import_module(alias.name) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = importlib.import_module(str(node.module))
            names |= {alias.asname or alias.name: getattr(module, alias.name) for alias in node.names}
    return names


def check_calls(tree: ast.Module, imported: dict[str, Any]) -> list[str]:
    """Bind the arguments of each call to what is imported from skyrange, by its name or as an attribute of the package;
    the names of what is called.
    """
    called = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func)
        package, _, attribute = name.partition(".")
        callee: Callable[..., Any] | None = imported.get(name)
        if package == "skyrange" and attribute.isidentifier():
            callee = getattr(imported[package], attribute)
        if callee is not None and callee.__module__.startswith("skyrange."):
            options = {str(keyword.arg): keyword.value for keyword in node.keywords}
            inspect.signature(callee).bind(*node.args, **options)
            called.append(name)
    return called


@each_notebook
def test_what_a_notebook_imports_and_calls_is_there(path: Path) -> None:
    if path == STUDY:
        pytest.importorskip("duckdb", reason="duckdb is not installed: pip install 'skyrange[study]'")
    tree = read_tree(path)
    imported = read_imports(tree)
    used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    assert used >= imported.keys(), "an import that is not used"
    assert check_calls(tree, imported)


def test_the_study_of_its_notebook_is_right() -> None:
    """Its scenario, arms, factors, draws and detectors exist, and each of its runs can be built."""
    (statement,) = [
        node
        for node in read_tree(STUDY).body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "study"
    ]
    from skyrange.analysis import Factor, Study

    study: Study = eval(ast.unparse(statement.value), {"Factor": Factor, "Study": Study})
    blocks = list_blocks(study)
    assert len(blocks) * len(study.arms) == 36
    check_blocks(study, blocks)


def test_the_cells_of_the_squares_draw_three_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process, with a flight that ends before the aircraft have taken off."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    drawn = 0
    for statement in read_tree(NOTEBOOK).body:
        if isinstance(statement, ast.Expr):
            drawn += hasattr(eval(ast.unparse(statement.value), names), "_repr_svg_")
        else:
            exec(ast.unparse(statement).replace("duration_s=60", "duration_s=8"), names)
    assert drawn == 3
    assert names["record"].manifest["simulated_s"] == 8.0
    assert set(names["record"].outcomes) == {"blue/b1", "blue/b2", "green/g1", "green/g2", "green/g3"}


@pytest.mark.slow
@each_notebook
def test_notebook_runs_and_gives_the_outputs_that_it_keeps(path: Path, tmp_path: Path) -> None:
    """It runs in a kernel of its own. Other processors may round differently, so numbers may differ a little."""
    if path == STUDY:
        for module in ("scipy", "duckdb", "mlcroissant"):
            pytest.importorskip(module, reason=f"{module} is not installed: pip install 'skyrange[study]'")
    kept, made = (nbformat.read(path, as_version=4) for _ in range(2))
    execute(made, tmp_path)
    assert count_figures(made) == count_figures(kept)
    for (text, numbers), (kept_text, kept_numbers) in zip(read_texts(made), read_texts(kept), strict=True):
        assert text == kept_text
        assert numbers == pytest.approx(kept_numbers, rel=0.02, abs=0.11)
    if path == NOTEBOOK:
        check_squares(tmp_path)
    if path == STUDY:
        check_study(tmp_path, made)


def check_squares(folder: Path) -> None:
    """All missions are flown."""
    from skyrange import load

    outcomes = load(folder / "runs" / "squares").outcomes
    assert {vehicle: outcome["state"] for vehicle, outcome in outcomes.items()} == dict.fromkeys(
        ("blue/b1", "blue/b2", "green/g1", "green/g2", "green/g3"), "complete"
    )


def check_study(folder: Path, notebook: Any) -> None:
    """All runs are complete, the data set is there, and the detector ranks before the floor `always`."""
    from skyrange.analysis import read_study_results

    runs = read_study_results(folder / "studies" / "jumps", "runs").to_pylist()
    assert [row["status"] for row in runs] == ["complete"] * 36
    text = "".join(text for text, _ in read_texts(notebook))
    assert text.index("gnss") < text.index("always")
    assert (folder / "jumps-data" / "croissant.json").is_file()


def test_notebook_is_about_as_long_as_the_published_snippet() -> None:
    """The published listing (UAV-CYBER-SIM, section IV.B) has 46 lines of code besides imports and comments."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    lines = [
        line
        for cell in code_cells(notebook)
        for line in cell.source.splitlines()
        if line.strip() and not line.startswith(("from ", "import "))
    ]
    assert len(lines) <= 46
