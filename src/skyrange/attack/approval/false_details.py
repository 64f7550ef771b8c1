"""False details: a USS tells others that its intents claim airspace where nobody flies, and uses what it has claimed.

The DSS knows that the intents are there, but not their volumes. Others ask the USS, believe it, and plan into them.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from pydantic import Field

from skyrange.attack.approval.uss_links import check_uss, uss_taps
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.on_path import ScheduledTap, TapMaker
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Params
from skyrange.contracts.verdicts import Replace, Verdict
from skyrange.core.time import Time

_BELOW_M: Final = 500.0
"""By how much lower the false volumes are: below the ground."""


class FalseDetails(Params):
    """Who lies."""

    uss: str = Field(description="The USS that lies, by name: the operator's id, unless the federation names others.")


@dataclass(slots=True)
class LyingTap(ScheduledTap):
    """Alters the volumes in details and notifications that leave a USS; the sham leaves them as they are."""

    uss: str
    sham: bool

    def act(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Alter what has volumes."""
        if not frame.src.endswith(f".{self.uss}"):
            return ()
        if b'"operational_intent":' not in frame.payload:
            return ()
        try:
            message = json.loads(frame.payload)
            details = message["body"]["operational_intent"]["details"]
            for volume in [*details["volumes"], *details["off_nominal_volumes"]]:
                _sink(volume["volume"])
        except (ValueError, LookupError, TypeError):
            return ()  # another attack has altered it
        false = json.dumps(message, sort_keys=True, separators=(",", ":")).encode()
        length = max(len(false), len(frame.payload))
        return [Replace((frame.payload if self.sham else false).ljust(length))]


def _sink(solid: dict[str, Any]) -> None:
    for bound in ("altitude_lower", "altitude_upper"):
        solid[bound]["value"] -= _BELOW_M


def make(params: FalseDetails, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for a USS that the scenario does not have."""
    check_uss(params.uss, context)
    maker = TapMaker(LyingTap, (context.schedule, params.uss, context.sham))
    return Attack(taps=uss_taps(params.uss, context, maker), exclusive=[Exclusive(f"details of {params.uss}")])


FALSE_DETAILS = AttackPlugin(
    FalseDetails,
    make,
    "A USS tells others that its intents claim airspace below the ground.",
    technique="T0856",
    surface=("uss",),
    persists="flight",
    effect="others plan into the airspace that the USS has claimed for its own aircraft, and meet them",
    threat=ThreatModel(
        knowledge="the interface of USSs (ASTM F3548-21)",
        position="a USS of the federation, or who has taken it over",
        equipment="its server",
        budget="no frames of its own",
    ),
    controls=Controls(
        load="the sham: the same frames, of the same length, with the true volumes",
        content="none, because the true details are those of the sham",
        placement="a USS whose aircraft fly where nobody else does",
    ),
)
