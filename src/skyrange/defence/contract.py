"""Defences as plugins: the parts that a defence consists of, what a kind says of itself, and its decorator.

A kind of defence is a class with the decorator `defence` (`defence.declaration`), as a kind of attack is, and is kept
as a `DefencePlugin` under a dotted name.

A defence is at the ends of links, as a tap, between sensors and autopilot, as a sensor check, or in the radios of
control links over Wi-Fi, as a policy for their channel. It acts by verdicts on frames, by writing into readings or by
orders to its radio, and raises alarms as alerts in its own name. It knows what its place knows: the frames at its ends,
the readings of its aircraft after every attack and fault, and what its radio measures. No label, true sender or true
state is among them. The kernel runs it muted or not, and discards what a muted one does, so a run with it muted is the
undefended one, to the byte.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, TypeVar

from skyrange.attack.contract import AttackContext
from skyrange.attack.declaration import Acting
from skyrange.contracts.plugins.form import declare
from skyrange.contracts.plugins.registry import DEFENCES, Plugin

if TYPE_CHECKING:
    from skyrange.attack.exclusive import Exclusive
    from skyrange.contracts.channel_plans import ChannelPlan
    from skyrange.contracts.components import SensorHook
    from skyrange.contracts.links import TapPlacement
    from skyrange.defence.path_rules import PathRule

DefenceContext = AttackContext
"""The context of a defence: that of an attack. Its `id` and `schedule` are the defence's own; it has no radio, and
`sham` and `honest` are false."""


@dataclass(frozen=True, slots=True)
class Defence:
    """The parts of a defence. Their acts are events, their alarms are alerts, both under the defence's id."""

    taps: Sequence[TapPlacement] = ()
    """They are nearer to the endpoint than those of every attack. Where defences share an end, a frame that arrives
    there meets the first declared one first."""
    checks: Sequence[SensorHook] = ()
    """Sensor checks. They get readings as all attacks and faults have left them, in the order of the defences."""
    channel_plans: Sequence[ChannelPlan] = ()
    """Policies for the channels of Wi-Fi control links."""
    exclusive: Sequence[Exclusive] = ()
    """What it decides as the only one. Two defences that decide the same at the same time are an error before the run.
    """
    path_rules: Sequence[PathRule] = ()
    """What it sends, lets pass, signs, compares and holds on the way between station and autopilot. Two defences that
    disturb each other there, or do so in the declared order, are an error before the run."""
    takes: Sequence[str] = ()
    """Readings that it takes away from the checks declared after it, such as "GNSS fixes of blue/b1"."""
    needs: Sequence[str] = ()
    """Readings of which it judges whether they are there. A check that takes them away and is declared before is an
    error before the run."""
    one_process: bool = False
    """Whether its parts share state, so that a live range must have all of them in one process."""


@dataclass(frozen=True, slots=True)
class DefencePlugin(Plugin[AttackContext, Defence]):
    """A kind of defence."""

    group: ClassVar[str] = DEFENCES

    surface: Sequence[str] = ()
    """What it protects: roles of links (`gcs`, `log`, `autopilot`, `rid_data`) or sensors (`gnss`, `baro`)."""
    place: str = ""
    """Where it is and what it knows there, as a phrase: "the companion's end of gcs links"."""
    effect: str = ""
    """What it does about an attack that it notices, as a phrase: "drops commands that are not on its list"."""
    alerts: Sequence[str] = ()
    """The kinds of its alerts, such as `firewall.command`."""
    against: Sequence[str] = ()
    """The kinds of attacks that it is made for, by name or pattern: `mavlink.*`."""
    evasion: str = ""
    """What an adversary who knows it does, as a phrase: "commands what is on the list"."""
    cost: str = ""
    """What it costs while nobody attacks, as a phrase: frames, delay, computing."""
    nominal: Sequence[str] = ()
    """What it does while nobody attacks: some of drop, replace, delay, inject, sensor, channel, scan and hop; empty for
    nothing."""
    realism: Mapping[str, str] = field(default_factory=dict)
    """What of it is "simulated", "cited: …" or "assumed: …"."""


DefenceT = TypeVar("DefenceT", bound="type[Acting]")


def defence(
    name: str,
    *,
    surface: Sequence[str] = (),
    place: str = "",
    effect: str = "",
    alerts: Sequence[str] = (),
    against: Sequence[str] = (),
    evasion: str = "",
    cost: str = "",
    nominal: Sequence[str] = (),
    realism: Mapping[str, str] | None = None,
) -> Callable[[DefenceT], DefenceT]:
    """Declare a class as the kind of defence `name`; the facts are those of `DefencePlugin`.

    Raises `InputError` for a class that is no such kind, as `contracts.plugins.declaration.declare` does.
    """

    def decorate(kind: DefenceT) -> DefenceT:
        facts = {
            "surface": surface, "place": place, "effect": effect, "alerts": alerts, "against": against,
            "evasion": evasion, "cost": cost, "nominal": nominal, "realism": dict(realism or {}),
        }  # fmt: skip
        declare(kind, name, Acting, DefencePlugin, facts)
        return kind

    return decorate
