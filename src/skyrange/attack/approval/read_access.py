"""Access to a DSS of who reads what a USS sends to it: the token of the USS, and the versions of its intents."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from skyrange.attack.bases.federation import read_uss
from skyrange.codec.f3548.frames import UssRequest, UssResponse, encode

_FIRST_EXCHANGE: Final = 2**40
"""Numbers of the adversary's requests, which the USS itself does not use."""
_PATH: Final = "/dss/v1/operational_intent_references/"


@dataclass(slots=True)
class ReadAccess:
    """The token and the versions that were read; a token gives access to whoever shows it."""

    token: str = ""
    ovns: dict[str, str] = field(default_factory=dict)
    """Current OVN of each intent that the DSS has accepted and the adversary has not ended."""
    sent: int = 0

    def learn(self, payload: bytes) -> None:
        """Learn from a message between the USS and the DSS."""
        message = read_uss(payload)
        if isinstance(message, UssRequest) and message.token:
            self.token = message.token
        elif isinstance(message, UssResponse) and message.status in (200, 201):
            self._learn_version((message.body or {}).get("operational_intent_reference"))

    def _learn_version(self, reference: object) -> None:
        if isinstance(reference, dict):
            id_, ovn = reference.get("id"), reference.get("ovn")
            if isinstance(id_, str) and isinstance(ovn, str):
                self.ovns[id_] = ovn

    def end_intent(self, sham: bool) -> bytes | None:
        """The request that ends the intent that is known for the longest time; that of a sham names a wrong version.

        `None` as long as no token or no intent is known.
        """
        if not self.token or not self.ovns:
            return None
        id_ = next(iter(self.ovns))
        ovn = self.ovns.pop(id_)
        self.sent += 1
        path = f"{_PATH}{id_}/{'0' * len(ovn) if sham else ovn}"
        exchange = _FIRST_EXCHANGE + self.sent
        return encode(
            UssRequest.model_construct(exchange=exchange, method="DELETE", path=path, token=self.token, body=None)
        )
