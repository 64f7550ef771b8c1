"""Handler of `skyrange compare`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from skyrange.cli.output.console import print_json, print_text, terminal


def compare(
    name: str,
    variants: Sequence[str],
    out: Path | None,
    seeds: int,
    jobs: int | None,
    seed: int | None,
    buildings: Path | None,
    changes: Sequence[str],
    as_json: bool,
) -> None:
    """`skyrange compare`."""
    from skyrange.cli.output.progress import compile_if_cold, parallel_progress
    from skyrange.cli.output.variants_table import print_comparison
    from skyrange.study.variants import compare_variants, read_variants, write_comparison_report
    from skyrange.twins.failed_missions import require_baseline

    chosen = read_variants(variants)
    compile_if_cold(quiet=as_json)
    with parallel_progress(name, seeds * (len(chosen) + 1), quiet=as_json) as on_progress:
        result = compare_variants(
            name,
            chosen,
            out,
            seeds=seeds,
            jobs=jobs,
            seed=seed,
            buildings=buildings,
            changes=changes,
            on_progress=on_progress,
        )
    report = write_comparison_report(result)
    if as_json:
        print_json({**result.describe(), "path": str(result.path), "report": str(report)})
    else:
        print_comparison(terminal(), result)
        print_text(f"runs   {result.path}")
        print_text(f"report {report}")
    require_baseline(result.failed_missions, result.path)
