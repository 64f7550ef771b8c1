"""Handler of `skyrange matrix`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from skyrange.cli.output.console import print_json, print_text, terminal


def matrix(
    file: Path | None,
    out: Path | None,
    rows: Sequence[str],
    columns: Sequence[str],
    seeds: int | None,
    jobs: int | None,
    page: Path | None,
    as_json: bool,
) -> None:
    """`skyrange matrix`."""
    from skyrange.cli.output.matrix_table import print_matrix
    from skyrange.cli.output.progress import compile_if_cold, map_progress
    from skyrange.core.errors import InputError
    from skyrange.study.matrix.flights import describe, fly_matrix
    from skyrange.study.matrix.model import read_matrix, select
    from skyrange.study.matrix.page import write_matrix_page, write_matrix_report
    from skyrange.twins.failed_missions import require_baseline

    chosen = select(read_matrix(file), tuple(rows), tuple(columns))
    if seeds is not None:
        chosen = chosen.model_copy(update={"seeds": seeds})
    if page is not None and not page.parent.is_dir():
        raise InputError.one("matrix", "--page", str(page), "a file in a folder that exists")
    compile_if_cold(quiet=as_json)
    with map_progress(chosen.name, "cells", quiet=as_json) as on_cell:
        result = fly_matrix(chosen, out, jobs=jobs, on_cell=on_cell)
    report = write_matrix_report(result)
    if page is not None:
        write_matrix_page(result, page)
    if as_json:
        print_json(describe(result))
    else:
        print_matrix(terminal(), result)
        print_text(f"matrix {result.path}")
        print_text(f"report {report}")
    require_baseline(result.failed_missions, result.path)
