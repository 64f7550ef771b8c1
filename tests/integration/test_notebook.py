"""Do the tutorials' notebooks run as their readers run them, and are they kept without outputs?"""

from __future__ import annotations

import ast
import importlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from skyrange.study.design.blocks import check_blocks, list_blocks

nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed: pip install 'skyrange[dev]'")
nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: pip install 'skyrange[dev]'")
pytest.importorskip("ipykernel", reason="ipykernel is not installed: pip install 'skyrange[dev]'")

TUTORIALS = Path(__file__).parents[2] / "docs" / "tutorials"
NOTEBOOK = TUTORIALS / "squares.ipynb"
STUDY = TUTORIALS / "a-study.ipynb"


@pytest.mark.parametrize("path", sorted(TUTORIALS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebook_is_kept_without_outputs(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == []
            assert cell.execution_count is None


def read_tree(path: Path) -> ast.Module:
    """The code of a notebook, cell after cell."""
    cells = nbformat.read(path, as_version=4).cells
    return ast.parse("\n".join(cell.source for cell in cells if cell.cell_type == "code"))


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
    """Bind the arguments of each call to a function of skyrange that is imported; the names of those functions."""
    called = []
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
            continue
        function: Callable[..., Any] | None = imported.get(node.func.id)
        if function is not None and function.__module__.startswith("skyrange."):
            options = {str(keyword.arg): keyword.value for keyword in node.keywords}
            inspect.signature(function).bind(*node.args, **options)
            called.append(node.func.id)
    return called


@pytest.mark.parametrize("path", sorted(TUTORIALS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_what_a_notebook_imports_and_calls_is_there(path: Path) -> None:
    if path == STUDY:
        pytest.importorskip("duckdb", reason="duckdb is not installed: pip install 'skyrange[study]'")
    tree = read_tree(path)
    imported = read_imports(tree)
    used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    assert used >= imported.keys(), "an import that is not used"
    assert len(check_calls(tree, imported)) >= 5


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
    assert len(blocks) * len(study.arms) == 72
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
def test_notebook_flies_the_five_squares(tmp_path: Path) -> None:
    """It runs in a kernel of its own; all missions are flown and its figures are drawn."""
    from skyrange import load

    notebook = nbformat.read(NOTEBOOK, as_version=4)
    client = nbclient.NotebookClient(
        notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    record = load(tmp_path / "runs" / "squares")
    assert [record.outcomes[vehicle]["state"] for vehicle in sorted(record.outcomes)] == ["complete"] * 5
    assert set(record.outcomes) == {"blue/b1", "blue/b2", "green/g1", "green/g2", "green/g3"}
    drawn = [
        output
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
        if "image/svg+xml" in output.get("data", {})
    ]
    assert len(drawn) == 3


def test_notebook_is_about_as_long_as_the_published_snippet() -> None:
    """The published listing (UAV-CYBER-SIM, section IV.B) has 46 lines of code besides imports and comments."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    lines = [
        line
        for cell in notebook.cells
        if cell.cell_type == "code"
        for line in cell.source.splitlines()
        if line.strip() and not line.startswith(("from ", "import "))
    ]
    assert len(lines) <= 46


@pytest.mark.slow
def test_the_notebook_of_a_study_goes_from_a_question_to_a_figure(tmp_path: Path) -> None:
    for module in ("scipy", "duckdb", "mlcroissant"):
        pytest.importorskip(module, reason=f"{module} is not installed: pip install 'skyrange[study]'")
    from skyrange.analysis import read_study_results

    notebook = nbformat.read(STUDY, as_version=4)
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=600, kernel_name="python3", resources=resources).execute()
    runs = read_study_results(tmp_path / "studies" / "jumps", "runs").to_pylist()
    assert [row["status"] for row in runs] == ["complete"] * 72
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert sum("image/svg+xml" in output.get("data", {}) for output in outputs) == 1
    text = "".join(output.get("text", "") for output in outputs)
    assert text.index("1 gnss") < text.index("always")
    assert (tmp_path / "jumps-data" / "croissant.json").is_file()
