"""What do several commands take? Their common arguments and options."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for scripts.")]
RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder.", show_default=False)]


def complete_scenario(incomplete: str) -> list[str]:
    """Shipped scenarios that begin so, for the shell."""
    from skyrange.scenario.catalogue import SHIPPED

    return [name for name in SHIPPED if name.startswith(incomplete)]


ScenarioName = Annotated[
    str,
    typer.Argument(
        metavar="NAME|FILE",
        help="A shipped scenario's name (see `skyrange scenarios`) or a TOML file.",
        autocompletion=complete_scenario,
        show_default=False,
    ),
]
RunOut = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="The run's folder, empty or new. Default: runs/NAME, then runs/NAME-2 …"),
]
Seed = Annotated[int | None, typer.Option(metavar="N", help="Chance of the run, over the scenario's.")]
Buildings = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Fly over this GeoJSON city; the origin moves to its centre."),
]
Changes = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="PATH=VALUE", help="Change the scenario; * in the path means all. May be repeated."),
]
Plugins = Annotated[
    list[Path] | None,
    typer.Option(
        "--plugin",
        metavar="FILE",
        help="Run this Python file first; it calls skyrange.register for each plugin that it offers. May be repeated.",
    ),
]
Qgc = Annotated[
    bool,
    typer.Option("--qgc", help="Let QGroundControl, MAVProxy and others watch, read-only, at a TCP port per aircraft."),
]
ViewerPort = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=0,
        max=65_535,
        help="The first of those ports, each next aircraft's is 10 higher; 0 takes any. Implies --qgc. "
        "Default: 5763, and a --port-offset.",
    ),
]
Motion = Annotated[
    bool,
    typer.Option(
        "--allow-motion",
        help="Let arming and motion commands through to external vehicles, where the scenario says allow_motion too. "
        "Such a vehicle can hurt somebody.",
    ),
]
PortOffset = Annotated[int, typer.Option(metavar="N", min=-5000, max=35_000, help="Added to every port.")]


class Grouping(StrEnum):
    """How a live range's components share processes."""

    COMPONENT = "component"
    OPERATOR = "operator"
    HOST = "host"
    ONE = "one"
