"""How is a node's process started? Its orders in a file beside its record, on whichever machine it shall run."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from skyrange.io.programs import Program
from skyrange.record.folder import PARTS
from skyrange.runtime.live.orders import Orders


def label_of(node: str) -> str:
    """A node's name as that of a file."""
    return node.replace("/", "-").replace(":", "_")


def part_of(node: str, start: int = 1) -> str:
    """The folder of a node's record within the run's; each of its starts has its own."""
    return f"{PARTS}/{label_of(node)}" + (f".{start}" if start > 1 else "")


def start(root: Path, orders: Orders, through: Sequence[str] = ()) -> Program:
    """Start the process that `orders` are for in the run's folder `root`, by way of the command `through`."""
    folder = root / f"{orders.part}.program"
    folder.mkdir(parents=True, exist_ok=True)
    path = (folder / "orders.json").absolute()
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "w") as file:
        file.write(orders.to_json())  # it holds keys
    command = [*through, sys.executable, "-m", "skyrange.runtime.live.process", str(path)]
    return Program(orders.name, command, folder)
