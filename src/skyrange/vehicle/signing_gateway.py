"""MAVLink gateway that holds an aircraft's key: it signs what its ground side sends unsigned.

After MAVProxy (mavproxy.py `process_mavlink`, setting `mavfwd_signing`, on by default since pull request 1589;
pymavlink `MAVLink_message.pack`). It asks nobody on its ground side for anything, which is MAVProxy's issue 1683.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from skyrange.codec.mavlink import Packer, decode
from skyrange.codec.mavlink.signing import Signer, SigningKey, is_signed
from skyrange.contracts.frames import Frame
from skyrange.contracts.verdicts import Replace, Verdict
from skyrange.core.errors import DecodeError
from skyrange.core.time import Time

LINK_ID: Final = 0
"""Link id in its signatures (pymavlink's default)."""
SENDER: Final = (255, 190)
"""System and component id of all that it signs: those of its own process, which are the ground station's here, as with
MAVProxy's option --source-component=190. So answers reach the ground station."""


class SigningGateway:
    """Tap at an aircraft's end of its `gcs` link. Deep-copyable."""

    def __init__(self, key: SigningKey) -> None:
        self._signer = Signer(key, LINK_ID)
        self._packer = Packer(*SENDER)
        self._started = False

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Pack an unsigned message anew and sign it; anything else passes as it is.

        The timestamp follows those of the aircraft (pymavlink `check_signature`).
        """
        if not self._started:
            self._started = True
            self._signer.start(now)
        if frame.direction == "rev":
            if is_signed(frame.payload):
                self._signer.check(frame.payload)
            return ()
        if is_signed(frame.payload):
            return ()
        try:
            message = decode(frame.payload)
        except DecodeError:
            return ()
        return (Replace(self._signer.sign(self._packer.pack(message))),)

    def next_wakeup(self) -> Time | None:
        """Never."""
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Nothing."""
        return ()
