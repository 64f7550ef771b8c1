"""Files of a new federation on one machine: configurations, keys, and certificates of an authority of its own."""

from __future__ import annotations

import ipaddress
import json
import os
import secrets
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat
from cryptography.x509.oid import NameOID
from uas_standards.astm.f3548.v21.constants import Scope

from skyrange.core.errors import InputError, Problem
from skyrange.core.ids import ID_PATTERN
from skyrange.utm.contract import DSS

AUTHORIZATION: Final = "auth"
AUTHORITY: Final = "authority"
_DAYS: Final = 365
_TESTERS: Final = ("uss_qualifier", "uss_qualifier_2", "mock_uss")
"""Clients for `uss_qualifier` of InterUSS, and for the USS that it tests others with."""
_TEST_SCOPES: Final = (
    "interuss.flight_planning.direct_automated_test",
    "interuss.flight_planning.plan",
    "interuss.versioning.read_system_versions",
    "utm.inject_test_data",
    Scope.AvailabilityArbitration.value,
)
_SCOPES: Final = (
    Scope.StrategicCoordination,
    Scope.ConformanceMonitoringForSituationalAwareness,
    Scope.ConstraintProcessing,
    Scope.ConstraintManagement,
)


def write_federation(
    folder: Path, services: Mapping[str, Sequence[str]], first_port: int, *, tests: bool
) -> list[Path]:
    """Write what a federation needs into a new folder; returns the configurations, in the order to start them.

    `services`: USSs with the operators of each. The services listen on loopback, from `first_port` on. With `tests`,
    each USS has the interfaces for automated tests. Raises `InputError`.
    """
    _check(services, first_port, len(services) + 2, "--uss", "NAME=OPERATORS, such as north=blue,green")
    _make_folder(folder)
    names = [AUTHORIZATION, DSS, *services]
    ports = {name: first_port + number for number, name in enumerate(names)}
    _write_certificates(folder, names)
    key = rsa.generate_private_key(65_537, 3_072)
    _write_key(folder / "auth-signing.key", key)
    public = key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    (folder / "auth-signing.pem").write_bytes(public)
    _write_secret(folder / "ovn.key", secrets.token_bytes(32))
    passwords = {name: secrets.token_urlsafe(24) for name in services}
    testers = {name: secrets.token_urlsafe(24) for name in _TESTERS} if tests else {}
    texts = {
        AUTHORIZATION: _authorization(ports[AUTHORIZATION], passwords, testers),
        DSS: _service(DSS, "dss", ports[DSS]) + _TOKENS + '\n[dss]\nsecret = "ovn.key"\n',
    }
    for name, operators in services.items():
        texts[name] = _uss(name, operators, ports, passwords[name], tests=tests)
    written = []
    for name, text in texts.items():
        _write_secret(folder / f"{name}.toml", text.encode())
        written.append(folder / f"{name}.toml")
    return written


def write_authority(folder: Path, operators: Sequence[str], port: int) -> Path:
    """Write what an approval authority with some operators needs into a new folder; returns its configuration.

    It listens on loopback. Raises `InputError`.
    """
    _check({AUTHORITY: operators}, port, 1, "--authority", "operators, such as blue,green")
    _make_folder(folder)
    _write_certificates(folder, [AUTHORITY])
    served = "".join(f'{operator} = "{secrets.token_urlsafe(24)}"\n' for operator in operators)
    path = folder / f"{AUTHORITY}.toml"
    _write_secret(path, f"{_service(AUTHORITY, AUTHORITY, port)}\n[authority.operators]\n{served}".encode())
    return path


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise InputError.one("utm init", "folder", str(folder), "a folder that does not exist", str(error)) from error


def _check(services: Mapping[str, Sequence[str]], first_port: int, ports: int, option: str, example: str) -> None:
    """Raise `InputError` for names and ports that cannot be; `option` is the one that has given the names."""
    problems = []
    for name, operators in services.items():
        for identifier in (name, *operators):
            if not ID_PATTERN.fullmatch(identifier) or (identifier == name and identifier in (AUTHORIZATION, DSS)):
                expected = f"a name of letters, digits, - and _, other than {AUTHORIZATION!r} and {DSS!r}"
                problems.append(Problem(option, repr(identifier), expected, f"Write {example}."))
    if not 1 <= first_port <= 65_536 - ports:
        problems.append(Problem("--port", str(first_port), "a port that leaves enough of them for all services"))
    if problems:
        raise InputError("utm init", problems)


_TOKENS: Final = '\n[tokens]\nkeys = ["auth-signing.pem"]\nissuers = ["auth.skyrange"]\n'


def _service(name: str, role: str, port: int) -> str:
    database = "" if role == "authorization" else f'database = "sqlite:///{name}.db"\nlog = "{name}.jsonl"\n'
    return (
        f'name = "{name}"\nrole = "{role}"\nlisten = "127.0.0.1:{port}"\nbase_url = "https://localhost:{port}"\n'
        f"{database}"
        f'\n[tls]\ncertificate = "{name}.crt"\nkey = "{name}.key"\nauthority = "ca.crt"\n'
    )


def _authorization(port: int, passwords: Mapping[str, str], testers: Mapping[str, str]) -> str:
    scopes = [scope.value for scope in _SCOPES]
    rows = [_client(name, secret, scopes) for name, secret in passwords.items()]
    rows += [_client(name, secret, [*scopes, *_TEST_SCOPES]) for name, secret in testers.items()]
    table = '\n[authorization]\nkey = "auth-signing.key"\n\n[authorization.clients]\n'
    return _service(AUTHORIZATION, "authorization", port) + table + "".join(rows)


def _client(name: str, secret: str, scopes: Sequence[str]) -> str:
    return f'{name} = {{ secret = "{secret}", scopes = {json.dumps(scopes)} }}\n'


def _uss(name: str, operators: Sequence[str], ports: Mapping[str, int], password: str, *, tests: bool) -> str:
    tokens = f'{_TOKENS}url = "https://localhost:{ports[AUTHORIZATION]}/token"\nsecret = "{password}"\n'
    uss = f'\n[uss]\ndss_url = "https://localhost:{ports[DSS]}"\n'
    served = "".join(f'{operator} = "{secrets.token_urlsafe(24)}"\n' for operator in operators)
    planning = "flight_planning = true\n" if tests else ""
    return f"{_service(name, 'uss', ports[name])}{tokens}{uss}{planning}\n[uss.operators]\n{served}"


def _write_certificates(folder: Path, names: Sequence[str]) -> None:
    """A certificate for each service on localhost, signed by an authority whose key is not kept."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "skyrange UTM services")])
    authority = _builder(subject, subject, key.public_key())
    authority = authority.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    authority = authority.add_extension(_usage(signs_certificates=True), critical=True)
    (folder / "ca.crt").write_bytes(authority.sign(key, hashes.SHA256()).public_bytes(Encoding.PEM))
    alternatives = x509.SubjectAlternativeName(
        [x509.DNSName("localhost"), x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]
    )
    for name in names:
        private_key = ec.generate_private_key(ec.SECP256R1())
        builder = _builder(
            x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)]), subject, private_key.public_key()
        )
        builder = builder.add_extension(alternatives, critical=False)
        builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        builder = builder.add_extension(_usage(signs_certificates=False), critical=True)
        signer = x509.AuthorityKeyIdentifier.from_issuer_public_key(key.public_key())
        builder = builder.add_extension(signer, critical=False)
        certificate = builder.sign(key, hashes.SHA256())
        (folder / f"{name}.crt").write_bytes(certificate.public_bytes(Encoding.PEM))
        _write_key(folder / f"{name}.key", private_key)


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    """What a key is for; strict clients ask for it (RFC 5280, 4.2.1.3)."""
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _builder(subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=_DAYS))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _write_key(path: Path, key: rsa.RSAPrivateKey | ec.EllipticCurvePrivateKey) -> None:
    _write_secret(path, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))


def _write_secret(path: Path, content: bytes) -> None:
    """Write a file that its owner alone can read."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(content)
