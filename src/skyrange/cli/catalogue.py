"""The commands that list scenarios, kinds of attacks, faults and defences, and the keys of a scenario."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import typer

from skyrange.cli.options import AsJson, Plugins, load_plugins
from skyrange.cli.output.console import print_json, print_text

if TYPE_CHECKING:
    from skyrange.attack.contract import AttackPlugin
    from skyrange.defence.contract import DefencePlugin
    from skyrange.fault.contract import FaultPlugin

commands = typer.Typer()


@commands.command(epilog="Example: skyrange scenarios --json")
def scenarios(*, as_json: AsJson = False) -> None:
    """List the shipped scenarios."""
    from skyrange.scenario.shipped import SHIPPED

    if as_json:
        print_json([{"name": name, "about": about} for name, about in SHIPPED.items()])
        return
    width = max(map(len, SHIPPED))
    for name, about in SHIPPED.items():
        print_text(f"{name:<{width}}  {about}")


@commands.command(epilog="Example: skyrange attacks --plugin lag.py")
def attacks(*, plugin: Plugins = None, as_json: AsJson = False) -> None:
    """List the installed kinds of attacks with a description of each."""
    load_plugins(plugin)
    from skyrange.attack.contract import AttackPlugin
    from skyrange.attack.techniques import list_techniques
    from skyrange.contracts.plugins.registry import ATTACKS, kinds

    installed = {name: AttackPlugin.find(name) for name in kinds(ATTACKS)}
    if as_json:
        print_json([_describe_attack(name, kind) for name, kind in installed.items()])
        return
    techniques = {name: "/".join(list_techniques(kind.technique)) for name, kind in installed.items()}
    width, columns = max(map(len, installed), default=0), max(map(len, techniques.values()), default=0)
    for name, kind in installed.items():
        print_text(f"{name:<{width}}  {techniques[name]:<{columns}}  {', '.join(kind.surface):<14}  {kind.about}")


def _describe_attack(name: str, kind: AttackPlugin) -> dict[str, Any]:
    """A kind of attack as `skyrange attacks --json` prints it."""
    from skyrange.attack.techniques import describe_technique, list_techniques

    return {
        "kind": name,
        "about": kind.about,
        "surface": list(kind.surface),
        "effect": kind.effect,
        "techniques": list_techniques(kind.technique),
        "technique_name": describe_technique(kind.technique),
        "mechanism": kind.mechanism or name,
        "counterfactual": kind.counterfactual,
        "threat": asdict(kind.threat) if kind.threat is not None else None,
        "controls": asdict(kind.controls) if kind.controls is not None else None,
        "realism": dict(kind.realism),
    }


@commands.command(epilog="Example: skyrange faults --json")
def faults(*, plugin: Plugins = None, as_json: AsJson = False) -> None:
    """List the installed kinds of benign faults with a description of each."""
    load_plugins(plugin)
    from skyrange.contracts.plugins.registry import FAULTS, kinds
    from skyrange.fault.contract import FaultPlugin

    installed = {name: FaultPlugin.find(name) for name in kinds(FAULTS)}
    if as_json:
        print_json([_describe_fault(name, kind) for name, kind in installed.items()])
        return
    width = max(map(len, installed), default=0)
    for name, kind in installed.items():
        print_text(f"{name:<{width}}  {', '.join(kind.surface):<14}  {kind.about}")


def _describe_fault(name: str, kind: FaultPlugin) -> dict[str, Any]:
    """A kind of fault as `skyrange faults --json` prints it."""
    return {
        "kind": name,
        "about": kind.about,
        "surface": list(kind.surface),
        "effect": kind.effect,
        "cause": kind.cause,
        "not_modelled": kind.not_modelled,
        "realism": dict(kind.realism),
    }


@commands.command(epilog="Example: skyrange defences --json")
def defences(*, plugin: Plugins = None, as_json: AsJson = False) -> None:
    """List the installed kinds of defences with a description of each."""
    load_plugins(plugin)
    from skyrange.contracts.plugins.registry import DEFENCES, kinds
    from skyrange.defence.contract import DefencePlugin

    installed = {name: DefencePlugin.find(name) for name in kinds(DEFENCES)}
    if as_json:
        print_json([_describe_defence(name, kind) for name, kind in installed.items()])
        return
    width = max(map(len, installed), default=0)
    for name, kind in installed.items():
        print_text(f"{name:<{width}}  {', '.join(kind.surface):<14}  {kind.about}")


def _describe_defence(name: str, kind: DefencePlugin) -> dict[str, Any]:
    """A kind of defence as `skyrange defences --json` prints it."""
    texts = {key: getattr(kind, key) for key in ("about", "place", "effect", "evasion", "cost")}
    lists = {key: list(getattr(kind, key)) for key in ("surface", "alerts", "against", "nominal")}
    return {"kind": name, **texts, **lists, "realism": dict(kind.realism)}


@commands.command(epilog="Example: skyrange schema > scenario.schema.json")
def schema(*, plugin: Plugins = None) -> None:
    """Print the JSON Schema of a scenario, with the meaning, unit and range of every key."""
    load_plugins(plugin)
    from skyrange.scenario.model.scenario import json_schema

    print_json(json_schema())
