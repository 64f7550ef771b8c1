"""Benign faults as plugins: made of the parts of an attack, with no adversary.

A kind of fault is a class with the decorator `fault` (`fault.declaration`), as a kind of attack is, and is kept as a
`FaultPlugin` under a dotted name. Its parts run, are muted and are labelled as those of an attack are, but every label
and event says "fault". Without it there would be nothing, so its counterfactual is to mute it; it has no sham.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from skyrange.attack.contract import Attack, AttackContext
from skyrange.contracts.plugins.registry import FAULTS, Plugin

FaultContext = AttackContext
"""The context of a fault: that of an attack. Its `id` and `schedule` are the fault's own, and `sham` is false."""
FaultParts = Attack
"""The parts of a fault: taps, agents, sensor faults, body faults and links. `threat` and `radios` are those of attacks
alone."""


@dataclass(frozen=True, slots=True)
class FaultPlugin(Plugin[AttackContext, Attack]):
    """A kind of benign fault."""

    group: ClassVar[str] = FAULTS

    surface: Sequence[str] = ()
    """What it acts on: roles of links (`gcs`, `log`, `autopilot`, `rid_data`), sensors (`gnss`, `baro`), `motor` or
    `wind`."""
    effect: str = ""
    """What changes for the aircraft or its operator, as a phrase: "the estimator stops aiding"."""
    cause: str = ""
    """What goes wrong in reality, as a phrase: "buildings hide satellites"."""
    not_modelled: str = ""
    """What of the real fault the model leaves out, as a phrase."""
    realism: Mapping[str, str] = field(default_factory=dict)
    """What a sensor or link does under the fault → "simulated", "cited: …" or "assumed: …"."""
    places: Sequence[str] = ("at",)
    """Names of parameters that are places, which `anchor` of a fault moves. The kind need not have all of them."""
