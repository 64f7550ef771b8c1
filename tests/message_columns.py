"""All messages of a column, decoded in groups."""

from __future__ import annotations

import numpy as np

from skyrange.codec.mavlink.message_columns import MessageGroup, classify_frames, unpack_group
from skyrange.contracts.frames import Payloads
from skyrange.core.arrays import Ints


def unpack_frames(payloads: Payloads) -> tuple[list[MessageGroup], Ints]:
    """The groups in order of message ids, and the rows that are in none."""
    kinds = classify_frames(payloads)
    found = [kind for kind in np.unique(kinds).tolist() if kind >= 0]
    return [unpack_group(payloads, kind, np.flatnonzero(kinds == kind)) for kind in found], np.flatnonzero(kinds < 0)
