"""Is a kind what its class says, and is what it lacks named before a run?"""

from __future__ import annotations

import copy
import pickle
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import pytest
from pydantic import ValidationError

from skyrange.attack.contract import AttackPlugin, ThreatModel
from skyrange.attack.declaration import Acting, Composite, Facts, attack
from skyrange.attack.link.delay import Lag
from skyrange.contracts.params import Number
from skyrange.contracts.plugins import registry
from skyrange.contracts.plugins.form import Kind, KindType, check_copies, make_params_model, param, plugin_of, state
from skyrange.core.errors import ComponentError, InputError, Problem
from tests.registered_kinds import registered

if TYPE_CHECKING:
    from decimal import Decimal


def _make_generator() -> Iterator[int]:
    return (number for number in range(3))


def _pickle(one: Any) -> Any:
    return pickle.loads(pickle.dumps(one))


class First(Kind):
    """A base."""

    size_m: Number = param("Size in metres.", ge=0)
    seen: dict[str, int] = state(dict)
    turns: int = 0

    def who(self) -> str:
        return "first"


class Second(First):
    """A kind."""

    form: Literal["round", "square"] = param("Form.", default="round")
    later: int

    def find_problems(self) -> Iterator[Problem]:
        if self.size_m == 3 and self.form == "square":
            yield Problem("size_m", "3", "another size of a square")

    def who(self) -> str:
        return super().who() + " and second"


Second.params_model = make_params_model(Second)


def test_parameters_are_those_of_bases_and_then_of_the_class() -> None:
    schema = Second.params_model.model_json_schema()
    assert list(schema["properties"]) == ["size_m", "form"]
    assert schema["required"] == ["size_m"]
    assert schema["properties"]["form"] == {
        "default": "round", "description": "Form.", "enum": ["round", "square"], "title": "Form", "type": "string",
    }  # fmt: skip


class Changed(Second):
    """A kind whose fields are declared anew."""

    size_m: Number = 2.0
    turns: int = param("Turns.", default=5)


Changed.params_model = make_params_model(Changed)


def test_a_field_that_is_declared_anew_is_what_it_is_declared_as_last() -> None:
    assert list(Changed.params_model.model_fields) == ["form", "turns"]
    one = Changed(turns=7)
    assert (one.turns, one.size_m) == (7, 2.0)


class Below(Changed):
    """A kind below one whose fields were declared anew."""


class Beside(First):
    """A base that has a parameter where `First` has state."""

    turns: int = param("Turns.", default=5)


class Both(Beside, Second):
    """A kind of two bases, of which the nearer one says what a field is."""


Below.params_model, Both.params_model = make_params_model(Below), make_params_model(Both)


def test_a_field_of_a_far_base_is_what_the_nearest_class_declares() -> None:
    assert list(Below.params_model.model_fields) == ["form", "turns"]
    assert Below(turns=7).turns == 7
    assert sorted(Both.params_model.model_fields) == ["form", "size_m", "turns"]
    assert Both(size_m=1, turns=7).turns == 7


def test_each_instance_has_state_of_its_own() -> None:
    one, other = Second(size_m=1.5), Second(size_m=2)
    one.seen["a"] = 1
    one.turns += 1
    assert (other.seen, other.turns, other.size_m, other.form) == ({}, 0, 2.0, "round")
    assert one.who() == "first and second"


@pytest.mark.parametrize("how", [copy.deepcopy, _pickle])
def test_a_copy_shares_nothing(how: Callable[[Any], Any]) -> None:
    one = Second(size_m=1)
    one.seen["a"] = 1
    other = how(one)
    other.seen["b"] = 2
    assert one.seen == {"a": 1}
    assert other.size_m == 1.0


def test_what_is_not_declared_cannot_be_set() -> None:
    with pytest.raises(AttributeError, match="undeclared"):
        Second(size_m=1).undeclared = 1  # type: ignore[attr-defined]


def test_parameters_are_checked_one_by_one_and_beside_each_other() -> None:
    for wrong in ({"size_m": -1}, {}, {"size_m": 1, "form": "oval"}, {"size_m": 1, "colour": "red"}):
        with pytest.raises(ValidationError):
            Second(**wrong)
    with pytest.raises(ValidationError, match="another size of a square"):
        Second(size_m=3, form="square")


def test_a_mutable_default_is_refused() -> None:
    with pytest.raises(InputError, match=r"class .*Shared in .*seen.*state\(dict\)"):

        class Shared(Kind):
            """Shares."""

            seen: dict[str, int] = {}  # noqa: RUF012


def test_a_class_attribute_that_hides_a_field_is_refused() -> None:
    with pytest.raises(InputError, match=r"class .*Hiding in .*turns: 5 — expected an annotation"):

        class Hiding(First):
            """Hides."""

            turns = 5


def test_parameters_of_a_kind_can_be_pickled() -> None:
    params = Lag.params_model.model_validate({"links": ["gcs:*"]})
    assert _pickle(params) == params


def test_state_that_cannot_be_copied_is_named() -> None:
    class Odd(Kind):
        """Odd."""

        source: Any = state(_make_generator)

    Odd.params_model = make_params_model(Odd)
    with pytest.raises(InputError, match=r"class .*Odd in .*source: generator"):
        check_copies(Odd())


def test_a_closure_is_no_state() -> None:
    class Closed(Kind):
        """Closed."""

        call: Any

    Closed.params_model = make_params_model(Closed)
    one, captured = Closed(), [1]
    one.call = lambda: captured
    with pytest.raises(InputError, match="closure"):
        check_copies(one)


def test_a_type_that_only_checkers_see_is_named() -> None:
    class Checked(Kind):
        """Checked."""

        value: Decimal = param("A value.")

    with pytest.raises(InputError, match=r"class .*Checked in .*value: Decimal.*not for type checkers alone"):
        make_params_model(Checked)


class Nothing(Composite):
    """Does nothing."""

    def build(self, context: Any) -> Any:
        return None


class Undescribed(Nothing):
    """Does nothing."""

    size_m: Number = param("")


class Undocumented(Nothing):
    pass


class Unfinished(Composite):
    """Does nothing."""


class Wordless(Nothing):
    """Nothing"""


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (Undescribed, "size_m: no description"),
        (Undocumented, "docstring: missing"),
        (Wordless, "docstring: Nothing — expected a sentence"),
        (Unfinished, "methods: missing — expected build, which every Acting defines"),
        (Second, "bases: First — expected Acting or one of its bases"),
    ],
)
def test_a_class_that_is_no_kind_is_named_with_what_it_lacks(kind: Any, message: str) -> None:
    with registered(), pytest.raises(InputError, match=f"class {kind.__qualname__} in .*{message}"):
        attack("test.nothing")(kind)


def test_two_classes_of_one_name_are_an_error_that_names_both() -> None:
    class Other(Nothing):
        """Does nothing else."""

    with registered():
        attack("test.nothing")(Nothing)
        with pytest.raises(InputError, match=r"test\.nothing of class .*Other.*class Nothing in .* has it"):
            attack("test.nothing")(Other)


def test_a_cell_of_a_notebook_may_run_again() -> None:
    def run_cell() -> Any:
        return KindType("Cell", (Nothing,), {"__doc__": "Does it.", "__module__": "__main__"})

    with registered():
        attack("test.nothing")(run_cell())
        again = attack("test.nothing")(run_cell())
        assert AttackPlugin.find("test.nothing") is again.plugin


def test_a_kind_is_called_as_its_module(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "skyrange.attack.link.lag", ModuleType("skyrange.attack.link.lag"))
    moved: Any = KindType("Moved", (Nothing,), {"__doc__": "Does it.", "__module__": "skyrange.attack.link.lag"})
    with pytest.raises(InputError, match=r"name: link\.delay — expected 'link\.lag', the path of its module"):
        attack("link.delay")(moved)


def test_a_kind_is_found_by_the_path_of_its_module() -> None:
    assert AttackPlugin.find("link.delay") is Lag.plugin
    assert plugin_of(Lag) is Lag.plugin
    assert registry.is_known(registry.ATTACKS, "link.break")  # break_.py, because a module cannot be called break
    assert not registry.is_known(registry.ATTACKS, "contract")  # a module without a kind
    with pytest.raises(InputError, match="decorator"):
        plugin_of(Acting)


KIND_OF_A_PACKAGE = '''\
"""A kind in a package of somebody else."""

from skyrange.plugin import Delay, Frame, OnPath, Time, Verdicts, attack


@attack("NAME")
class Lag(OnPath):
    """Delays all frames."""

    def act(self, now: Time, frame: Frame) -> Verdicts:
        return (Delay(now + 1_000_000),)
'''


def test_a_package_offers_its_kinds_by_one_entry_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "acme_sky" / "deep").mkdir(parents=True)
    text = KIND_OF_A_PACKAGE
    for place in ("__init__.py", "deep/__init__.py"):
        (tmp_path / "acme_sky" / place).write_text('"""Kinds."""\n')
    (tmp_path / "acme_sky" / "lag.py").write_text(text.replace("NAME", "acme.lag"))
    (tmp_path / "acme_sky" / "deep" / "lag.py").write_text(text.replace("NAME", "acme.deep.lag"))
    (tmp_path / "acme_sky" / "broken.py").write_text("1 / 0\n")
    (tmp_path / "acme_sky" / "__main__.py").write_text("raise SystemExit(7)\n")
    information = tmp_path / "acme_sky-1.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-sky\nVersion: 1\n")
    (information / "entry_points.txt").write_text("[skyrange.plugins]\nacme = acme_sky\n")
    monkeypatch.syspath_prepend(tmp_path)
    from skyrange.contracts.plugins import registry

    registry._offered.cache_clear()
    try:
        with pytest.raises(ComponentError, match=r"package acme_sky: cannot import acme_sky.broken: ZeroDivisionError"):
            AttackPlugin.find("acme.broken")
        (tmp_path / "acme_sky" / "broken.py").unlink()
        assert AttackPlugin.find("acme.lag").about == "Delays all frames."
        assert "acme.deep.lag" in registry.kinds(registry.ATTACKS)
    finally:
        registry._offered.cache_clear()
        for key in [key for key in registry._at_home if key[1].startswith("acme.")]:
            del registry._at_home[key]


class Common(Composite):
    """A base with facts that its kinds have in common."""

    attack_facts: ClassVar[Facts] = {
        "surface": ("gcs",), "persists": "acts", "position": "here", "equipment": "a pin", "budget": "nothing",
    }  # fmt: skip


class Nearer(Common):
    """A base of its own, which says otherwise."""

    attack_facts: ClassVar[Facts] = {"budget": "one pin", "technique": "T0814"}


def test_facts_of_a_kind_go_before_those_of_its_bases_and_the_nearest_base_first() -> None:
    class Pricked(Nearer):
        """Pricks."""

        def build(self, context: Any) -> Any: ...

    with registered():
        attack("test.pricked", persists="flight", knowledge="where it is")(Pricked)
        plugin: AttackPlugin = plugin_of(Pricked)
    assert (plugin.surface, plugin.persists, plugin.technique) == (("gcs",), "flight", "T0814")
    assert plugin.threat == ThreatModel("where it is", "here", "a pin", "one pin")
    assert plugin.controls is None


@pytest.mark.parametrize(
    ("name", "intrudes"),
    [
        ("mavlink.mode", True), ("identity.keep_alive", True), ("signing.replay", True), ("remote_id.spoof", True),
        ("link.replay", True), ("companion.takeover", True),
        ("companion.no_avoidance", False),  # replaces frames by themselves
        ("remote_id.jam", False),  # nothing receives noise of -200 dBm
        ("approval.squat", False),  # an operator asks what it may ask
        ("link.delay", False), ("telemetry.position", False), ("gnss.drift", False),
    ],
)  # fmt: skip
def test_shams_that_put_frames_of_somebody_unauthorised_on_a_medium_intrude(name: str, intrudes: bool) -> None:
    assert AttackPlugin.find(name).intrudes == intrudes


@pytest.mark.parametrize(
    ("facts", "missing"),
    [
        ({"budget": "nothing"}, "knowledge"),
        ({"load": "none"}, "content"),
        ({"content": "none", "placement": "elsewhere"}, "load"),
    ],
)
def test_a_part_of_a_threat_model_or_of_controls_is_refused(facts: Any, missing: str) -> None:
    class Half(Common):
        """Says half."""

        def build(self, context: Any) -> Any: ...

    with pytest.raises(InputError) as caught:
        attack("test.half", **facts)(Half)
    (problem,) = caught.value.problems
    assert problem.where.endswith(missing)
    assert "all of them, here or in a base" in problem.expected


def test_a_fact_that_is_misspelt_is_refused() -> None:
    with registered(), pytest.raises(InputError, match=r"surfaces: no fact of an attack.*'surface'"):
        attack("test.misspelt", surfaces=("gcs",))(Common)  # type: ignore[call-arg]
