"""Does the tutorial's notebook run as its reader runs it, and is it kept without outputs?"""

from __future__ import annotations

from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed: pip install 'skyrange[dev]'")
nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: pip install 'skyrange[dev]'")
pytest.importorskip("ipykernel", reason="ipykernel is not installed: pip install 'skyrange[dev]'")

NOTEBOOK = Path(__file__).parents[2] / "docs" / "tutorials" / "squares.ipynb"


def test_notebook_is_kept_without_outputs() -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
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
