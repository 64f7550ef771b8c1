"""Measured effects of the kinds of attacks and faults: their examples flown beside their twins, over ten seeds each.

`python -m tools.docs.measure_attacks [NAME …]` flies the examples (all of them unless named), and rewrites their
sections of `docs/reference/attack-effects.md` or `fault-effects.md` and their figures in `docs/images/attacks` or
`faults`. Of a scenario in `NAMED` it rewrites the table on its own page; `tools/docs/pictures.py` draws its figure.
What an ArduCopter does is read from the tables of `docs/reference/parity-results.md`; the name `arducopter` renews it.
Differences are those of the attacked run from its baseline: the sham of an attack that lies, and the nominal run of one
that works by load and of a fault.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Final

from skyrange.attack.contract import AttackPlugin
from skyrange.attack.techniques import describe_technique
from skyrange.metrics.links import link_statistics
from skyrange.metrics.time_series import read_notes
from skyrange.record import RunRecord
from skyrange.report.pair.page import draw_pair_plan
from skyrange.scenario.shipped import EXAMPLES, FAULT_EXAMPLES, load, source_of
from skyrange.statistics.means import Interval, estimate_mean
from skyrange.study.pairing import pair
from skyrange.twins.pair_folder import Pair
from tools.docs.plugin_kinds import page_of

ROOT: Final = Path(__file__).parents[2]
PAGE: Final = ROOT / "docs" / "reference" / "attack-effects.md"
FAULT_PAGE: Final = ROOT / "docs" / "reference" / "fault-effects.md"
PARITY_PAGE: Final = ROOT / "docs" / "reference" / "parity-results.md"
PUBLISHED_PAGE: Final = ROOT / "docs" / "reference" / "published-attacks.md"
SCENARIO_PAGES: Final = ROOT / "docs" / "reference" / "scenarios"
NAMED: Final = (
    "falsified-log", "gcs-flood", "gnss-pull-off", "hijack", "insider", "jam-then-spoof", "jammed-corridor",
    "mitm-mission",
)  # fmt: skip
"""Shipped scenarios whose pages have a measured table."""
PUBLISHED: Final[Mapping[str, tuple[str, Sequence[str]]]] = {
    "denial of service": ("`gcs`", ("gcs-flood", "link.flood", "link.drop")),
    "Remote ID spoofing": ("`rid_up`", ("remote_id.spoof",)),
    "man in the middle": ("`gcs`", ("mitm-mission", "link.delay", "mavlink.mission_alter", "link.reorder")),
    "GPS or position spoofing": ("`log`", ("falsified-log", "telemetry.position")),
    "jamming": ("`gcs`", ("link.drop", "link.delay", "link.corrupt")),
    "arbitrary control injection": ("`gcs`", ("hijack", "mavlink.command", "mavlink.mode", "mavlink.guided")),
    "malicious input": ("`gcs`, `log`", ("mavlink.malformed", "mavlink.mission_replace")),
}
"""By name in the publication: the links that it names, and the named scenarios and kinds."""
IMAGES: Final = ROOT / "docs" / "images"
SEEDS: Final = 10
FEWEST: Final = 0.5
"""A difference of counts is told from half an event per flight on."""
SECTION: Final = re.compile(r"<!-- measured: (\S+) -->\n(.*?)<!-- end: \1 -->\n", re.DOTALL)

MEASURES: Final[Mapping[str, tuple[str, str, float]]] = {
    "delay_s": ("delay of the mission", "s", 1.0),
    "departure_m": ("departure from the twin", "m", 1.0),
    "extra_distance_m": ("additional way", "m", 1.0),
    "extra_energy_j": ("additional energy", "kJ", 1e-3),
    "near_misses": ("near misses", "", 1.0),
    "collisions": ("collisions", "", 1.0),
}
"""Columns of `effects.parquet`: title, unit, factor."""


def main(names: Sequence[str]) -> None:
    """Fly, measure, and renew the pages."""
    if list(names) == ["arducopter"]:
        sections = dict(SECTION.findall(PAGE.read_text(encoding="utf-8")))
        write(PAGE, sections)
        write_published(sections)
        return
    for kind in names or [*sorted(EXAMPLES), *sorted(FAULT_EXAMPLES), *NAMED]:
        if kind in NAMED:
            write_named(kind)
            write_published(dict(SECTION.findall(PAGE.read_text(encoding="utf-8"))))
            print(kind, flush=True)
            continue
        page, examples = (FAULT_PAGE, FAULT_EXAMPLES) if kind in FAULT_EXAMPLES else (PAGE, EXAMPLES)
        with tempfile.TemporaryDirectory() as folder:
            section = measure(kind, Path(folder) / kind)
        sections = {**dict(SECTION.findall(page.read_text(encoding="utf-8"))), kind: section}
        write(page, {kind: sections[kind] for kind in sorted(sections) if kind in examples})
        if page == PAGE:
            write_published(sections)
        print(kind, flush=True)


def write(page: Path, sections: Mapping[str, str]) -> None:
    """Replace the sections of a page."""
    text = page.read_text(encoding="utf-8")
    head = text[: match.start()] if (match := SECTION.search(text)) else text
    if page == PAGE:
        sections = {kind: _with_arducopter(kind, section) for kind, section in sections.items()}
    body = "\n".join(
        f"<!-- measured: {kind} -->\n{section}<!-- end: {kind} -->\n" for kind, section in sections.items()
    )
    page.write_text(f"{head.rstrip()}\n\n{body}", encoding="utf-8")


@cache
def reactions() -> Mapping[str, tuple[str, str]]:
    """What the builtin and ArduCopter do under each kind: over ten seeds where the page has them, else with one."""
    found: dict[str, tuple[str, str]] = {}
    pairs: dict[str, list[str]] = {}
    for line in PARITY_PAGE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split(" | ")]
        if not line.startswith("| `"):
            continue
        kind = cells[0].strip("`")
        if len(cells) == 6 and kind in EXAMPLES and not cells[5].startswith("does not apply"):
            found.setdefault(kind, (f"{cells[1]} (seed of the example)", f"{cells[2]} (seed of the example)"))
        elif len(cells) == 5 and cells[1] in ("builtin", "ArduCopter"):
            pairs.setdefault(kind, []).append(f"{cells[2]} of {SEEDS}; {cells[3]}; {cells[4]}")
    return found | {kind: (first, second) for kind, (first, second) in pairs.items()}


_ARDUCOPTER: Final = "Reaction of the builtin: "


def _with_arducopter(kind: str, section: str) -> str:
    """A section with the line that compares the builtin with ArduCopter, if both have flown the example."""
    kept = "\n".join(line for line in section.splitlines() if not line.startswith(_ARDUCOPTER)).rstrip("\n")
    if kind not in reactions():
        return f"{kept}\n"
    first, second = reactions()[kind]
    return f"{kept}\n\n{_ARDUCOPTER}{first}. Of ArduCopter: {second}. [Parity](../explanation/parity.md#attacks)\n"


def write_named(name: str) -> None:
    """Fly a named scenario and renew the table on its page."""
    with tempfile.TemporaryDirectory() as folder:
        flown = pair(load(name), Path(folder) / name, seeds=SEEDS)
        table = "\n".join(_table(flown, "attacked"))
    page = SCENARIO_PAGES / f"{name}.md"
    block = f"<!-- measured: {name} -->\n{table}\n<!-- end: {name} -->\n"
    page.write_text(SECTION.sub(lambda _: block, page.read_text(encoding="utf-8")), encoding="utf-8")


def write_published(sections: Mapping[str, str]) -> None:
    """Renew the table of the published attacks from the sections of the kinds."""
    pages = [(SCENARIO_PAGES / f"{name}.md").read_text(encoding="utf-8") for name in NAMED]
    sections = {**sections, **dict(section for page in pages for section in SECTION.findall(page))}
    rows = [
        "| published attack | link | kind or scenario | measured effect | reaction of ArduCopter |",
        "|---|---|---|---|---|",
    ]
    for attack, (link, kinds) in PUBLISHED.items():
        for kind in kinds:
            target = f"scenarios/{kind}.md" if kind in NAMED else page_of(kind)
            _, arducopter = reactions().get(kind, ("", "not flown"))
            rows.append(f"| {attack} | {link} | [`{kind}`]({target}) | {_first(sections, kind)} | {arducopter} |")
            attack = link = ""
    table = "\n".join(rows)
    text = PUBLISHED_PAGE.read_text(encoding="utf-8")
    block = f"<!-- measured: published -->\n{table}\n<!-- end: published -->\n"
    PUBLISHED_PAGE.write_text(SECTION.sub(lambda _: block, text), encoding="utf-8")


def _first(sections: Mapping[str, str], kind: str) -> str:
    """The first differences of a section, in one line."""
    rows = [row.strip("| ").split(" | ") for row in sections.get(kind, "").splitlines() if row.startswith("| ")]
    effects = [f"{what} {mean} ({bounds})" for what, mean, bounds in (row for row in rows[1:] if len(row) == 3)]
    return "; ".join(effects[:2]) or "not measured"


def measure(kind: str, folder: Path) -> str:
    """The section of a kind: its story, its figure and its differences."""
    scenario = load(kind)
    is_fault = kind in FAULT_EXAMPLES
    flown = pair(scenario, folder, seeds=SEEDS)
    images = IMAGES / ("faults" if is_fault else "attacks")
    images.mkdir(parents=True, exist_ok=True)
    draw_pair_plan(flown).save(images / f"{kind}.svg")
    lines = [f"## `{kind}`", "", tell_story(source_of(kind)), ""]
    if is_fault:
        lines += [f"![Plan view: flight with the fault, and nominal flight](../images/faults/{kind}.svg)", ""]
    else:
        technique = describe_technique(AttackPlugin.find(kind).technique)
        lines += [f"Technique: {technique}.", ""]
        lines += [f"![Plan view: attacked and nominal flight](../images/attacks/{kind}.svg)", ""]
    lines += _table(flown, "with the fault" if is_fault else "attacked")
    return "\n".join(lines) + "\n"


def _table(flown: Pair, arm: str) -> list[str]:
    """The differences of the attacked run from its baseline, as lines of Markdown."""
    baseline = flown.baseline or "nominal"
    rows = describe_effects(flown)
    if not rows:
        return [f"No difference from the {baseline} run in motion, events or delivered frames."]
    head = [f"| {arm} minus {baseline} | mean of {SEEDS} seeds | 95 % |", "|---|---|---|"]
    return head + [f"| {what} | {mean} | {bounds} |" for what, mean, bounds in rows]


def describe_effects(flown: Pair) -> list[tuple[str, str, str]]:
    """Every difference of the attacked run from its baseline that is not zero: what, its mean, and its interval."""
    baseline = flown.baseline or "nominal"
    return _effects(flown, baseline) + _counts(flown, baseline)


def tell_story(source: Path) -> str:
    """What the comments of a scenario's file say."""
    lines = source.read_text(encoding="utf-8").splitlines()
    return " ".join(line.lstrip("# ").strip() for line in lines if line.startswith("#"))


def _effects(flown: Pair, baseline: str) -> list[tuple[str, str, str]]:
    rows = [row for row in flown.effects.to_pylist() if row["against"] == baseline]
    effects = []
    for vehicle in sorted({row["vehicle"] for row in rows}):
        flights = [row for row in rows if row["vehicle"] == vehicle]
        done = sum(row["outcome"] == "complete" for row in flights)
        twin = sum(row["outcome_twin"] == "complete" for row in flights)
        if done != twin:
            effects.append(
                (f"{vehicle}: missions complete", f"{done} of {len(flights)}", f"{twin} of {len(flights)} without it")
            )
        for column, (title, unit, factor) in MEASURES.items():
            samples = [
                factor * (row[column] - (row.get(f"{column}_twin") or 0.0))
                for row in flights
                if row[column] is not None
            ]
            effects += _row(f"{vehicle}: {title}", unit, estimate_mean(samples))
    return effects


def _row(what: str, unit: str, value: Interval | None) -> list[tuple[str, str, str]]:
    """A difference whose interval excludes zero; one without an interval where all seeds agree, or most of them.

    One seed alone, because the others did not complete their missions, shows none.
    """
    if value is None or value.n == 1 or abs(value.mean) < 0.05:
        return []
    mean = f"{value.mean:+.1f} {unit}".rstrip()
    if value.low is None or value.high is None:
        return [(what, mean, value.without)]
    return [(what, mean, f"{value.low:+.1f} to {value.high:+.1f}")] if value.excludes_zero else []


def _counts(flown: Pair, baseline: str) -> list[tuple[str, str, str]]:
    frames = _count_rows(flown, baseline, "frames delivered on", _delivered)
    return _count_rows(flown, baseline, "events", _events) + fold_frames(frames)


FRAMES: Final = "frames delivered, fwd / rev"


def fold_frames(rows: Sequence[tuple[str, str, str]]) -> list[tuple[str, str, str]]:
    """One row for all kinds of links of the rows "frames delivered on `link, direction`", with their means."""
    means: dict[str, dict[str, str]] = {}
    for what, mean, _ in rows:
        link, _, direction = what.rpartition("`")[0].rpartition("`")[2].partition(", ")
        means.setdefault(link, {})[direction] = mean
    if not means:
        return []
    listed = (f"`{link}` {of.get('fwd', '–')} / {of.get('rev', '–')}" for link, of in sorted(means.items()))
    return [(FRAMES, ", ".join(listed), "means")]


def _count_rows(
    flown: Pair, baseline: str, title: str, count: Callable[[RunRecord], Counter[str]]
) -> list[tuple[str, str, str]]:
    attacked = [count(flown.run("attacked", seed)) for seed in flown.seeds]
    without = [count(flown.run(baseline, seed)) for seed in flown.seeds]
    found = []
    for name in sorted(set().union(*attacked, *without)):
        value = estimate_mean([float(a[name] - b[name]) for a, b in zip(attacked, without, strict=True)])
        if value is not None and abs(value.mean) >= FEWEST:
            found += _row(f"{title} `{name}`", "", value)
    return found


_ANNOUNCED: Final = ("event.attack", "event.fault")


def _events(run: RunRecord) -> Counter[str]:
    return Counter(note.kind for note in read_notes(run, "events") if not note.kind.startswith(_ANNOUNCED))


def _delivered(run: RunRecord) -> Counter[str]:
    delivered: Counter[str] = Counter()
    for statistics in link_statistics(run):
        delivered[f"{statistics.kind}, {statistics.direction}"] += statistics.delivered
    return delivered


if __name__ == "__main__":
    main(sys.argv[1:])
