"""Configuration of one UTM service: a TOML file with its role, address, keys and database."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from skyrange.codec.web_urls import is_web_url
from skyrange.contracts.params import refuse
from skyrange.core.errors import Problem
from skyrange.core.ids import ID_PATTERN
from skyrange.core.whole_numbers import parse_whole
from skyrange.scenario.named_files import read_text
from skyrange.scenario.toml_files import parse_toml
from skyrange.scenario.validation.error_messages import input_error
from skyrange.utm.authority import AlternativeParams, AuthorityParams


def _check_url(value: str) -> str:
    if not is_web_url(value):
        raise refuse(Problem("", repr(value), "a URL such as https://localhost:8071, without a query"))
    return value


def _parse_address(value: str) -> tuple[str, int]:
    host, _, port = value.rpartition(":")
    number = parse_whole(port)
    if not host or number is None or number > 65_535:
        raise refuse(Problem("", repr(value), "an address such as 127.0.0.1:8071"))
    return host.strip("[]"), number


def _check_address(value: str) -> str:
    _parse_address(value)
    return value


Text = Annotated[str, Field(min_length=1, max_length=512)]
_Url = Annotated[Text, AfterValidator(_check_url)]
_BaseUrl = Annotated[_Url, AfterValidator(lambda url: url.rstrip("/"))]
_NAME = Annotated[str, Field(pattern=ID_PATTERN.pattern)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class TlsConfig(_Table):
    """Certificates of a service, PEM files."""

    certificate: Path = Field(description="Certificate of the service, with those that it is signed by.")
    key: Path = Field(description="Private key of the certificate.")
    authority: Path | None = Field(
        default=None,
        description="Certificates that other services have to be signed by; those of the system if not given.",
    )


class TokenConfig(_Table):
    """Access tokens: which ones are accepted, and where the service gets its own."""

    keys: tuple[Path, ...] = Field(
        min_length=1, description="Public keys of authorization services, PEM files of RSA or Ed25519 keys."
    )
    issuers: tuple[Text, ...] = Field(
        default=(), description="Issuers of accepted tokens; any one with a key if empty."
    )
    url: _Url | None = Field(default=None, description="Token endpoint of the authorization service.")
    secret: Text | None = Field(default=None, description="Secret with which the service asks there.")


class UssConfig(_Table):
    """A UAS service supplier."""

    dss_url: _BaseUrl = Field(description="Base URL of the DSS.")
    dss_audience: Text | None = Field(
        default=None, description="Receiver of tokens for the DSS; the host of its URL if not given."
    )
    operators: dict[_NAME, Text] = Field(
        default_factory=dict, max_length=64, description="Operators that it serves, each with its bearer token."
    )
    limits: AlternativeParams = Field(default_factory=AlternativeParams, description="Limits of alternatives.")
    peers: tuple[_BaseUrl, ...] = Field(
        default=(), description="Base URLs of other USSs that it may call; every one that the DSS names if empty."
    )
    constraints: bool = Field(
        default=True, description="Whether it asks for constraints and keeps flights out of them."
    )
    flight_planning: bool = Field(
        default=False,
        description="Whether it has the interfaces of InterUSS for automated tests: flight planning and versioning.",
    )


class AuthorityConfig(_Table):
    """An approval authority: one approver that keeps the only database of intents."""

    operators: dict[_NAME, Text] = Field(
        min_length=1, max_length=1_000, description="Operators that it serves, each with its bearer token."
    )
    limits: AuthorityParams = Field(
        default_factory=AuthorityParams, description="Limits of alternatives, and the order of decisions."
    )


class DssConfig(_Table):
    """A discovery and synchronization service."""

    secret: Path = Field(description="File with the key of its OVNs, at least 16 bytes.")


class AuthorizationConfig(_Table):
    """An authorization service: issues tokens to its clients (OAuth 2.0 client credentials, RFC 6749, 4.4)."""

    key: Path = Field(description="Private key, a PEM file of an RSA or Ed25519 key.")
    issuer: Text = Field(default="auth.skyrange", description="Issuer of its tokens.")
    clients: dict[_NAME, Client] = Field(min_length=1, max_length=1_000, description="Clients by name.")


class Client(_Table):
    """A client of an authorization service."""

    secret: Text = Field(description="Its secret.")
    scopes: tuple[Text, ...] = Field(description="Scopes that it may ask for.")


class ServiceConfig(_Table):
    """One service of a federation."""

    name: _NAME = Field(description="Name of the service, as tokens call it.")
    role: Literal["uss", "dss", "authorization", "authority"] = Field(description="What the service is.")
    listen: Annotated[Text, AfterValidator(_check_address)] = Field(description="Address and port on which it listens.")
    base_url: _BaseUrl = Field(description="URL at which others reach it.")
    audiences: tuple[Text, ...] = Field(
        default=(), description="Receivers of accepted tokens; the host of base_url if empty."
    )
    database: Text | None = Field(
        default=None,
        description="URL of its database, such as sqlite:///north.db; without one it forgets all at its end.",
    )
    log: Path | None = Field(default=None, description="File to which its decisions are appended, as JSON lines.")
    tls: TlsConfig | None = Field(default=None, description="Certificates; without them it speaks plain HTTP.")
    tokens: TokenConfig | None = Field(default=None, description="Access tokens.")
    uss: UssConfig | None = Field(default=None, description="Settings of the role uss.")
    dss: DssConfig | None = Field(default=None, description="Settings of the role dss.")
    authorization: AuthorizationConfig | None = Field(default=None, description="Settings of the role authorization.")
    authority: AuthorityConfig | None = Field(default=None, description="Settings of the role authority.")

    @model_validator(mode="after")
    def _has_its_role(self) -> ServiceConfig:
        problems = [
            Problem(role, "a table", f"no table, because the role is {self.role!r}")
            for role in ("uss", "dss", "authorization", "authority")
            if role != self.role and getattr(self, role) is not None
        ]
        if getattr(self, self.role) is None:
            problems.append(Problem(self.role, "none", f"a table, because the role is {self.role!r}"))
        if self.role in ("uss", "dss") and self.tokens is None:
            problems.append(Problem("tokens", "none", "a table with the keys of an authorization service"))
        if self.role == "uss" and self.tokens is not None and self.tokens.url is None:
            problems.append(Problem("tokens.url", "none", "the token endpoint where the USS gets its own tokens"))
        if problems:
            raise refuse(*problems)
        return self

    @property
    def address(self) -> tuple[str, int]:
        """Host and port of `listen`."""
        return _parse_address(self.listen)

    @property
    def receivers(self) -> frozenset[str]:
        """The receivers of tokens that it accepts."""
        return frozenset(self.audiences or (host_of(self.base_url),))


def host_of(url: str) -> str:
    """The host of a URL, which tokens for it name as their receiver."""
    return urlsplit(url).hostname or ""


def load_config(path: Path) -> ServiceConfig:
    """The configuration in a TOML file; names of files in it are relative to its folder. Raises `InputError`."""
    who = str(path)
    data = parse_toml(read_text(path, who), who)
    try:
        config = ServiceConfig.model_validate(data)
    except ValidationError as error:
        raise input_error(who, error, ServiceConfig, data) from None
    return _within(path.parent, config)


def _within(folder: Path, table: BaseModel) -> ServiceConfig:
    """The same table with its files relative to `folder`."""

    def moved(value: object) -> object:
        if isinstance(value, Path):
            return folder / value
        if isinstance(value, BaseModel):
            return _within(folder, value)
        if isinstance(value, tuple):
            return tuple(moved(item) for item in value)
        return value

    changed = {name: moved(getattr(table, name)) for name in type(table).model_fields}
    if isinstance(database := changed.get("database"), str):
        changed["database"] = _sqlite_within(folder, database)
    return table.model_copy(update=changed)  # type: ignore[return-value]


def _sqlite_within(folder: Path, url: str) -> str:
    prefix = "sqlite:///"
    path = url.removeprefix(prefix)
    return url if path == url or path.startswith(("/", ":")) else f"{prefix}{folder / path}"
