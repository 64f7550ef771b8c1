"""Start of a node's process, with its configuration in a file beside its record."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from skyrange.io.processes.program import Program
from skyrange.record.folder import PARTS
from skyrange.runtime.live.config import NodeConfig

CONFIG_FILE: Final = "node.json"


def file_name_of(node: str) -> str:
    """A node's name as that of a file."""
    return node.replace("/", "-").replace(":", "_")


def part_of(node: str, start: int = 1) -> str:
    """The folder of a node's record, relative to the run's; each start of the node has its own."""
    return f"{PARTS}/{file_name_of(node)}" + (f".{start}" if start > 1 else "")


def program_folder(root: Path, config: NodeConfig) -> Path:
    """The folder in which the process runs, in the run's folder `root`: configuration, output, tap socket."""
    return root / f"{config.part}.program"


def write_config(root: Path, config: NodeConfig) -> Path:
    """Write the configuration file that the process is started with; its path."""
    folder = program_folder(root, config)
    folder.mkdir(parents=True, exist_ok=True)
    path = (folder / CONFIG_FILE).absolute()
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "w") as file:
        file.write(config.to_json())  # it holds keys
    return path


def start_node(root: Path, config: NodeConfig, through: Sequence[str] = ()) -> Program:
    """Start the process of `config` in the run's folder `root`, by way of the command `through`."""
    path = write_config(root, config)
    command = [*through, sys.executable, "-m", "skyrange.runtime.live.node.process", str(path)]
    return Program(config.name, command, path.parent)
