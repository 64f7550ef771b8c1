"""Which Gazebo does a run take, and what does it say of those that it does not? Programs are shell scripts."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from skyrange.core.errors import InputError
from skyrange.vehicle.gazebo import gazebo_program
from skyrange.vehicle.gazebo.gazebo_program import (
    VARIABLE,
    WINDOW_VARIABLE,
    Flavour,
    Gazebo,
    find_gazebo,
    find_window,
    parse_classic_version,
    parse_sim_version,
)
from skyrange.vehicle.gazebo.gazebo_program import window_command as command_of_window

CLASSIC = "Gazebo multi-robot simulator, version {}\nCopyright (C) 2012 Open Source Robotics Foundation.\n"
USAGE = "The 'gz' command provides a command line interface to the Gazebo Tools.\n\n  gz <command> [options]\n"
MOVED = "I cannot find any available 'gz' command:\n\t* Did you install any Gazebo library?\n"

Make = Callable[..., Path]


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    """Makes a program that prints `version` for `--version`, and `versions` for `sim --versions`."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.delenv(WINDOW_VARIABLE, raising=False)
    monkeypatch.setattr(gazebo_program, "_seen", {})
    (tmp_path / "on path").mkdir()
    monkeypatch.setenv("PATH", f"{tmp_path / 'on path'}:/usr/bin:/bin")

    def make(name: str, version: str = "", versions: str = "", commands: str = "", otherwise: str = "exit 1") -> Path:
        path = tmp_path / "on path" / name
        answers = {"--version": version, "sim --versions": versions, "--commands": commands}
        cases = "".join(f"'{asked}') cat <<'END'\n{said}\nEND\nexit 255;;\n" for asked, said in answers.items() if said)
        path.write_text(f'#!/bin/sh\necho "$*" >> "$0.asked"\ncase "$*" in\n{cases}esac\n{otherwise}\n')
        path.chmod(0o755)
        return path

    return make


def sim(make: Make, versions: str = "8.9.0", name: str = "gz", commands: str = "gui\nsim") -> Path:
    return make(name, USAGE, versions, commands)


def classic(make: Make, version: str = "11.1.0", name: str = "gzserver") -> Path:
    return make(name, CLASSIC.format(version))


def test_both_flavours_are_known_by_their_answers(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    path = classic(make, name="a wrapper")
    monkeypatch.setenv(VARIABLE, str(path))
    found = find_gazebo()
    assert found == Gazebo(Flavour.CLASSIC, "11.1.0", path, "SKYRANGE_GAZEBO")
    assert (found.title, found.build, found.major) == ("Gazebo 11.1.0", "classic11", 11)
    path = sim(make, name="another wrapper")
    monkeypatch.setenv(VARIABLE, str(path))
    found = find_gazebo()
    assert found == Gazebo(Flavour.SIM, "8.9.0", path, "SKYRANGE_GAZEBO")
    assert (found.title, found.build, found.major) == ("Gazebo Sim 8.9.0", "sim8", 8)


def test_a_gzserver_is_not_asked_what_makes_it_serve(make: Make) -> None:
    path = classic(make)
    find_gazebo()
    assert Path(f"{path}.asked").read_text() == "--version\n"


def test_a_program_is_asked_once_while_it_is_unchanged(make: Make) -> None:
    path = classic(make)
    find_gazebo()
    assert find_gazebo().version == "11.1.0"
    assert len(Path(f"{path}.asked").read_text().splitlines()) == 1
    path.write_text(path.read_text().replace("11.1.0", "11.15.1"))
    assert find_gazebo().version == "11.15.1"


def test_sim_comes_before_classic_on_path(make: Make) -> None:
    classic(make)
    gz = sim(make, "9.1.0\n8.9.0")
    found = find_gazebo()
    assert (found.path, found.version, found.source) == (gz, "9.1.0", "PATH")  # `gz sim` starts the newest, its first


@pytest.mark.parametrize("answer", ["Invalid arguments", USAGE, "7.5.0"])
def test_a_gz_without_a_supported_sim_is_passed_over(make: Make, answer: str) -> None:
    sim(make, answer)
    gzserver = classic(make)
    assert find_gazebo().path == gzserver


def test_without_a_gazebo_the_ways_to_get_one_are_told(make: Make) -> None:
    with pytest.raises(InputError, match=r"SKYRANGE_GAZEBO \(not set\) and PATH.*neither gz nor gzserver") as caught:
        find_gazebo()
    assert "apt-get install gz-harmonic" in str(caught.value)
    assert "libgazebo-dev" in str(caught.value)
    assert caught.value.exit_code == 2


def test_all_that_is_wrong_with_those_on_path_is_told(make: Make) -> None:
    sim(make, "7.5.0")
    classic(make, "9.0.0")
    with pytest.raises(InputError) as caught:
        find_gazebo()
    assert [problem.value for problem in caught.value.problems] == ["Gazebo Sim 7.5.0", "Gazebo 9.0.0"]


@pytest.mark.parametrize(
    ("said", "value"),
    [
        ("", "says nothing of its version"),
        ("usage: ls [FILE]\nmore", "'usage: ls [FILE]'"),
        (USAGE, "gz without the command sim"),
        (MOVED, "it looks for them in the folder that it was built for"),
        ("Invalid arguments", "gz of Gazebo 11 or older, not its gzserver"),
        ("Gazebo Sim 8", "'Gazebo Sim 8'"),
    ],
)
def test_a_named_program_that_is_no_gazebo_is_refused(
    make: Make, monkeypatch: pytest.MonkeyPatch, said: str, value: str
) -> None:
    path = make("program", said, said)
    classic(make)  # the one that is named is not passed over
    monkeypatch.setenv(VARIABLE, str(path))
    with pytest.raises(InputError) as caught:
        find_gazebo()
    assert str(caught.value).startswith(f"{VARIABLE}: {path}: ")
    assert value in caught.value.problems[0].value


def test_a_named_path_without_a_program_is_refused(make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = classic(make)
    path.chmod(0o644)
    script = tmp_path / "no interpreter"
    script.write_text("#!/nowhere/sh\n")
    script.chmod(0o755)
    for named, value in (
        (path, "not executable"),
        (tmp_path, "a folder"),
        (tmp_path / "nothing", "no such file"),
        (script, "loader that it names"),
        ("a\0b", "null"),
    ):
        if "\0" in str(named):  # no variable can hold it
            with pytest.raises(InputError, match=value):
                gazebo_program.examine_gazebo(Path(named), "PATH")
            continue
        monkeypatch.setenv(VARIABLE, str(named))
        with pytest.raises(InputError, match=value) as caught:
            find_gazebo()
        assert str(caught.value).startswith(f"{VARIABLE}: {named}")


def test_a_program_that_hangs_is_killed_with_what_it_started(
    make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gazebo_program, "ANSWER_S", 1.0)
    pid = tmp_path / "pid"
    make("gz", otherwise=f"sleep 300 & echo $! > '{pid}'; wait")
    with pytest.raises(InputError, match=r"did not answer `--version` within 1 s.*an answer with its version"):
        find_gazebo()
    until = time.monotonic() + 10.0
    while not (ended := _has_ended(int(pid.read_text()))) and time.monotonic() < until:
        time.sleep(0.01)
    assert ended


def _has_ended(pid: int) -> bool:
    """Whether a process is gone, or waits to be collected by the one that inherited it."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except OSError:
        return True


def test_versions_are_read_from_what_the_programs_print() -> None:
    assert parse_classic_version(CLASSIC.format("11.1.0")) == "11.1.0"
    assert parse_classic_version("11.1.0") is None
    assert parse_sim_version("8.9.0\n8.6.0\n") == "8.9.0"
    assert parse_sim_version("10.0.0~pre1\n") == "10.0.0~pre1"
    assert Gazebo(Flavour.SIM, "10.0.0~pre1", Path("gz")).major == 10
    for text in ("", "8.9", "gz: version unknown", "8.9.0 is not installed"):
        assert parse_sim_version(text) is None


def test_servers_are_started_without_a_window_and_apart_from_others() -> None:
    world = Path("a folder/world.sdf")
    server = Gazebo(Flavour.CLASSIC, "11.1.0", Path("/bin/gzserver")).server_command(world, seed=7, port=12_000)
    at = server.index("/bin/gzserver")
    assert server[0] == "env"
    assert "GAZEBO_MASTER_URI=http://127.0.0.1:12000" in server[:at]
    assert server[at + 1 :] == ("--verbose", "--seed", "7", str(Path.cwd() / world))
    server = Gazebo(Flavour.SIM, "8.9.0", Path("/bin/gz")).server_command(world, port=12_000)
    at = server.index("/bin/gz")
    assert "GZ_PARTITION=skyrange-12000" in server[:at]
    assert server[at + 1 :] == ("sim", "-s", "-r", "-v", "2", str(Path.cwd() / world))


def test_the_window_is_that_of_the_server(make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sim(make)
    found = find_gazebo()
    assert find_window(found) == str(found.path)
    assert command_of_window(found, 12_000)[-2:] == ("sim", "-g")
    assert "GZ_PARTITION=skyrange-12000" in command_of_window(found, 12_000)
    sim(make, commands="sim\nsdf")
    with pytest.raises(InputError, match="gz without the command gui"):
        find_window(found)

    monkeypatch.setenv(VARIABLE, str(classic(make)))
    found = find_gazebo()
    with pytest.raises(InputError, match=r"no gzclient.*SKYRANGE_GZCLIENT"):
        find_window(found)
    beside = make("gzclient")
    assert command_of_window(found, 12_000)[-1] == str(beside)
    other = tmp_path / "a client"
    monkeypatch.setenv(WINDOW_VARIABLE, str(other))
    with pytest.raises(InputError, match="gzclient of Gazebo 11"):
        find_window(found)
    beside.rename(other)
    assert find_window(found) == str(other)
    assert os.access(other, os.X_OK)
