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


CONTROL_LINKS: Final = ("gcs", "log", "autopilot")
"""The roles of the links that a control link consists of, from ground station to autopilot."""


def on_control_link(
    knowledge: str,
    *,
    position: str = "on the network of the control link, or on board",
    equipment: str = "a computer with a MAVLink library",
    budget: str,
) -> ThreatModel:
    """An adversary who puts MAVLink frames on a control link."""
    return ThreatModel(knowledge, position, equipment, budget)


def sham_to_nobody(*, content: str, placement: str, acts: str = "frames") -> Controls:
    """Controls of an act whose sham is the same, addressed to a system that is not there."""
    return Controls(
        load=f"the sham: the same {acts}, addressed to a system that is not there", content=content, placement=placement
    )


def rewrites_telemetry(knowledge: str) -> ThreatModel:
    """An on-path adversary who alters telemetry."""
    return on_path(
        knowledge,
        position="on the path between autopilot and receiver: a router, the companion computer or its proxy",
        equipment="a computer that decodes and rewrites MAVLink frames",
        budget="no frames of its own; each altered frame is at most some bytes longer",
    )


TELEMETRY_CONTROLS: Final = Controls(
    load="the sham: the same frames are replaced by themselves, with as many bytes",
    content="none, because the sham has the true content",
    placement="the same alteration on another link: rid_data instead of gcs",
)
"""Controls of an alteration of telemetry."""


def acts_as_member(knowledge: str, *, budget: str = "no frames of its own") -> ThreatModel:
    """An operator whose node of a hashgraph is byzantine."""
    position = "a member: an operator whose node is byzantine"
    return ThreatModel(knowledge, position, equipment="a node of its own", budget=budget)


def acts_as_operator(*, budget: str) -> ThreatModel:
    """An operator who claims airspace that it does not use."""
    return ThreatModel(
        knowledge="where and when others want to fly",
        position="an operator with an account of the approval",
        equipment="a ground station",
        budget=budget,
    )


def true_volumes(*, content: str, placement: str) -> Controls:
    """Controls of an act that replaces claimed volumes."""
    load = "the sham: the same frames, of the same length, with the true volumes"
    return Controls(load, content, placement)


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


SPOOFED_OFFSET: Final = {
    "position and velocity": "simulated: the truth with an offset",
    "fix type, satellites, claimed accuracy": "assumed: unaltered, a seamless capture",
}
"""Realism of fixes that a spoofer moves."""


def gnss_spoofer(
    knowledge: str = "the place of each victim, to align code and Doppler with the authentic signals",
    *,
    equipment: str = "a GNSS simulator that follows each victim alone",
    budget: str = "a signal some decibels above the authentic ones, for as long as it acts",
) -> ThreatModel:
    """An adversary that transmits false GNSS signals to each victim alone."""
    return ThreatModel(knowledge, "in sight of the victims' antennas", equipment, budget)


def takes_no_airtime(signal: str, *, content: str, placement: str) -> Controls:
    """Controls of an act by a signal that no link of the range carries."""
    load = f"none, because a {signal} signal takes no airtime of the range's links"
    return Controls(load=load, content=content, placement=placement)


def unaltered_fixes(*, placement: str = "the same offset on another aircraft", besides: str = "") -> Controls:
    """Controls of an act whose sham leaves GNSS fixes as they are; `besides` is another content control."""
    return takes_no_airtime(
        "spoofed", content=f"the sham: the same acts with unaltered fixes{besides}", placement=placement
    )


def unaltered_readings(placement: str, *, besides: str = "") -> Controls:
    """Controls of an act whose sham leaves readings of sensors as they are; `besides` is another content control."""
    content = f"the sham: the same act with unaltered readings{besides}"
    return takes_no_airtime("sensor", content=content, placement=placement)


SOUND_AT_AIRCRAFT: Final = {
    "amplitude at the aircraft": "assumed: a parameter, because it depends on sensor, distance and housing"
}
"""Realism of readings that sound alters."""


def sound(knowledge: str, *, position: str, budget: str) -> ThreatModel:
    """An adversary that plays sound at the resonance of inertial sensors."""
    return ThreatModel(knowledge, position, "a loudspeaker and amplifier for the resonance", budget)
