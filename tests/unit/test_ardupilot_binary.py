"""Which arducopter is found, and what is said of files that are none. The files are made up: nothing here is run."""

from __future__ import annotations

import hashlib
import os
import platform
from pathlib import Path

import pytest

from skyrange.core.errors import ComponentError, InputError
from skyrange.vehicle.ardupilot import arducopter_binary
from skyrange.vehicle.ardupilot.arducopter_binary import (
    MACHINES,
    REQUIRED_OPTIONS,
    VARIABLE,
    check_help,
    data_folder,
    examine_binary,
    find_binary,
    version_key,
    why_not_executable,
)
from tests.ardupilot import ARDUCOPTER, NAMED, WHY_NOT, needs_arducopter
from tests.unit.made_up_binaries import AARCH64, ARM, elf, firmware


@pytest.fixture(autouse=True)
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """An x86-64 machine, with nothing found yet."""
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


def put(path: Path, data: bytes, mode: int = 0o755) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    path.chmod(mode)
    return path


def copter(path: Path, version: str = "4.6.3") -> Path:
    return put(path, elf(body=firmware(f"ArduCopter V{version}")))


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        examine_binary(path)
    return str(caught.value)


# ---------------------------------------------------------------- looking into a file


@pytest.mark.parametrize("version", ["4.6.3", "4.5.0", "4.7.0-dev", "4.7.0-beta2", "4.10.12", "5.0.0-rc1"])
def test_an_arducopter_is_taken_with_version_and_hash(tmp_path: Path, version: str) -> None:
    path = copter(tmp_path / "arducopter", version)
    found = examine_binary(path)
    assert (found.path, found.version, found.source) == (path, version, "installed")
    assert found.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "an empty file"),
        (b"#!/bin/sh\nexec arducopter\n", "a script"),
        (b"\n<!DOCTYPE html><html>ArduCopter V4.6.3</html>", "an HTML page"),
        (b"\x1f\x8b\x08" + bytes(60), "a gzip archive"),
        (b"PK\x03\x04" + bytes(60), "a zip archive"),
        (b'{"board_id": 9}', "JSON, as an .apj"),
        (b"MZ" + bytes(60), "a Windows program"),
        (b"\xcf\xfa\xed\xfe" + bytes(60), "a macOS program"),
        (b"ArduCopter V4.6.3\0--speedup", "a file that is not a program"),
        (b"\x7fELF", "broken header"),
        (b"\x7fELF\x02\x01\x01" + bytes(20), "cut off after 27 bytes"),
        (b"\x7fELF\x07\x01\x01" + bytes(60), "broken header"),
        (elf(AARCH64, body=firmware()), "another machine (aarch64)"),
        (elf(ARM, bits=32, body=firmware()), "another machine (armv7l)"),
        (elf(bits=32, body=firmware()), "another machine (ELF machine 62, 32 bits)"),
        (elf(kind=1, body=firmware()), "an object file"),
        (elf(kind=4, body=firmware()), "a core dump"),
        (elf(loaded=False, body=firmware()), "nothing to run"),
        (elf(body=b"hello\0"), "without ArduPilot's version"),
        (elf(body=firmware("ArduPlane V4.6.3")), "ArduPlane 4.6.3 — expected ArduCopter"),
        (elf(body=firmware("ArduRover V4.5.7")), "ArduRover 4.5.7 — expected ArduCopter"),
        (elf(body=firmware("ArduSub V4.5.0-beta1")), "ArduSub 4.5.0-beta1"),
        (elf(body=firmware("AP_Periph V1.7.0")), "AP_Periph 1.7.0"),
        (elf(body=firmware("ArduCopter V4.4.4")), "ArduCopter 4.4.4 — expected version 4.6 or newer"),
        (elf(body=firmware("APM:Copter V3.3")), "ArduCopter 3.3 — expected version 4.6 or newer"),
        (elf(body=firmware(mark=b"")), "ArduCopter 4.6.3 for a flight controller — expected a build for SITL"),
    ],
)
def test_anything_else_is_named(tmp_path: Path, data: bytes, said: str) -> None:
    path = put(tmp_path / "arducopter", data)
    message = refused(path)
    assert said in message
    assert str(path) in message
    assert "skyrange install ardupilot" in message


def test_a_file_cut_anywhere_is_refused(tmp_path: Path) -> None:
    """The program header says how long the file is; what hangs behind its end is not missed."""
    whole = elf(body=firmware())
    assert why_not_executable(whole, "x86_64") == ""
    assert why_not_executable(whole + b"more", "x86_64") == ""
    for size in range(len(whole)):
        assert why_not_executable(whole[:size], "x86_64")
    assert "cut off" in refused(put(tmp_path / "arducopter", whole[:-1]))


def test_any_damage_to_the_header_is_survived() -> None:
    whole = bytearray(elf(body=firmware()))
    for at in range(120):
        for value in (0x00, 0x7F, 0xFF):
            hurt = whole.copy()
            hurt[at] = value
            assert isinstance(why_not_executable(bytes(hurt), "x86_64"), str)


def test_a_machine_that_is_not_known_takes_any_program() -> None:
    assert why_not_executable(elf(AARCH64), "loongarch64") == ""
    assert {why_not_executable(elf(AARCH64), name) for name, own in MACHINES.items() if own == (64, AARCH64)} == {""}


def test_exec_bit_folder_device_and_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = put(tmp_path / "a copter", elf(body=firmware()), 0o644)
    assert f"chmod +x '{plain}'" in refused(plain)
    plain.chmod(0o755)
    assert examine_binary(plain).version == "4.6.3"
    assert "a folder" in refused(tmp_path)
    assert "not a regular file" in refused(Path("/dev/null"))
    assert "no such file" in refused(tmp_path / "nothing")
    monkeypatch.setattr(arducopter_binary, "MAX_BYTES", 100)
    assert "bytes — expected an arducopter, no larger than 100" in refused(plain)


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    path = copter(tmp_path / "arducopter", "4.6.2")
    first = examine_binary(path)
    assert examine_binary(path) == first
    put(path, elf(body=firmware("ArduCopter V4.6.3")))
    os.utime(path, ns=(1, 1))
    assert examine_binary(path).version == "4.6.3"
    assert examine_binary(path).sha256 != first.sha256


def test_capabilities_are_what_was_built_in(tmp_path: Path) -> None:
    bare = put(tmp_path / "bare", elf(body=firmware()))
    rich = put(tmp_path / "rich", elf(body=firmware() + b"no_time_sync\0" + b"\0AP_OpenDroneID\0"))
    assert examine_binary(bare).capabilities == ()
    assert examine_binary(rich).capabilities == ("lockstep", "Open Drone ID")


# ---------------------------------------------------------------- finding one


def test_variable_then_path_then_newest_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for version in ("4.6.3", "4.6.10", "4.7.0-beta1", "4.7.0-dev"):
        copter(data_folder() / version / "arducopter", version)
    found = find_binary()
    assert (found.source, found.version) == ("installed", "4.7.0-beta1")
    copter(tmp_path / "bin" / "arducopter", "4.5.7")
    found = find_binary()
    assert (found.source, found.version) == ("PATH", "4.5.7")
    monkeypatch.setenv(VARIABLE, str(copter(tmp_path / "own" / "mine", "4.6.0")))
    found = find_binary()
    assert (found.source, found.version) == (VARIABLE, "4.6.0")
    monkeypatch.setenv(VARIABLE, "")
    assert find_binary().source == "PATH"


def test_what_is_first_and_wrong_is_not_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copter(data_folder() / "4.6.3" / "arducopter")
    put(tmp_path / "bin" / "arducopter", b"#!/bin/sh\n")
    with pytest.raises(InputError, match=r"arducopter on PATH: .* a script"):
        find_binary()
    monkeypatch.setenv(VARIABLE, str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match=f"{VARIABLE}: .*nowhere: no such file"):
        find_binary()


def test_none_at_all_says_how_to_get_one(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        find_binary()
    fault = caught.value.problems[0]
    assert "skyrange install ardupilot" in fault.hint
    assert VARIABLE in fault.hint
    assert str(tmp_path / "data") in fault.where


def test_versions_sort_as_they_were_released() -> None:
    released = ["4.5.7", "4.6.0-dev", "4.6.0-beta1", "4.6.0-beta2", "4.6.0-rc1", "4.6.0", "4.6.9", "4.6.10", "4.10.0"]
    backwards = released[::-1]
    assert sorted(backwards, key=version_key) == released
    assert version_key("something else") < version_key("4.5.0")


# ---------------------------------------------------------------- its answer


def test_an_answer_must_be_that_of_sitl() -> None:
    text = "Options:\n" + "\n".join(f"\t{option} X" for option in REQUIRED_OPTIONS)
    check_help("it", "exit 0", text)
    with pytest.raises(ComponentError, match=r"it: `--help` ended with exit 1: no GLIBC"):
        check_help("it", "exit 1", "no GLIBC\n")
    with pytest.raises(ComponentError, match="--start-time"):
        check_help("it", "exit 0", text.replace("--start-time", "--fg"))


def test_an_arducopter_that_is_named_will_do() -> None:
    """Else a misspelt variable would skip every test of ArduPilot, and nothing would be red."""
    assert ARDUCOPTER is not None or not NAMED, WHY_NOT


@needs_arducopter
def test_the_real_one_answers() -> None:
    from skyrange.io.processes.program import run_once

    assert ARDUCOPTER is not None
    assert "lockstep" in ARDUCOPTER.capabilities
    answer = run_once(ARDUCOPTER.path, "--help", deadline_s=10.0)
    check_help("arducopter", answer.ended, answer.text)
