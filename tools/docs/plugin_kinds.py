"""Kinds of attacks, faults, defences, detectors and approvals as the reference describes them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, NamedTuple

from tools.docs.markdown_tables import KEY_HEADS, Row, key_rows, keys, own_rows, shared_rows, table

PERSISTENCE = {
    "acts": "its last act",
    "upload": "the next upload of the ground station, or the flight",
    "mode": "the next mode that the ground station commands, or the flight",
    "flight": "the flight",
}
"""What ends the effect of an attack, by `AttackPlugin.persists`."""


def shipped_kinds(group: str) -> list[tuple[str, Any]]:
    """Kinds of a group that this project ships, by name, and nothing that a program or another package offers."""
    from skyrange.contracts.plugins.registry import find, kinds

    points = {point.name for point in entry_points(group=group) if point.value.startswith("skyrange.")}
    plugins = [(name, find(group, name)) for name in kinds(group)]
    return [(name, kind) for name, kind in plugins if name in points or " in skyrange." in kind.source]


def count_shipped(group: str) -> int:
    """How many kinds of a group this project ships."""
    return len(shipped_kinds(group))


def count_mechanisms() -> int:
    """How many of the shipped kinds of attack have an act of their own."""
    from skyrange.contracts.plugins.registry import ATTACKS

    return sum(not kind.mechanism for _, kind in shipped_kinds(ATTACKS))


class _Section(NamedTuple):
    """A kind on a page of several: its heading, its text, its facts, its keys, and what is modelled how."""

    heading: str
    text: str
    facts: Sequence[Row]
    keys: Sequence[Row]
    models: Sequence[Row] = ()


_MODEL_HEADS = ("modelled", "how")
_LEAST = 3
"""Keys that so many kinds of a page have alike are described once."""


def _sections(kinds: Iterable[_Section], shared: list[Row] | None = None, place: str = "") -> str:
    """Kinds one after another; facts that all have stand before them, as do keys that several have.

    Keys that stand at `place` instead are `shared`.
    """
    sections = list(kinds)
    level = sections[0].heading.partition(" ")[0]
    facts = shared_rows([section.facts for section in sections], max(len(sections), _LEAST))
    parts = [f"{level} Common to all kinds\n", table(("", ""), facts)] if facts else []
    if shared is None:
        shared = shared_rows([section.keys for section in sections], _LEAST)
        parts += [f"{level} Keys of several kinds\n", table(KEY_HEADS, shared)] if shared else []
    models = shared_rows([section.models for section in sections], _LEAST)
    parts += [f"{level} Models of several kinds\n", table(_MODEL_HEADS, models)] if models else []
    where = f"[Keys of several kinds]({place}#keys-of-several-kinds)"
    of_models = "[Models of several kinds](#models-of-several-kinds)"
    for section in sections:
        parts.append(f"{section.heading}\n\n{section.text}\n")
        own = [row for row in section.facts if row not in facts]
        parts.append(table(("", ""), own) if own else "")
        parts.append(own_rows(_MODEL_HEADS, section.models, models, of_models))
        parts.append(own_rows(KEY_HEADS, section.keys, shared, where))
    return "\n".join(part for part in parts if part)


def _index(group: str, folder: str) -> str:
    """Every kind of a group with what it does and the page of its family, and the keys that several kinds have."""
    kinds = shipped_kinds(group)
    rows = [(f"[`{name}`]({folder}/{_family_of(name)}.md#{name.replace('.', '')})", kind.about) for name, kind in kinds]
    shared = shared_rows([_keys_of(kind) for _, kind in kinds], _LEAST)
    return "\n".join([table(("kind", "what it does"), rows), "### Keys of several kinds\n", table(KEY_HEADS, shared)])


def _family(group: str, family: str, place: str, describe: Callable[[str, Any], _Section]) -> str:
    """The kinds of a family; keys that several kinds of the group have stand at `place`."""
    kinds = shipped_kinds(group)
    shared = shared_rows([_keys_of(kind) for _, kind in kinds], _LEAST)
    return _sections((describe(name, kind) for name, kind in kinds if _family_of(name) == family), shared, place)


def _keys_of(kind: Any) -> list[Row]:
    return key_rows(kind.params.model_json_schema(), kind.params.model_fields)


def attacks() -> str:
    """Every kind of attack with what it does, and the page of its family."""
    from skyrange.contracts.plugins.registry import ATTACKS

    rows = [
        (f"[`{name}`]({page_of(name)})", kind.about + (f" As `{kind.mechanism}`." if kind.mechanism else ""))
        for name, kind in shipped_kinds(ATTACKS)
    ]
    return table(("kind", "what it does"), rows)


def page_of(name: str) -> str:
    """The place of a kind of attack in the reference, relative to `docs/reference`."""
    return f"attacks/{_family_of(name)}.md#{name.replace('.', '')}"


def families(kind: str) -> list[str]:
    """The families of `attacks`, `defences` or `detectors`: the first words of their names."""
    return sorted({_family_of(name) for name, _ in shipped_kinds(f"skyrange.{kind}")})


def attacks_of(family: str) -> str:
    """The kinds of attacks of a family with their facts and parameters."""
    from skyrange.contracts.plugins.registry import ATTACKS

    return _sections(
        _Section(f"## `{name}`", kind.about, _facts(kind), _keys_of(kind), list(kind.realism.items()))
        for name, kind in shipped_kinds(ATTACKS)
        if _family_of(name) == family
    )


def _family_of(name: str) -> str:
    return name.partition(".")[0]


def _facts(kind: Any) -> list[Row]:
    """What is declared of a kind of attack."""
    from skyrange.attack.techniques import describe_technique

    threat, controls = kind.threat, kind.controls
    return [
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
    ]


def faults() -> str:
    """Every kind of benign fault with its parameters."""
    from skyrange.contracts.plugins.registry import FAULTS

    return _sections(
        _Section(
            f"### `{name}`",
            kind.about,
            [
                ("acts on", ", ".join(f"`{surface}`" for surface in kind.surface)),
                ("cause", kind.cause),
                ("effect", kind.effect),
                ("not modelled", kind.not_modelled),
            ],
            _keys_of(kind),
            list(kind.realism.items()),
        )
        for name, kind in shipped_kinds(FAULTS)
    )


def defences() -> str:
    """Every kind of defence with what it does, and the page of its family."""
    from skyrange.contracts.plugins.registry import DEFENCES

    return _index(DEFENCES, "defences")


def defences_of(family: str) -> str:
    """The kinds of defences of a family with their parameters."""
    from skyrange.contracts.plugins.registry import DEFENCES

    def describe(name: str, kind: Any) -> _Section:
        facts = [
            ("protects", ", ".join(f"`{name}`" for name in kind.surface)),
            ("place", kind.place),
            ("effect", kind.effect),
            ("made against", ", ".join(f"`{name}`" for name in kind.against)),
            ("alerts", ", ".join(f"`{name}`" for name in kind.alerts)),
            ("an adversary who knows it", kind.evasion),
            ("cost while nobody attacks", kind.cost),
            ("acts while nobody attacks", ", ".join(kind.nominal) or "none"),
        ]
        return _Section(f"## `{name}`", kind.about, facts, _keys_of(kind), list(kind.realism.items()))

    return _family(DEFENCES, family, "../defences.md", describe)


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
    """Every kind of detector with what it does, and the page of its family."""
    from skyrange.contracts.plugins.registry import DETECTORS

    return _index(DETECTORS, "detectors")


def detectors_of(family: str) -> str:
    """The kinds of detectors of a family with the descriptions of their modules and their parameters."""
    from skyrange.contracts.plugins.registry import DETECTORS

    def describe(name: str, kind: Any) -> _Section:
        about = (import_module(kind.params.__module__).__doc__ or "").partition("\n")[2].strip()
        reduced = f"**Reduced**, as rankings say: {kind.reduced}.\n\n" if kind.reduced else ""
        return _Section(f"## `{name}`", f"{kind.about}\n\n{reduced}{about}", [], _keys_of(kind))

    return _family(DETECTORS, family, "../detectors.md", describe)


def approvals() -> str:
    """Every kind of flight approval with its parameters."""
    from skyrange.contracts.plugins.registry import APPROVALS

    parts = []
    for name, kind in shipped_kinds(APPROVALS):
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
