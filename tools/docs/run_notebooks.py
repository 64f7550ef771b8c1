"""Stored outputs of the tutorials' notebooks.

`python -m tools.docs.run_notebooks [NAME …]` runs the notebooks of `docs/tutorials` (all of them unless named), each in
a kernel and a folder of its own, and stores their outputs in them. A cell with the tag `skip-execution`, which installs
skyrange, is not run. A figure is stored as SVG alone. The notebook keeps the digest of the code that made its outputs;
`tests/integration/test_notebook.py` compares it with the code, and outputs with those of a new run.
"""

from __future__ import annotations

import hashlib
import sys
import tempfile
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any, Final

TUTORIALS: Final = Path(__file__).parents[2] / "docs" / "tutorials"
SKIPPED: Final = "skip-execution"
"""The tag of cells that nbclient does not run."""
DIGEST: Final = "code_of_outputs"
"""The key of the digest in the metadata of a notebook."""
SVG: Final = "image/svg+xml"
TIMEOUT_S: Final = 600


def list_notebooks() -> list[Path]:
    """The notebooks, by name."""
    return sorted(TUTORIALS.glob("*.ipynb"))


def code_cells(notebook: Any) -> list[Any]:
    """The cells of a notebook that are run."""
    return [
        cell for cell in notebook.cells if cell.cell_type == "code" and SKIPPED not in cell.metadata.get("tags", ())
    ]


def digest_code(notebook: Any) -> str:
    """The digest of the code that a notebook runs."""
    return hashlib.sha256("\0".join(cell.source for cell in code_cells(notebook)).encode()).hexdigest()


def execute(notebook: Any, folder: Path) -> None:
    """Run a notebook in `folder`, and put the outputs into it. Raises `CellExecutionError` for a cell that fails."""
    from nbclient import NotebookClient

    resources = {"metadata": {"path": str(folder)}}
    NotebookClient(notebook, timeout=TIMEOUT_S, kernel_name="python3", resources=resources).execute()
    for cell in code_cells(notebook):
        cell.metadata.pop("execution", None)  # the times
        cell.outputs = _join_streams(map(_reduce, cell.outputs))
    notebook.metadata.language_info = {"name": "python"}
    notebook.metadata[DIGEST] = digest_code(notebook)


def _reduce(output: Any) -> Any:
    """An output without what is shown twice."""
    if SVG in output.get("data", {}):
        output.data = {SVG: output.data[SVG]}
        output.metadata = {}
    return output


def _join_streams(outputs: Iterable[Any]) -> list[Any]:
    """Outputs, with one stream for several of one name in a row."""
    joined: list[Any] = []
    for output in outputs:
        if joined and output.output_type == joined[-1].output_type == "stream" and output.name == joined[-1].name:
            joined[-1].text += output.text
        else:
            joined.append(output)
    return joined


def count_figures(notebook: Any) -> int:
    """How many figures the outputs have."""
    return sum(SVG in output.get("data", {}) for cell in code_cells(notebook) for output in cell.outputs)


def main(names: list[str]) -> None:
    """Run notebooks, and store their outputs."""
    nbformat: Any = import_module("nbformat")
    for path in [TUTORIALS / f"{name}.ipynb" for name in names] or list_notebooks():
        notebook = nbformat.reads(path.read_text(encoding="utf-8"), as_version=4)
        with tempfile.TemporaryDirectory() as folder:
            execute(notebook, Path(folder))
        path.write_text(nbformat.writes(notebook) + "\n", encoding="utf-8")
        print(f"{path.name}: {count_figures(notebook)} figures, {path.stat().st_size / 1000:.0f} KB")


if __name__ == "__main__":
    main(sys.argv[1:])
