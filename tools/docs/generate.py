"""Which parts of the reference are written by the code itself? Makes them, and puts them where they belong.

`python -m tools.docs.generate` rewrites every block between `<!-- generated: NAME -->` and `<!-- end: NAME -->` in the
pages beside it and above it, and every number between `<!-- count: NAME -->` and `<!-- /count -->`.
`tests/unit/test_docs.py` fails while one of them is out of date.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

from tools.docs.markdown_tables import keys, table
from tools.docs.plugin_kinds import (
    approvals,
    attack_families,
    attacks,
    attacks_of,
    count_mechanisms,
    count_shipped,
    defences,
    detectors,
    faults,
    firewall_profiles,
)
from tools.docs.public_api import described as describe_api

DOCS = Path(__file__).parents[2] / "docs"
BLOCK = re.compile(r"(<!-- generated: (\S+) -->\n)(.*?)(<!-- end: \2 -->)", re.DOTALL)
COUNT = re.compile(r"(<!-- count: (\S+) -->)(.*?)(<!-- /count -->)")


# ---------------------------------------------------------------- the command line


@cache
def commands() -> dict[str, Any]:
    """Every command by what one types after `skyrange`, as click's object."""
    from typer.main import get_command

    from skyrange.cli.app import app

    found: dict[str, Any] = {}

    def visit(command: Any, words: tuple[str, ...]) -> None:
        below = getattr(command, "commands", None)
        if below is None:
            found[" ".join(words)] = command
            return
        for name, child in below.items():
            visit(child, (*words, name))

    root = get_command(app)
    assert hasattr(root, "commands")
    visit(root, ())
    return found


def cli() -> str:
    """Every command with its arguments and options, in the words of its `--help`."""
    parts = []
    for words, command in commands().items():
        arguments = [p for p in command.params if p.param_type_name == "argument"]
        options = [p for p in command.params if p.param_type_name == "option"]
        usage = " ".join(
            ["skyrange", words, *(f"{_metavar(a)}" for a in arguments), *(["[OPTIONS]"] if options else [])]
        )
        example = (command.epilog or "").removeprefix("Example: ")
        rows = [
            (f"`{_metavar(a)}`", a.help or "", "" if _metavar(a).startswith("[") else "required") for a in arguments
        ]
        rows += [(f"`{_spelling(o)}`", o.help or "", _default(o)) for o in options]
        parts.append(f"### `skyrange {words}`\n\n{(command.help or '').strip()}\n\n```text\n{usage}\n```\n")
        if rows:
            parts.append(table(("argument or option", "meaning", "default"), rows))
        parts.append(f"Example: `{example}`\n" if example else "")
    return "\n".join(part for part in parts if part)


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
    ("Record", "`[record]`"),
    ("Autopilots", "`[autopilots]`"),
    ("Live", "`[live]`"),
    ("Radio", "`[radio]`"),
    ("Receiver", "`[[radio.receivers]]`"),
    ("Link", "`[[links]]`"),
    ("WifiParams", "`links.wifi`"),
    ("CellularParams", "`links.cellular`"),
    ("BaseStation", "`links.cellular.base_stations`"),
    ("Processing", "`[[processing]]`"),
    ("ConstraintTable", "`[[constraints]]`: areas that are closed to flight"),
    ("AttackTable", "`[[attacks]]`"),
    ("FaultTable", "`[[faults]]`"),
    ("DefenceTable", "`[[defences]]`"),
    ("DefenceCost", "`cost` of a defence"),
    ("When", "`when` of an attack or a fault"),
    ("DetectorTable", "`[[detectors]]`"),
    ("Operator", "`[[operators]]`"),
    ("VolumeMargins", "`margins` of an operator"),
    ("ReplanningRules", "`replan` of an operator"),
    ("Vehicle", "`[[operators.vehicles]]`"),
    ("Fleet", "`[[operators.fleets]]`"),
    ("Start", "`start`"),
    ("RemoteId", "`remote_id`"),
    ("Verify", "`verify` of `remote_id` and of `[[radio.receivers]]`"),
    ("Avoidance", "`avoidance`"),
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


def tables() -> str:
    """Every table and column of a run's folder."""
    from skyrange.record.schema import TABLES, TELEMETRY

    return _tables({**TABLES, "telemetry": TELEMETRY})


def pair_tables() -> str:
    """The tables of a pair's folder."""
    from skyrange.twins.attribution.attribute import COLUMNS as ATTRIBUTION
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
    from skyrange.record.schema import arrow_schema

    parts = []
    for name, columns in tables.items():
        types = [str(field.type).replace("item: ", "") for field in arrow_schema(name, columns)]
        rows = [
            (f"`{column.name}`", f"{kind}, nullable" if column.nullable else kind, column.unit, column.meaning)
            for column, kind in zip(columns, types, strict=True)
        ]
        parts.append(f"### `{name}`\n\n{table(('column', 'type', 'unit', 'meaning'), rows)}")
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
    names = ", ".join(f"`{_message(number)}`" for number in sorted(RID_MESSAGES))
    return (
        table(("endpoint", "from", "to", "frames", "forwarded"), rows) + f"\nThe messages for Remote ID are {names}.\n"
    )


def _ms(time_ns: int) -> str:
    return f"{time_ns / 1e6:g} ms"


# ---------------------------------------------------------------- the builtin autopilot


def _message(number: int) -> str:
    from skyrange.codec.mavlink import dialect

    return str(dialect.mavlink_map[number].msgname)


def _command(number: int) -> str:
    from skyrange.codec.mavlink import dialect

    return str(dialect.enums["MAV_CMD"][number].name)


def modes() -> str:
    """Flight modes, and in which one may arm."""
    from skyrange.vehicle.builtin.modes import Mode, allows_arming

    rows = [
        (
            f"`{m.name}`",
            int(m),
            "yes" if allows_arming(m, 0) else "with bit 0 of `AUTO_OPTIONS`" if allows_arming(m, 1) else "no",
        )
        for m in Mode
    ]
    return table(("mode", "number", "can be armed in"), rows)


def autopilot_commands() -> str:
    """Commands that are obeyed."""
    from skyrange.vehicle.builtin.commands import HANDLERS

    return "".join(f"- `{_command(number)}` ({number})\n" for number in sorted(HANDLERS))


def mission_items() -> str:
    """Mission items that are flown."""
    from skyrange.vehicle.builtin.mission.command_ids import SUPPORTED

    return "".join(f"- `{_command(number)}` ({number})\n" for number in sorted(SUPPORTED))


def messages() -> str:
    """Messages that can be streamed or asked for, and the data stream that asks for each."""
    from skyrange.vehicle.builtin.telemetry.schedule import STREAMS
    from skyrange.vehicle.builtin.telemetry.table import BUILDERS

    stream = {number: name for name, numbers in STREAMS.values() for number in numbers}
    rows = [(f"`{_message(number)}`", number, f"`{stream[number]}`" if number in stream else "") for number in BUILDERS]
    return table(("message", "id", "rate at boot"), rows)


def heard() -> str:
    """Messages that the autopilot acts on."""
    from skyrange.vehicle.builtin import engine

    numbers = sorted({*engine._HANDLERS, *engine._COMMANDS})
    others = re.findall(r"MAVLINK_MSG_ID_([A-Z_]+)", Path(engine.__file__).read_text().split("def _receive", 1)[1])
    names = sorted({_message(number) for number in numbers} | set(others))
    return "".join(f"- `{name}`\n" for name in names)


def parameters() -> str:
    """Parameters with range, default and meaning."""
    from skyrange.vehicle.builtin.parameters.table import PARAMETERS

    rows = [(f"`{p.name}`", f"{p.default:g}", f"{p.low:g} to {p.high:g}", p.meaning) for p in PARAMETERS]
    return table(("parameter", "default", "range", "meaning and unit"), rows)


def renamed() -> str:
    """Parameters' names of ArduCopter 4.7."""
    from skyrange.vehicle.builtin.parameters.renames import RENAMED
    from skyrange.vehicle.builtin.parameters.table import INDEX

    rows = [
        (f"`{new}`", f"`{old}`", "inverse" if factor == 0.0 else f"{factor:g}")
        for new, (old, factor) in sorted(RENAMED.items())
        if old in INDEX
    ]
    return table(("name in 4.7", "name in 4.6", "times"), rows)


def tuning() -> str:
    """What an airframe changes of the defaults."""
    from skyrange.vehicle.builtin.parameters.table import AIRFRAME_TUNING

    rows = [
        (airframe, f"`{name}`", f"{value:g}")
        for airframe, values in AIRFRAME_TUNING.items()
        for name, value in values.items()
    ]
    return table(("airframe", "parameter", "value"), rows)


def airframes() -> str:
    """The airframe table."""
    from dataclasses import fields

    from skyrange.world.airframes import AIRFRAMES

    names = [f.name for f in fields(next(iter(AIRFRAMES.values()))) if f.name not in ("name", "rotors")]
    rows = [(f"`{name}`", *(_number(getattr(a, name)) for a in AIRFRAMES.values())) for name in names]
    rows.append(("rotors", *(str(len(a.rotors)) for a in AIRFRAMES.values())))
    rows.append(("hover thrust, of full", *(f"{a.hover_thrust:.3f}" for a in AIRFRAMES.values())))
    return table(("", *AIRFRAMES), rows)


def _number(value: object) -> str:
    return ", ".join(f"{part:g}" for part in value) if isinstance(value, tuple) else f"{value:g}"


def part89() -> str:
    """The rule's elements and the fields that carry them."""
    from skyrange.codec.f3411.part89 import MODULE, STANDARD

    return table(("14 CFR", "element", "carried by"), [(e.clause, e.what, e.fields) for e in (*STANDARD, *MODULE)])


def avoidance() -> str:
    """The parameters of every kind of avoidance."""
    from skyrange.vehicle.avoidance.contract import AvoidanceLimits

    rows = [
        (f"`{name}`", f"{field.default:g}", field.description) for name, field in AvoidanceLimits.model_fields.items()
    ]
    return table(("parameter", "default", "meaning"), rows)


# ---------------------------------------------------------------- benchmarks


def benchmark_results() -> str:
    """The shipped results of all benchmarks."""
    from skyrange.bench.suite.page import make_markdown
    from skyrange.bench.suite.results import read_results

    return make_markdown(read_results(DOCS / "data" / "benchmarks.json"))


def gazebo_benchmark() -> str:
    """The shipped results of the benchmark of Gazebo, of each set-up that was measured."""
    import json

    from tools.agreement.gazebo_bench.page import make_markdown

    parts = []
    for file in sorted((DOCS / "data" / "gazebo").glob("*.json")):
        data = json.loads(file.read_text())
        first = data["rows"][0]
        title = f"### {first['versions']['gazebo']}{', with its window' if first['window'] else ''}"
        parts += [title, "", make_markdown(data, f"../images/gazebo-{file.stem}.svg"), ""]
    return "\n".join(parts)


def benchmark_sizes() -> str:
    """Every benchmark with its cases, those of `--quick` beside them."""
    from skyrange.bench.suite.cases import BENCHMARKS

    rows = [
        (
            f"`{benchmark.name}`",
            benchmark.about,
            "; ".join(case.name for case in benchmark.cases),
            "; ".join(case.name for case in benchmark.quick) or "none",
        )
        for benchmark in BENCHMARKS
    ]
    return table(("name", "what it measures", "cases", "cases with `--quick`"), rows)


def benchmark_format() -> str:
    """Every key of the JSON document of results."""
    from skyrange.bench.suite import results as described

    schema = described.Results.model_json_schema()
    models = {"Results": schema, **schema["$defs"]}
    names = ("Results", "Machine", "BenchmarkResult", "CaseResult", "Row", "Measure", "Load", "Memory")
    assert set(names) == set(models) - {"JsonValue"}
    places = ("the document", "`machine`", "`benchmarks`", "`cases`", "`rows`", "`measures`", "`load`", "`memory`")
    return "\n".join(
        f"### {place}\n\n{keys(models[name], getattr(described, name).model_fields)}"
        for name, place in zip(names, places, strict=True)
    )


# ---------------------------------------------------------------- scores


def learned_features() -> str:
    """The features of windows that learned detectors read."""
    from skyrange.detect.window_features import FEATURES

    return table(("feature", "meaning"), [(f"`{one.name}`", one.about) for one in FEATURES])


def score_tables() -> str:
    """The columns of the tables that scoring reads."""
    from skyrange.scoring.tables import ALERTS, ATTACKS, FLIGHTS, INTRUSIONS

    about = {
        "flights": "One row for each aircraft of each run.",
        "attacks": "One row for each attack on each aircraft that it affects, or for each attack on a whole run.",
        "intrusions": "One row for each harmless intrusion about each aircraft, or about a whole run.",
        "alerts": "One row for each alert, of all detectors and with all scores: scoring applies the threshold.",
    }
    parts = []
    for (name, text), schema in zip(about.items(), (FLIGHTS, ATTACKS, INTRUSIONS, ALERTS), strict=True):
        rows = [(f"`{field.name}`", field.type, field.metadata[b"about"].decode()) for field in schema]
        parts.append(f"### {name}\n\n{text}\n\n{table(('column', 'type', 'meaning'), rows)}")
    return "\n".join(parts)


def score_format() -> str:
    """Every key of the result file of a scoring."""
    from skyrange.scoring import result_file as described

    schema = described.ScoreFile.model_json_schema()
    models = {"ScoreFile": schema, **schema["$defs"]}
    places = {
        "ScoreFile": "the document",
        "ScoreSettings": "`settings`",
        "HeldOut": "`held_out`",
        "DetectorScore": "`detectors`",
        "Threshold": "`threshold`",
        "SetScore": "`sets` and `effect_sets`",
        "FalseAlarmsByFlights": "`false_alarms`",
        "FalseAlarms": "`nominal`, `sham`, `fault`, `hostile`; `reached`",
        "Claim": "`claim`",
        "Detection": "`detection`",
        "GroupDetection": "`kinds` and `families`",
        "Delay": "`delay`",
        "BeforeEffect": "`before_effect`",
        "HarmlessIntrusions": "`harmless_intrusions`",
        "Precision": "`precision`",
        "EqualRate": "`equal_rate`",
        "Estimate": "ratios: `per_h`, `recall`, `share`",
    }
    assert set(places) == set(models)
    return "\n".join(
        f"### {place}\n\n{keys(models[name], getattr(described, name).model_fields)}" for name, place in places.items()
    )


# ---------------------------------------------------------------- the Python API


def study_file() -> str:
    """The keys of a study's file."""
    from skyrange.study.sweep.design import model as described
    from skyrange.study.sweep.design.model import Study

    schema = Study.model_json_schema()
    places = {
        "Study": "The file",
        "Factor": "`[[factors]]` and `[[draws]]`",
        "StudyArm": "`[[arms]]`",
        "Registration": "`[registration]`",
        "LearnedTable": "`[learned]`",
        "HeldOutTraits": "`[held_out]`",
    }
    models = {"Study": schema, **{name: schema["$defs"][name] for name in list(places)[1:]}}
    return "\n".join(
        f"### {places[name]}\n\n{keys(part, getattr(described, name).model_fields)}" for name, part in models.items()
    )


def study_measures() -> str:
    """The measures in the table `runs` of a study."""
    from skyrange.study.sweep.columns import column_of
    from skyrange.study.variants.run_measures import QUANTITIES

    return table(
        ("column", "unit", "meaning"), [(f"`{column_of(one.name)}`", one.unit, one.about) for one in QUANTITIES]
    )


def python_api() -> str:
    """Every public name with its signature and docstring."""
    return describe_api()


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
            below = sorted(one.name for one in place.glob("*/") if (one / "__init__.py").exists())
            rows.append((len(layers) - number, f"`{name}`", first, ", ".join(f"`{one}`" for one in below)))
    return table(("layer", "package", "contents", "subpackages"), rows)


GENERATED: dict[str, Callable[[], str]] = {
    "packages": packages,
    "benchmark-results": benchmark_results,
    "benchmark-sizes": benchmark_sizes,
    "gazebo-benchmark": gazebo_benchmark,
    "benchmark-format": benchmark_format,
    "study-file": study_file,
    "study-measures": study_measures,
    "learned-features": learned_features,
    "score-tables": score_tables,
    "score-format": score_format,
    "python-api": python_api,
    "cli": cli,
    "scenario": scenario,
    "attacks": attacks,
    **{f"attacks-{family}": partial(attacks_of, family) for family in attack_families()},
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
}


COUNTED: dict[str, Callable[[], int]] = {
    kind: partial(count_shipped, f"skyrange.{kind}") for kind in ("attacks", "defences", "detectors", "faults")
}
COUNTED["mechanisms"] = count_mechanisms


def renewed(text: str) -> str:
    """A page with every generated block and every count as it should be."""
    text = BLOCK.sub(lambda found: found[1] + GENERATED[found[2]]().strip("\n") + "\n" + found[4], text)
    return COUNT.sub(lambda found: f"{found[1]}{COUNTED[found[2]]()}{found[4]}", text)


def add_family_pages() -> None:
    """Add the pages of families of attacks that have none."""
    for family in attack_families():
        page = DOCS / "reference" / "attacks" / f"{family}.md"
        if not page.exists():
            page.parent.mkdir(exist_ok=True)
            head = f"# Attacks: `{family}`\n\n[All kinds](../attacks.md), and their [effects](../attack-effects.md).\n"
            block = f"<!-- generated: attacks-{family} -->\n<!-- end: attacks-{family} -->\n"
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
