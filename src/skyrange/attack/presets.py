"""Facts that many kinds of attacks share: threat models and controls, in the words that the reference prints."""

from __future__ import annotations

from typing import Final

from skyrange.attack.contract import Controls, ThreatModel


def on_path(
    knowledge: str,
    *,
    position: str = "on the path, such as a router between ground station and aircraft",
    equipment: str = "a computer that forwards the frames",
    budget: str = "no frames of its own",
) -> ThreatModel:
    """An adversary through whose computer the frames of a link pass."""
    return ThreatModel(knowledge, position, equipment, budget)


FORWARDS_AND_HOLDS: Final = "a computer that forwards the frames, with memory for those that it holds"
"""Equipment of who delays frames."""


def adds_no_load(*, content: str, placement: str) -> Controls:
    """Controls of an act that puts no frame on a link."""
    return Controls(load="none, because it adds no load", content=content, placement=placement)


def benign_frames(*, content: str, placement: str, when: str = "in place of the copies") -> Controls:
    """Controls of an act whose sham sends as many frames, of the same length, that ask for nothing."""
    return Controls(load=f"the sham: benign frames of the same length {when}", content=content, placement=placement)


NEAR_RECEIVERS: Final = "within some hundred metres of the receivers, by power and walls"
"""Position of who transmits noise."""


def noise_controls(*, placement: str, same: str = "bursts") -> Controls:
    """Controls of a jammer, whose sham transmits or orders the `same` without power."""
    return Controls(
        load=f"none, because the noise is the attack; the sham has the same {same} at −200 dBm",
        content="none, because noise has no content",
        placement=placement,
    )


ANOTHER_COMPANION: Final = "the companion of another aircraft"
"""Placement control of a compromised companion."""


def in_companion(knowledge: str, *, budget: str, position: str = "in the companion computer") -> ThreatModel:
    """An adversary whose program runs on the companion computer of an aircraft."""
    equipment = "a program on the companion: from its supply chain, an update or a remote login"
    return ThreatModel(knowledge, position, equipment, budget)
