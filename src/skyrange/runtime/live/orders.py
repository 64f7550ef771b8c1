"""What is a process of a live range told to be? A file beside its record, which its owner alone can read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pydantic import TypeAdapter

from skyrange.io.mavlink_sockets import Address
from skyrange.runtime.live.addresses import Crossing
from skyrange.runtime.live.passes import Passes
from skyrange.runtime.live.viewing import Watched


@dataclass(frozen=True, slots=True)
class Orders:
    """What a node is told by the file that it is started with."""

    name: str
    endpoints: tuple[str, ...]
    part: str
    """The folder of its record within the run's."""
    host: str
    """The address of the machine that it runs on."""
    control: Address
    crossings: tuple[Crossing, ...]
    passes: Passes
    anew: bool = False
    """Whether one of this name died before, while the range flew: it begins at the range's present."""
    motion: bool = False
    """Whether the command line lets vehicles outside the range be moved."""
    watched: Watched = ()
    """Aircraft of this node that viewers see, and where."""

    def to_json(self) -> str:
        """As the file has it."""
        return _ORDERS.dump_json(self).decode()

    @classmethod
    def from_json(cls, text: str) -> Orders:
        """What `to_json` wrote."""
        return _ORDERS.validate_json(text)


_ORDERS: Final = TypeAdapter(Orders)
