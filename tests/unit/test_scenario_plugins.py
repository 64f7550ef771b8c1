"""Approvals with parameters, detectors and radio media in a scenario: checked, described, written, made."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from pydantic import Field

from skyrange.assembly.build import build
from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import Agent
from skyrange.contracts.links import LinkSpec
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.monitors import DetectorContext, DetectorPlugin, ObservedFrames
from skyrange.contracts.params import Number, Params
from skyrange.contracts.plugins import registry as plugins
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, Time
from skyrange.radio.builtin.medium import BuiltinMedium
from skyrange.radio.contract import MediumContext, MediumPlugin
from skyrange.record import load as load_run
from skyrange.runtime.run import Run
from skyrange.scenario.model.scenario import Scenario, json_schema
from skyrange.scenario.shipped import SHIPPED, source_of
from skyrange.scenario.toml_files import load_text, to_toml
from skyrange.utm.approval_service import FlightApproval, policy_plugin
from skyrange.utm.approve_all import ApproveAll
from skyrange.utm.contract import ApprovalContext, ApprovalPlugin, ApprovalService

FLEET = """
name = "s"
duration_s = 1
origin = [40.778, -73.955]
[[operators]]
id = "blue"
approval = "test.strict"
  [[operators.vehicles]]
  id = "b1"
  plan.square = { side_m = 20, alt_m = 10 }
[[operators]]
id = "green"
  [[operators.vehicles]]
  id = "g1"
  start = [30, 0]
  plan.square = { side_m = 20, alt_m = 10 }
"""
STRICT = "[approvals.'test.strict']\napart_m = 20\n"


class Apart(Params):
    """What strictness is."""

    apart_m: Number = Field(gt=0, description="How far apart flights have to be, in metres.")
    later_s: Number = Field(default=600.0, description="How much later another is offered, in seconds.")


class Gap(Params):
    """How long a silence is one."""

    longer_s: Number = Field(default=3.0, gt=0, description="A silence that is longer than this, in seconds.")


@dataclass
class Listener:
    longer_s: float
    context: DetectorContext
    service_ns: Time = 500 * NS_PER_MS

    def observe(self, now: Time, frames: ObservedFrames) -> list[Alert]:
        return [Alert(now, self.context.id, "test.gap", self.longer_s)] if now == 500 * NS_PER_MS else []


class Counted(BuiltinMedium):
    """The builtin, with its closing counted."""

    closed: int = 0

    @property
    def manifest(self) -> Mapping[str, Any]:
        return {"version": "7"}

    def close(self) -> None:
        Counted.closed += 1


class Horizon(Params):
    """A parameter of the medium."""

    floor_dbm: Number = Field(default=-100.0, description="Nothing weaker is heard, in dBm.")


given: list[Any] = []


def make_medium(params: Horizon, context: MediumContext) -> BuiltinMedium:
    given.append((params, context))
    return Counted(context.radios, context.chance, context.city, context.surroundings, every_pair=context.every_pair)


@dataclass
class Gossip:
    """A service of two agents that have a link of their own."""

    name: str
    ports: Sequence[Port]
    service_ns: Time = 20 * NS_PER_MS

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        return Outbox()

    def next_wakeup(self) -> Time | None:
        return None


def federated(params: Apart, context: ApprovalContext) -> ApprovalService:
    front = FlightApproval(context.operators, context.epoch, ApproveAll(), name=context.name)
    a, b = context.endpoint("one"), context.endpoint("two")
    link = LinkSpec("uss:one-two", a, b)
    ends = [Gossip(f"{context.name}.{end}", (Port(end, link.name),)) for end in (a, b)]
    agents: list[Agent] = [front, *ends]
    return ApprovalService(agents, [link])


def _approve_all(params: Apart) -> ApproveAll:
    given.append(params)
    return ApproveAll()


@pytest.fixture(autouse=True)
def _kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "_registered", dict(plugins._registered))
    given.clear()
    strict = policy_plugin(Apart, _approve_all, "Strict.")
    plugins.register(plugins.APPROVALS, "test.strict", strict)
    plugins.register(plugins.APPROVALS, "test.federated", ApprovalPlugin(Apart, federated, "Talks."))
    detector = DetectorPlugin(Gap, lambda params, context: Listener(params.longer_s, context), "Notes silences.")
    plugins.register(plugins.DETECTORS, "test.gap", detector)
    plugins.register(plugins.MEDIA, "test.counted", MediumPlugin(Horizon, make_medium, "Counts."))


def faults(text: str) -> str:
    with pytest.raises(InputError) as caught:
        build(load_text(text))
    return "\n".join(str(fault) for fault in caught.value.problems)


# ---------------------------------------------------------------- approvals


def test_an_approval_gets_its_parameters_once_for_all_its_operators() -> None:
    scenario = load_text(FLEET.replace('id = "green"', 'id = "green"\napproval = "test.strict"') + STRICT)
    built = build(scenario)
    assert given == [Apart(apart_m=20, later_s=600)]
    names = [agent.name for agent in built.wiring.agents]
    assert names.count("approval.test.strict") == 1
    assert [row["approval"] for row in built.header["operators"]] == ["test.strict", "test.strict"]


def test_approvals_read_back_as_they_were_written() -> None:
    scenario = load_text(FLEET + STRICT)
    text = to_toml(scenario)
    assert load_text(text) == scenario
    assert tomllib.loads(text)["approvals"] == {"test.strict": {"apart_m": 20.0, "later_s": 600.0}}
    assert "approvals" not in to_toml(load_text(FLEET.replace("test.strict", "approve-all")))


def test_overrides_reach_a_dotted_kind_in_quotes() -> None:
    scenario = load_text(FLEET, overrides=['approvals."test.strict".apart_m=5', "operators.*.approval=test.strict"])
    assert scenario.approvals["test.strict"]["apart_m"] == 5.0
    for path in ('approvals."test.strict.apart_m', 'approvals."test.strict"x.apart_m', "approvals..x", ".approvals"):
        with pytest.raises(InputError, match="not an assignment"):
            load_text(FLEET, overrides=[f"{path}=5"])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "approvals.test.strict.apart_m: missing — expected a value (How far apart flights have to be, in metres)"),
        ("[approvals.'test.strict']\napart_m = -1", "approvals.test.strict.apart_m: -1 — expected more than 0"),
        ("[approvals.'test.strict']\napart = 3", "apart = 3 — expected a known key. Write apart_m"),
        ("[approvals.'test.strit']\napart_m = 3", "expected an approval service. Did you mean 'test.strict'?"),
        (STRICT + "[approvals.'test.federated']\napart_m = -1", "apart_m: -1 — expected more than 0"),
    ],
)
def test_what_is_wrong_with_an_approvals_parameters_is_named(text: str, words: str) -> None:
    assert words in faults(FLEET + text)


def test_parameters_of_an_approval_that_is_not_used_wait_for_an_override() -> None:
    both = FLEET + STRICT + "[approvals.'test.federated']\napart_m = 3"
    assert load_text(both).approvals["test.federated"]["apart_m"] == 3.0
    assert load_text(both, overrides=["operators.*.approval=test.federated"]).operators[0].approval == "test.federated"


def test_an_approval_may_have_several_agents_and_links_between_them() -> None:
    text = FLEET.replace("test.strict", "test.federated")
    built = build(load_text(text + '[approvals."test.federated"]\napart_m = 1\n'))
    (link,) = [spec for spec in built.wiring.links if spec.name.startswith("uss:")]
    assert (link.a, link.b) == ("approval.one", "approval.two")
    names = [agent.name for agent in built.wiring.agents if agent.name.startswith("approval.test.federated")]
    assert len(names) == 3
    other = build(load_text(text + '[approvals."test.federated"]\napart_m = 1\n'), local=frozenset({"blue.gcs"}))
    assert link.name in [spec.name for spec in other.wiring.links], "every process knows all links"
    assert [agent.name for agent in other.wiring.agents] == ["blue.gcs"]


def test_an_approval_that_leaves_an_operator_alone_is_blamed() -> None:
    lazy = ApprovalPlugin(plugins.NoParams, lambda params, context: ApprovalService([]), "Serves nobody.")
    plugins.register(plugins.APPROVALS, "test.lazy", lazy)
    with pytest.raises(ComponentError, match=r"approval\.test\.lazy: 0 of its agents have the port .*approval:blue"):
        build(load_text(FLEET.replace("test.strict", "test.lazy")))


# ---------------------------------------------------------------- detectors


def test_detectors_are_made_with_the_links_that_they_listen_to() -> None:
    text = FLEET + STRICT + '[[detectors]]\nid="silence"\nkind="test.gap"\n'
    whole = build(load_text(text))
    (built,) = whole.wiring.monitors
    assert (built.id, built.links, built.side) == ("silence", ("gcs:*",), "gcs")
    monitor: Any = built.make()
    assert monitor.longer_s == 3.0
    assert list(monitor.context.vehicles) == ["blue/b1", "green/g1"]
    assert built.make() is not monitor
    (row,) = whole.header["detectors"]
    assert row == {
        "id": "silence", "kind": "test.gap", "links": ["gcs:*"], "side": "gcs", "params": {"longer_s": 3.0}
    }  # fmt: skip
    (chosen,) = build(
        load_text(text + 'links=["log:*", "approval:blue"]\nside="*"\nparams.longer_s=9\n')
    ).wiring.monitors
    other: Any = chosen.make()
    assert (chosen.links, chosen.side, other.longer_s) == (("log:*", "approval:blue"), "*", 9.0)
    assert "detectors" not in build(load_text(FLEET + STRICT)).header


def test_what_detectors_raise_is_recorded(tmp_path: Path) -> None:
    run = Run.start(load_text(FLEET + STRICT + '[[detectors]]\nid="silence"\nkind="test.gap"\n'), tmp_path / "a")
    run.execute()
    (row,) = load_run(tmp_path / "a").table("alerts").to_pylist()
    assert (row["detector"], row["subject"], row["kind"], row["score"]) == ("silence", "silence", "test.gap", 3.0)


def test_detectors_read_back_as_they_were_written() -> None:
    scenario = load_text(FLEET + STRICT + '[[detectors]]\nid="silence"\nkind="test.gap"\nparams.longer_s=9\n')
    assert load_text(to_toml(scenario)) == scenario
    assert load_text(FLEET + STRICT).detectors == ()
    assert "detectors" not in to_toml(load_text(FLEET + STRICT))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('id="a"\nkind="test.gapp"', "expected a kind of detector that is installed. Did you mean 'test.gap'?"),
        ('id="a"\nkind="test.gap"\nlinks=["gsc:*"]', "detectors.a.links: gsc:* — expected a link"),
        ('id="a"\nkind="test.gap"\nlinks=["log:*"]', "detectors.a.side: gcs — expected an end of log:blue/b1"),
        ('id="a"\nkind="test.gap"\nlinks=[]', "detectors.a.links: [] — expected a list of at least 1 element(s)"),
        ('id="a"\nkind="test.gap"\nparams.longer_s=0', "detectors.a.params.longer_s: 0 — expected more than 0"),
        ('id="a"\nkind="test.gap"\n[[detectors]]\nid="a"\nkind="test.gap"', "an id that no other detector has"),
    ],
)
def test_what_is_wrong_with_a_detector_is_named(text: str, words: str) -> None:
    assert words in faults(f"{FLEET}{STRICT}[[detectors]]\n{text}\n")


# ---------------------------------------------------------------- media

AIR = FLEET.replace("test.strict", "approve-all")


def test_a_medium_is_made_of_what_the_scenario_says() -> None:
    scenario = load_text(AIR + "[radio]\nengine='test.counted'\nhorizon_m=500\nparams.floor_dbm=-90\n")
    built = build(scenario)
    ((params, context),) = given
    assert params == Horizon(floor_dbm=-90)
    assert context.surroundings.horizon_m == 500.0
    assert sorted(radio.name for radio in context.radios) == ["blue/b1", "green/g1"]
    assert built.oracle is not None
    assert isinstance(built.oracle.medium, Counted)
    assert built.header["medium"] == {"kind": "test.counted", "repeatable": "bytes", "version": "7"}
    assert "medium" not in build(load_text(AIR + "[radio]\n")).header
    assert load_text(to_toml(scenario)) == scenario
    assert tomllib.loads(to_toml(load_text(AIR + "[radio]\n")))["radio"]["params"] == {
        "frame_capture": True, "capture_margin_db": 10.0, "preamble_choice": "strongest", "eifs": True
    }  # fmt: skip


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("engine='bultin'", "radio.engine: bultin — expected a radio medium that is installed. Did you mean"),
        ("engine='test.counted'\nparams.floor=-90", "radio.params.floor: floor = -90 — expected a known key. Did you"),
        ("params.x=1", "radio.params.x: x = 1 — expected a known key"),
    ],
)
def test_what_is_wrong_with_a_medium_is_named(text: str, words: str) -> None:
    assert words in faults(f"{AIR}[radio]\n{text}\n")


def test_a_run_closes_its_medium_and_so_does_its_fork(tmp_path: Path) -> None:
    run = Run.start(load_text(AIR + "[radio]\nengine='test.counted'\n"), tmp_path / "a")
    run.advance(0.5)
    fork = run.fork(tmp_path / "b")
    Counted.closed = 0
    fork.execute()
    assert Counted.closed == 1
    run.execute()
    assert Counted.closed == 2


# ---------------------------------------------------------------- the JSON Schema


def test_the_schema_has_every_kinds_parameters() -> None:
    schema = json_schema()
    models = schema["$defs"]
    for name in ("approvals.test.strict", "detectors.test.gap", "media.test.counted", "avoidance.geometric"):
        assert all(value["description"] for value in models[name]["properties"].values())
    options = models["Autopilots"]["properties"]["options"]["properties"]
    assert set(options) >= {"ardupilot", "builtin", "external"}
    assert options["ardupilot"] == {"$ref": "#/$defs/autopilots.ardupilot"}
    assert schema["properties"]["approvals"]["properties"]["test.strict"] == {"$ref": "#/$defs/approvals.test.strict"}
    refs = set(_refs(schema))
    assert refs <= {f"#/$defs/{name}" for name in models}


def _refs(part: Any) -> Iterator[str]:
    if isinstance(part, dict):
        if isinstance(part.get("$ref"), str):
            yield part["$ref"]
        for value in part.values():
            yield from _refs(value)
    if isinstance(part, list):
        for value in part:
            yield from _refs(value)


@pytest.mark.parametrize("name", sorted(SHIPPED))
def test_the_schema_accepts_every_shipped_scenario(name: str) -> None:
    schema = json_schema()
    with source_of(name).open("rb") as file:
        given = tomllib.load(file)
    jsonschema.Draft202012Validator(schema).validate(json.loads(json.dumps(given, default=str)))
    written = tomllib.loads(to_toml(Scenario.model_validate(_absolute(given, source_of(name).parent))))
    jsonschema.Draft202012Validator(schema).validate(json.loads(json.dumps(written, default=str)))


def _absolute(part: Any, folder: Path) -> Any:
    if isinstance(part, dict):
        return {
            key: str(folder / value) if key in ("file", "buildings") else _absolute(value, folder)
            for key, value in part.items()
        }
    return [_absolute(value, folder) for value in part] if isinstance(part, list) else part
