"""Commands that make the figures and measured tables of the documentation anew.

`python -m tools.docs.reproduce` (`make reproduce`) lists them. `python -m tools.docs.reproduce NAME` runs the commands
of one; NAME is a name of the list, or the file of a figure, such as `gnss.jump.svg` or `attacks/remote_id.replay.svg`.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

from tools.docs.markdown_tables import table

ROOT: Final = Path(__file__).parents[2]
DOCS: Final = ROOT / "docs"
KIND: Final = "{kind}"
PLACEHOLDER: Final = re.compile(r"\b[A-Z]{3,}\b")
"""What stands for a file that a command needs."""
DRAWN_BY_HAND: Final = ("images/live.svg",)
"""Figures that no command makes."""


class Result(NamedTuple):
    """Figures or tables that the same commands make; paths are relative to `docs`.

    In `files` and `part`, `{kind}` stands for the name of a kind: `part` makes its figure and its section alone.
    """

    name: str
    page: str
    commands: tuple[str, ...]
    files: tuple[str, ...] = ()
    part: str = ""
    needs: str = ""
    time: str = ""


MEASURED: Final = (
    Result(
        "attack-effects",
        "reference/attack-effects.md",
        ("python -m tools.docs.measure_attacks",),
        ("images/attacks/{kind}.svg", "images/faults/{kind}.svg"),
        "python -m tools.docs.measure_attacks {kind}",
        time="minutes for each kind of attack or fault",
    ),
    Result(
        "defence-effects",
        "reference/defence-effects.md",
        ("python -m tools.docs.measure_defences",),
        ("images/defences/{kind}.svg",),
        "python -m tools.docs.measure_defences {kind}",
        time="minutes for each kind",
    ),
    Result(
        "defence-matrix",
        "how-to/measure-defences.md",  # skyrange writes the whole page of the matrix
        ("skyrange matrix --out runs/matrix --page docs/reference/defence-matrix.md",),
        ("reference/defence-matrix.svg",),
        time="many hours",
    ),
    Result(
        "sight-matrix",
        "explanation/sight.md",  # skyrange writes the whole page of the matrix
        (
            "skyrange matrix docs/data/sight-matrix.toml --seeds 30 --out runs/sight "
            "--page docs/reference/sight-matrix.md",
        ),
        ("reference/sight-matrix.svg",),
        time="half an hour",
    ),
    Result(
        "drip-effects",
        "reference/drip-effects.md",
        ("python -m tools.docs.measure_drip",),
        time="minutes for each attack",
    ),
    Result("coverage", "reference/coverage.md", ("python -m tools.docs.measure_coverage",), time="three minutes"),
    Result(
        "benchmark-results",
        "reference/benchmark-results.md",
        ("skyrange bench all --output docs/data/benchmarks.json", "python -m tools.docs.generate"),
        needs="a quiet machine",
        time="five minutes",
    ),
    *(
        Result(
            f"gazebo-{name.split()[0]}",
            "reference/benchmark-results.md",
            (
                f"python -m tools.docs.measure_gazebo speed {name} --vehicles {' --vehicles '.join(fleets.split())}",
                "python -m tools.docs.generate",
            ),
            (f"images/gazebo-{name.split()[0]}.svg",),
            needs=f"{flavour}, ArduPilot, a quiet machine",
            time="five minutes",
        )
        for name, fleets, flavour in (
            ("sim", "1 2 5 10 20 40", "Gazebo Sim"),
            ("classic", "1 5 10 20 40", "Gazebo 11"),
            ("window --window", "1 5 10", "Gazebo 11 and a display"),
        )
    ),
    Result(
        "gazebo-collision",
        "reference/benchmark-results.md",
        ("python -m tools.docs.photograph_gazebo",),
        ("images/gazebo-collision.png",),
        needs="Gazebo 11 with gzclient, ArduPilot, Xvfb, ImageMagick",
    ),
    Result(
        "gazebo-parity",
        "explanation/gazebo-parity.md",
        ("python -m tools.agreement gazebo-physics --page docs/explanation/gazebo-parity.md",),
        needs="Gazebo, ArduPilot",
        time="ten minutes",
    ),
    Result(
        "radio-parity",
        "explanation/radio-parity.md",
        ("python -m tools.agreement radio --buildings city.geojson --page docs/explanation/radio-parity.md",),
        ("images/radio-parity-shares.svg", "images/radio-parity-losses.svg"),
        needs="ns-3, OMNeT++ with INET, a file city.geojson of buildings",
        time="half an hour",
    ),
    Result(
        "reality",
        "explanation/reality.md",
        (
            "skyrange parity log mission1.tlog mission2.tlog --without mission2-1 --ardupilot-seeds 3 "
            "--page docs/explanation/reality.md",
            "python -m tools.agreement fix-noise mission1.tlog mission2.tlog --page docs/explanation/reality.md",
            "skyrange detect mission1.tlog mission2.tlog --benign --page docs/explanation/reality.md",
        ),
        needs="ArduPilot; the logs of the page as mission1.tlog and mission2.tlog",
        time="half an hour",
    ),
    Result(
        "accelerometer-failsafe",
        "explanation/accelerometer-failsafe.md",
        (
            "skyrange study run accelerometer-failsafe --out studies/accelerometer-failsafe",
            "python -m tools.docs.measure_studies accelerometer-failsafe studies/accelerometer-failsafe",
        ),
        time="a quarter of an hour",
    ),
    Result(
        "signing-time",
        "explanation/signing-time.md",
        (
            "skyrange study run signing-time --out studies/signing-time",
            "python -m tools.docs.measure_studies signing-time studies/signing-time",
        ),
        time="half an hour",
    ),
    Result(
        "detection-range",
        "explanation/detection-range.md",
        ("python -m tools.detection_range --page docs/explanation/detection-range.md --images docs/images",),
        ("images/detection-range.svg",),
        time="five minutes",
    ),
    Result(
        "landings",
        "explanation/emergency-landing.md",
        ("python -m tools.docs.measure_landings",),
        time="half an hour",
    ),
    Result(
        "confirm",
        "explanation/sight.md",
        ("python -m tools.docs.measure_sight",),
        time="half an hour",
    ),
    Result(
        "parity-results",
        "reference/parity-results.md",
        ("python -m tests.parity runs/parity", "python -m tools.docs.generate"),
        needs="ArduPilot",
        time="some minutes",
    ),
    Result(
        "parity-attacks",
        "reference/parity-results.md",
        (
            "skyrange parity attacks --page docs/reference/parity-results.md",
            "skyrange parity attacks --seeds 10 --page docs/reference/parity-results.md",
        ),
        needs="ArduPilot",
    ),
    Result(
        "parity-gnss",
        "explanation/parity.md",
        ("python -m tools.agreement gnss --out runs/gnss",),
        needs="ArduPilot",
    ),
    Result(
        "cores",
        "explanation/several-cores.md",
        ("python -m tools.docs.measure_cores measure", "python -m tools.docs.measure_cores draw"),
        ("images/cores.svg",),
        needs="a quiet machine with two cores",
        time="ten minutes for each repetition",
    ),
    Result(
        "live-agreement",
        "explanation/live.md",
        ("python -m tests.integration.live_agrees",),
        needs="a quiet machine",
        time="half an hour",
    ),
    Result(
        "live-faults",
        "explanation/live-faults.md",
        ("python -m tests.integration.live_faults docs/explanation/live-faults.md",),
        needs="a quiet machine",
    ),
    Result(
        "utm-conformance",
        "reference/utm-conformance.md",
        ("python -m tools.docs.uss_qualifier_results REPORT.json MONITORING",),
        needs="the report of a run of uss_qualifier (docs/how-to/run-the-conformance-suite.md)",
    ),
)
"""Results that are measured, and the figures that come with them."""


@cache
def list_results() -> tuple[Result, ...]:
    """All results: those of the shipped scenarios, then those that are measured."""
    from tools.docs.measure_attacks import NAMED

    effects = tuple(
        Result(
            f"{name}-effects",
            f"reference/scenarios/{name}.md",
            (f"python -m tools.docs.measure_attacks {name}",),
            time="minutes",
        )
        for name in NAMED
    )
    return (*_list_pictures(), *effects, *MEASURED)


def _list_pictures() -> tuple[Result, ...]:
    """The pictures of shipped scenarios."""
    from tools.docs.pictures import CAUSAL_PATHS, FIGURES, PAIRS, SCREENSHOTS, VIEWS

    results = []
    for name in sorted({*FIGURES, *PAIRS, *SCREENSHOTS, *VIEWS}):
        pictures = [SCREENSHOTS[name].name] if name in SCREENSHOTS else []
        pictures += [view.name for view in VIEWS.get(name, ())]
        figures = [f"{name}.svg"] if name in FIGURES or name in PAIRS else []
        figures += [f"{name}-path.svg"] if name in CAUSAL_PATHS else []
        results.append(
            Result(
                name,
                f"reference/scenarios/{name}.md",
                (f"python -m tools.docs.pictures {name}",),
                tuple(f"images/{file}" for file in (*figures, *pictures)),
                needs="Chromium, for " + ", ".join(pictures) if pictures else "",
                time="up to a minute" if name != "rid-city" else "minutes",
            )
        )
    return tuple(results)


def find_part(result: Result, file: str) -> str | None:
    """The kind whose figure a file is, or None if the result has no figure of that name for a kind.

    `file` is a path relative to `docs`.
    """
    for pattern in result.files:
        start, cut, end = pattern.partition(KIND)
        if cut and (found := re.fullmatch(re.escape(start) + r"([^/]+)" + re.escape(end), file)):
            return found[1]
    return None


def find_commands(what: str) -> tuple[str, ...]:
    """The commands of a name, or of the file of a figure. Raises `LookupError` if there are none, or several."""
    for result in list_results():
        if what == result.name:
            return result.commands
    files = [path.relative_to(DOCS).as_posix() for path in list_images()]
    found = [file for file in files if f"docs/{file}".endswith(f"/{what.removeprefix('/')}") or what == f"docs/{file}"]
    if len(found) > 1:
        raise LookupError(f"{what} is the file of several figures: {', '.join(found)}")
    for file in found:
        if file in DRAWN_BY_HAND:
            raise LookupError(f"{file} was drawn by hand")
        for result in list_results():
            if file in result.files:
                return result.commands
            if kind := find_part(result, file):
                return (result.part.replace(KIND, kind),)
    raise LookupError(f"{what} is not in the list; `make reproduce` prints it")


def list_images() -> list[Path]:
    """The pictures of the documentation."""
    return sorted(
        path
        for folder in ("images", "reference")
        for end in ("svg", "png")
        for path in DOCS.glob(f"{folder}/**/*.{end}")
    )


def describe() -> str:
    """The table of the how-to guide."""
    rows = [
        (
            f"`{result.name}`",
            f"[{Path(result.page).stem}](../{result.page})",
            "; ".join(f"`{command}`" for command in result.commands),
            result.needs,
            result.time,
        )
        for result in list_results()
    ]
    return table(("`WHAT`", "page", "commands", "needs", "time"), rows)


def run(command: str) -> int:
    """Run a command of the list in the project's folder, with this Python; its exit code."""
    program, *arguments = shlex.split(command)
    words = arguments if program == "python" else ["-m", program, *arguments]
    return subprocess.run([sys.executable, *words], cwd=ROOT, check=False).returncode


def main(names: Sequence[str]) -> int:
    """List the results, or make some anew; an exit code."""
    if not names:
        for result in list_results():
            notes = "; ".join(part for part in (result.needs and f"needs {result.needs}", result.time) if part)
            print(f"{result.name:<24} docs/{result.page}" + (f"  ({notes})" if notes else ""))
        return 0
    for name in names:
        try:
            commands = find_commands(name)
        except LookupError as error:
            print(f"reproduce: {error}", file=sys.stderr)
            return 2
        for command in commands:
            print(f"$ {command}", flush=True)
            if PLACEHOLDER.search(command):
                print("reproduce: run this command with your files for the words in capitals", file=sys.stderr)
                return 2
            if code := run(command):
                return code
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
