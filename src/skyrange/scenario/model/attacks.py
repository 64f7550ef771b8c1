"""Attacks in a scenario: `[[attacks]]`, their kind, their parameters, and when they act."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator

from skyrange.attack.contract import AttackPlugin
from skyrange.attack.triggers import Near
from skyrange.contracts.params import Enu, Params
from skyrange.contracts.plugins import ATTACKS
from skyrange.core.errors import Problem, nearest
from skyrange.scenario.model.base import Id, Model, Number, items, wrong
from skyrange.scenario.validation.plugin_params import known, normalized


def _place_or_name(value: Any) -> Any:
    value = items(value)
    numbers = isinstance(value, (list, tuple)) and len(value) == 3 and all(isinstance(x, (int, float)) for x in value)
    if not numbers and not isinstance(value, str):
        raise wrong(value, "a place [east_m, north_m, up_m] in metres, or an aircraft such as 'red/r1'")
    return value


class When(Model):
    """A condition on where aircraft truly are; it starts the attack when it first holds."""

    vehicle: str = Field(description="The aircraft that is watched, such as 'green/g1'.")
    within_m: Number = Field(gt=0, le=100_000, description="Holds while it is this near, in metres in space.")
    of: Annotated[str | Enu, BeforeValidator(_place_or_name, json_schema_input_type=str | list[float])] = Field(
        description="To what: a place [east_m, north_m, up_m] in metres from the origin, or another aircraft."
    )

    @property
    def vehicles(self) -> tuple[str, ...]:
        """The aircraft that it speaks of."""
        return (self.vehicle, self.of) if isinstance(self.of, str) else (self.vehicle,)

    @property
    def trigger(self) -> Near:
        """The same for the kernel."""
        return Near(self.vehicles, self.within_m, None if isinstance(self.of, str) else self.of)


class AttackTable(Model):
    """One attack: what it does, when, and whether it is muted."""

    id: Id = Field(description="Name, unique among the attacks: in labels, links and figures.")
    kind: Annotated[str, known(ATTACKS, "a kind of attack")] = Field(
        description="What it does, a plugin of skyrange.attacks."
    )
    start_s: Number = Field(
        default=0.0, ge=0, le=31_536_000, description="Simulated second from which it acts, or waits for its trigger."
    )
    stop_s: Number | None = Field(
        default=None, gt=0, le=31_536_000, description="Simulated second at which it stops; default: never."
    )
    for_s: Number | None = Field(
        default=None, gt=0, le=31_536_000, description="It stops this many seconds after it has started."
    )
    when: When | None = Field(default=None, description="Start when this first holds, once start_s has come.")
    muted: bool = Field(default=False, strict=True, description="All there, but none of its acts counts.")
    sham: bool = Field(
        default=False, strict=True, description="The same transmitter, airtime and timing with content that is benign."
    )
    anchor: str | None = Field(
        default=None,
        description="An aircraft such as 'green/g1': places count from where it starts; default: from the origin.",
    )
    params: dict[str, Any] = Field(
        default_factory=dict, validate_default=True, description="The kind's own parameters."
    )

    @field_validator("params")
    @classmethod
    def _of_its_kind(cls, params: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        """The parameters that its kind makes of them, with every default; untouched where the kind is unknown."""
        return normalized(AttackPlugin.find(info.data["kind"]), params) if "kind" in info.data else params

    @field_validator("stop_s")
    @classmethod
    def _stops_after_it_starts(cls, stop_s: float | None, info: ValidationInfo) -> float | None:
        start_s = info.data.get("start_s", 0.0)
        if stop_s is not None and stop_s <= start_s:
            raise wrong(f"{stop_s:g}", f"more than start_s, {start_s:g}")
        return stop_s

    @property
    def settings(self) -> Params:
        """The parameters as the kind's own model."""
        return self.plugin.params.model_validate(self.params)

    @property
    def plugin(self) -> AttackPlugin:
        """The plugin of its kind."""
        return AttackPlugin.find(self.kind)


def check_attack_vehicles(attacks: Sequence[AttackTable], vehicles: Sequence[str]) -> Iterator[Problem]:
    """Aircraft in triggers and anchors that the scenario does not have."""
    for index, attack in enumerate(attacks):
        named = [("anchor", attack.anchor)] if attack.anchor is not None else []
        if attack.when is not None:
            named += zip(("when.vehicle", "when.of"), attack.when.vehicles, strict=False)
        for key, name in named:
            if name not in vehicles:
                yield Problem(f"attacks.{index}.{key}", name, "a vehicle of the scenario", nearest(name, vehicles))
