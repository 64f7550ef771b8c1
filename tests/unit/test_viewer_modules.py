"""The check of the viewer's modules finds what it is for."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tools.node_packages import FOLDER, are_packages_installed
from tools.viewer_modules import ASSETS, PASSED, check_modules

MISSING = "" if are_packages_installed() else "the packages of Node are not installed (make check)"

pytestmark = pytest.mark.external(missing=MISSING)

FAULTS = {
    "TS2322": ("camera.js", "this.touched = false;", 'this.touched = "no";'),
    "TS2339": ("player.js", "view.playing", "view.plays"),
    "TS7006": ("theme.js", "/** @param {{ink: string[]}} one @param {Theme} theme */", ""),
    "eqeqeq": ("player.js", 'event.key === " "', 'event.key == " "'),
    "prefer-const": ("theme.js", "const style", "let style"),
    "no-unused-vars": ("scene.js", "const STREAM_VERSION", "const unused = 1;\nconst STREAM_VERSION"),
    "no-restricted-properties": ("page-parts.js", "node.textContent = text", "node.innerHTML = text"),
}
"""By what is found, a module, and what of it is replaced by what."""


@pytest.mark.parametrize("rule", FAULTS)
def test_a_fault_in_a_module_is_named(rule: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    name, before, after = FAULTS[rule]
    assets = Path(shutil.copytree(ASSETS, tmp_path / "assets"))
    text = (assets / name).read_text(encoding="utf-8")
    assert before in text
    (assets / name).write_text(text.replace(before, after, 1), encoding="utf-8")
    passed = FOLDER / PASSED
    stamp = passed.read_text() if passed.exists() else None
    assert not check_modules(assets)
    printed = capfd.readouterr().out
    assert rule in printed
    assert name in printed
    assert (passed.read_text() if passed.exists() else None) == stamp
