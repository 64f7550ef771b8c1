"""The diagnosis names what an optional part lacks, and does not call it ok."""

from __future__ import annotations

import errno
import os
import tempfile
from contextlib import AbstractContextManager, nullcontext
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as real_version
from pathlib import Path

import pytest

from skyrange import doctor
from skyrange.core import compiled
from skyrange.radio.external.ns3 import VARIABLE
from skyrange.runtime import compilation
from tests.integration.radio_program import write_program


def test_a_part_without_its_package_says_what_it_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    def version(name: str) -> str:
        if name == "pyrvo":
            raise PackageNotFoundError(name)
        return "1.0" if name == "pyserial" else real_version(name)

    monkeypatch.setattr(doctor, "version", version)
    findings = {one.subject: one for one in (*doctor._packages(), *doctor._plugins())}
    avoidance, pyrvo = findings["skyrange.avoidance"], findings["pyrvo"]
    assert "orca (needs pyrvo)" in avoidance.found
    assert (avoidance.ok, avoidance.optional) == (False, True)
    assert (pyrvo.ok, pyrvo.optional) == (False, True)
    assert "skyrange[orca]" in avoidance.hint
    assert "skyrange[orca]" in pyrvo.hint
    assert findings["pyserial"].ok
    assert findings["skyrange.attacks"].ok
    assert "pytest" not in findings


def test_a_part_with_its_package_is_ok(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "version", lambda name: "1.0")
    findings = [*doctor._packages(), *doctor._plugins()]
    assert all(one.ok for one in findings)
    assert "orca" in next(one.found for one in findings if one.subject == "skyrange.avoidance")


def test_a_radio_engine_is_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(write_program(tmp_path)))
    found = doctor._ns3()
    assert (found.ok, found.optional) == (True, True)
    assert "reach 1" in found.found
    monkeypatch.setenv(VARIABLE, "/bin/false")
    found = doctor._ns3()
    assert (found.ok, found.optional) == (False, True)
    assert "skyrange install ns3" in found.hint


def test_a_radio_engine_that_is_not_there_is_optional(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    found = doctor._ns3()
    assert (found.ok, found.optional) == (False, True)
    assert "skyrange install ns3" in found.hint
    assert "libns3-dev" in found.hint


def test_a_compiled_engine_needs_no_wheel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def version(name: str) -> str:
        if name == "ns3":
            raise PackageNotFoundError(name)
        return "1.0"

    monkeypatch.setattr(doctor, "version", version)
    for program, ok in ((str(write_program(tmp_path)), True), ("/bin/false", False)):
        monkeypatch.setenv(VARIABLE, program)
        media = next(one for one in doctor._plugins() if one.subject == "skyrange.media")
        assert media.ok == ok
        assert ("needs ns3" in media.found) != ok


def test_runs_are_recorded_in_their_folder_where_nothing_else_is_writable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a container: the working folder is read-only, and a volume is mounted at `runs`."""
    writable = {tmp_path / "runs"}

    def make(dir: Path) -> AbstractContextManager[str]:
        if dir not in writable:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))
        return nullcontext(str(dir))

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tempfile, "TemporaryDirectory", make)
    without = doctor._writable()
    assert (without.found, without.ok) == (f"{tmp_path}: Read-only file system", False)
    assert "--out DIR" in without.hint
    (tmp_path / "runs").mkdir()
    assert doctor._writable() == doctor.Finding("folder of runs", f"{tmp_path / 'runs'} is writable")
    writable.clear()
    assert not doctor._writable().ok


def test_kernels_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compilation, "count_kernels", lambda: (3, 5))
    monkeypatch.setattr(compiled, "cache_folder", lambda: "/cache")
    some = doctor._kernels()
    assert (some.found, some.ok, some.optional) == ("3 of 5 compiled, in /cache", False, True)
    assert "skyrange install kernels" in some.hint
    monkeypatch.setattr(compilation, "count_kernels", lambda: (5, 5))
    assert doctor._kernels() == doctor.Finding("kernels", "5 of 5 compiled, in /cache", optional=True)
    monkeypatch.setattr(compiled, "cache_folder", lambda: "")
    assert not doctor._kernels().ok
