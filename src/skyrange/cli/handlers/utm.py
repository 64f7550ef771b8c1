"""The commands `skyrange utm`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from skyrange.cli.output.console import print_notice, print_text
from skyrange.runtime.utm import check_installed


def init(folder: Path, uss: Sequence[str], port: int, tests: bool) -> None:
    """`skyrange utm init`."""
    check_installed()
    from skyrange.core.errors import InputError
    from skyrange.runtime.utm.initial_files import write_federation

    services: dict[str, list[str]] = {}
    for one in uss:
        name, _, operators = one.partition("=")
        if name in services:
            raise InputError.one("utm init", "--uss", repr(one), "another name for each USS")
        services[name] = [operator for operator in operators.split(",") if operator]
    written = write_federation(folder, services, port, tests=tests)
    print_text(f"{folder}: {', '.join(path.stem for path in written)}")
    print_text(f"Start them with: skyrange utm serve {' '.join(map(str, written))}")


def init_authority(folder: Path, operators: str, port: int) -> None:
    """`skyrange utm init --authority`."""
    check_installed()
    from skyrange.runtime.utm.initial_files import write_authority

    path = write_authority(folder, [one for one in operators.split(",") if one], port)
    print_text(f"{folder}: {path.stem}")
    print_text(f"Start it with: skyrange utm serve {path}")


def serve(files: Sequence[Path]) -> None:
    """`skyrange utm serve`."""
    check_installed()
    from skyrange.runtime.utm.config import load_config
    from skyrange.runtime.utm.service import serve as serve_all

    configs = [load_config(path) for path in files]
    serve_all(configs, lambda name, url: print_notice(f"{name}: listens at {url}"))
