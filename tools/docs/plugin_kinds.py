"""Kinds of attacks, faults, defences, detectors and approvals as the reference describes them."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from tools.docs.markdown_tables import keys, table

PERSISTENCE = {
    "acts": "its last act",
    "upload": "the next upload of the ground station, or the flight",
    "mode": "the next mode that the ground station commands, or the flight",
    "flight": "the flight",
}
"""What ends the effect of an attack, by `AttackPlugin.persists`."""


def _shipped(group: str) -> list[tuple[str, Any]]:
    """Kinds of a group that this project ships, by name, and nothing that a program or another package offers."""
    from skyrange.contracts.plugins.registry import find, kinds

    points = {point.name for point in entry_points(group=group) if point.value.startswith("skyrange.")}
    plugins = [(name, find(group, name)) for name in kinds(group)]
    return [(name, kind) for name, kind in plugins if name in points or " in skyrange." in kind.source]


def count_shipped(group: str) -> int:
    """How many kinds of a group this project ships."""
    return len(_shipped(group))


def count_mechanisms() -> int:
    """How many of the shipped kinds of attack have an act of their own."""
    from skyrange.contracts.plugins.registry import ATTACKS

    return sum(not kind.mechanism for _, kind in _shipped(ATTACKS))


def attacks() -> str:
    """Every kind of attack with what it does, and the page of its family."""
    from skyrange.contracts.plugins.registry import ATTACKS

    rows = [
        (f"[`{name}`]({page_of(name)})", kind.about + (f" As `{kind.mechanism}`." if kind.mechanism else ""))
        for name, kind in _shipped(ATTACKS)
    ]
    return table(("kind", "what it does"), rows)


def page_of(name: str) -> str:
    """The place of a kind of attack in the reference, relative to `docs/reference`."""
    return f"attacks/{_family_of(name)}.md#{name.replace('.', '')}"


def attack_families() -> list[str]:
    """The families of attacks: the first words of their names."""
    from skyrange.contracts.plugins.registry import ATTACKS

    return sorted({_family_of(name) for name, _ in _shipped(ATTACKS)})


def attacks_of(family: str) -> str:
    """The kinds of attacks of a family with their facts and parameters."""
    from skyrange.contracts.plugins.registry import ATTACKS

    parts = []
    for name, kind in _shipped(ATTACKS):
        if _family_of(name) == family:
            parts.append(f"## `{name}`\n\n{kind.about}\n")
            parts.append(_facts(kind))
            parts.append(keys(kind.params.model_json_schema(), kind.params.model_fields))
    return "\n".join(parts)


def _family_of(name: str) -> str:
    return name.partition(".")[0]


def _facts(kind: Any) -> str:
    """What is declared of a kind of attack, as a table."""
    from skyrange.attack.techniques import describe_technique

    threat, controls = kind.threat, kind.controls
    rows = [
        ("acts on", ", ".join(f"`{surface}`" for surface in kind.surface)),
        ("effect", kind.effect),
        ("technique", describe_technique(kind.technique)),
        *([("the same mechanism", f"[`{kind.mechanism}`](../{page_of(kind.mechanism)})")] if kind.mechanism else []),
        ("knowledge", threat.knowledge),
        ("position", threat.position),
        ("equipment", threat.equipment),
        ("budget", threat.budget),
        ("counterfactual", "its sham" if kind.counterfactual == "sham" else "muted"),
        ("effect ends with", PERSISTENCE[kind.persists or "acts"]),
        ("sham is", "a harmless intrusion" if kind.intrudes else "benign"),
        ("load control", controls.load),
        ("content control", controls.content),
        ("placement control", controls.placement),
        *((f"{what} under attack", how) for what, how in kind.realism.items()),
    ]
    return table(("", ""), rows)


def faults() -> str:
    """Every kind of benign fault with its parameters."""
    from skyrange.contracts.plugins.registry import FAULTS

    parts = []
    for name, kind in _shipped(FAULTS):
        rows = [
            ("acts on", ", ".join(f"`{surface}`" for surface in kind.surface)),
            ("cause", kind.cause),
            ("effect", kind.effect),
            ("not modelled", kind.not_modelled),
            *kind.realism.items(),
        ]
        parts.append(f"### `{name}`\n\n{kind.about}\n")
        parts.append(table(("", ""), rows))
        parts.append(keys(kind.params.model_json_schema(), kind.params.model_fields))
    return "\n".join(parts)


def defences() -> str:
    """Every kind of defence with its parameters."""
    from skyrange.contracts.plugins.registry import DEFENCES

    parts = []
    for name, kind in _shipped(DEFENCES):
        rows = [
            ("protects", ", ".join(f"`{name}`" for name in kind.surface)),
            ("place", kind.place),
            ("effect", kind.effect),
            ("made against", ", ".join(f"`{name}`" for name in kind.against)),
            ("alerts", ", ".join(f"`{name}`" for name in kind.alerts)),
            ("an adversary who knows it", kind.evasion),
            ("cost while nobody attacks", kind.cost),
            ("acts while nobody attacks", ", ".join(kind.nominal) or "none"),
            *kind.realism.items(),
        ]
        parts.append(f"### `{name}`\n\n{kind.about}\n")
        parts.append(table(("", ""), rows))
        parts.append(keys(kind.params.model_json_schema(), kind.params.model_fields))
    return "\n".join(parts)


def firewall_profiles() -> str:
    """The lists of each profile of the firewall."""
    from skyrange.defence.station_profiles import PROFILES

    heads = ("profile", "messages", "commands", "modes")
    rows = [
        (f"`{name}`", *(", ".join(sorted(names)) for names in (profile.messages, profile.commands, profile.modes)))
        for name, profile in PROFILES.items()
    ]
    return table(heads, rows)


def detectors() -> str:
    """Every kind of detector with the description of its module and its parameters."""
    from skyrange.contracts.plugins.registry import DETECTORS

    parts = []
    for name, kind in _shipped(DETECTORS):
        about = (import_module(kind.params.__module__).__doc__ or "").partition("\n")[2].strip()
        reduced = f"**Reduced**, as rankings say: {kind.reduced}.\n\n" if kind.reduced else ""
        parts.append(f"### `{name}`\n\n{kind.about}\n\n{reduced}{about}\n")
        parts.append(keys(kind.params.model_json_schema(), kind.params.model_fields))
    return "\n".join(parts)


def approvals() -> str:
    """Every kind of flight approval with its parameters."""
    from skyrange.contracts.plugins.registry import APPROVALS

    parts = []
    for name, kind in _shipped(APPROVALS):
        parts.append(f"### `{name}`\n\n{kind.about}\n")
        if kind.params.model_fields:
            parts.append(keys(kind.params.model_json_schema(), kind.params.model_fields))
    return "\n".join(parts)


def radio_engine(name: str) -> str:
    """The parameters of a radio engine that is a program, whether its package is installed or not."""
    from skyrange.contracts.params import Params
    from skyrange.radio.external.ns3 import Ns3Params
    from skyrange.radio.external.omnetpp import OmnetppParams

    engines: dict[str, type[Params]] = {"ns3": Ns3Params, "omnetpp": OmnetppParams}
    params = engines[name]
    return keys(params.model_json_schema(), params.model_fields)
