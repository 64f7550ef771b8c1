from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from skyrange.attack.gnss.jump import Jump
from skyrange.contracts.plugins import registry as plugins
from skyrange.contracts.plugins.registry import NoParams, Plugin
from skyrange.core.errors import ComponentError, InputError
from skyrange.utm.approval_service import policy_plugin
from skyrange.utm.approve_all import APPROVE_ALL, ApproveAll
from skyrange.utm.contract import ApprovalPlugin

YES = policy_plugin(NoParams, lambda params: ApproveAll(), "Says yes.")
NO = policy_plugin(NoParams, lambda params: ApproveAll(), "Says no.")


@pytest.fixture(autouse=True)
def _forget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "_loaded_files", dict(plugins._loaded_files))


def test_no_test_module_registers_kinds_when_it_is_imported() -> None:
    assert not plugins._registered, "every other test would see them; use tests.registered_kinds"


def test_a_registered_kind_is_found_and_listed() -> None:
    plugins.register(plugins.APPROVALS, "test.say_yes", YES)
    assert plugins.find(plugins.APPROVALS, "test.say_yes") is YES
    assert ApprovalPlugin.find("test.say_yes") is YES
    assert "test.say_yes" in plugins.kinds(plugins.APPROVALS)
    assert "test.say_yes" not in plugins.kinds(plugins.AUTOPILOTS)


def test_kinds_are_sorted() -> None:
    plugins.register(plugins.APPROVALS, "zz", YES)
    plugins.register(plugins.APPROVALS, "aa", YES)
    assert list(plugins.kinds(plugins.APPROVALS)) == sorted(plugins.kinds(plugins.APPROVALS))


def test_the_same_plugin_may_register_twice_and_another_may_not() -> None:
    plugins.register(plugins.APPROVALS, "test-kind", YES)
    plugins.register(plugins.APPROVALS, "test-kind", YES)
    with pytest.raises(InputError, match="free"):
        plugins.register(plugins.APPROVALS, "test-kind", NO)


@pytest.mark.parametrize("other", [Jump.plugin, ApproveAll, None, Plugin(NoParams, print, "Of no group.")])
def test_what_is_no_plugin_of_the_group_is_refused(other: object) -> None:
    with pytest.raises(InputError, match=r"plugin x: object: .* expected a plugin of skyrange\.approvals"):
        plugins.register(plugins.APPROVALS, "x", other)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["", "Upper", "two words", ".x", "x.", "a..b", "-a", "a\n", "a/b", "1st"])
def test_malformed_kinds_are_refused(kind: str) -> None:
    with pytest.raises(InputError, match="lower-case"):
        plugins.register(plugins.APPROVALS, kind, YES)


def test_an_unknown_kind_names_the_nearest() -> None:
    plugins.register(plugins.APPROVALS, "central", YES)
    with pytest.raises(InputError) as error:
        plugins.find(plugins.APPROVALS, "centrall")
    assert error.value.exit_code == 2
    assert "Did you mean 'central'?" in str(error.value)


@pytest.mark.parametrize("use", [plugins.kinds, lambda group: plugins.find(group, "x")])
def test_an_unknown_group_names_the_nearest(use: Callable[[str], object]) -> None:
    with pytest.raises(InputError, match=r"Did you mean 'skyrange\.approvals'"):
        use("skyrange.approval")


def test_entry_points_are_offered_and_loaded_only_when_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    group = plugins.APPROVALS
    here = {
        "good": EntryPoint("good", "skyrange.utm.approve_all:APPROVE_ALL", group),
        "gone": EntryPoint("gone", "skyrange.no_such_module:Nothing", group),
        "bare": EntryPoint("bare", "skyrange.utm.approve_all:ApproveAll", group),
    }
    monkeypatch.setattr(plugins, "_entry_points", lambda of: here if of == group else {})
    assert set(plugins.kinds(group)) >= {"gone", "good"}
    assert plugins.find(group, "good") is APPROVE_ALL
    with pytest.raises(ComponentError, match=r"gone: cannot import skyrange\.no_such_module"):
        plugins.find(group, "gone")
    with pytest.raises(InputError, match=r"plugin bare: object: type .*ApproveAll"):
        plugins.find(group, "bare")


def test_the_shipped_kinds_are_installed() -> None:
    assert "approve-all" in plugins.kinds(plugins.APPROVALS)
    assert "builtin" in plugins.kinds(plugins.AUTOPILOTS)
    assert "builtin" in plugins.kinds(plugins.MEDIA)


# ---------------------------------------------------------------- plugins from a file

GOOD = """
import skyrange
from skyrange.attack.gnss.jump import Jump

skyrange.register("skyrange.attacks", "test.jump", Jump.plugin)
"""


def written(folder: Path, text: str, name: str = "mine.py") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_offers_what_it_registers(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD)
    assert plugins.load_file(path) == ((plugins.ATTACKS, "test.jump"),)
    assert plugins.find(plugins.ATTACKS, "test.jump") is Jump.plugin
    path.write_text("raise RuntimeError('run twice')")
    assert plugins.load_file(str(path)) == ((plugins.ATTACKS, "test.jump"),)
    assert plugins.loaded_sources()[-1] == ("mine.py", GOOD.encode())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "from skyrange.plugin import OnPath, attack\n@attack('acme.bad')\nclass Bad(OnPath):\n    'Drops.'\n",
            "class Bad, methods: missing — expected act, which every OnLinks defines",
        ),
        (
            "from skyrange.plugin import OnPath, attack, drop\n@attack('link.drop')\nclass Bad(OnPath):\n    'Drops.'\n"
            "    act = drop()\n",
            "class Loss in skyrange.attack.link.drop has it",
        ),
        ("x = 1\n", "registers no plugin — expected a class with a decorator"),
        ("import skyrange\n\nskyrange.regster('a')\n", "line 3: AttributeError: module 'skyrange' has no attribute"),
        ("import skyrange\ndef :\n", "line 2: SyntaxError"),
        (
            "from skyrange import register\nregister('skyrange.attack', 'x', None)\n",
            "group: skyrange.attack — expected",
        ),
        ("import nothing_of_this_name\n", "line 1: ModuleNotFoundError: No module named 'nothing_of_this_name'"),
        (f"{GOOD}\nraise OSError('no key')\n", "OSError: no key"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_and_nothing_of_it_stays(tmp_path: Path, text: str, words: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        plugins.load_file(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert words in str(caught.value)
    assert "test.jump" not in plugins.kinds(plugins.ATTACKS)


@pytest.mark.parametrize("name", ["gone.py", ".", "mine.txt"])
def test_a_file_that_cannot_be_one_is_named(tmp_path: Path, name: str) -> None:
    written(tmp_path, GOOD, "mine.txt")
    with pytest.raises(InputError, match=r"--plugin: file: .* expected a Python file"):
        plugins.load_file(tmp_path / name)
