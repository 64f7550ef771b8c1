"""Reports of ground receptions: JSON objects in which the oracle tells an operator what its receivers decoded.

One object per step of the oracle, with method and path as in HTTP.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from skyrange.codec.remote_id.link_payload import NO_RSSI, RidFrame, RidHeader
from skyrange.core.errors import DecodeError

MAX_FRAME_BYTES = 1_048_576
MAX_RECEPTIONS = 1_500
"""The most in one object; further receptions go into further objects."""


class Reception(BaseModel):
    """One broadcast as a receiver decoded it."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    receiver: str
    time_ns: Annotated[int, Field(ge=-(2**63), lt=2**63)]
    """End of the reception, in range time."""
    transport: Annotated[int, Field(ge=1, le=4)]
    channel: Annotated[int, Field(ge=0, le=255)]
    counter: Annotated[int, Field(ge=0, le=255)]
    rssi_dbm: float
    address: Annotated[str, Field(pattern=r"^[0-9a-f]{12}$")]
    """The sender's address as claimed."""
    body: Annotated[str, Field(max_length=510, pattern=r"^([0-9a-f]{2})*$")]
    """A message or pack of F3411, in hexadecimal."""

    def frame(self) -> RidFrame:
        """The same reception as an aircraft's companion would get it on `rid_down`; the signal strength in 0.01 dB."""
        rssi_cdbm = min(max(round(self.rssi_dbm * 100.0), NO_RSSI + 1), 32_767)
        address, body = bytes.fromhex(self.address), bytes.fromhex(self.body)
        return RidFrame(RidHeader(self.transport, self.channel, self.counter, address, rssi_cdbm, self.time_ns), body)


class ReceptionReport(BaseModel):
    """What an operator's receivers decoded in one step of the oracle."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    method: Literal["POST"] = "POST"
    path: Literal["/receptions"] = "/receptions"
    body: Annotated[tuple[Reception, ...], Field(max_length=MAX_RECEPTIONS)]


def encode(report: ReceptionReport) -> bytes:
    """The report as one frame."""
    return report.model_dump_json().encode()


def decode(payload: bytes) -> ReceptionReport:
    """Decode a report; raises `DecodeError` for anything that `encode` does not produce."""
    if len(payload) > MAX_FRAME_BYTES:
        raise DecodeError(f"{len(payload)} bytes, at most {MAX_FRAME_BYTES} are read")
    try:
        return ReceptionReport.model_validate_json(payload)
    except (ValidationError, RecursionError) as error:
        raise DecodeError(f"not a report of receptions: {str(error).splitlines()[0]}") from error
