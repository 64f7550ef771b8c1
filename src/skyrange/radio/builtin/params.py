"""Settings of the builtin medium: parameters of its radio environment, and rules of receivers and senders.

Other network simulators set these rules otherwise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Final, Literal

from pydantic import Field, Strict

from skyrange.contracts.params import Number, Params


@dataclass(frozen=True, slots=True)
class RadioEnvironment:
    """Parameters of the builtin medium that belong to a place and not to a radio."""

    horizon_m: float = 1_000.0
    """Nothing is received beyond this distance; the cost of simulation grows with its square. Open Drone ID gives 200
    to 400 m for Wi-Fi and legacy Bluetooth and four times that for Long Range (opendroneid.org)."""
    chance: bool = True
    """Whether there is shadowing and fading; without them, signals have their median power."""
    city_busy: float = 0.0
    """Share of time, 0…1, in which background traffic fills the Wi-Fi channels 1, 6 and 11: in a city 0.2, which most
    access points see or exceed, and 0.5, which the busiest tenth exceeds (Biswas et al., "Large-scale Measurements of
    Wireless Network Behavior", SIGCOMM 2015: ten thousand access points)."""
    city_dbm: float = -85.0
    """Mean power of the background traffic at any antenna; it is exponentially distributed."""
    carrier_sense_dbm: float | None = None
    """The weakest Wi-Fi frame that senders defer to; None for every frame whose preamble their receivers detect, as in
    IEEE 802.11-2020 17.3.12. The standard permits -82 dBm at most (17.3.10.6)."""


OPEN_GROUND: Final = RadioEnvironment()


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
