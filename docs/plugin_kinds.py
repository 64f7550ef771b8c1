"""Kinds of attacks, faults and defences as the reference describes them."""

from __future__ import annotations

from typing import Any

from markdown_tables import keys, table


def _attack_kinds() -> list[tuple[str, Any]]:
    """Every kind of attack that this project ships, by name."""
    from skyrange.attack.contract import AttackPlugin
    from skyrange.contracts.plugins import ATTACKS, kinds

    found = [(name, AttackPlugin.find(name)) for name in kinds(ATTACKS)]
    return [(name, kind) for name, kind in found if kind.make.__module__.startswith("skyrange.")]


def attacks() -> str:
    """Every kind of attack with its parameters."""
    parts = []
    for name, kind in _attack_kinds():
        parts.append(f"### `{name}`\n\n{kind.about}\n")
        parts.append(_facts(kind))
        parts.append(keys(kind.params.model_json_schema(), kind.params.model_fields))
    return "\n".join(parts)


def _facts(kind: Any) -> str:
    """What is declared of a kind of attack, as a table."""
    from skyrange.attack.techniques import describe_technique

    threat, controls = kind.threat, kind.controls
    rows = [
        ("acts on", ", ".join(f"`{one}`" for one in kind.surface)),
        ("effect", kind.effect),
        ("technique", describe_technique(kind.technique)),
        ("knowledge", threat.knowledge),
        ("position", threat.position),
        ("equipment", threat.equipment),
        ("budget", threat.budget),
        ("counterfactual", "its sham" if kind.counterfactual == "sham" else "muted"),
        ("load control", controls.load),
        ("content control", controls.content),
        ("placement control", controls.placement),
        *((f"{what} under attack", how) for what, how in kind.realism.items()),
    ]
    return table(("", ""), rows)


def faults() -> str:
    """Every kind of benign fault with its parameters."""
    from skyrange.contracts.plugins import FAULTS, kinds
    from skyrange.fault.contract import FaultPlugin

    parts = []
    for name in kinds(FAULTS):
        kind = FaultPlugin.find(name)
        if not kind.make.__module__.startswith("skyrange."):
            continue
        rows = [
            ("acts on", ", ".join(f"`{one}`" for one in kind.surface)),
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
    from skyrange.contracts.plugins import DEFENCES, kinds
    from skyrange.defence.contract import DefencePlugin

    parts = []
    for name in kinds(DEFENCES):
        kind = DefencePlugin.find(name)
        if not kind.make.__module__.startswith("skyrange."):
            continue
        rows = [
            ("protects", ", ".join(f"`{one}`" for one in kind.surface)),
            ("place", kind.place),
            ("effect", kind.effect),
            ("made against", ", ".join(f"`{one}`" for one in kind.against)),
            ("alerts", ", ".join(f"`{one}`" for one in kind.alerts)),
            ("an adversary who knows it", kind.evasion),
            ("cost while nobody attacks", kind.cost),
            ("acts while nobody attacks", ", ".join(kind.nominal) or "none"),
            *kind.realism.items(),
        ]
        parts.append(f"### `{name}`\n\n{kind.about}\n")
        parts.append(table(("", ""), rows))
        parts.append(keys(kind.params.model_json_schema(), kind.params.model_fields))
    return "\n".join(parts)
