"""`skyrange install ardupilot`, from a web server on this machine and from files, good and bad ones.

The binaries are made up: a few instructions that print what SITL's `--help` prints, and the firmware's name.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import socket
import ssl
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

import pytest

from skyrange.cli import main
from skyrange.core.errors import ComponentError, InputError
from skyrange.install import ardupilot as installing
from skyrange.install import download as downloading
from skyrange.install.ardupilot import DEFAULT_VERSION, VARIABLE, install
from skyrange.vehicle.ardupilot import arducopter_binary
from skyrange.vehicle.ardupilot.arducopter_binary import REQUIRED_OPTIONS, data_folder, find_binary
from tests.tiers import needs
from tests.unit.made_up_binaries import AARCH64, elf, firmware, program

X86_64 = sys.platform == "linux" and platform.machine() == "x86_64"
pytestmark = pytest.mark.skipif(
    not X86_64, reason="programs made up for the tests, as ArduPilot's SITL, are of Linux on x86-64"
)

HELP = b"Options:\n" + b"".join(b"\t%s X   do it\n" % option.encode() for option in REQUIRED_OPTIONS)
PAD = bytes(300_000)


def copter(version: str = DEFAULT_VERSION) -> bytes:
    return program(HELP, firmware(f"ArduCopter V{version}") + PAD)


def path_of(version: str) -> str:
    return f"/Copter/stable-{version}/SITL_x86_64_linux_gnu/arducopter"


class Server(BaseHTTPRequestHandler):
    """Serves `files`; what it does to them is said by `manner`."""

    files: ClassVar[dict[str, bytes]] = {}
    manner: ClassVar[str] = ""
    over: ClassVar[threading.Event] = threading.Event()

    def do_GET(self) -> None:
        body = self.files.get(self.path)
        if self.manner == "moved" and not self.path.startswith("/new"):
            self.send_response(302)
            self.send_header("Location", f"/new{self.path}")
            self.end_headers()
            return
        body = self.files.get(self.path.removeprefix("/new"))
        if self.manner == "down" or body is None:
            self.send_error(503 if self.manner == "down" else 404)
            return
        self.send_response(200)
        if self.manner != "no length":
            self.send_header("Content-Length", str(body and len(body)))
        self.end_headers()
        self.wfile.write(body[: len(body) // 2] if self.manner in ("cut", "silent") else body)
        if self.manner == "silent":
            self.wfile.flush()
            self.over.wait(10.0)

    def log_message(self, format: str, *args: Any) -> None:
        pass


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[type[Server]]:
    """A web server with the default version on it, a data folder, and nothing else to be found."""
    monkeypatch.setattr(Server, "files", {path_of(DEFAULT_VERSION): copter()})
    monkeypatch.setattr(Server, "manner", "")
    monkeypatch.setattr(Server, "over", threading.Event())
    monkeypatch.delenv(arducopter_binary.VARIABLE, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("no_proxy", "*")
    with ThreadingHTTPServer(("127.0.0.1", 0), Server) as own:
        monkeypatch.setenv(VARIABLE, f"http://127.0.0.1:{own.server_address[1]}/Copter/")
        thread = threading.Thread(target=own.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield Server
        Server.over.set()
        own.shutdown()
        thread.join()


def left(tmp_path: Path) -> list[str]:
    """Files in the data folder."""
    data = tmp_path / "data"
    return sorted(str(path.relative_to(data)) for path in data.rglob("*") if not path.is_dir())


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    """The exit code of `skyrange install ardupilot`."""
    monkeypatch.setattr(sys, "argv", ["skyrange", "install", "ardupilot", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


# ---------------------------------------------------------------- what goes well


def test_a_download_is_checked_put_away_and_found(server: type[Server], tmp_path: Path) -> None:
    told: list[tuple[int, int | None]] = []
    made = install(on_progress=lambda done, total: told.append((done, total)))
    data = copter()
    assert left(tmp_path) == [f"skyrange/ardupilot/{DEFAULT_VERSION}/arducopter"]
    assert made.binary.path.read_bytes() == data
    assert os.access(made.binary.path, os.X_OK)
    assert made.binary.sha256 == hashlib.sha256(data).hexdigest()
    assert made.origin.endswith(path_of(DEFAULT_VERSION))
    assert find_binary() == made.binary
    assert len(told) > 2
    assert told[-1] == (len(data), len(data))
    assert install().binary == made.binary  # once more, over itself


@pytest.mark.parametrize("manner", ["moved", "no length"])
def test_a_server_may_send_on_and_not_know_the_length(
    server: type[Server], monkeypatch: pytest.MonkeyPatch, manner: str
) -> None:
    monkeypatch.setattr(server, "manner", manner)
    assert install().binary.version == DEFAULT_VERSION


def test_another_version_stands_beside(server: type[Server], tmp_path: Path) -> None:
    server.files[path_of("4.6.3")] = copter("4.6.3")
    install()
    for spelling in ("4.6.3", "v4.6.3", "stable-4.6.3"):
        assert install(spelling).binary.version == "4.6.3"
    assert len(left(tmp_path)) == 2
    assert find_binary().version == DEFAULT_VERSION


def test_the_command_says_what_it_did(
    server: type[Server], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert run(monkeypatch, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["version"], told["path"]) == (DEFAULT_VERSION, str(find_binary().path))
    assert (told["sha256"], told["from"]) == (find_binary().sha256, os.environ[VARIABLE] + path_of(DEFAULT_VERSION)[8:])
    given = tmp_path / "given"
    given.write_bytes(copter("4.6.3"))  # no exec bit, as a browser leaves it
    assert run(monkeypatch, "--from", str(given)) == 0
    out, err = capsys.readouterr()
    assert hashlib.sha256(given.read_bytes()).hexdigest() in out
    assert "4.6.3/arducopter" in out
    assert f"skyrange runs a different binary, which is newer: ArduCopter {DEFAULT_VERSION}" in err


def test_help_names_the_version_that_is_fetched(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "--help") == 0
    assert f"Default: {DEFAULT_VERSION}" in " ".join(capsys.readouterr().out.replace("│", " ").split())


# ---------------------------------------------------------------- what a server may do wrong


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        (b"<html><body>Please log in to this network</body></html>", "sent an HTML page or XML text"),
        (program(HELP, firmware(f"ArduPlane V{DEFAULT_VERSION}")), "sent ArduPlane"),
        (elf(AARCH64, body=firmware()), "sent a program for another machine (aarch64)"),
        (copter("4.6.3"), f"sent ArduCopter 4.6.3; expected version {DEFAULT_VERSION}"),
        (copter()[:-1000], "cut off"),
        (b"", "an empty file"),
        (
            program(b"no such option\n", firmware(f"ArduCopter V{DEFAULT_VERSION}"), code=3),
            "ended with exit 3: no such",
        ),
        (program(b"hello", firmware(f"ArduCopter V{DEFAULT_VERSION}")), "does not list --model"),
        (elf(body=firmware(f"ArduCopter V{DEFAULT_VERSION}")), "`--help` ended with signal SIG"),  # a crash
    ],
)
def test_a_wrong_file_leaves_nothing(server: type[Server], tmp_path: Path, sent: bytes, said: str) -> None:
    server.files[path_of(DEFAULT_VERSION)] = sent
    with pytest.raises(ComponentError, match=r"127\.0\.0\.1") as caught:
        install()
    assert said in str(caught.value)
    assert left(tmp_path) == []


def test_a_binary_that_does_not_end_is_killed(
    server: type[Server], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.files[path_of(DEFAULT_VERSION)] = program(b"", firmware(f"ArduCopter V{DEFAULT_VERSION}"), hangs=True)
    monkeypatch.setattr(installing, "ANSWER_S", 0.3)
    with pytest.raises(ComponentError, match=r"did not answer `--help` within 0.3 s of wall time"):
        install()
    assert left(tmp_path) == []
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    assert not [child for child in children if "arducopter" in Path(f"/proc/{child}/cmdline").read_text()]


@pytest.mark.parametrize(
    ("manner", "said"),
    [("cut", "closed the connection after"), ("silent", "sent nothing for 0.3 s"), ("down", "answered 503")],
)
def test_a_broken_transfer_leaves_nothing_and_what_was_there(
    server: type[Server], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, manner: str, said: str
) -> None:
    monkeypatch.setattr(downloading, "TIMEOUT_S", 0.3)
    before = install().binary
    monkeypatch.setattr(server, "manner", manner)
    with pytest.raises(ComponentError, match=said) as caught:
        install()
    assert "--from FILE" in str(caught.value)
    assert left(tmp_path) == [f"skyrange/ardupilot/{DEFAULT_VERSION}/arducopter"]
    assert find_binary() == before


def test_a_cut_off_transfer_of_unknown_length_is_noticed(
    server: type[Server], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.files[path_of(DEFAULT_VERSION)] = copter()[: len(copter()) // 2]
    monkeypatch.setattr(server, "manner", "no length")
    with pytest.raises(ComponentError, match="cut off"):
        install()
    assert left(tmp_path) == []


def test_a_file_without_end_is_refused(server: type[Server], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(downloading, "MAX_BYTES", 100_000)
    for manner in ("", "no length"):
        monkeypatch.setattr(server, "manner", manner)
        with pytest.raises(ComponentError, match="sends more than 100,000 bytes"):
            install()
    assert left(tmp_path) == []


def test_an_interrupted_download_leaves_nothing(server: type[Server], tmp_path: Path) -> None:
    def interrupt(done: int, total: int | None) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        install(on_progress=interrupt)
    assert left(tmp_path) == []


def test_a_host_that_is_not_there(server: type[Server], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        monkeypatch.setenv(VARIABLE, f"http://127.0.0.1:{free.getsockname()[1]}")
        with pytest.raises(ComponentError, match=r"cannot be reached: .*refused.*--from FILE"):
            install()
    monkeypatch.setenv(VARIABLE, "https://firmware.invalid/Copter")
    with pytest.raises(ComponentError, match=r"firmware.invalid: cannot be reached"):
        install()
    assert left(tmp_path) == []


@needs("openssl")
def test_a_certificate_that_nobody_vouches_for_is_refused(
    server: type[Server], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    key, certificate = tmp_path / "key.pem", tmp_path / "cert.pem"
    monkeypatch.undo()  # PATH, for openssl
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "1",
         "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", "-keyout", key, "-out", certificate],
        check=True, capture_output=True,
    )  # fmt: skip
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("no_proxy", "*")
    monkeypatch.setattr(Server, "files", {path_of(DEFAULT_VERSION): copter()})
    with ThreadingHTTPServer(("127.0.0.1", 0), Server) as own:
        own.socket = context.wrap_socket(own.socket, server_side=True, do_handshake_on_connect=False)
        monkeypatch.setenv(VARIABLE, f"https://localhost:{own.server_address[1]}/Copter")
        monkeypatch.setattr(own, "handle_error", lambda *_: None)
        thread = threading.Thread(target=own.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            with pytest.raises(ComponentError, match="CERTIFICATE_VERIFY_FAILED"):
                install()
            assert left(tmp_path) == []
            monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
            assert install().binary.version == DEFAULT_VERSION
        finally:
            own.shutdown()
            thread.join()


# ---------------------------------------------------------------- what the user may do wrong


@pytest.mark.parametrize(
    ("version", "said"),
    [
        ("4.6.99", "--version: 4.6.99 — expected a version that the server has"),
        ("latest", "expected a release, such as"),
        ("4.6", "expected a release, such as"),
        ("../../etc", "expected a release, such as"),
        ("4.3.0", "expected version 4.6 or newer"),
    ],
)
def test_a_version_that_is_none(server: type[Server], tmp_path: Path, version: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        install(version)
    assert said in str(caught.value)
    assert left(tmp_path) == []


@pytest.mark.parametrize(
    "url", ["file:///etc", "ftp://firmware.ardupilot.org", "nowhere", "http://", "http://a:b/", "https://a b/"]
)
def test_a_mirror_that_is_no_web_address(server: type[Server], monkeypatch: pytest.MonkeyPatch, url: str) -> None:
    monkeypatch.setenv(VARIABLE, url)
    with pytest.raises(InputError, match=f"{VARIABLE}: .* expected an http or https address"):
        install()


@pytest.mark.parametrize(("system", "machine"), [("linux", "aarch64"), ("darwin", "x86_64"), ("darwin", "arm64")])
def test_a_machine_for_which_there_is_none_is_told_before_any_download(
    server: type[Server], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, system: str, machine: str
) -> None:
    monkeypatch.setattr(platform, "machine", lambda: machine)
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(server, "files", {})
    with pytest.raises(
        InputError, match=f"this machine: {system} on {machine} — expected Linux on x86_64.*--from FILE"
    ):
        install()
    assert not (tmp_path / "data").exists()


def test_a_file_that_will_not_do(server: type[Server], tmp_path: Path) -> None:
    plane = tmp_path / "plane"
    plane.write_bytes(program(HELP, firmware("ArduPlane V4.6.3")))
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for source, said in (
        (plane, f"--from: {plane}: ArduPlane 4.6.3"),
        (pipe, "is a pipe"),
        (tmp_path, "is a folder"),
        (tmp_path / "nothing", "no such file"),
    ):
        with pytest.raises(InputError) as caught:
            install(source=source)
        assert said in str(caught.value)
    good = tmp_path / "good"
    good.write_bytes(copter("4.6.3"))
    with pytest.raises(InputError, match=f"--from: {good}: ArduCopter 4.6.3 — expected version 4.6.2"):
        install("4.6.2", good)
    broken = tmp_path / "broken"
    broken.write_bytes(program(b"GLIBC_2.99 not found\n", firmware(), code=1))
    with pytest.raises(ComponentError, match=f"{broken}: `--help` ended with exit 1: GLIBC_2.99 not found"):
        install(source=broken)
    assert left(tmp_path) == []


def test_a_data_folder_that_cannot_be_written(
    server: type[Server], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_the_way = tmp_path / "data"
    in_the_way.write_text("a file")
    with pytest.raises(InputError, match=r"data folder: .* not a directory — expected a writable folder"):
        install()
    assert in_the_way.read_text() == "a file"


def test_a_disk_that_is_full(server: type[Server], tmp_path: Path) -> None:
    """The limit on file sizes stands for it: the write fails halfway, with an error of its own."""
    code = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))\n"
    code += "import sys; sys.argv[1:] = ['install', 'ardupilot']\nfrom skyrange.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, env={**os.environ}, check=False
    )
    assert done.returncode == 2
    assert f"data folder: {data_folder()}: file too large — expected a writable folder" in done.stderr
    assert left(tmp_path) == []


def test_exit_codes(server: type[Server], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(monkeypatch, "--version", "4.6.99") == 2
    monkeypatch.setattr(server, "manner", "cut")
    assert run(monkeypatch) == 3
    assert "skyrange: 127.0.0.1" in capsys.readouterr().err


# ---------------------------------------------------------------- what the doctor says


def test_the_doctor_says_what_was_found(server: type[Server], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from skyrange.doctor import _ardupilot

    none = _ardupilot()
    assert (none.ok, none.optional) == (False, True)
    assert "no arducopter" in none.found
    assert "skyrange install ardupilot" in none.hint
    made = install().binary
    found = _ardupilot()
    assert found.ok
    for said in (DEFAULT_VERSION, "installed", str(made.path), made.sha256[:16], "runs"):
        assert said in found.found
    wrong = tmp_path / "wrong"
    wrong.write_bytes(program(b"", firmware(), code=1))
    wrong.chmod(0o755)
    monkeypatch.setenv(arducopter_binary.VARIABLE, str(wrong))
    bad = _ardupilot()
    assert (bad.ok, bad.optional) == (False, True)
    assert "does not run" in bad.found
    assert "`--help` ended with exit 1" in bad.hint


def test_the_doctor_does_not_fail_for_what_is_optional(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from skyrange import doctor
    from skyrange.cli import installation

    findings = [doctor.Finding("ardupilot", "none", ok=False, hint="get it", optional=True)]
    monkeypatch.setattr(doctor, "examine", lambda **_: findings)
    installation.doctor(compiling=False, as_json=False)
    assert capsys.readouterr().out == "--  ardupilot: none\n    get it\n"
    findings.append(doctor.Finding("numpy", "missing", ok=False, hint="pip install numpy"))
    with pytest.raises(SystemExit) as ended:
        installation.doctor(compiling=False, as_json=False)
    assert ended.value.code == 3
