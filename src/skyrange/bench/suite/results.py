"""Results of all benchmarks: the model of the JSON document that `skyrange bench all --json` prints, and its reader."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import AwareDatetime, Field, JsonValue, ValidationError

from skyrange.core.errors import InputError
from skyrange.core.files import MAX_TEXT_BYTES, atomic_write, parse_json, read_input
from skyrange.scenario.model.base import Model
from skyrange.scenario.validation.error_messages import input_error

FORMAT: Final = "skyrange.bench"
"""Value of `format`, by which a file of results is recognised."""
VERSION: Final = 1
"""Version of the format that this version of skyrange writes and reads."""
HOW_TO_MAKE: Final = "Make one with: skyrange bench all --output FILE"
Better = Literal["higher", "lower"]


class Machine(Model):
    """Machine and versions that the benchmarks ran with."""

    processor: str = Field(description="Model of the processor, as the system reports it.")
    cores: int = Field(ge=1, description="Number of cores that the benchmarks could use.")
    memory_mb: float | None = Field(ge=0, description="Physical memory in MB.")
    virtual: bool | None = Field(description="Whether the processor says that it is that of a virtual machine (x86).")
    system: str = Field(description="Operating system, its version and its architecture.")
    python: str = Field(description="Version of Python.")
    numpy: str = Field(description="Version of NumPy.")
    numba: str = Field(description="Version of Numba, which compiles the numeric functions.")
    llvmlite: str = Field(description="Version of llvmlite, Numba's binding of LLVM.")


class Load(Model):
    """What a case used of the machine, and what else ran on it before and meanwhile."""

    wall_s: float = Field(ge=0, description="Wall seconds of the case, from its first process's start on.")
    cpu_s: float = Field(ge=0, description="Processor seconds of all processes of the case, user and system.")
    involuntary_switches: int = Field(
        ge=0, description="Involuntary context switches of these processes: how often others took the core from them."
    )
    loadavg_before: float = Field(ge=0, description="Load average of the last minute, before the case.")
    loadavg_after: float = Field(ge=0, description="Load average of the last minute, after it; it includes the case.")
    elsewhere_cores: float | None = Field(
        ge=0, description="Cores that everything else on the machine used during the case. On a quiet machine near 0."
    )
    yardstick_before_us: float = Field(gt=0, description="`yardstick_us` as in `bench fleet`, before the case.")
    yardstick_after_us: float = Field(gt=0, description="The same after the case.")


class Memory(Model):
    """Resident memory of a case's processes together; pages that they share count for each of them."""

    every_s: float = Field(gt=0, description="Seconds between two values.")
    resident_mb: tuple[float, ...] = Field(
        description="Largest resident memory in MB of each interval, from the start on. Empty if it is not reported."
    )
    peak_mb: float | None = Field(description="The largest of all samples, which were taken every 0.25 s.")
    processes: int = Field(ge=0, description="Largest number of processes at once.")


class Measure(Model):
    """A measured quantity."""

    name: str = Field(min_length=1, description="What it is: 'peak memory'.")
    unit: str = Field(description="Its unit; × for a factor.")
    better: Better = Field(description='"higher" or "lower": which values are better.')
    relative: bool = Field(
        description="Whether it is a ratio to something that was measured on the same machine, or does not depend on "
        "the machine: between machines compare these, not the others."
    )
    value: float | None = Field(description="The value; null if there is none.")


class Row(Model):
    """What was measured of one thing."""

    name: str = Field(description="Which one, if a case has several, such as each transport.")
    measures: tuple[Measure, ...] = Field(description="The quantities that pages show.")
    data: dict[str, JsonValue] = Field(description="The row as the single benchmark prints it with `--json`.")


class CaseResult(Model):
    """One case of a benchmark: a size."""

    name: str = Field(min_length=1, description="Its size, such as '1000 aircraft, 20 s'.")
    failed: str = Field(default="", description="Why it failed; empty if it did not.")
    rows: tuple[Row, ...] = Field(default=(), description="What was measured.")
    load: Load = Field(description="Load of the machine.")
    memory: Memory = Field(description="Memory over time.")

    @property
    def yardstick_us(self) -> float:
        """Mean of the yardsticks before and after the case, in microseconds."""
        return 0.5 * (self.load.yardstick_before_us + self.load.yardstick_after_us)


class BenchmarkResult(Model):
    """One benchmark."""

    name: str = Field(min_length=1, description="Name, as `--only` takes it.")
    about: str = Field(description="What it measures.")
    skipped: str = Field(default="", description="Why it was skipped; empty if it ran.")
    cases: tuple[CaseResult, ...] = Field(default=(), description="Its cases.")


class Results(Model):
    """The whole document."""

    format: Literal["skyrange.bench"] = Field(description="Always this text.")
    version: Literal[1] = Field(description="Version of the format.")
    skyrange: str = Field(description="Version of skyrange.")
    started: AwareDatetime = Field(description="When the first case started.")
    quick: bool = Field(description="Whether the sizes are those of `--quick`.")
    machine: Machine = Field(description="The machine.")
    benchmarks: tuple[BenchmarkResult, ...] = Field(description="The benchmarks, in the order in which they ran.")

    def cases(self) -> Iterator[tuple[BenchmarkResult, CaseResult]]:
        """Each case that ran, with its benchmark."""
        for benchmark in self.benchmarks:
            for case in benchmark.cases:
                yield benchmark, case

    def failures(self) -> list[tuple[BenchmarkResult, CaseResult]]:
        """The cases that failed, each with its benchmark."""
        return [(benchmark, case) for benchmark, case in self.cases() if case.failed]


def read_results(path: Path) -> Results:
    """The results in a file. Raises `InputError` if it cannot be read, or is not such a file."""
    who = str(path)
    data = parse_json(read_input(path, who, max_bytes=MAX_TEXT_BYTES, expected="a file of results"), who, "file")
    _check_format(who, data)
    try:
        return Results.model_validate(data)
    except ValidationError as error:
        raise input_error(who, error, Results, data) from None


def write_results(results: Results, path: Path) -> None:
    """Write the results to a file, as JSON. Raises `OSError` if it cannot be written."""
    with atomic_write(path) as file:
        file.write((results.model_dump_json(indent=1) + "\n").encode())


def _check_format(who: str, data: Any) -> None:
    file_format = data.get("format") if isinstance(data, dict) else None
    if file_format != FORMAT:
        value = repr(file_format) if isinstance(data, dict) and "format" in data else "not there"
        raise InputError.one(who, "format", value, f'"{FORMAT}", as in results of all benchmarks', HOW_TO_MAKE)
    if data.get("version") != VERSION:
        hint = "The file is of another version of skyrange; make a page of it with that version"
        raise InputError.one(who, "version", repr(data.get("version")), str(VERSION), hint)
