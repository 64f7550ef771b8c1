"""Measured worth of the kinds of defences: their examples flown with the defence and with it muted, attacked and not.

`python -m tools.docs.measure_defences [KIND …]` flies the examples (all of them unless named), over `SEEDS` seeds each,
and rewrites their sections of `docs/reference/defence-effects.md` and their figures in `docs/images/defences`.
Differences are those of the attacked run from its baseline, as in `tools/docs/measure_attacks.py`.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from skyrange.report.pair.page import draw_pair_plan
from skyrange.scenario.shipped import DEFENCE_EXAMPLES, load
from skyrange.statistics.means import estimate_mean
from skyrange.study.matrix.cells import Cell, join_seeds, measure_cell
from skyrange.study.pairing import pair
from skyrange.twins.arms import NOMINAL
from skyrange.twins.pair_folder import Pair
from tools.docs.measure_attacks import SECTION, describe_effects, tell_story, write

ROOT: Final = Path(__file__).parents[2]
PAGE: Final = ROOT / "docs" / "reference" / "defence-effects.md"
IMAGES: Final = ROOT / "docs" / "images" / "defences"
SEEDS: Final = 5


def main(kinds: Sequence[str]) -> None:
    """Fly, measure, and renew the page."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    for kind in kinds or sorted(DEFENCE_EXAMPLES):
        with tempfile.TemporaryDirectory() as folder:
            section = measure(kind, Path(folder))
        sections = {**dict(SECTION.findall(PAGE.read_text(encoding="utf-8"))), kind: section}
        write(PAGE, {one: sections[one] for one in sorted(sections) if one in DEFENCE_EXAMPLES})
        print(kind, flush=True)


def measure(kind: str, folder: Path) -> str:
    """The section of a kind: its story, its figure, the effects with and without it, and its alarms."""
    path = str(DEFENCE_EXAMPLES[kind])
    acting = pair(load(path), folder / "acting", arms="sham", seeds=SEEDS)
    muted = pair(load(path, ["defences.*.muted=true"]), folder / "muted", arms="baseline", seeds=SEEDS)
    draw_pair_plan(acting).save(IMAGES / f"{kind}.svg")
    lines = [f"## `{kind}`", "", tell_story(Path(path)), ""]
    lines += [f"![Plan view: attacked and nominal flight, with the defence](../images/defences/{kind}.svg)", ""]
    lines += [*_table(muted, acting), "", _describe_alarms(acting)]
    return "\n".join(lines) + "\n"


def _table(muted: Pair, acting: Pair) -> list[str]:
    """Every difference that is not zero without the defence or with it, as lines of Markdown."""
    first, second = (
        {what: (mean, bounds) for what, mean, bounds in describe_effects(pair)} for pair in (muted, acting)
    )
    rows = [what for what in dict.fromkeys([*first, *second]) if not what.startswith(("events", "frames"))]
    if not rows:
        return ["No aircraft flies otherwise, with the defence or without it."]
    head = [f"| attacked minus {acting.baseline} | without the defence | with it |", "|---|---|---|"]
    return head + [f"| {what} | {_cell(first.get(what))} | {_cell(second.get(what))} |" for what in rows]


def _cell(effect: tuple[str, str] | None) -> str:
    return "none" if effect is None else f"{effect[0]} ({re.sub(' without it$', '', effect[1])})"


def _describe_alarms(acting: Pair) -> str:
    """When the first alarm came, and how many came without an attack."""
    detectors = [row["id"] for row in acting.run(NOMINAL).manifest["defences"]]
    each = [{arm: acting.run(arm, seed) for arm in acting.arms} for seed in acting.seeds]
    cell = join_seeds([measure_cell(runs, Cell("", ""), "departure_m", detectors) for runs in each])
    alarms_s = [at for at in cell.alarms_s if at is not None]
    mean = estimate_mean(alarms_s)
    when = "No alarm"
    if mean is not None:
        when = f"First alarm {mean.mean:.1f} s after the attack began, with {len(alarms_s)} of {SEEDS} seeds"
    hours = sum(cell.flown_h)
    return f"{when}. Without an attack: {sum(cell.false_alarms)} alarms in {60 * hours:.0f} minutes of flight."


if __name__ == "__main__":
    main(sys.argv[1:])
