"""Configurations of UTM services: each mistake is an error that names the file, the key and what was expected."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.core.errors import ComponentError, InputError
from skyrange.runtime.utm.config import load_config
from skyrange.runtime.utm.initial_files import write_authority, write_federation
from skyrange.runtime.utm.service import run_service
from tests.utm_services import free_port


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("made") / "federation"
    write_federation(made, {"north": ["blue"]}, free_port(3), tests=False)
    return made


@pytest.mark.parametrize(
    ("service", "old", "new", "expected"),
    [
        ("north", 'role = "uss"', 'role = "dss"', "uss: a table — expected no table, because the role is 'dss'"),
        ("north", 'role = "uss"', 'role = "pilot"', "role: 'pilot' — expected 'uss'"),
        ("north", 'base_url = "https', 'base_url = "ftp', "base_url: 'ftp://"),
        ("north", 'dss_url = "https', 'dss_url = "ftp', "uss.dss_url: 'ftp://"),
        ("north", "dss_url =", 'peers = ["https://a.example/?q"]\ndss_url =', "uss.peers.0: 'https://a.example/?q'"),
        ("north", '\nurl = "https', '\nurl = "wss', "tokens.url: 'wss://"),
        ("north", 'listen = "127.0.0.1:', 'listen = "127.0.0.1:9', "listen: '127.0.0.1:9"),
        ("north", "[uss]", "[uss]\nspeed = 3", "uss.speed: speed = 3 — expected a known key"),
        ("north", "\nurl =", "\nno_url =", "tokens.no_url"),
        ("north", 'name = "north"', 'name = "no rth"', "name"),
        ("dss", "[tokens]", "[tls.more]", "tls.more"),
        ("auth", "[authorization]", "[[authorization]]", "authorization"),
    ],
)
def test_a_mistake_is_named(folder: Path, tmp_path: Path, service: str, old: str, new: str, expected: str) -> None:
    text = (folder / f"{service}.toml").read_text()
    assert old in text
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_config(wrong)
    assert expected in str(caught.value)
    assert "wrong.toml" in str(caught.value)


def start(path: Path) -> None:
    async def body() -> None:
        async with run_service(load_config(path)):
            pass

    asyncio.run(body())


@pytest.mark.parametrize(
    ("service", "file", "content", "expected"),
    [
        ("dss", "ovn.key", b"short", "dss.secret: 5 bytes — expected at least 16 bytes"),
        ("dss", "auth-signing.pem", b"no key", "tokens.keys"),
        ("north", "north.crt", b"no certificate", "tls"),
        ("auth", "auth-signing.key", b"no key", "authorization.key"),
        ("dss", "dss.db", b"this is no database, but it is long enough to be read as one", "database"),
    ],
)
def test_a_file_that_is_wrong_is_an_error_before_the_service_listens(
    tmp_path: Path, service: str, file: str, content: bytes, expected: str
) -> None:
    made = tmp_path / "federation"
    write_federation(made, {"north": ["blue"]}, free_port(3), tests=False)
    (made / file).write_bytes(content)
    with pytest.raises(InputError, match=expected):
        start(made / f"{service}.toml")


def test_beyond_loopback_a_service_needs_certificates(folder: Path) -> None:
    path = folder / "dss.toml"
    text = path.read_text().replace("127.0.0.1", "0.0.0.0").split("[tls]")
    open_one = folder / "open.toml"
    open_one.write_text(text[0] + "[tokens]" + text[1].split("[tokens]")[1])
    with pytest.raises(InputError, match=r"0\.0\.0\.0.*loopback"):
        start(open_one)


def test_an_address_that_is_taken_is_named(folder: Path) -> None:
    async def body() -> None:
        config = load_config(folder / "auth.toml")
        async with run_service(config):
            with pytest.raises(OSError, match=str(config.address[1])):
                async with run_service(config):
                    pass

    asyncio.run(body())


def test_new_files_are_written_once_and_for_their_owner_alone(tmp_path: Path) -> None:
    made = tmp_path / "one"
    path = write_authority(made, ["blue", "green"], 8_080)
    config = load_config(path)
    assert config.authority is not None
    assert set(config.authority.operators) == {"blue", "green"}
    assert config.database == f"sqlite:///{made / 'authority.db'}"
    for secret in (path, made / "authority.key"):
        assert secret.stat().st_mode & 0o077 == 0
    with pytest.raises(InputError, match="a folder that does not exist"):
        write_authority(made, ["blue"], 8_080)
    with pytest.raises(InputError, match="--port: 65535"):
        write_federation(tmp_path / "two", {"north": ["blue"]}, 65_535, tests=False)
    with pytest.raises(InputError, match="other than 'auth' and 'dss'"):
        write_federation(tmp_path / "two", {"dss": ["blue"]}, 8_080, tests=False)
    with pytest.raises(InputError, match="--authority: 'no name'"):
        write_authority(tmp_path / "two", ["no name"], 8_080)
    assert not (tmp_path / "two").exists()


def test_the_commands_say_what_is_wrong(tmp_path: Path) -> None:
    runner = CliRunner()
    made = runner.invoke(app, ["utm", "init", str(tmp_path / "f"), "--uss", "north=blue", "--port", "8090"])
    assert made.exit_code == 0, made.output
    assert "Start them with: skyrange utm serve" in made.output
    for wrong in (["utm", "serve", str(tmp_path / "missing.toml")], ["utm", "init", str(tmp_path / "f")]):
        with pytest.raises((InputError, ComponentError)):
            runner.invoke(app, wrong, catch_exceptions=False, standalone_mode=False)
