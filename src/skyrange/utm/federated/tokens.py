"""Access tokens of USSs: JSON Web Tokens (RFC 7519) with the scopes of F3548.

An authorization service issues them for one receiver each; receivers know its public key. That of a range signs with
Ed25519 (RFC 8037), and times are those of the scenario. Services on a network also read RS256 (RFC 7518, 3.3).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final, Protocol

import jwt
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPublicKey
from cryptography.hazmat.primitives.serialization import load_pem_public_key

from skyrange.codec.strict_json import parse_json
from skyrange.core.errors import DecodeError
from skyrange.core.time import NS_PER_S, Epoch, Time

LIFETIME_S: Final = 3_600
"""How long a token is valid."""
RENEWED_S: Final = 300
"""A token is renewed when it is valid for no longer."""
ISSUER: Final = "auth.skyrange"
EDDSA: Final = "EdDSA"
RS256: Final = "RS256"
_JWS: Final = jwt.PyJWS()
_REMEMBERED: Final = 256


class TokenError(Exception):
    """A token that gives no access; the message says why."""


@dataclass(frozen=True, slots=True)
class Claims:
    """What a token that was checked says."""

    uss: str
    scopes: frozenset[str]
    expires_s: int
    valid_from_s: float = 0.0
    """The time before which the token is not to be taken (`nbf`)."""


@dataclass(frozen=True, slots=True)
class PublicKey:
    """A public key of an authorization service."""

    algorithm: str
    """`EDDSA` or `RS256`."""
    data: bytes
    """32 bytes of Ed25519, or the PEM of an RSA key."""

    def load(self) -> Ed25519PublicKey | RSAPublicKey:
        """The key; `ValueError` for bytes that are none."""
        return _load(self)


@lru_cache(maxsize=16)
def _load(key: PublicKey) -> Ed25519PublicKey | RSAPublicKey:
    if key.algorithm == EDDSA:
        return Ed25519PublicKey.from_public_bytes(key.data)
    loaded = load_pem_public_key(key.data)
    if not isinstance(loaded, RSAPublicKey):
        raise ValueError(f"an RSA key is needed, this is {type(loaded).__name__}")
    return loaded


class Tokens(Protocol):
    """Where the tokens of one USS come from."""

    def get(self, now: Time, receiver: str, *scopes: str) -> str:
        """A token for `receiver`."""
        ...


@dataclass(slots=True)
class TokenStore:
    """The tokens of one USS, one for each receiver and set of scopes. Deep-copyable."""

    uss: str
    secret: bytes
    """The private key of the authorization service."""
    epoch: Epoch
    _tokens: dict[tuple[str, str], tuple[str, int]] = field(default_factory=dict)

    def get(self, now: Time, receiver: str, *scopes: str) -> str:
        """A token for `receiver` that is valid for a while."""
        now_s = _seconds(now, self.epoch)
        key = receiver, " ".join(scopes)
        token, expires_s = self._tokens.get(key, ("", 0))
        if expires_s - now_s <= RENEWED_S:
            expires_s = now_s + LIFETIME_S
            claims = {
                "iss": ISSUER,
                "sub": self.uss,
                "aud": receiver,
                "scope": key[1],
                "iat": now_s,
                "exp": expires_s,
                "jti": f"{self.uss}.{receiver}.{now_s}",
            }
            token = jwt.encode(claims, Ed25519PrivateKey.from_private_bytes(self.secret), EDDSA)
            self._tokens[key] = token, expires_s
        return token


@dataclass(slots=True)
class TokenChecker:
    """Checks of the tokens that one receiver is shown. Deep-copyable."""

    receivers: frozenset[str]
    """The names by which tokens call it; one is enough."""
    keys: tuple[PublicKey, ...]
    """Public keys of authorization services."""
    epoch: Epoch
    issuers: frozenset[str] = frozenset({ISSUER})
    """Who may issue tokens; empty means whoever has one of the keys."""
    _known: dict[str, Claims] = field(default_factory=dict)
    """Tokens whose signatures were right, so that each is verified once."""

    def check(self, now: Time, token: str) -> Claims:
        """What a token says. Raises `TokenError`."""
        claims = self._known.get(token)
        if claims is None:
            claims = self._verify(token)
            if len(self._known) >= _REMEMBERED:
                del self._known[next(iter(self._known))]
            self._known[token] = claims
        if claims.expires_s <= _seconds(now, self.epoch):
            raise TokenError("the token has expired")
        if claims.valid_from_s > _seconds(now, self.epoch):
            raise TokenError("the token is not valid yet")
        return claims

    def _verify(self, token: str) -> Claims:
        if not token:
            raise TokenError("no token")
        # JWS alone: the claims are compared here, because those of time are by the scenario's clock
        read = self._decode(token)
        if not isinstance(read, dict):
            raise TokenError("the token is not valid: it has no claims")
        uss, scope, expires_s = read.get("sub"), read.get("scope", ""), read.get("exp")
        if not isinstance(uss, str) or not isinstance(scope, str) or type(expires_s) is not int:
            raise TokenError("the token is not valid: sub, scope or exp is missing, or of a wrong type")
        valid_from_s = read.get("nbf", 0.0)
        if isinstance(valid_from_s, bool) or not isinstance(valid_from_s, (int, float)):
            raise TokenError("the token is not valid: nbf is no number")
        if self.issuers and read.get("iss") not in self.issuers:
            raise TokenError("the token is of another issuer")
        audiences = read.get("aud")
        named = {
            audience
            for audience in (audiences if isinstance(audiences, list) else [audiences])
            if isinstance(audience, str)
        }
        if self.receivers.isdisjoint(named):
            raise TokenError(f"the token is for another receiver than {' or '.join(sorted(self.receivers))}")
        return Claims(uss, frozenset(scope.split()), expires_s, valid_from_s)

    def _decode(self, token: str) -> object:
        """The claims of a token that one of the keys has signed."""
        problem: Exception = ValueError("no key is known")
        for key in self.keys:
            try:
                return parse_json(_JWS.decode(token, key.load(), [key.algorithm]))
            except (jwt.PyJWTError, ValueError, DecodeError) as error:
                problem = error
        raise TokenError(f"the token is not valid: {problem}"[:200]) from problem


@lru_cache(maxsize=16)
def public_of(secret: bytes) -> PublicKey:
    """The public key of a private one of Ed25519, 32 bytes."""
    return PublicKey(EDDSA, Ed25519PrivateKey.from_private_bytes(secret).public_key().public_bytes_raw())


def _seconds(now: Time, epoch: Epoch) -> int:
    return (epoch.unix_ns + now) // NS_PER_S
