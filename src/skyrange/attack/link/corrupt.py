"""Damage on a link: bits of selected frames are flipped, with or without a checksum that fits."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.link.bit_errors import flip_bits, mend_checksum, payload_range


@sky.attack(
    "link.corrupt",
    technique="T0830",
    effect="receivers reject damaged frames, or accept values that nobody sent",
    knowledge="nothing to damage frames; the message's layout and CRC_EXTRA to have a changed value accepted",
    position="on the path; damage without a mended checksum is also what a jammer near the receiver does",
    equipment="a computer that forwards the frames, or a jammer",
    content="the sham: the same frames replaced by equal ones",
    placement="the same damage on another aircraft's link, or of other messages or bytes",
)
class Damage(sky.OnPath):
    """Flips bits of selected frames, and can mend their checksums.

    Each bit of the chosen bytes is flipped with the same probability, independently. With `fix_checksum` only payload
    bytes are flipped, and the CRC is computed anew, so that receivers accept the changed values. A signature (the last
    13 bytes of a signed frame) cannot be computed without the key: a receiver that checks signatures refuses the frame
    either way.
    """

    bit_error_rate: sky.Number = sky.param("Probability that a bit is flipped.", default=0.001, gt=0, le=1)
    first_byte: sky.Whole = sky.param(
        "First byte that is damaged, from 0; a MAVLink 2 payload begins at 10.", default=0, ge=0, le=65_535
    )
    last_byte: sky.Whole | None = sky.param("Last of them; default: the frame's last.", default=None, ge=0, le=65_535)
    fix_checksum: bool = sky.param(
        "Whether payload bytes alone are damaged, and the CRC of a MAVLink frame is mended.", default=False
    )

    def find_problems(self) -> sky.Problems:
        if self.last_byte is not None and self.last_byte < self.first_byte:
            yield sky.Problem("last_byte", str(self.last_byte), f"at least first_byte, {self.first_byte}")

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        payload = frame.payload
        chosen = payload_range(payload) if self.fix_checksum else range(len(payload))
        last = len(payload) if self.last_byte is None else self.last_byte
        start, stop = max(chosen.start, self.first_byte), min(chosen.stop, last + 1)
        damaged = flip_bits(payload, start, stop, self.bit_error_rate, lambda block: self.draw(frame, block))
        if damaged == payload:
            return ()
        return (sky.Replace(payload if self.sham else mend_checksum(damaged) if self.fix_checksum else damaged),)
