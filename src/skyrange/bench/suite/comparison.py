"""Comparison of two results of all benchmarks: measures old and new, and what speaks against comparing them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

from skyrange.bench.suite.results import CaseResult, Machine, Measure, Results

MARKED: Final = 0.1
"""Share by which a measure has to differ to be called better or worse."""
LOAD_DIFFERS_CORES: Final = 0.2
"""Difference of the cores used by other programs from which two cases ran under different loads."""
YARDSTICK_DIFFERS: Final = 0.1
"""Share by which yardsticks differ from which the machine was not equally fast."""
QUIET_CORES: Final = 0.1
"""Cores that other programs may use on a machine that is called quiet."""


class Change(NamedTuple):
    """A measure in two results."""

    benchmark: str
    case: str
    row: str
    old: Measure
    new: Measure

    @property
    def ratio(self) -> float | None:
        """New over old; `None` if one is missing or the old one is 0."""
        if self.old.value is None or self.new.value is None or not self.old.value:
            return None
        return self.new.value / self.old.value

    @property
    def verdict(self) -> str:
        """`better`, `worse`, or "" if it differs by at most `MARKED`."""
        ratio = self.ratio
        if ratio is None or abs(ratio - 1.0) <= MARKED:
            return ""
        return "better" if (ratio > 1.0) == (self.new.better == "higher") else "worse"


def compare_results(old: Results, new: Results) -> list[Change]:
    """Every measure that both have, in the order of the new results."""
    before = dict(_measures(old))
    return [Change(*key[:3], before[key], measure) for key, measure in _measures(new) if key in before]


def list_warnings(results: Results) -> list[str]:
    """What to know before the figures of one file are read: other programs on the machine, and failures."""
    busy = [
        (case.load.elsewhere_cores, f"{benchmark.name}, {case.name}")
        for benchmark, case in results.cases()
        if case.load.elsewhere_cores is not None and case.load.elsewhere_cores > QUIET_CORES
    ]
    warnings = []
    if busy:
        most, name = max(busy)
        total = sum(1 for _ in results.cases())
        warnings.append(
            f"Other programs used more than {QUIET_CORES:g} cores during {len(busy)} of {total} cases, "
            f"at most {most:.2f} cores ({name}). Read the ratios, not the times."
        )
    return warnings + [
        f"Failed: {benchmark.name}, {case.name}: {case.failed}" for benchmark, case in results.failures()
    ]


def list_differences(old: Results, new: Results) -> list[str]:
    """Why two results may not be comparable: machines, versions, loads, speeds of the machine, sizes."""
    fields = ("processor", "cores", "memory_mb", "virtual", "system", "python", "numpy", "numba", "llvmlite")
    differences = [
        f"{Machine.model_fields[name].description} Old: {before}; new: {after}."
        for name in fields
        if (before := getattr(old.machine, name)) != (after := getattr(new.machine, name))
    ]
    differences = [f"The machines differ. {' '.join(differences)}"] if differences else []
    if old.quick != new.quick:
        differences.append("One was measured with --quick, whose sizes are smaller: few cases are in both.")
    pairs = list(_pairs(old, new))
    loads = [
        (abs(b.load.elsewhere_cores - a.load.elsewhere_cores), name, a.load.elsewhere_cores, b.load.elsewhere_cores)
        for name, a, b in pairs
        if a.load.elsewhere_cores is not None and b.load.elsewhere_cores is not None
    ]
    far = [load for load in loads if load[0] > LOAD_DIFFERS_CORES]
    if far:
        _, name, before, after = max(far)
        differences.append(
            f"The loads differ in {len(far)} of {len(pairs)} cases. Other programs used {before:.2f} cores in the old "
            f"and {after:.2f} cores in the new results during {name}."
        )
    speeds = [(b.yardstick_us / a.yardstick_us, name) for name, a, b in pairs]
    apart = [speed for speed in speeds if abs(speed[0] - 1.0) > YARDSTICK_DIFFERS]
    if apart:
        ratio, name = max(apart, key=lambda speed: abs(speed[0] - 1.0))
        differences.append(
            f"The machine was not equally fast in {len(apart)} of {len(pairs)} cases: the yardstick took {ratio:.2f} "
            f"times as long in the new results during {name}. Compare yardsticks, not times."
        )
    return differences


def _pairs(old: Results, new: Results) -> Iterator[tuple[str, CaseResult, CaseResult]]:
    """The cases that both have."""
    before = {(benchmark.name, case.name): case for benchmark, case in old.cases()}
    for benchmark, case in new.cases():
        if (benchmark.name, case.name) in before:
            yield f"{benchmark.name}, {case.name}", before[benchmark.name, case.name], case


def _measures(results: Results) -> Iterator[tuple[tuple[str, str, str, str], Measure]]:
    """Each measure after its benchmark, case, row and name."""
    for benchmark, case in results.cases():
        for row in case.rows:
            for measure in row.measures:
                yield (benchmark.name, case.name, row.name, measure.name), measure
