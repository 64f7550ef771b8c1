"""Commands that run scenarios or read their records: each calls the library and prints a table or JSON."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skyrange.cli.addresses import parse_ip_address
from skyrange.cli.output.console import print_json, print_notice, print_text, print_unverified
from skyrange.core.errors import InputError, ShortfallError
from skyrange.core.files import expand_user

if TYPE_CHECKING:
    from skyrange.attack.contract import AttackPlugin
    from skyrange.defence.contract import DefencePlugin
    from skyrange.fault.contract import FaultPlugin
    from skyrange.twins.attribution.arms import Selection
    from skyrange.twins.pair_folder import Pair


def run(
    name: str,
    out: Path | None,
    seed: int | None,
    speed: float | None,
    buildings: Path | None,
    changes: Sequence[str],
    qgc: bool,
    viewer_port: int | None,
    viewer_host: str,
    motion: bool,
    cores: int,
    as_json: bool,
) -> None:
    """`skyrange run`."""
    from skyrange.cli.output.interlock_notice import print_interlock_notice
    from skyrange.cli.output.progress import compile_if_cold, progress
    from skyrange.cli.output.run_summary import print_summary
    from skyrange.cli.output.viewer_notices import open_viewers
    from skyrange.cli.output.warnings import print_warnings
    from skyrange.metrics.summary import summary
    from skyrange.scenario.shipped import load
    from skyrange.study.runs import fly
    from skyrange.twins.failed_missions import require_missions

    scenario = load(name, changes, seed=seed, buildings=buildings)
    print_warnings(scenario)
    shortfall: ShortfallError | None = None
    compile_if_cold(quiet=as_json)
    watched = qgc or viewer_port is not None
    viewer_host = parse_ip_address("viewers", "--viewer-host", viewer_host)
    opened = open_viewers(scenario, watched, viewer_port, viewer_host)
    with opened as viewers, progress(scenario.name, quiet=as_json) as on_progress:
        try:
            record = fly(
                scenario,
                out,
                speed=speed,
                viewers=viewers,
                on_progress=on_progress,
                motion=motion,
                cores=cores,
                on_notice=print_notice,
            )
        except ShortfallError as error:
            from skyrange.record import load as load_run

            shortfall, record = error, load_run(error.path)
    facts = summary(record)
    if as_json:
        print_json(facts)
    else:
        print_summary(facts)
        print_interlock_notice(record.manifest)
    if shortfall is not None:
        raise shortfall
    require_missions(record)


def pair(
    name: str,
    out: Path | None,
    arms: Selection | None,
    honest: bool,
    seeds: int,
    jobs: int | None,
    seed: int | None,
    buildings: Path | None,
    changes: Sequence[str],
    as_json: bool,
) -> None:
    """`skyrange pair`."""
    from skyrange.cli.output.pair_table import print_pair
    from skyrange.cli.output.progress import compile_if_cold, parallel_progress
    from skyrange.cli.output.warnings import print_warnings
    from skyrange.scenario.shipped import load
    from skyrange.study.pairing import pair as fly_pair
    from skyrange.twins.attribution.arms import acting_attacks, plan_arms
    from skyrange.twins.failed_missions import require_baseline

    scenario = load(name, changes, seed=seed, buildings=buildings)
    print_warnings(scenario)
    compile_if_cold(quiet=as_json)
    flights = seeds * len(plan_arms(acting_attacks(scenario), arms, honest))
    with parallel_progress(scenario.name, flights, quiet=as_json) as on_progress:
        result = fly_pair(scenario, out, arms=arms, honest=honest, seeds=seeds, jobs=jobs, on_progress=on_progress)
    if as_json:
        print_json(_pair_facts(result))
    else:
        print_pair(result)
    require_baseline(map(str, result.failed_missions), result.path)


def _pair_facts(result: Pair) -> dict[str, Any]:
    """A pair as plain data, for `--json`."""
    from skyrange.twins.attribution.arms import HONEST

    found = {vehicle: {key: one._asdict() for key, one in own.items()} for vehicle, own in result.intervals().items()}
    folder = {"path": str(result.path), "report": str(result.report)}
    failed = [{**asdict(one), "reasons": dict(one.reasons)} for one in result.failed_missions]
    effects, attribution = result.effects.to_pylist(), result.attribution.to_pylist()
    facts = {**result.manifest, **folder, "failed_missions": failed, "effects": effects, "intervals": found}
    facts["attribution"] = attribution
    return facts | ({"lie_and_truth": result.lie_and_truth.to_pylist()} if HONEST in result.arms else {})


def _open_pair(folder: Path) -> Pair | None:
    """The pair in a folder, None if it is another folder; `InputError` for a pair whose runs did not all end."""
    from skyrange.twins.pair_folder import EFFECTS, MANIFEST, load_pair

    folder = expand_user(folder)
    if not (folder / MANIFEST).exists():
        return None
    result = load_pair(folder)
    if not (folder / EFFECTS).exists():
        hint = f"It was interrupted, or a run failed. See a single run: `skyrange show {folder / 'attacked'}`."
        raise InputError.one(str(folder), EFFECTS, "missing", "a pair whose runs have all ended", hint)
    return result


def show(folder: Path, as_json: bool) -> None:
    """`skyrange show`."""
    from skyrange.cli.output.pair_table import print_pair
    from skyrange.cli.output.run_summary import print_disk, print_summary
    from skyrange.metrics.summary import summary
    from skyrange.record import load

    result = _open_pair(folder)
    facts = summary(load(folder)) if result is None else {}
    print_unverified(expand_user(folder), is_pair=result is not None)
    if result is not None:
        if as_json:
            print_json(_pair_facts(result))
        else:
            print_pair(result)
        return
    if as_json:
        print_json(facts)
    else:
        print_summary(facts)
        print_disk(facts)


def report(folder: Path, out: Path | None, as_json: bool) -> None:
    """`skyrange report`."""
    from skyrange.record import load
    from skyrange.report import write_report
    from skyrange.report.pair.page import write_comparison

    result = _open_pair(folder)
    record = load(folder) if result is None else None
    print_unverified(expand_user(folder), is_pair=result is not None)
    path = expand_user(out) if out is not None else expand_user(folder) / "report.html"
    try:
        if result is not None:
            write_comparison(result, path)
        elif record is not None:
            write_report(record, path)
    except OSError as error:
        raise InputError.one("--out", "file", str(path), f"a file that can be written ({error.strerror})") from None
    if as_json:
        print_json({"report": str(path), "bytes": path.stat().st_size})
    else:
        print_text(path)


def diff(a: Path, b: Path, tolerance_s: float | None, as_json: bool) -> None:
    """`skyrange diff`."""
    from skyrange.metrics.agreement import Agreement, agreement
    from skyrange.metrics.exact_difference import Difference
    from skyrange.metrics.exact_difference import diff as compare
    from skyrange.record import load

    runs = load(a), load(b)
    if tolerance_s is not None:  # without it, `compare` verifies both
        for run in runs:
            print_unverified(run.path)
    difference: Agreement | Difference = compare(*runs) if tolerance_s is None else agreement(*runs, tolerance_s)
    if as_json:
        print_json(difference.to_dict())
    else:
        print_text(difference)


def verify(folder: Path, as_json: bool) -> None:
    """`skyrange verify`."""
    from skyrange.record.read.run import open_folder
    from skyrange.record.verification import verify_run

    found = verify_run(open_folder(folder))
    if as_json:
        print_json(found.to_dict())
    else:
        print_text(found)
    if not found.ok:
        sys.exit(3)


def scenarios(as_json: bool) -> None:
    """`skyrange scenarios`."""
    from skyrange.scenario.shipped import SHIPPED

    if as_json:
        print_json([{"name": name, "about": about} for name, about in SHIPPED.items()])
        return
    width = max(map(len, SHIPPED))
    for name, about in SHIPPED.items():
        print_text(f"{name:<{width}}  {about}")


def load_plugins(files: Sequence[Path] | None) -> None:
    """`--plugin` of several commands."""
    if files:
        from skyrange.contracts.plugins.registry import load_files

        load_files(files)


def attacks(as_json: bool) -> None:
    """`skyrange attacks`."""
    from skyrange.attack.contract import AttackPlugin
    from skyrange.attack.techniques import list_techniques
    from skyrange.contracts.plugins.registry import ATTACKS, kinds

    found = {name: AttackPlugin.find(name) for name in kinds(ATTACKS)}
    if as_json:
        print_json([_describe_attack(name, one) for name, one in found.items()])
        return
    techniques = {name: "/".join(list_techniques(one.technique)) for name, one in found.items()}
    width, columns = max(map(len, found), default=0), max(map(len, techniques.values()), default=0)
    for name, one in found.items():
        print_text(f"{name:<{width}}  {techniques[name]:<{columns}}  {', '.join(one.surface):<14}  {one.about}")


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


def faults(as_json: bool) -> None:
    """`skyrange faults`."""
    from skyrange.contracts.plugins.registry import FAULTS, kinds
    from skyrange.fault.contract import FaultPlugin

    found = {name: FaultPlugin.find(name) for name in kinds(FAULTS)}
    if as_json:
        print_json([_describe_fault(name, one) for name, one in found.items()])
        return
    width = max(map(len, found), default=0)
    for name, one in found.items():
        print_text(f"{name:<{width}}  {', '.join(one.surface):<14}  {one.about}")


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


def defences(as_json: bool) -> None:
    """`skyrange defences`."""
    from skyrange.contracts.plugins.registry import DEFENCES, kinds
    from skyrange.defence.contract import DefencePlugin

    found = {name: DefencePlugin.find(name) for name in kinds(DEFENCES)}
    if as_json:
        print_json([_describe_defence(name, one) for name, one in found.items()])
        return
    width = max(map(len, found), default=0)
    for name, one in found.items():
        print_text(f"{name:<{width}}  {', '.join(one.surface):<14}  {one.about}")


def _describe_defence(name: str, kind: DefencePlugin) -> dict[str, Any]:
    """A kind of defence as `skyrange defences --json` prints it."""
    texts = {key: getattr(kind, key) for key in ("about", "place", "effect", "evasion", "cost")}
    lists = {key: list(getattr(kind, key)) for key in ("surface", "alerts", "against", "nominal")}
    return {"kind": name, **texts, **lists, "realism": dict(kind.realism)}


def schema() -> None:
    """`skyrange schema`."""
    from skyrange.scenario.model.scenario import json_schema

    print_json(json_schema())
