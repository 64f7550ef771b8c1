from __future__ import annotations

from importlib.metadata import EntryPoint

import pytest

from skyrange.agent import plugins
from skyrange.core.errors import ComponentError, Fault, InputError


class Yes:
    pass


class No:
    pass


@pytest.fixture(autouse=True)
def _forget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "_registered", dict(plugins._registered))


def test_a_registered_kind_is_found_and_listed():
    plugins.register(plugins.APPROVALS, "test.say_yes", Yes)
    assert plugins.find(plugins.APPROVALS, "test.say_yes") is Yes
    assert "test.say_yes" in plugins.kinds(plugins.APPROVALS)
    assert "test.say_yes" not in plugins.kinds(plugins.AUTOPILOTS)


def test_kinds_are_sorted():
    plugins.register(plugins.APPROVALS, "zz", Yes)
    plugins.register(plugins.APPROVALS, "aa", Yes)
    assert list(plugins.kinds(plugins.APPROVALS)) == sorted(plugins.kinds(plugins.APPROVALS))


def test_the_same_factory_may_register_twice_and_another_may_not():
    plugins.register(plugins.APPROVALS, "test-kind", Yes)
    plugins.register(plugins.APPROVALS, "test-kind", Yes)
    with pytest.raises(InputError, match="free"):
        plugins.register(plugins.APPROVALS, "test-kind", No)


@pytest.mark.parametrize("kind", ["", "Upper", "two words", ".x", "x.", "a..b", "-a", "a\n", "a/b", "1st"])
def test_malformed_kinds_are_refused(kind: str):
    with pytest.raises(InputError, match="lower-case"):
        plugins.register(plugins.APPROVALS, kind, Yes)


def test_an_unknown_kind_names_the_nearest():
    plugins.register(plugins.APPROVALS, "central", Yes)
    with pytest.raises(InputError) as error:
        plugins.find(plugins.APPROVALS, "centrall")
    assert error.value.exit_code == 2
    assert "Did you mean 'central'?" in str(error.value)


@pytest.mark.parametrize("use", [plugins.kinds, lambda group: plugins.find(group, "x")])
def test_an_unknown_group_names_the_nearest(use):
    with pytest.raises(InputError, match=r"Did you mean 'skyrange\.approvals'"):
        use("skyrange.approval")


def test_entry_points_are_offered_and_loaded_only_when_asked(monkeypatch: pytest.MonkeyPatch):
    group = plugins.APPROVALS
    here = {
        "good": EntryPoint("good", "skyrange.core.errors:Fault", group),
        "gone": EntryPoint("gone", "skyrange.no_such_module:Nothing", group),
    }
    monkeypatch.setattr(plugins, "_entry_points", lambda of: here if of == group else {})
    assert set(plugins.kinds(group)) >= {"gone", "good"}
    assert plugins.find(group, "good") is Fault
    with pytest.raises(ComponentError, match=r"gone: cannot import skyrange\.no_such_module"):
        plugins.find(group, "gone")


def test_the_shipped_kinds_are_installed():
    assert "approve-all" in plugins.kinds(plugins.APPROVALS)
    assert "builtin" in plugins.kinds(plugins.AUTOPILOTS)
