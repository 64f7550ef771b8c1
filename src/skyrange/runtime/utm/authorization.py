"""Authorization service: issues access tokens to its clients (OAuth 2.0 client credentials, RFC 6749, 4.4)."""

from __future__ import annotations

import base64
import binascii
import hmac
import time
from collections.abc import Mapping
from typing import Any

from skyrange.core.ids import ID_PATTERN
from skyrange.runtime.utm.config import AuthorizationConfig
from skyrange.runtime.utm.tokens import PrivateKey, sign
from skyrange.utm.contract import make_uuid
from skyrange.utm.federated.tokens import LIFETIME_S


class Authorization:
    """Issues tokens, each for one receiver."""

    def __init__(self, config: AuthorizationConfig, key: PrivateKey) -> None:
        """`key` signs the tokens."""
        self._config = config
        self._key = key
        self._count = 0

    def answer(self, asked: Mapping[str, str], authorization: str) -> tuple[int, dict[str, Any]]:
        """Status and body of the response to a request.

        `asked` are the fields of its form, or of its query. Name and secret of the client are in the `authorization`
        header (Basic), or in the fields `client_id` and `client_secret` (RFC 6749, 2.3.1).
        """
        name, secret = _read_basic(authorization) if authorization else ("", "")
        if not name:
            name, secret = asked.get("client_id", ""), asked.get("client_secret", "")
        client = self._config.clients.get(name)
        if client is None or not hmac.compare_digest(secret.encode(), client.secret.encode()):
            return 401, {"error": "invalid_client", "error_description": "no client with this name and secret"}
        if asked.get("grant_type") != "client_credentials":
            return 400, {"error": "unsupported_grant_type", "error_description": "grant_type is client_credentials"}
        receiver = asked.get("intended_audience") or asked.get("audience") or ""
        if not receiver or len(receiver) > 256:
            return 400, {"error": "invalid_request", "error_description": "intended_audience: a receiver is needed"}
        scopes = asked.get("scope", "").split()
        refused = sorted(set(scopes) - set(client.scopes))
        if refused:
            text = f"not for this client: {' '.join(refused)}"
            return 400, {"error": "invalid_scope", "error_description": text[:256]}
        now_s = int(time.time())
        self._count += 1
        claims = {
            "iss": self._config.issuer,
            "sub": name,
            "aud": receiver,
            "scope": " ".join(scopes),
            "iat": now_s,
            "exp": now_s + LIFETIME_S,
            "jti": make_uuid(f"token {name} {time.time_ns()} {self._count}"),
        }
        token = sign(self._key, claims)
        return 200, {"access_token": token, "token_type": "Bearer", "expires_in": LIFETIME_S}


def _read_basic(header: str) -> tuple[str, str]:
    """Name and secret in a header (RFC 7617); two empty texts for another one."""
    kind, _, text = header.partition(" ")
    if kind.lower() != "basic":
        return "", ""
    try:
        name, _, secret = base64.b64decode(text, validate=True).decode().partition(":")
    except (binascii.Error, UnicodeDecodeError):
        return "", ""
    return (name, secret) if ID_PATTERN.match(name) else ("", "")
