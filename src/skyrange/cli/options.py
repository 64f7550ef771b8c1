"""Arguments and options common to several commands, and the addresses among them."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from skyrange.cli.output.console import print_notice
from skyrange.core.errors import InputError
from skyrange.core.whole_numbers import parse_whole

if TYPE_CHECKING:
    from skyrange.scenario.model.scenario import Scenario
    from skyrange.study.execution.executors import Executor

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON, for scripts.")]
RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder.", show_default=False)]
RunOrPairFolder = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="The folder of a run or of a pair.", show_default=False)
]


def complete_scenario(incomplete: str) -> list[str]:
    """Names of shipped scenarios that begin with `incomplete`, for shell completion."""
    from skyrange.scenario.shipped import SHIPPED

    return [name for name in SHIPPED if name.startswith(incomplete)]


ScenarioName = Annotated[
    str,
    typer.Argument(
        metavar="NAME|FILE",
        help="Name of a shipped scenario (see `skyrange scenarios`) or a TOML file.",
        autocompletion=complete_scenario,
        show_default=False,
    ),
]
RunOut = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Folder of the run, empty or new. Default: runs/NAME, then runs/NAME-2 …"),
]
Seed = Annotated[int | None, typer.Option(metavar="N", help="Seed of the run; overrides the seed of the scenario.")]
Buildings = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="File of the buildings of a city to use, such as GeoJSON; the origin moves to its centre."
    ),
]


Jobs = Annotated[
    int | None, typer.Option(metavar="N", min=1, help="Runs at a time. Default: one for each CPU.", show_default=False)
]
MaxRuns = Annotated[
    int,
    typer.Option(
        "--max-runs",
        metavar="N",
        min=1,
        help="Most runs; a command of more is refused before it makes any.",
    ),
]
On = Annotated[
    str | None,
    typer.Option(
        "--on",
        metavar="ADDRESS",
        help="Fly on a Ray cluster: auto, local or ray://HOST:PORT. Its nodes must see the folder of the runs, or, "
        "of a study, its --storage.",
        show_default=False,
    ),
]

OtherVersion = Annotated[
    bool, typer.Option("--other-version", help="Go on with another version of skyrange than the one that began it.")
]


class Workers(NamedTuple):
    """Who flies runs: `jobs` processes of this machine, or the Ray cluster `cluster`."""

    jobs: int | None
    cluster: str | None = None

    def at_a_time(self) -> int:
        """Runs at a time on this machine."""
        from skyrange.runtime.cores.division import available_cpus

        return self.jobs if self.jobs is not None else len(available_cpus())

    def executor(self, *, in_process: bool = False) -> Executor:
        """What flies the runs; with `in_process`, one job is this process. Raises `InputError` for `jobs` of a
        cluster.
        """
        from skyrange.study.execution.executors import InThisProcess, LocalPool, RayPool

        if self.cluster is None:
            jobs = self.at_a_time()
            return InThisProcess() if in_process and jobs == 1 else LocalPool(jobs)
        if self.jobs is not None:
            raise InputError.one("skyrange", "--jobs", str(self.jobs), "none with --on: the cluster says how many")
        return RayPool(self.cluster)


class Arms(StrEnum):
    """Which runs `skyrange pair` compares: the values of `attribution.arms.Selection`."""

    BASELINE = "baseline"
    NOMINAL = "nominal"
    SHAM = "sham"
    EACH = "each"
    SUBSETS = "subsets"


Changes = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="PATH=VALUE",
        help="Change a value of the scenario; * in the path matches all elements. May be repeated.",
    ),
]
Plugins = Annotated[
    list[Path] | None,
    typer.Option(
        "--plugin",
        metavar="FILE",
        help="Run this Python file first, which has kinds or calls skyrange.register. May be repeated.",
    ),
]
Qgc = Annotated[
    bool,
    typer.Option(
        "--qgc", help="Open a read-only TCP port per aircraft for QGroundControl, MAVProxy and other viewers."
    ),
]
Control = Annotated[
    bool,
    typer.Option(
        "--control",
        help="With --view, let the browser start and stop attacks, faults and defences, and in `skyrange run` pause "
        "and change the speed. The address has a token: whoever has it controls the run.",
    ),
]
View = Annotated[bool, typer.Option("--view", help="Show the run in a browser while it flies, and then until Ctrl-C.")]
ViewHost = Annotated[
    str,
    typer.Option(
        "--view-host",
        metavar="ADDRESS",
        help="IP address at which the browser's page is served. One of a network needs --certificate and --key.",
    ),
]
ViewPort = Annotated[
    int, typer.Option("--view-port", metavar="PORT", min=0, max=65_535, help="Its TCP port; 0 takes a free one.")
]
Certificate = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="PEM file of the certificate of the page's server, for other machines."),
]
CertificateKey = Annotated[
    Path | None, typer.Option("--key", metavar="FILE", help="PEM file of the key of that certificate.")
]
ViewerPort = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=0,
        max=65_535,
        help="Port of the first aircraft; the port of each further aircraft is 10 higher. 0 selects free ports. "
        "Implies --qgc. Default: 5763, plus --port-offset if there is one.",
    ),
]
ViewerHost = Annotated[
    str,
    typer.Option(
        metavar="ADDRESS",
        help="IP address of this machine at which the viewers' ports listen. Whoever reaches it can watch; viewers "
        "command nothing.",
    ),
]
Motion = Annotated[
    bool,
    typer.Option(
        "--allow-motion",
        help="Pass arming and motion commands to external vehicles. The scenario must set allow_motion too. A real "
        "vehicle that moves can injure people.",
    ),
]
PortOffset = Annotated[int, typer.Option(metavar="N", min=-5000, max=35_000, help="Number added to every port.")]


class Rates(StrEnum):
    """Loop rates of ArduPilot, the values of `options.ardupilot.rates`."""

    FULL = "full"
    SINGLE = "single"
    REDUCED = "reduced"


class Load(StrEnum):
    """Telemetry profiles of the benchmarks."""

    LIGHT = "light"
    OPERATOR = "operator"


Telemetry = Annotated[
    Load, typer.Option(metavar="LOAD", help="Telemetry profile: light, or operator (that of QGroundControl).")
]


class Grouping(StrEnum):
    """How the components of a live range share processes."""

    COMPONENT = "component"
    OPERATOR = "operator"
    HOST = "host"
    ONE = "one"


def parse_ip_address(who: str, option: str, text: str) -> str:
    """The IP address `text`, in its usual form. Raises `InputError`, in the name of `who`, for anything else."""
    try:
        return str(ip_address(text))
    except ValueError:
        raise InputError.one(who, option, text, "an IP address") from None


def parse_address(who: str, option: str, text: str, default_port: int) -> tuple[str, int]:
    """IP address and TCP port of `text`: ADDRESS, ADDRESS:PORT or [ADDRESS]:PORT. Raises `InputError`."""
    host, separator, port = text.rpartition(":") if text.count(":") == 1 or "]:" in text else (text, "", "")
    number = parse_whole(port) if separator else default_port
    if number is None or not 0 < number < 65_536:
        raise InputError.one(who, option, text, "ADDRESS or ADDRESS:PORT")
    return parse_ip_address(who, option, host.strip("[]")), number


class ViewerOptions(NamedTuple):
    """The viewers' ports of a run: whether they are opened, the first one (the usual one without), and their host."""

    wanted: bool
    first_port: int | None
    host: str


class ScenarioChoice(NamedTuple):
    """The scenario of a command: its name or file, and what the command line changes of it."""

    name: str
    seed: int | None = None
    buildings: Path | None = None
    changes: Sequence[str] = ()

    def load(self) -> Scenario:
        """The scenario, checked."""
        from skyrange.scenario.shipped import load

        return load(self.name, self.changes, seed=self.seed, buildings=self.buildings)


def load_plugins(files: Sequence[Path] | None) -> None:
    """`--plugin` of several commands."""
    if files:
        from skyrange.contracts.plugins.registry import load_files

        load_files(files)


def check_control(scenario: Scenario, *, control: bool, view: bool) -> None:
    """Raise `InputError` for control without a viewer; tell if nothing can be started."""
    if not control:
        return
    if not view:
        raise InputError.one("--control", "option", "without --view", "--view --control")
    if not any(table.manual for table in scenario.acting.values()):
        print_notice("nothing starts by hand: no act has manual = true, such as by --set 'attacks.*.manual=true'")
