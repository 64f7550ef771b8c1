"""The diagnosis names what an optional part lacks, and does not call it ok."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as real_version

import pytest

from skyrange import doctor


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
