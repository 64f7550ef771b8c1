"""Reports: self-contained HTML pages of a run or of a pair of runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from skyrange.core.files import atomic_write

if TYPE_CHECKING:
    from skyrange.record import RunRecord

__all__ = ["write_report"]


def write_report(record: RunRecord, path: str | Path) -> Path:
    """Write the run's report as one self-contained HTML file and return its path.

    `record` is what `skyrange.record.load` returns for a finished, interrupted or killed run. The page fetches nothing;
    its content security policy forbids it. A page of 500 aircraft is smaller than 3 MB, because what the viewer and the
    charts show is thinned and long tables are packed and cut; the page says so. Raises `OSError` if `path` cannot be
    written; the file that was there then stays as it was.
    """
    from skyrange.report.run.page import render_run

    target = Path(path)
    page = render_run(record)
    with atomic_write(target) as file:
        file.write(page.encode())
    return target
