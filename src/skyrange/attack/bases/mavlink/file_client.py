"""Base of kinds that use MAVLink FTP as a client: requests one after the other, each until it is answered.

By https://mavlink.io/en/services/ftp.html: a request that is not answered is sent again under the same sequence number,
so that a server that has served it repeats its reply.
"""

from __future__ import annotations

from typing import ClassVar, Final, NamedTuple

from skyrange.attack.bases.mavlink.injection import Injection
from skyrange.attack.bases.mavlink.orders import AUTOPILOT
from skyrange.attack.declaration import Facts
from skyrange.codec.mavlink import Message, file_transfer
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.file_transfer import Error, Transfer
from skyrange.contracts.params import Whole
from skyrange.contracts.plugins.form import param
from skyrange.core.time import NS_PER_MS, Time

RETRY_NS: Final = 500 * NS_PER_MS
"""pymavlink mavftp.py, `retry_time`."""
TRIES: Final = 10
"""The first try and nine retries: 5 s, in which a server ends a session that nobody uses (GCS_FTP.cpp: 3 s)."""
_ANSWER_NS: Final = NS_PER_MS
"""Time in which the node sends the next request."""


class FileRequest(NamedTuple):
    """A request; `size` is how much is to be read."""

    opcode: int
    data: bytes = b""
    offset: int = 0
    size: int | None = None


class FileClient(Injection):
    """Sends the requests of `first_request` and then of `next_request`, once, until that has none."""

    attack_facts: ClassVar[Facts] = {
        "position": "by place: near the link with a radio, in the operator's network, or on board, where "
        "replies can be heard",
        "equipment": "a computer with a MAVLink library, such as any ground station",
    }
    needs: ClassVar[tuple[str, ...]] = ("first_request", "next_request")
    reads = ("FILE_TRANSFER_PROTOCOL",)

    session: Whole = param(
        "Number of its session. An autopilot may take two clients with one number for the same.",
        default=37,
        ge=0,
        le=255,
    )
    request: FileRequest | None = None
    """What was requested last."""
    sequence: int = 0
    tries: int = 0
    ended: bool = False

    def first_request(self) -> FileRequest:
        """The first request."""
        raise NotImplementedError

    def next_request(self, request: FileRequest, reply: Transfer | None) -> FileRequest | None:
        """The request after one that was answered so, or that nobody answered (`None`); `None` for the end."""
        raise NotImplementedError

    def period_ns(self) -> Time:
        """Time after which a request is sent again."""
        return RETRY_NS

    def next_wakeup(self) -> Time | None:
        """When it next sends."""
        return None if self.ended else self.clock.due

    def on_message(self, now: Time, message: Message) -> None:
        """Go on with the reply to the last request; what is another's is left."""
        if self.request is None or self.ended or not self.claimed.is_answered(message):
            return
        reply = file_transfer.unpack(bytes(message.payload))
        is_own = reply.session == self.session and reply.sequence == (self.sequence + 1) & 0xFFFF
        if not is_own or reply.request != self.request.opcode:
            return
        if reply.error in (Error.INVALID_SESSION, Error.NO_SESSIONS_AVAILABLE):
            self.sequence += (
                1  # of another one, which may end: it is asked anew, because a repetition has the same reply
            )
            return
        self._go_on(reply._replace(data=reply.data[: reply.size]))
        self.clock.due = now + _ANSWER_NS

    def orders(self, now: Time) -> list[Message]:
        """The request that is due."""
        if self.request is None:
            self.request = self.first_request()
        elif self.tries >= TRIES:
            self._go_on(None)
        if self.ended:
            return []
        self.tries += 1
        opcode, data, offset, size = self.request
        payload = file_transfer.pack(self.sequence, self.session, opcode, data, offset=offset, size=size)
        return [mav.MAVLink_file_transfer_protocol_message(0, self.target, AUTOPILOT, payload)]

    def _go_on(self, reply: Transfer | None) -> None:
        assert self.request is not None
        following = self.next_request(self.request, reply)
        self.sequence = (self.sequence + 1) & 0xFFFF
        self.tries = 0
        if following is None:
            self.ended = True
        else:
            self.request = following
