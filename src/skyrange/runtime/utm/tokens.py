"""Access tokens of a UTM service on a network: issued to its clients (OAuth 2.0, RFC 6749, 4.4), got, and checked."""

from __future__ import annotations

import asyncio
import base64
import binascii
import time
from collections.abc import Mapping
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

from skyrange.codec.strict_json import parse_json_object
from skyrange.core.errors import DecodeError, InputError
from skyrange.core.files import read_input
from skyrange.core.ids import ID_PATTERN
from skyrange.core.secrets import is_same_secret
from skyrange.core.time import Time
from skyrange.runtime.utm.config import AuthorizationConfig
from skyrange.utm.contract import make_uuid
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
        """A token for `receiver`. Raises `aiohttp.ClientError`, `OSError`, `TimeoutError` and `DecodeError`."""
        async with self._lock:
            token, expires_s = self._tokens.get((receiver, scopes), ("", 0.0))
            if expires_s - time.time() <= RENEWED_S:
                token, expires_s = await self._fetch(receiver, scopes)
                self._tokens[receiver, scopes] = token, expires_s
            return token

    def forget(self, receiver: str, scopes: tuple[str, ...]) -> None:
        """Get a new token the next time, because the receiver does not take the present one."""
        self._tokens.pop((receiver, scopes), None)

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
                raise DecodeError(f"{self._url} answers {response.status}: {text[:200].decode(errors='replace')}")
        token = _token_in(text)
        try:
            claims = jwt.decode(token, options={"verify_signature": False})
        except (jwt.PyJWTError, ValueError, RecursionError) as error:
            raise DecodeError(f"{self._url} answers no token: {error}"[:200]) from error
        expires_s = claims.get("exp")
        return token, expires_s if type(expires_s) is int else time.time() + LIFETIME_S


def _token_in(text: bytes) -> str:
    token = parse_json_object(text).get("access_token")
    if not isinstance(token, str):
        raise DecodeError("the answer of the token endpoint has no access_token")
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


class Authorization:
    """Issues tokens, each for one receiver."""

    def __init__(self, config: AuthorizationConfig, key: PrivateKey) -> None:
        """`key` signs the tokens."""
        self._config = config
        self._key = key
        self._count = 0

    def answer(self, form: Mapping[str, str], authorization: str) -> tuple[int, dict[str, Any]]:
        """Status and body of the response to a request.

        `form` are the fields of its form, or of its query. Name and secret of the client are in the `authorization`
        header (Basic), or in the fields `client_id` and `client_secret` (RFC 6749, 2.3.1).
        """
        name, secret = _read_basic(authorization) if authorization else ("", "")
        if not name:
            name, secret = form.get("client_id", ""), form.get("client_secret", "")
        client = self._config.clients.get(name)
        if client is None or not is_same_secret(secret, client.secret):
            return 401, {"error": "invalid_client", "error_description": "no client with this name and secret"}
        if form.get("grant_type") != "client_credentials":
            return 400, {"error": "unsupported_grant_type", "error_description": "grant_type is client_credentials"}
        receiver = form.get("intended_audience") or form.get("audience") or ""
        if not receiver or len(receiver) > 256:
            return 400, {"error": "invalid_request", "error_description": "intended_audience: a receiver is needed"}
        scopes = form.get("scope", "").split()
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
    return (name, secret) if ID_PATTERN.fullmatch(name) else ("", "")
