"""Does a campaign whose adversary is a Python class keep the contract of attacks, and do what its declaration would?"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import pytest
from pydantic import ValidationError

from skyrange.assembly.build import build
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.kernel import Kernel
from skyrange.plugin import (
    AttackContext,
    CampaignBase,
    CampaignStage,
    Knowledge,
    Observation,
    Time,
    attack,
    state,
)
from skyrange.record import MemoryObserver
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load
from skyrange.scenario.toml_files import load_text
from skyrange.testing import check_attack
from skyrange.testing.checks.attacks import Flight

pytestmark = pytest.mark.rotating

GHOST = {"kind": "remote_id.spoof", "params": {"at": [10.0, 5.0, 20.0]}}
JUMP = {"kind": "gnss.jump", "params": {"vehicles": ["blue/b1"], "offset_m": [20.0, 0.0, 0.0]}}
MEANS: dict[str, Any] = {
    "acts": {"ghost": GHOST, "jump": JUMP},
    "taps": ["gcs:blue/b1"],
    "longest_s": 60,
}
RECONNAISSANCE = CampaignStage("reconnaissance")
DECEPTION = CampaignStage("deception", ["ghost"])


@dataclass(slots=True)
class Leader:
    """What the shipped scenario `chain` declares."""

    knowledge: Knowledge
    began_ns: Time = -1
    heard: int = 0
    deceives_since_ns: Time = -1

    def observe(self, now: Time, observation: Observation) -> None:
        self.knowledge.read(observation)

    def decide(self, now: Time) -> CampaignStage | None:
        known = self.knowledge
        if self.began_ns < 0:
            self.began_ns, self.heard = now, known.broadcasts
            return RECONNAISSANCE
        if self.deceives_since_ns >= 0:
            return DECEPTION if now < self.deceives_since_ns + 30 * NS_PER_S else None
        if known.sees((0.0, 90.0, 30.0), 8.0, vehicle="green/g1") and known.broadcasts >= self.heard + 20:
            self.deceives_since_ns = now
            return DECEPTION
        return RECONNAISSANCE if now < self.began_ns + 60 * NS_PER_S else None


@dataclass(slots=True)
class Script:
    """Goes through stages, each until a time since its first call."""

    stages: Sequence[tuple[float, CampaignStage | None]]
    seen: list[Time] = field(default_factory=list)
    start_ns: Time = -1

    def observe(self, now: Time, observation: Observation) -> None:
        assert observation.vehicle == "blue/b1"
        self.seen.append(now)

    def decide(self, now: Time) -> Any:
        self.start_ns = now if self.start_ns < 0 else self.start_ns
        return next((one for until, one in self.stages if now < self.start_ns + from_seconds(until)), None)


class Leading(CampaignBase):
    """Does what `chain` declares."""

    leader: Leader

    def prepare(self, context: AttackContext) -> None:
        self.leader = Leader(Knowledge(context.origin))

    def observe(self, now: Time, observation: Observation) -> None:
        self.leader.observe(now, observation)

    def decide(self, now: Time) -> CampaignStage | None:
        return self.leader.decide(now)


def kind_of(name: str, given: Any) -> type[CampaignBase]:
    """A kind of campaign that does what an adversary decides."""

    @attack(name)
    class Told(CampaignBase):
        """Does what its adversary decides."""

        adversary: Any = state(partial(deepcopy, given))

        def observe(self, now: Time, observation: Observation) -> None:
            self.adversary.observe(now, observation)

        def decide(self, now: Time) -> Any:
            return self.adversary.decide(now)

    return Told


def script(name: str, *stages: tuple[float, Any]) -> type[CampaignBase]:
    return kind_of(name, Script(stages))


GHOSTLY = CampaignStage("ghost", ("ghost",))
BOTH = CampaignStage("both", {"ghost", "jump"})


@pytest.mark.catalogue
def test_a_class_conforms() -> None:
    check_attack(script("test.both", (1.0, GHOSTLY), (3.0, BOTH)), MEANS, acts={"send", "sensor"})


@pytest.mark.catalogue
def test_a_class_that_starts_nothing_does_nothing() -> None:
    check_attack(script("test.waits", (9.0, CampaignStage("wait"))), MEANS, acts=False)


def fly(scenario: Scenario, seconds: float) -> MemoryObserver:
    seen = MemoryObserver()
    kernel = Kernel(build(scenario).wiring, [seen])
    kernel.advance(from_seconds(seconds))
    kernel.finish()
    return seen


def with_params(scenario: Scenario, kind: str, params: dict[str, Any]) -> Scenario:
    (attack,) = scenario.attacks
    return scenario.model_copy(update={"attacks": (attack.model_copy(update={"kind": kind, "params": params}),)})


def test_chain_as_a_class_is_the_same_run() -> None:
    attack("test.chain")(Leading)
    declared = load("chain")
    (only,) = declared.attacks
    params = {name: value for name, value in only.params.items() if name != "stages"}
    written = with_params(declared, "test.chain", {**params, "longest_s": 120.0})
    one, other = fly(declared, 46), fly(written, 46)
    assert len(one.labels) > 5
    first, second = Flight(one, frozenset()), Flight(other, frozenset())
    assert first.frames() == second.frames()
    assert first.notes() == second.notes()
    assert first.labels() == second.labels()
    assert first.truth() == second.truth()


SQUARE = """
name = "campaign"
seed = 4
duration_s = 10
origin = [40.778, -73.955]
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan.square = { side_m = 20, alt_m = 10 }
[[attacks]]
id = "mallory"
kind = "campaign"
start_s = 1
params = { acts.jump = { kind = "gnss.jump", params = { vehicles = ["blue/b1"], offset_m = [20, 0, 0] } }, stages = [
  { name = "pull", acts = ["jump"], timeout_s = 3 } ] }
"""


@pytest.fixture
def square() -> Scenario:
    return load_text(SQUARE)


def test_it_ends_after_its_longest_duration(square: Scenario) -> None:
    script("test.endless", (1e6, CampaignStage("jump", ("jump",))))
    (attack,) = square.attacks
    seen = fly(with_params(square, "test.endless", {"acts": attack.params["acts"], "longest_s": 2.0}), 10)
    stages = [(one.time_ns, one.note.data["stage"]) for one in seen.notes if one.note.kind == "event.campaign_stage"]
    assert stages == [(1 * NS_PER_S, "jump"), (3 * NS_PER_S, "end")]


def test_a_class_without_a_longest_duration_is_refused() -> None:
    with pytest.raises(ValidationError, match="longest_s"):
        script("test.without_longest", (1.0, GHOSTLY))(acts={"ghost": GHOST})


JUMPS = CampaignStage("a", ["jump"])


@dataclass(slots=True)
class Restless:
    """Never comes to rest."""

    count: int = 0

    def observe(self, now: Time, observation: Observation) -> None:
        """Nothing."""

    def decide(self, now: Time) -> CampaignStage:
        self.count += 1
        return CampaignStage(str(self.count))


@pytest.mark.parametrize(
    ("number", "adversary", "blamed"),
    [
        (0, Script([(9.0, CampaignStage("a", ["jmup"]))]), "'jump'"),
        (1, Script([(1.0, JUMPS), (2.0, CampaignStage("b")), (3.0, CampaignStage("c", ["jump"]))]),
         "starts the act 'jump' again"),
        (2, Script([(9.0, "jump")]), "no CampaignStage"),  # type: ignore[list-item]
        (3, Restless(), "more than 1000 stages"),
        (4, Script([(9.0, CampaignStage("a", ["jump", "drift"]))]), "GNSS fixes of blue/b1"),
    ],
)  # fmt: skip
def test_a_wrong_decision_is_blamed_on_the_adversary(
    square: Scenario, number: int, adversary: Any, blamed: str
) -> None:
    kind = f"test.wrong{number}"
    kind_of(kind, adversary)
    (attack,) = square.attacks
    drift = {"kind": "gnss.drift", "params": {"vehicles": ["blue/b1"], "rate_mps": [1, 0, 0]}}
    params = {"acts": {**attack.params["acts"], "drift": drift}, "longest_s": 9.0}
    with pytest.raises(ComponentError, match=f"mallory(.|\n)*{blamed}"):
        fly(with_params(square, kind, params), 8)


def test_a_campaign_is_no_act_of_a_campaign(square: Scenario) -> None:
    script("test.inner")
    (attack,) = square.attacks
    inner = {"kind": "test.inner", "params": {"acts": attack.params["acts"], "longest_s": 5.0}}
    params = {**attack.params, "acts": {"jump": inner}}
    with pytest.raises(InputError, match="no campaign"):
        build(with_params(square, "campaign", params))
