"""Do the tutorials' notebooks run as their readers run them, and are they kept without outputs?"""

from __future__ import annotations

from pathlib import Path

import pytest

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
