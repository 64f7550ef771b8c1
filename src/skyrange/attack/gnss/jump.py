"""GNSS jump: all fixes have a constant offset from the truth; velocities stay true."""

from __future__ import annotations

from skyrange.attack.bases.fixes import FalseFixes, Offset, offset_fixes
from skyrange.attack.declaration import attack
from skyrange.attack.presets import SPOOFED_OFFSET, gnss_spoofer, unaltered_fixes
from skyrange.contracts.plugins.fields import param


@attack(
    "gnss.jump",
    technique="EX-0014.04",
    counterfactual="mute",
    surface=("gnss",),
    persists="acts",
    effect="the estimator rejects fixes, then resets to the false position or fails safe",
    threat=gnss_spoofer(),
    controls=unaltered_fixes(),
    realism=SPOOFED_OFFSET,
)
class Jump(FalseFixes):
    """Shifts GNSS fixes by a constant offset, from one fix to the next.

    All fixes have the same offset. The reported velocity stays true, because the offset does not change.
    """

    offset_m: Offset = param(
        "Offset of the fixes from the truth, [east_m, north_m, up_m] in metres, each from -100000 to 100000."
    )

    shift = offset_fixes("offset_m")
