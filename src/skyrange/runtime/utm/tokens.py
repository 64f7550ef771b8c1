"""Access tokens of a UTM service on a network: its own from an authorization service, and checks of those of others."""

from __future__ import annotations

import asyncio
import json
import time
from pathlib import Path
from typing import Any, Final

import aiohttp
import jwt
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey, RSAPublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)

from skyrange.core.errors import InputError
from skyrange.core.input_files import read_input
from skyrange.core.time import Time
from skyrange.utm.federated.tokens import EDDSA, LIFETIME_S, RENEWED_S, RS256, PublicKey

PrivateKey = RSAPrivateKey | Ed25519PrivateKey
_MAX_BYTES: Final = 65_536


class TokenRequests:
    """Stands for the tokens of an agent: what it asks for is fetched when its request is sent (`parse_request`)."""

    def get(self, now: Time, receiver: str, *scopes: str) -> str:
        """The name of a token."""
        return " ".join((receiver, *scopes))


def parse_request(name: str) -> tuple[str, tuple[str, ...]]:
    """Receiver and scopes of a token that `TokenRequests` has named."""
    receiver, *scopes = name.split(" ")
    return receiver, tuple(scopes)


class TokenClient:
    """The tokens of one service: one for each receiver and set of scopes, renewed before they expire."""

    def __init__(self, session: aiohttp.ClientSession, url: str, name: str, secret: str | None) -> None:
        """`url` is the token endpoint; the service is its client `name`."""
        self._session = session
        self._url = url
        self._name = name
        self._secret = secret
        self._tokens: dict[tuple[str, tuple[str, ...]], tuple[str, float]] = {}
        self._lock = asyncio.Lock()

    async def get(self, receiver: str, scopes: tuple[str, ...]) -> str:
        """A token for `receiver`. Raises `aiohttp.ClientError`, `OSError`, `TimeoutError` and `ValueError`."""
        async with self._lock:
            token, expires_s = self._tokens.get((receiver, scopes), ("", 0.0))
            if expires_s - time.time() <= RENEWED_S:
                token, expires_s = await self._fetch(receiver, scopes)
                self._tokens[receiver, scopes] = token, expires_s
            return token

    async def _fetch(self, receiver: str, scopes: tuple[str, ...]) -> tuple[str, float]:
        """A new token; the query is the one of InterUSS's authorization servers, which name the receiver so."""
        query = {
            "grant_type": "client_credentials",
            "scope": " ".join(scopes),
            "intended_audience": receiver,
            "sub": self._name,
        }
        headers = {} if self._secret is None else {"Authorization": aiohttp.encode_basic_auth(self._name, self._secret)}
        async with self._session.get(self._url, params=query, headers=headers, allow_redirects=False) as response:
            text = await response.content.read(_MAX_BYTES)
            if response.status != 200:
                raise ValueError(f"{self._url} answers {response.status}: {text[:200].decode(errors='replace')}")
        token = _token_in(text)
        claims = jwt.decode(token, options={"verify_signature": False})
        expires_s = claims.get("exp")
        return token, float(expires_s) if isinstance(expires_s, (int, float)) else time.time() + LIFETIME_S


def _token_in(text: bytes) -> str:
    data: Any = json.loads(text)
    token = data.get("access_token") if isinstance(data, dict) else None
    if not isinstance(token, str):
        raise ValueError("the answer of the token endpoint has no access_token")
    return token


def read_public_key(path: Path, who: str) -> PublicKey:
    """The public key in a PEM file. Raises `InputError`."""
    try:
        key = load_pem_public_key(read_input(path, who, "tokens.keys", max_bytes=_MAX_BYTES))
    except (OSError, ValueError) as error:
        raise InputError.one(who, "tokens.keys", str(path), "a PEM file of a public key", str(error)) from error
    if isinstance(key, Ed25519PublicKey):
        return PublicKey(EDDSA, key.public_bytes_raw())
    if isinstance(key, RSAPublicKey):
        return PublicKey(RS256, key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    raise InputError.one(who, "tokens.keys", f"{path}: {type(key).__name__}", "an RSA or Ed25519 key")


def read_private_key(path: Path, who: str) -> PrivateKey:
    """The private key in a PEM file. Raises `InputError`."""
    try:
        key = load_pem_private_key(read_input(path, who, "authorization.key", max_bytes=_MAX_BYTES), None)
    except (OSError, ValueError, TypeError) as error:
        raise InputError.one(who, "authorization.key", str(path), "a PEM file of a private key", str(error)) from error
    if isinstance(key, (Ed25519PrivateKey, RSAPrivateKey)):
        return key
    raise InputError.one(who, "authorization.key", f"{path}: {type(key).__name__}", "an RSA or Ed25519 key")


def sign(key: PrivateKey, claims: dict[str, Any]) -> str:
    """A token with some claims."""
    return jwt.encode(claims, key, EDDSA if isinstance(key, Ed25519PrivateKey) else RS256)
