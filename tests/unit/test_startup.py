"""Start-up stays quick because nothing heavy is imported before it is needed."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("numpy", "numba", "pyarrow", "pymavlink", "shapely", "pydantic", "pyproj")


@pytest.mark.parametrize(
    "statement",
    [
        "import skyrange",
        "import skyrange.cli.app",
        "import skyrange.cli.app as a; from typer.testing import CliRunner;"
        "assert CliRunner().invoke(a.app, ['--help']).exit_code == 0",
    ],
)
def test_nothing_heavy_is_imported(statement: str) -> None:
    code = f"{statement}\nimport sys\nprint([m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_root_exports_what_a_first_notebook_needs() -> None:
    import skyrange

    for name in skyrange.__all__:
        assert getattr(skyrange, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = skyrange.nothing  # type: ignore[attr-defined]
