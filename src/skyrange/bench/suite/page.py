"""Page of the results of all benchmarks as one HTML file, and their tables in Markdown."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from skyrange.bench.suite.comparison import compare_results, list_differences, list_warnings
from skyrange.bench.suite.figures import draw_changes, draw_memory, draw_speeds
from skyrange.bench.suite.results import Results
from skyrange.bench.suite.tables import Table, list_facts, list_skipped, make_load_table, make_tables
from skyrange.core.files import atomic_write
from skyrange.report.rendering import asset, content_policy, render

MEMORY_TEXT: Final = """\
Resident memory of all processes of a case together, from its start to its end. Pages that processes share count for
each of them, so a case of several processes takes less than this.
"""


def write_page(results: Results, path: Path, old: Results | None = None) -> None:
    """Write the page of the results, compared with `old` ones if there are some. Raises `OSError`."""
    with atomic_write(path) as file:
        file.write(make_page(results, old).encode())


def make_page(results: Results, old: Results | None = None) -> str:
    """The page of the results as HTML, which loads nothing."""
    style = asset("style.css") + asset("bench.css")
    before = {} if old is None else {(one.name, case.name): case.memory for one, case in old.cases()}
    memories = [
        (
            benchmark.name,
            case.name,
            case.memory.peak_mb,
            case.memory.processes,
            draw_memory(case.memory, f"{benchmark.name}, {case.name}", before.get((benchmark.name, case.name))),
        )
        for benchmark, case in results.cases()
        if case.memory.resident_mb
    ]
    was = dict(list_facts(results if old is None else old))
    facts = [(name, value, was[name]) for name, value in list_facts(results)]
    return str(
        render(
            "bench/page.html.jinja",
            policy=content_policy(style),
            title="Benchmarks · skyrange",
            style=style,
            compared=old is not None,
            machine=results.machine,
            started=f"{results.started:%Y-%m-%d %H:%M} UTC",
            quick=results.quick,
            facts=facts,
            warnings=[*([] if old is None else list_differences(old, results)), *list_warnings(results)],
            speeds=draw_speeds(results, old),
            changes=None if old is None else draw_changes(compare_results(old, results)),
            tables=make_tables(results, old),
            load=make_load_table(results),
            memories=memories,
            memory_text=MEMORY_TEXT,
            skipped=list_skipped(results),
        )
    )


def make_markdown(results: Results) -> str:
    """The tables of the results in Markdown, from headings of the second level on."""
    facts = Table("Machine", "", ("", ""), list_facts(results), 2)
    parts = [*(f"> {warning}\n" for warning in list_warnings(results)), _markdown(facts)]
    parts += [_markdown(table) for table in make_tables(results)]
    parts.append(_markdown(make_load_table(results)))
    if skipped := list_skipped(results):
        parts.append(_markdown(Table("Skipped", "", ("benchmark", "why"), skipped, 2)))
    return "\n".join(parts)


def _markdown(table: Table) -> str:
    lines = [table.head, ["---" if n < table.texts else "---:" for n in range(len(table.head))], *table.rows]
    text = f"{' '.join(table.text.split())}\n\n" if table.text else ""
    rows = "".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)
    return f"## {table.title}\n\n{text}{rows}"
