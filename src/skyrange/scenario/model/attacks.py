"""Attacks and faults in a scenario: the models of `[[attacks]]` and `[[faults]]`: kind, parameters and times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator

from skyrange.attack.contract import AttackPlugin
from skyrange.attack.triggers import Near
from skyrange.contracts.params import Enu, Params
from skyrange.contracts.plugins.registry import ATTACKS, FAULTS
from skyrange.core.errors import Problem, nearest
from skyrange.defence.contract import DefencePlugin
from skyrange.fault.contract import FaultPlugin
from skyrange.scenario.model.base import Id, Model, Number, items, wrong
from skyrange.scenario.validation.plugin_params import known, normalized


def _place_or_name(value: Any) -> Any:
    value = items(value)
    numbers = isinstance(value, (list, tuple)) and len(value) == 3 and all(isinstance(x, (int, float)) for x in value)
    if not numbers and not isinstance(value, str):
        raise wrong(value, "a place [east_m, north_m, up_m] in metres, or an aircraft such as 'red/r1'")
    return value


class When(Model):
    """A condition on the true positions of aircraft. The attack or fault starts when it first holds."""

    vehicle: str = Field(description="Aircraft whose distance is measured, such as 'green/g1'.")
    within_m: Number = Field(
        gt=0, le=100_000, description="Largest distance in metres at which the condition holds, in three dimensions."
    )
    of: Annotated[str | Enu, BeforeValidator(_place_or_name, json_schema_input_type=str | list[float])] = Field(
        description="Place or aircraft to which the distance is measured: [east_m, north_m, up_m] in metres from the "
        "origin or the anchor, or an aircraft such as 'red/r1'."
    )

    @property
    def vehicles(self) -> tuple[str, ...]:
        """The aircraft that the condition names."""
        return (self.vehicle, self.of) if isinstance(self.of, str) else (self.vehicle,)

    @property
    def trigger(self) -> Near:
        """The condition as a trigger for the kernel."""
        return Near(self.vehicles, self.within_m, None if isinstance(self.of, str) else self.of)


class PluginTable(Model):
    """A table with a `kind`, its `params` and the time in which it acts: their validators, without the fields."""

    if TYPE_CHECKING:
        kind: str
        params: dict[str, Any]

    @field_validator("params", check_fields=False)
    @classmethod
    def _of_its_kind(cls, params: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        """The parameters, checked and completed with the kind's defaults; unchanged if the kind is unknown."""
        return normalized(cls._find(info.data["kind"]), params) if "kind" in info.data else params

    @field_validator("stop_s", check_fields=False)
    @classmethod
    def _stops_after_it_starts(cls, stop_s: float | None, info: ValidationInfo) -> float | None:
        start_s = info.data.get("start_s", 0.0)
        if stop_s is not None and stop_s <= start_s:
            raise wrong(f"{stop_s:g}", f"more than start_s, {start_s:g}")
        return stop_s

    @field_validator("manual", check_fields=False)
    @classmethod
    def _starts_one_way(cls, manual: bool, info: ValidationInfo) -> bool:  # noqa: FBT001 - of pydantic
        if manual and info.data.get("when") is not None:
            raise wrong("true", "false with when: a condition starts it, or somebody does")
        return manual

    @property
    def settings(self) -> Params:
        """The parameters as the kind's own model."""
        return self.plugin.params.model_validate(self.params)

    @property
    def plugin(self) -> AttackPlugin | FaultPlugin | DefencePlugin:
        """The plugin of its kind."""
        return self._find(self.kind)

    @classmethod
    def _find(cls, kind: str) -> AttackPlugin | FaultPlugin | DefencePlugin:
        raise NotImplementedError


def manual_start() -> Any:
    """The field `manual` of what acts."""
    return Field(
        default=False,
        strict=True,
        description="Whether it starts by hand, at or after start_s: from Python, in the viewer, or as manual_acts "
        "has it.",
    )


class ActTable(PluginTable):
    """What an attack and a fault declare alike: when it acts, and with which parameters."""

    id: Id = Field(description="Name, unique among attacks and faults; used in labels, links and figures.")
    kind: str = Field(description="Kind.")
    start_s: Number = Field(
        default=0.0,
        ge=0,
        le=31_536_000,
        description="Simulated time in seconds from which it acts, or waits for its condition or for a start by hand.",
    )
    stop_s: Number | None = Field(
        default=None,
        gt=0,
        le=31_536_000,
        description="Simulated time in seconds at which it stops; default: never.",
    )
    for_s: Number | None = Field(
        default=None,
        gt=0,
        le=31_536_000,
        description="Duration in seconds, from its start; default: no limit.",
    )
    when: When | None = Field(
        default=None, description="Condition that starts it when it first holds, at or after start_s."
    )
    manual: bool = manual_start()
    muted: bool = Field(default=False, strict=True, description="Whether to run it and discard its output.")
    anchor: str | None = Field(
        default=None,
        description="Aircraft, such as 'green/g1', whose start is the origin of its places; default: the origin of "
        "the scenario.",
    )
    params: dict[str, Any] = Field(default_factory=dict, validate_default=True, description="Parameters of the kind.")

    @property
    def plugin(self) -> AttackPlugin | FaultPlugin:
        """The plugin of its kind."""
        return self._find(self.kind)

    @classmethod
    def _find(cls, kind: str) -> AttackPlugin | FaultPlugin:
        raise NotImplementedError


class AttackTable(ActTable):
    """One attack: its kind and parameters, and when it acts."""

    kind: Annotated[str, known(ATTACKS, "a kind of attack")] = Field(
        description="Kind of attack, a plugin of skyrange.attacks."
    )
    sham: bool = Field(
        default=False,
        strict=True,
        description="Whether to act from the same transmitter, with the same airtime and timing, but with benign "
        "content.",
    )
    honest: bool = Field(
        default=False,
        strict=True,
        description="Whether a real aircraft flies where the attack claims that one is, and sends what the attack "
        "would send, which is then true.",
    )

    @field_validator("honest")
    @classmethod
    def _not_a_sham_too(cls, honest: bool, info: ValidationInfo) -> bool:  # noqa: FBT001 - of pydantic
        if honest and info.data.get("sham"):
            raise wrong("true", "false with sham = true: one arm at a time")
        return honest

    @property
    def plugin(self) -> AttackPlugin:
        """The plugin of its kind."""
        return self._find(self.kind)

    @classmethod
    def _find(cls, kind: str) -> AttackPlugin:
        return AttackPlugin.find(kind)


class FaultTable(ActTable):
    """One benign fault: its kind and parameters, and when it acts. It has no adversary, and is labelled as a fault."""

    kind: Annotated[str, known(FAULTS, "a kind of fault")] = Field(
        description="Kind of fault, a plugin of skyrange.faults."
    )

    @property
    def plugin(self) -> FaultPlugin:
        """The plugin of its kind."""
        return self._find(self.kind)

    @classmethod
    def _find(cls, kind: str) -> FaultPlugin:
        return FaultPlugin.find(kind)


def check_act_vehicles(where: str, acts: Sequence[ActTable], vehicles: Sequence[str]) -> Iterator[Problem]:
    """A problem for each trigger and anchor of `attacks` or `faults` with an aircraft that the scenario lacks."""
    for index, act in enumerate(acts):
        named = [("anchor", act.anchor)] if act.anchor is not None else []
        if act.when is not None:
            named += zip(("when.vehicle", "when.of"), act.when.vehicles, strict=False)
        for key, name in named:
            if name not in vehicles:
                yield Problem(f"{where}.{index}.{key}", name, "a vehicle of the scenario", nearest(name, vehicles))
