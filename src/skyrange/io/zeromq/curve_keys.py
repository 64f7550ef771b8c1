"""CURVE key pairs of ZeroMQ sockets, and the files that keep them.

The files are ZeroMQ's usual certificates (`NAME.key` with the public key, `NAME.key_secret` with both),
as czmq and pyzmq write them. Both are readable by their owner only (0600); only `.key` is given to others.
Curve and encoding: https://rfc.zeromq.org/spec/26 (CurveZMQ), https://rfc.zeromq.org/spec/32 (Z85).
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import zmq
import zmq.auth

from skyrange.core.errors import InputError
from skyrange.core.files import open_input, read_input

PUBLIC_SUFFIX = ".key"
SECRET_SUFFIX = ".key_secret"  # noqa: S105 (the end of a name)
MAX_BYTES = 65_536
"""Longest certificate; one has about 400."""
RANGE = "range"
"""The name of the range's own pair, in the folder that holds all of its keys."""
_RANGE_KEY = b"range-key"
"""In the secret file of a machine that joins: the public key of the range."""
_WHO = "keys"
_KEY = re.compile(rb"[0-9a-zA-Z.\-:+=^!/*?&<>()\[\]{}@%$#]{40}")
"""32 bytes in Z85."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


class KeyFile(NamedTuple):
    """The content of a certificate, in Z85; `secret` is `None` in the file that is given to others."""

    public: bytes
    secret: bytes | None


@dataclass(frozen=True, slots=True)
class Keys:
    """One side's own key pair, and the public keys of its peers, all in Z85.

    The side that connects has one peer, the side that binds any number. The secret is not part of `repr`.
    """

    public: bytes
    secret: bytes = field(repr=False)
    peers: frozenset[bytes]

    @classmethod
    def load(cls, secret_file: Path, peers: Iterable[Path]) -> Keys:
        """Load the own secret file and the peers' public files. Raises `InputError` with the file that is wrong."""
        own_keys = load_keys(secret_file)
        if own_keys.secret is None:
            hint = f"Give the file that ends in {SECRET_SUFFIX}."
            raise InputError.one(_WHO, str(secret_file), "only a public key", "one's own secret key too", hint)
        return cls(own_keys.public, own_keys.secret, frozenset(load_keys(peer).public for peer in peers))


def make_keys(folder: Path, name: str, metadata: Mapping[str, str] | None = None) -> tuple[Path, Path]:
    """Make a key pair; returns `folder/NAME.key` and `folder/NAME.key_secret`, both 0600, with `metadata` in them.

    Makes the folder (0700) if there is none. Raises `InputError` if either file exists, since peers that trust the old
    key would be locked out, or cannot be written.
    """
    _check_name(name)
    paths = (folder / (name + PUBLIC_SUFFIX), folder / (name + SECRET_SUFFIX))
    made: list[Path] = []
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for path in paths:
            # made beforehand: a file opened for writing later keeps these permissions, and others could never read it
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
            made.append(path)
        zmq.auth.create_certificates(folder, name, dict(metadata or {}))
    except OSError as error:
        for path in made:
            path.unlink()
        if isinstance(error, FileExistsError) and error.filename != str(folder):
            hint = "Choose another name, or move the old key away."
            raise InputError.one(_WHO, str(error.filename), "is there already", "no such file", hint) from error
        reason = (error.strerror or str(error)).lower()
        raise InputError.one(_WHO, str(folder), reason, "a folder that can be written to") from error
    return paths


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name):
        raise InputError.one(_WHO, "name", name, "1 to 64 letters, digits, '-', '_' or '.', a letter or digit first")


def make_range_keys(folder: Path, names: Iterable[str]) -> list[Path]:
    """Make a range's pair in `folder`, unless it is there, and one for each machine of `names`; the secret files.

    The file `NAME.key_secret` goes to that machine: it has the range's public key, and the range accepts the machine by
    `NAME.key`, until that is deleted. `InputError` as `make_keys`; nothing new is left behind then.
    """
    names = list(names)
    secret_file = folder / (RANGE + SECRET_SUFFIX)
    for name in names:
        _check_name(name)
        if name == RANGE or names.count(name) > 1:
            expected = "another name: that one is the range's own" if name == RANGE else "each name once"
            raise InputError.one(_WHO, "name", name, expected)
    missing = [candidate for candidate in (folder, *folder.parents) if not candidate.exists()]
    made: list[Path] = []
    try:
        made += [] if secret_file.exists() else [make_keys(folder, RANGE)[1]]
        public = load_keys(secret_file).public.decode()
        for name in names:
            made.append(make_keys(folder, name, {_RANGE_KEY.decode(): public})[1])
    except InputError:
        for path in made:
            path.unlink()
            path.with_suffix(PUBLIC_SUFFIX).unlink()
        for missing_folder in missing:
            with suppress(OSError):  # not empty, or not there
                missing_folder.rmdir()
        raise
    return made


def load_range(folder: Path) -> Keys:
    """Load the range's own keys in `folder`, and those of all machines that may join."""
    secret_file = folder / (RANGE + SECRET_SUFFIX)
    if not os.path.exists(secret_file):
        hint = f"`skyrange keys {folder} NAME` makes it."
        raise InputError.one(_WHO, str(folder), f"no {secret_file.name}", "a folder of a range's keys", hint)
    others = [path for path in sorted(folder.glob(f"*{PUBLIC_SUFFIX}")) if path.stem != RANGE]
    return Keys.load(secret_file, others)


def load_member(path: Path) -> Keys:
    """Load the keys of a machine that joins: its own, and the range's public one."""
    own_keys = load_keys(path)
    range_key = _entry(path, read_input(path, _WHO, str(path), max_bytes=MAX_BYTES), _RANGE_KEY)
    if own_keys.secret is None or range_key is None:
        what = "only a public key" if own_keys.secret is None else "no key of a range"
        hint = f"`skyrange keys FOLDER NAME` makes NAME{SECRET_SUFFIX}."
        raise InputError.one(_WHO, str(path), what, "the secret key file of a machine that joins", hint)
    return Keys(own_keys.public, own_keys.secret, frozenset({range_key}))


def load_keys(path: Path) -> KeyFile:
    """Read a certificate. Raises `InputError` if it is none, or holds a secret that others can read."""
    with open_input(path, _WHO, "key", expected="a key file", hint="`skyrange keys` makes one.") as file:
        mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise InputError.one(_WHO, str(path), f"more than {MAX_BYTES} bytes", "a ZeroMQ certificate")
    public, secret = _entry(path, data, b"public-key"), _entry(path, data, b"secret-key")
    if public is None:
        raise InputError.one(_WHO, str(path), "no public-key", "a ZeroMQ certificate", "`skyrange keys` makes one.")
    if secret is not None:
        if mode & 0o077:
            hint = f"chmod 600 {path}, or make a new key if others may have read it."
            raise InputError.one(
                _WHO, str(path), f"permissions {mode:04o}", "a secret that only its owner can read", hint
            )
        if zmq.curve_public(secret) != public:
            raise InputError.one(_WHO, str(path), "a public-key that is not the secret-key's", "a pair")
    return KeyFile(public, secret)


def _entry(path: Path, data: bytes, name: bytes) -> bytes | None:
    match = re.search(rb"^[ \t]*" + re.escape(name) + rb"[ \t]*=[ \t]*(.*?)\s*$", data, re.MULTILINE)
    if match is None:
        return None
    key = match[1].strip(b"\"'")
    if not _KEY.fullmatch(key):
        expected = "40 characters of Z85"
        raise InputError.one(_WHO, f"{path}: {name.decode()}", f"{len(key)} bytes that are no key", expected)
    return key
