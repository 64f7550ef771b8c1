"""Configuration of one node of a live range: a file beside its record that only its owner can read, and its start."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pydantic import TypeAdapter

from skyrange.io.mavlink.transports import Address
from skyrange.io.processes.program import Program
from skyrange.record.folder import PARTS
from skyrange.runtime.live.node.viewers import Watched
from skyrange.runtime.live.transport.addresses import Credentials, Crossing
from skyrange.scenario.model.scenario import OnDeath


@dataclass(frozen=True, slots=True)
class NodeConfig:
    """What a node is told by the file that it is started with."""

    name: str
    endpoints: tuple[str, ...]
    part: str
    """The folder of its record, relative to the run's."""
    host: str
    """The address of the machine that it runs on."""
    control: Address
    """Of the supervisor's control socket."""
    crossings: tuple[Crossing, ...]
    credentials: Credentials
    restarted: bool = False
    """Whether a node of this name died before, while the range flew: this one begins at the range's present."""
    motion: bool = False
    """Whether the command line lets vehicles outside the range be moved."""
    on_death: OnDeath = "stop"
    """What to do about a radio engine of this node that dies."""
    watched: Watched = ()
    """Aircraft of this node that viewers see, and at which port."""
    reports_events: bool = False
    """Whether it tells the supervisor what happens, for a display."""

    def to_json(self) -> str:
        """The content of the file."""
        return _ADAPTER.dump_json(self).decode()

    @classmethod
    def from_json(cls, text: str) -> NodeConfig:
        """The configuration that `to_json` wrote."""
        return _ADAPTER.validate_json(text)


_ADAPTER: Final = TypeAdapter(NodeConfig)


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
