"""Groups of MAVLink messages that are counted together: heartbeats, commands, missions and parameters."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink.frames import LAYOUTS
from skyrange.contracts.frames import Bytes, Ints, Payloads
from skyrange.core.compiled import compiled

GROUPS: Final = ("heartbeats", "commands", "missions", "parameters")
"""The columns of `features` with their counts; group 0 is everything else."""

_COMMANDS: Final = frozenset({"COMMAND_LONG", "COMMAND_INT", "COMMAND_ACK", "SET_MODE"})
_IDS: Final = 512
"""All messages of the groups have smaller ids."""


def _group_of(name: str) -> int:
    if name == "HEARTBEAT":
        return 1
    if name in _COMMANDS:
        return 2
    return 3 if name.startswith("MISSION_") else 4 if name.startswith("PARAM_") else 0


_GROUP_OF_ID: Final = np.array(
    [_group_of(str(LAYOUTS[number].cls.msgname)) if number in LAYOUTS else 0 for number in range(_IDS)], dtype=np.uint8
)


@compiled
def _group_messages(
    data: Bytes, starts: Ints, sizes: Ints, group_of_id: NDArray[np.uint8], found: NDArray[np.uint8]
) -> None:
    """MAVLink 2 begins with 0xFD and has its id in bytes 7 to 9, MAVLink 1 with 0xFE and its id in byte 5; the length
    in byte 1 must be that of the payload (mavlink.io, "Packet Serialization").
    """
    for row in range(starts.shape[0]):
        start = starts[row]
        size = sizes[row]
        group = np.uint8(0)
        if size >= 12 and data[start] == 0xFD:
            signature = 13 if data[start + 2] & 1 else 0
            number = np.int64(data[start + 7]) | np.int64(data[start + 8]) << 8 | np.int64(data[start + 9]) << 16
            if size == 12 + data[start + 1] + signature and number < group_of_id.shape[0]:
                group = group_of_id[number]
        elif size >= 8 and data[start] == 0xFE and size == 8 + data[start + 1]:
            group = group_of_id[data[start + 5]]
        found[row] = group


def group_messages(payloads: Payloads) -> NDArray[np.uint8]:
    """(n,) the number of each payload's group, 1 to 4 in the order of `GROUPS`; 0 for others and for no MAVLink frame.

    Checksums and signatures are not verified.
    """
    groups = np.empty(len(payloads), dtype=np.uint8)
    _group_messages(*payloads.arrays, _GROUP_OF_ID, groups)
    return groups
