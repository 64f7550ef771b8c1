"""Parameters of the builtin medium: rules of its receivers and senders that other network simulators set otherwise."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, Strict

from skyrange.contracts.params import Number, Params


class BuiltinParams(Params):
    """Rules of reception and channel access. Their defaults are those of decisions 0046 and 0047."""

    frame_capture: Annotated[bool, Strict()] = Field(
        default=True,
        description="Whether a receiver leaves a frame for a later one that is stronger by `capture_margin_db` "
        "(message-in-message capture).",
    )
    capture_margin_db: Number = Field(
        default=10.0,
        ge=0,
        le=100,
        description="Margin of frame capture, in dB; 10 dB as in Manweiler et al. (MobiCom 2009).",
    )
    preamble_choice: Literal["strongest", "first"] = Field(
        default="strongest",
        description="Which of the Wi-Fi frames that begin within aCCATime (4 µs for OFDM, 15 µs for DSSS) a receiver "
        "locks on: the strongest, or the first.",
    )
    eifs: Annotated[bool, Strict()] = Field(
        default=True,
        description="Whether a Wi-Fi sender waits for EIFS instead of DIFS after a frame that it received with an "
        "error (IEEE 802.11-2020 10.3.2.3.7).",
    )

    @property
    def capture_db(self) -> float:
        """Margin of frame capture in dB; infinite without frame capture."""
        return self.capture_margin_db if self.frame_capture else math.inf


DEFAULT_PARAMS = BuiltinParams()
