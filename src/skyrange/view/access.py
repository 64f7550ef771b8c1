"""Access to the viewer's server from other machines: over TLS, with a token that the printed address contains.

The address gives the token to the server once, which answers with a cookie and an address without it; so it is neither
in the address that the browser shows and remembers, nor where scripts can read it.
"""

from __future__ import annotations

import ipaddress
import secrets
import ssl
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from aiohttp import web

from skyrange.core.errors import InputError
from skyrange.core.secrets import is_same_secret

_TOKEN_BYTES: Final = 24
_QUERY: Final = "token"
REFUSAL: Final = "The viewer answers those who open the address that skyrange printed.\n"


@dataclass(frozen=True)
class Access:
    """What a server needs to be reached from other machines."""

    context: ssl.SSLContext
    token: str = field(default_factory=lambda: secrets.token_urlsafe(_TOKEN_BYTES))

    @property
    def query(self) -> str:
        """What the printed address ends with."""
        return f"?{_QUERY}={self.token}"

    def admits(self, request: web.Request) -> bool:
        """Whether a request has the cookie."""
        return self._is_token(request.cookies.get(_cookie_of(request), ""))

    def answer(self, request: web.Request) -> web.Response:
        """The answer to one that has not: a cookie for the token, or a refusal."""
        if request.path != "/" or not self._is_token(request.query.get(_QUERY, "")):
            return web.Response(status=403, text=REFUSAL)
        response = web.Response(status=303, headers={"Location": "/"})
        response.set_cookie(_cookie_of(request), self.token, secure=True, httponly=True, samesite="Strict", path="/")
        return response

    def _is_token(self, text: str) -> bool:
        return is_same_secret(text, self.token)


def _cookie_of(request: web.Request) -> str:
    """The cookie's name: browsers give those of one machine to all its ports."""
    return f"skyrange-viewer-{request.url.port}"


def open_access(host: str, certificate: Path | None, key: Path | None) -> Access | None:
    """What it needs to be reached at an IP address; None on this machine alone.

    Raises `InputError` without a certificate and its key for an address of a network, and for files that are none.
    """
    if certificate is None and key is None:
        if ipaddress.ip_address(host).is_loopback:
            return None
        hint = "Others on the network could read the record: give --certificate and --key, or forward a port with ssh."
        raise InputError.one("viewer", "--host", host, "an address of this machine alone, or TLS", hint)
    if certificate is None or key is None:
        missing = "--certificate" if certificate is None else "--key"
        raise InputError.one("viewer", missing, "missing", "a PEM file: a certificate and its key go together")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(certificate, key, password=b"")  # one that is encrypted is refused, not asked about
    except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
        reason = getattr(error, "strerror", None) or str(error)
        expected = f"a certificate and its key, unencrypted, as PEM files ({reason})"
        raise InputError.one("viewer", "--certificate, --key", f"{certificate}, {key}", expected) from None
    return Access(context)
