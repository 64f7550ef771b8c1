"""Declaration of the commands `skyrange utm`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli import utm

utm_app = typer.Typer(
    help="Run UTM services as processes: USSs and a DSS after ASTM F3548-21, or an approval authority.\n\n"
    "Example: skyrange utm init federation",
    no_args_is_help=True,
)


@utm_app.command(epilog="Example: skyrange utm init federation --uss north=blue,green --uss south=red")
def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to make.", show_default=False)],
    uss: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=OPERATORS",
            help="A USS with the operators that it serves, separated by commas. May be repeated. Default: north=blue "
            "and south=green.",
        ),
    ] = None,
    authority: Annotated[
        str | None,
        typer.Option(
            metavar="OPERATORS",
            help="Instead of a federation, one approval authority for these operators, separated by commas.",
            show_default=False,
        ),
    ] = None,
    port: Annotated[int, typer.Option(metavar="PORT", help="First port; each service takes the next one.")] = 8_080,
    tests: Annotated[
        bool, typer.Option("--tests", help="Give each USS the interfaces of InterUSS for automated tests.")
    ] = False,
) -> None:
    """Write the configurations, keys and certificates of new services on this machine."""
    if authority is not None:
        utm.init_authority(folder, authority, port)
    else:
        utm.init(folder, uss or ["north=blue", "south=green"], port, tests)


@utm_app.command(epilog="Example: skyrange utm serve federation/*.toml")
def serve(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Configurations of the services.", show_default=False)
    ],
) -> None:
    """Run services until they are interrupted; each file is one service, and all of them share this process."""
    utm.serve(files)
