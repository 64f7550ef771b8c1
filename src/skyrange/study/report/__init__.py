"""Reports: a run, or a pair of runs, on one page that needs no network."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from skyrange.core.files import atomic_write

if TYPE_CHECKING:
    from skyrange.study.series import Record

__all__ = ["write_report"]


def write_report(record: Record, path: str | Path) -> Path:
    """Write the run's report as one self-contained HTML file and return its path.

    `record` is what `skyrange.record.load` returns, of a finished, interrupted or killed run. The page fetches nothing
    (its content security policy forbids it) and stays below about 5 MB: long tracks are thinned, long tables cut,
    and both are said on the page. Raises `OSError` where `path` cannot be written; a half-written file never stands
    there.
    """
    from skyrange.study.report.page import render_run

    target = Path(path)
    page = render_run(record)
    with atomic_write(target) as file:
        file.write(page.encode())
    return target
