"""Configuration of one node of a live range: a file beside its record, which only its owner can read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pydantic import TypeAdapter

from skyrange.io.mavlink.transports import Address
from skyrange.runtime.live.node.viewers import Watched
from skyrange.runtime.live.transport.addresses import Crossing
from skyrange.runtime.live.transport.credentials import Credentials
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

    def to_json(self) -> str:
        """The content of the file."""
        return _ADAPTER.dump_json(self).decode()

    @classmethod
    def from_json(cls, text: str) -> NodeConfig:
        """The configuration that `to_json` wrote."""
        return _ADAPTER.validate_json(text)


_ADAPTER: Final = TypeAdapter(NodeConfig)
