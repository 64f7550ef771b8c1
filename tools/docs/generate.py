"""Parts of the reference that the code itself writes, put where they belong.

`python -m tools.docs.generate` rewrites every block between `<!-- generated: NAME -->` and `<!-- end: NAME -->` in the
pages beside it and above it, and every number between `<!-- count: NAME -->` and `<!-- /count -->`.
`tests/unit/test_docs.py` fails while one of them is out of date.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

from tools.docs.autopilot_reference import (
    airframes,
    autopilot_commands,
    avoidance,
    heard,
    message_name,
    messages,
    mission_items,
    modes,
    parameters,
    part89,
    renamed,
    tuning,
)
from tools.docs.claims import claim_blocks
from tools.docs.install_reference import extras, install_sizes
from tools.docs.markdown_tables import Row, keys, own_rows, shared_rows, table
from tools.docs.measurement_reference import (
    benchmark_format,
    benchmark_results,
    benchmark_sizes,
    gazebo_benchmark,
    learned_features,
    parity_counts,
    parity_tables,
    score_format,
    score_tables,
    study_file,
    study_measures,
)
from tools.docs.plugin_kinds import (
    approvals,
    attacks,
    attacks_of,
    count_mechanisms,
    count_shipped,
    defences,
    defences_of,
    detectors,
    detectors_of,
    families,
    faults,
    firewall_profiles,
    radio_engine,
)
from tools.docs.reproduce import describe as describe_results

DOCS = Path(__file__).parents[2] / "docs"
BLOCK = re.compile(r"(<!-- generated: (\S+) -->\n)(.*?)(<!-- end: \2 -->)", re.DOTALL)
COUNT = re.compile(r"(<!-- count: (\S+) -->)(.*?)(<!-- /count -->)")


# ---------------------------------------------------------------- the command line


@cache
def commands() -> dict[str, Any]:
    """Every command by what one types after `skyrange`, as click's object."""
    from typer.main import get_command

    from skyrange.cli.app import app

    known: dict[str, Any] = {}

    def visit(command: Any, words: tuple[str, ...]) -> None:
        below = getattr(command, "commands", None)
        if below is None:
            known[" ".join(words)] = command
            return
        for name, child in below.items():
            visit(child, (*words, name))

    root = get_command(app)
    assert hasattr(root, "commands")
    visit(root, ())
    return known


def cli() -> str:
    """Every command with its arguments and options, in the words of its `--help`."""
    heads = ("argument or option", "meaning", "default")
    rows = {words: _parameter_rows(command) for words, command in commands().items()}
    shared = shared_rows([[row for row in part if row[0].startswith("`--")] for part in rows.values()], 5)
    parts = [f"### Options of several commands\n\n{table(heads, shared)}"]
    where = "[Options of several commands](#options-of-several-commands)"
    for words, command in commands().items():
        arguments = [p for p in command.params if p.param_type_name == "argument"]
        usage = ["skyrange", words, *map(_metavar, arguments)]
        usage += ["[OPTIONS]"] if len(rows[words]) > len(arguments) else []
        example = (command.epilog or "").removeprefix("Example: ")
        parts.append(f"### `skyrange {words}`\n\n{(command.help or '').strip()}\n\n```text\n{' '.join(usage)}\n```\n")
        parts.append(own_rows(heads, rows[words], shared, where))
        parts.append(f"Example: `{example}`\n" if example else "")
    return "\n".join(part for part in parts if part)


def _parameter_rows(command: Any) -> list[Row]:
    """The arguments of a command, then its options."""
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option"]
    rows = [(f"`{_metavar(a)}`", a.help or "", "" if _metavar(a).startswith("[") else "required") for a in arguments]
    return [*rows, *((f"`{_spelling(o)}`", o.help or "", _default(o)) for o in options)]


def _metavar(argument: Any) -> str:
    return str(argument.metavar or argument.name.upper())


def _spelling(option: Any) -> str:
    name: str = option.opts[0]
    if option.is_flag:
        return name
    return f"{name} {option.metavar or option.type.name.upper()}"


def _default(option: Any) -> str:
    if option.is_flag or option.default is None or callable(option.default):
        return ""
    return f"{option.default:g}" if isinstance(option.default, float) else str(option.default)


# ---------------------------------------------------------------- the scenario


_SECTIONS = (
    ("Scenario", "the top level"),
    ("Origin", "`[origin]`"),
    ("City", "`[city]`"),
    ("Grid", "`[city.grid]`"),
    ("Wind", "`[wind]`"),
    ("Sensors", "`[sensors]`"),
    ("Optics", "`[optics]`"),
    ("Record", "`[record]`"),
    ("Autopilots", "`[autopilots]`"),
    ("Live", "`[live]`"),
    ("Radio", "`[radio]`"),
    ("Receiver", "`[[radio.receivers]]`"),
    ("Link", "`[[links]]`"),
    ("WifiParams", "`links.wifi`"),
    ("CellularParams", "`links.cellular`"),
    ("BaseStation", "`links.cellular.base_stations`"),
    ("SikParams", "`links.sik`"),
    ("Processing", "`[[processing]]`"),
    ("ConstraintTable", "`[[constraints]]`: areas that are closed to flight"),
    ("AttackTable", "`[[attacks]]`"),
    ("FaultTable", "`[[faults]]`"),
    ("DefenceTable", "`[[defences]]`"),
    ("DefenceCost", "`cost` of a defence"),
    ("When", "`when` of an attack or a fault"),
    ("DetectorTable", "`[[detectors]]`"),
    ("ManualActTable", "`[[manual_acts]]`: starts and stops by hand"),
    ("Operator", "`[[operators]]`"),
    ("VolumeMargins", "`margins` of an operator"),
    ("ReplanningRules", "`replan` of an operator"),
    ("SigningTimeRules", "`signing_time` of an operator"),
    ("Vehicle", "`[[operators.vehicles]]`"),
    ("Fleet", "`[[operators.fleets]]`"),
    ("Start", "`start`"),
    ("OpticalSensor", "`[[operators.vehicles.sensors]]`"),
    ("RemoteId", "`remote_id`"),
    ("Verify", "`verify` of `remote_id` and of `[[radio.receivers]]`"),
    ("Avoidance", "`avoidance`"),
    ("SightRules", "`avoidance.sight`"),
    ("Landing", "`landing`"),
    ("Plan", "`plan`"),
    ("Square", "`plan.square`"),
    ("Path", "`plan.path`"),
    ("Route", "`plan.route`"),
    ("Fence", "`plan.fence`"),
    ("FenceCircle", "`plan.fence.circles`"),
    ("FencePolygon", "`plan.fence.polygons`"),
)


def scenario() -> str:
    """Every key of a scenario from its JSON Schema."""
    from skyrange.scenario.model import scenario as described

    schema = described.json_schema()
    models = {"Scenario": schema, **schema["$defs"]}
    models = {name: model for name, model in models.items() if "." not in name}  # without parameters of plugins
    missing = set(models) - {name for name, _ in _SECTIONS}
    assert not missing, f"give {missing} a section"
    parts = []
    for name, where in _SECTIONS:
        model = models[name]
        parts.append(f"### {where}\n\n{(model.get('description') or '').strip()}\n")
        parts.append(keys(model, getattr(described, name).model_fields))
    return "\n".join(parts)


# ---------------------------------------------------------------- run folder, links


COLUMN_HEADS = ("column", "type", "unit", "meaning")


def tables() -> str:
    """Every table and column of a run's folder."""
    from skyrange.record.schema import TABLES, TELEMETRY

    return _tables({**TABLES, "telemetry": TELEMETRY})


def pair_tables() -> str:
    """The tables of a pair's folder."""
    from skyrange.twins.attribution import COLUMNS as ATTRIBUTION
    from skyrange.twins.effects import COLUMNS as EFFECTS
    from skyrange.twins.lie_and_truth import COLUMNS as LIE_AND_TRUTH
    from skyrange.twins.pair_folder import ATTRIBUTION as ATTRIBUTION_FILE
    from skyrange.twins.pair_folder import EFFECTS as EFFECTS_FILE
    from skyrange.twins.pair_folder import LIE_AND_TRUTH as LIE_AND_TRUTH_FILE
    from skyrange.twins.pair_folder import PROPAGATION as PROPAGATION_FILE
    from skyrange.twins.propagation import COLUMNS as PROPAGATION

    return _tables(
        {
            EFFECTS_FILE: EFFECTS,
            ATTRIBUTION_FILE: ATTRIBUTION,
            PROPAGATION_FILE: PROPAGATION,
            LIE_AND_TRUTH_FILE: LIE_AND_TRUTH,
        }
    )


def _tables(tables: Mapping[str, Sequence[Any]]) -> str:
    """Tables with their columns; what follows the semicolon in the meanings of most columns of one stands before it.

    A table with the columns of an earlier one refers to that.
    """
    from skyrange.record.schema import arrow_schema

    parts = []
    known: dict[tuple[Row, ...], str] = {}
    for name, columns in tables.items():
        types = [str(field.type).replace("item: ", "") for field in arrow_schema(name, columns)]
        remark, count = Counter(column.meaning.rpartition("; ")[2] for column in columns).most_common(1)[0]
        remark = remark if 2 * count > len(columns) else ""
        rows = tuple(
            (
                f"`{column.name}`",
                f"{kind}, nullable" if column.nullable else kind,
                column.unit,
                column.meaning.removesuffix(f"; {remark}") if remark else column.meaning,
            )
            for column, kind in zip(columns, types, strict=True)
        )
        said = f"{remark[0].upper()}{remark[1:]}.\n\n" if remark else ""
        shown = f"The columns of `{known[rows]}`.\n" if rows in known else table(COLUMN_HEADS, rows)
        known.setdefault(rows, name)
        parts.append(f"### `{name}`\n\n{said}{shown}")
    return "\n".join(parts)


def links() -> str:
    """Every kind of link of a run, with its ends and default channel, as it is wired."""
    from skyrange.assembly.network import APPROVAL_CHANNEL, ORACLE_CHANNEL
    from skyrange.contracts.links import Channel
    from skyrange.core.ids import APPROVAL, endpoint
    from skyrange.scenario.model.links import AIR_LINKS, OPERATOR_LINKS, VEHICLE_LINKS
    from skyrange.vehicle.onboard_network import onboard_links, oracle_links

    specs = {spec.name.split(":")[0]: spec for spec in (*onboard_links("blue/b1", "blue"), *oracle_links("blue/b1"))}
    kinds = (*VEHICLE_LINKS, *AIR_LINKS)
    assert set(specs) == set(kinds)
    assert OPERATOR_LINKS == (APPROVAL,)
    rows = []
    for spec in (specs[kind] for kind in kinds):
        assert isinstance(spec.channel, Channel)
        rows.append((f"`{spec.name}`", f"`{spec.a}`", f"`{spec.b}`", spec.channel.mode, _ms(spec.channel.latency_ns)))
    station = endpoint("blue", "gcs")
    rows.append(
        (f"`{APPROVAL}:blue`", f"`{station}`", f"`{APPROVAL}`", APPROVAL_CHANNEL.mode, _ms(APPROVAL_CHANNEL.latency_ns))
    )
    rows.append(("`oracle:blue`", f"`{station}`", "`oracle`", ORACLE_CHANNEL.mode, _ms(ORACLE_CHANNEL.latency_ns)))
    return table(("instance, for example", "first end", "second end", "mode", "latency"), rows)


def routes() -> str:
    """What proxy and companion forward."""
    from skyrange.vehicle.onboard_network import RID_MESSAGES, for_remote_id, onboard_routes

    rows = [
        (
            f"`{r.endpoint}`",
            f"`{r.source}`",
            f"`{r.target}`",
            "messages for Remote ID" if r.select is for_remote_id else "all",
            f"every {_ms(r.service_ns)}" if r.service_ns else "on arrival",
        )
        for r in onboard_routes("blue/b1")
    ]
    names = ", ".join(f"`{message_name(number)}`" for number in sorted(RID_MESSAGES))
    return (
        table(("endpoint", "from", "to", "frames", "forwarded"), rows) + f"\nThe messages for Remote ID are {names}.\n"
    )


def _ms(time_ns: int) -> str:
    return f"{time_ns / 1e6:g} ms"


# ---------------------------------------------------------------- the packages


def packages() -> str:
    """Every package and top-level module, by layers from the top down, with the first line of its docstring."""
    import ast
    import tomllib

    root = DOCS.parent
    rules = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    layers = next(rule["layers"] for rule in rules if rule["type"] == "layers")
    rows = []
    for number, layer in enumerate(layers):
        for name in layer.split(" | "):
            place = root / "src" / "skyrange" / name
            file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
            first = (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").partition("\n")[0]
            below = sorted(folder.name for folder in place.glob("*/") if (folder / "__init__.py").exists())
            rows.append((len(layers) - number, f"`{name}`", first, ", ".join(f"`{folder}`" for folder in below)))
    return table(("layer", "package", "contents", "subpackages"), rows)


GENERATED: dict[str, Callable[[], str]] = {
    "packages": packages,
    "extras": extras,
    "install-sizes": install_sizes,
    "benchmark-results": benchmark_results,
    "benchmark-sizes": benchmark_sizes,
    "gazebo-benchmark": gazebo_benchmark,
    "reproducible": describe_results,
    **parity_tables(),
    "benchmark-format": benchmark_format,
    "study-file": study_file,
    "study-measures": study_measures,
    "learned-features": learned_features,
    "score-tables": score_tables,
    "score-format": score_format,
    "cli": cli,
    "scenario": scenario,
    "attacks": attacks,
    **{f"attacks-{family}": partial(attacks_of, family) for family in families("attacks")},
    **{f"defences-{family}": partial(defences_of, family) for family in families("defences")},
    **{f"detectors-{family}": partial(detectors_of, family) for family in families("detectors")},
    "faults": faults,
    "defences": defences,
    "detectors": detectors,
    "firewall-profiles": firewall_profiles,
    "approvals": approvals,
    "tables": tables,
    "pair-tables": pair_tables,
    "links": links,
    "routes": routes,
    "modes": modes,
    "commands": autopilot_commands,
    "mission-items": mission_items,
    "messages": messages,
    "heard": heard,
    "parameters": parameters,
    "renamed": renamed,
    "tuning": tuning,
    "airframes": airframes,
    "part89": part89,
    "avoidance": avoidance,
    **claim_blocks(),
    "radio-engine-ns3": partial(radio_engine, "ns3"),
    "radio-engine-omnetpp": partial(radio_engine, "omnetpp"),
}


COUNTED: dict[str, Callable[[], int]] = {
    kind: partial(count_shipped, f"skyrange.{kind}") for kind in ("attacks", "defences", "detectors", "faults")
}
COUNTED |= {"mechanisms": count_mechanisms, **parity_counts()}


def renewed(text: str) -> str:
    """A page with every generated block and every count as it should be."""
    text = BLOCK.sub(lambda block: block[1] + GENERATED[block[2]]().strip("\n") + "\n" + block[4], text)
    return COUNT.sub(lambda block: f"{block[1]}{COUNTED[block[2]]()}{block[4]}", text)


def add_family_pages() -> None:
    """Add the pages of families of attacks, defences and detectors that have none."""
    more = {
        "attacks": ", and their [effects](../attack-effects.md)",
        "defences": ", and their [effects](../defence-effects.md)",
        "detectors": "",
    }
    for kind, other in more.items():
        for family in families(kind):
            page = DOCS / "reference" / kind / f"{family}.md"
            if not page.exists():
                page.parent.mkdir(exist_ok=True)
                head = f"# {kind.capitalize()}: `{family}`\n\n[All kinds](../{kind}.md){other}.\n"
                block = f"<!-- generated: {kind}-{family} -->\n<!-- end: {kind}-{family} -->\n"
                page.write_text(f"{head}\n{block}", encoding="utf-8")


def main() -> None:
    """Rewrite what is out of date."""
    add_family_pages()
    for page in (*sorted(DOCS.parent.glob("*.md")), *sorted(DOCS.rglob("*.md"))):
        text = page.read_text(encoding="utf-8")
        new = renewed(text)
        if new != text:
            page.write_text(new, encoding="utf-8")
            print(page)


if __name__ == "__main__":
    main()
