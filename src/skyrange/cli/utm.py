"""The commands `skyrange utm`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli.output.console import print_notice, print_text
from skyrange.core.extras import require_extra

utm_app = typer.Typer(
    help="Run UTM services as processes: USSs and a DSS after ASTM F3548-21, or an approval authority.\n\n"
    "Example: skyrange utm init federation",
    no_args_is_help=True,
)


@utm_app.command(epilog="Example: skyrange utm init federation --uss north=blue,green --uss south=red")
def init(
    *,
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
        _init_authority(folder, authority, port)
    else:
        _init_federation(folder, uss or ["north=blue", "south=green"], port, tests=tests)


def _init_federation(folder: Path, uss: Sequence[str], port: int, *, tests: bool) -> None:
    """`skyrange utm init`."""
    require_extra("utm", "utm")
    from skyrange.core.errors import InputError
    from skyrange.runtime.utm.initial_files import write_federation

    services: dict[str, list[str]] = {}
    for given in uss:
        name, _, operators = given.partition("=")
        if name in services:
            raise InputError.one("utm init", "--uss", repr(given), "another name for each USS")
        services[name] = [operator for operator in operators.split(",") if operator]
    written = write_federation(folder, services, port, tests=tests)
    print_text(f"{folder}: {', '.join(path.stem for path in written)}")
    print_text(f"Start them with: skyrange utm serve {' '.join(map(str, written))}")


def _init_authority(folder: Path, operators: str, port: int) -> None:
    """`skyrange utm init --authority`."""
    require_extra("utm", "utm")
    from skyrange.runtime.utm.initial_files import write_authority

    path = write_authority(folder, [operator for operator in operators.split(",") if operator], port)
    print_text(f"{folder}: {path.stem}")
    print_text(f"Start it with: skyrange utm serve {path}")


@utm_app.command(epilog="Example: skyrange utm serve federation/*.toml")
def serve(
    *,
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Configurations of the services.", show_default=False)
    ],
) -> None:
    """Run services until they are interrupted; each file is one service, and all of them share this process."""
    require_extra("utm", "utm")
    from skyrange.runtime.utm.config import load_config
    from skyrange.runtime.utm.service import serve as serve_all

    configs = [load_config(path) for path in files]
    serve_all(configs, lambda name, url: print_notice(f"{name}: listens at {url}"))
