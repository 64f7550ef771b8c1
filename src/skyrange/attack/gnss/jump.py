"""GNSS jump: all fixes have a constant offset from the truth; velocities stay true."""

from __future__ import annotations

import skyrange.plugin as sky


@sky.attack(
    "gnss.jump",
    effect="the estimator rejects fixes, then resets to the false position or fails safe",
)
class Jump(sky.FalseFixes):
    """Shifts GNSS fixes by a constant offset, from one fix to the next.

    The reported velocity stays true, because the offset does not change.
    """

    offset_m: sky.Offset = sky.param(
        "Offset of the fixes from the truth, [east_m, north_m, up_m] in metres, each from -100000 to 100000."
    )

    shift = sky.offset_fixes("offset_m")
