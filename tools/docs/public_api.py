"""Reference of the public modules: every name with its signature and docstring, as `generate.py` writes it."""

from __future__ import annotations

import ast
import importlib
import inspect
import itertools
import re
import textwrap
from collections.abc import Sequence
from enum import Enum
from functools import cached_property
from typing import Any

from pydantic import BaseModel

from skyrange.core.lazy_exports import exports_of
from skyrange.core.time import NEVER

FACADE = ("skyrange", "skyrange.scenario", "skyrange.plugin", "skyrange.analysis", "skyrange.env", "skyrange.testing")
"""The public modules."""

TOPICS: dict[str, dict[str, str]] = {
    "skyrange.scenario": {
        "Scenarios": "Scenario SHIPPED to_toml json_schema",
        "Surroundings": "Origin City Grid Wind Radio Receiver",
        "Operators and aircraft": "Operator Vehicle Fleet Start Sensors RemoteId Verify Avoidance Autopilots",
        "Plans": "Plan Square Path Route Fence FenceCircle FencePolygon square path route mission_file",
        "Links, processing, attacks, faults, defences, detectors, recording": """Link WifiParams CellularParams
            BaseStation Processing AttackTable FaultTable When ManualActTable DefenceTable DefenceCost DetectorTable
            Record Live""",
    },
    "skyrange.plugin": {
        "Plugins and their parameters": "Plugin register NoParams Params Number Whole Enu items refuse Floats Ints",
        "Kinds that act or listen": "attack defence detector fault param place_param state",
        "Bases of attacks and faults": """OnPath OnMessages OnLinks LinkTap InAir PathPlace on_path_place
            drop delay duplicate alter_field hold_field
            Injection InjectionOnLinks Order mode_order CopterMode copter_mode geodetic AUTOPILOT STATION
            Script Step Upload MissionItem Clear AlteredTelemetry MavlinkFields put move_place
            OnSensors alter_reading hold_reading AddsSignal Signal OnFixes OnReceivers FalseFixes Offset offset_fixes
            OnBodies claim_identity ClaimedIdentity Transmission Periodic Reception Jamming Noise
            OnApproval Composite""",
        "Attacks": """AttackContext Attack Aircraft Transmitter Broadcaster transmitter up_link down_link
            AirLink ClaimedTrack SensorHook SensorAct technique_by TechniqueBy
            Schedule Act ThreatModel Controls Exclusive
            Victims Place LinkNames CONTROL_LINKS EVERY_LINK Repetition""",
        "Campaigns": "CampaignBase CampaignStage Knowledge Observation Adversary",
        "Defences": """EndTap SpeakingTap FixCheck ChannelDefence DefenceContext Defence PathRule PathEnd Sends Passes
            Signs Compares Holds ExpectsOrder""",
        "Faults": "FaultContext FaultParts BodyHook BodyAct Disturbances",
        "Detectors": """Detector ScoreDetector MessageDetector TelemetryDetector ReceptionDetector table
            DetectorContext Monitor ObservedFrames ObservedFrame Alert MonitorPlacement
            read_messages ObservedMessages read_receptions ObservedReceptions Series Steps series""",
        "Flight approvals": """ApprovalPlugin ApprovalContext ApprovalService ApprovalPolicy policy_plugin
            FlightApproval OperationalIntent Alternative ApprovalDecision Volume4D intent_id ApprovalRequest
            ApprovalResponse encode_approval decode_approval_request decode_approval_response RequestQueue RequestOrder
            WaitingRequest""",
        "Avoidance": """AvoidancePlugin AvoidanceContext Avoidance AvoidanceLimits AvoidanceDecision AvoidanceAction
            Episode Own Tracks""",
        "Radio media": """MediumPlugin MediumContext Medium MediumBase ExternalMedium RadioSpec RadioTable
            ScanSchedule ScanStep
            Waveform TxBatch EmitterTable OnAir Sent Heard TransmissionFate ReceptionOutcome
            ProgramStatus RadioEnvironment ANY_CHANNEL""",
        "Autopilots": """AutopilotPlugin AutopilotContext VehicleSpec Engine EngineBase WallEngine Sensors Finished
            Poses BodyInputs Contacts SimulatorEngine InstanceStatus Source Airframe AIRFRAMES""",
        "Agents": "Agent Inbox Arrival Outbox Departure Note Port FrameId",
        "Links and taps": """LinkSpec Channel VariableChannel OpenChannel Route Tap TapPlacement
            NetworkPlace RadioSite OwnRadio Frame Fate
            Verdict Verdicts Pass Drop Delay Replace Inject""",
        "Observers": "Observer FrameBlock Label World",
        "Time, chance, places and names": """Time Epoch NEVER NS_PER_S NS_PER_MS NS_PER_US from_seconds to_seconds
            Chance hash64 Origin City endpoint link_name vehicle_id operator_of owner_of""",
        "MAVLink and Remote ID": """decode_mavlink alter_mavlink name_mavlink message_id MavlinkMessage MavlinkPacker
            mavlink
            decode_remote_id encode_remote_id
            find_remote_id_deviations BasicId Location MessagePack""",
        "Errors": "SkyrangeError InputError Problem Problems ComponentError DecodeError nearest",
    },
    "skyrange.analysis": {
        "Runs": "load RunRecord RecordedFrame summary write_report",
        "Comparison": """load_pair Pair Interval compare_runs Difference compare_outcomes Agreement compare_autopilots
            compare_rates Parity""",
        "Remote ID": """received_broadcasts ReceivedBroadcast reception_summaries ReceptionSummary
            remote_id_trust TrustSummary TrustPair
            summarise_receptions receivers_of decode_remote_id find_remote_id_deviations""",
        "MAVLink": "decode_mavlink name_mavlink",
        "Detectors": "replay_monitor RaisedAlert",
        "Studies": """Study Factor StudyArm LearnedTable read_study run_study StudyResult read_study_results
            estimate_mean write_study_report""",
        "Scores of detectors": """score_study ScoreSettings ScoreFile read_scores write_scores rank_detectors
            LeaderboardRow""",
        "Data sets": """DatasetMember read_dataset_members list_dataset_members
            HeldOut assign_splits check_held_out ViewSettings SensorPlace
            build_dataset audit_dataset LeakFinding require_no_leak""",
        "Figures": "Figure trajectories_3d plan_view altitude track_deviation pair_plan_view",
        "Captures": "Capture export_mavlink export_remote_id",
        "Files for other tools": "Export export_mcap export_kml export_tables",
    },
}
"""Names of public modules by topic; a module that is not here has one list."""
HIDDEN = ("faults_between",)
"""Methods that only this project calls."""


def described() -> str:
    """All public modules, in Markdown. Fails for a name that has no topic."""
    parts = []
    for name in FACADE:
        module = importlib.import_module(name)
        public = [member for member in module.__all__ if not member.startswith("_")]
        topics = TOPICS.get(name, {"": " ".join(public)})
        listed = [member for members in topics.values() for member in members.split()]
        missing, gone = sorted(set(public) - set(listed)), sorted(set(listed) - set(public))
        assert not missing, f"give {missing} of {name} a topic"
        assert not gone, f"{gone} are not exported by {name}"
        parts.append(f"## `{name}`\n\n{_paragraphs(module.__doc__, 1)}\n")
        for topic, members in topics.items():
            if topic:
                parts.append(f"### {topic}\n")
            parts += [_entry(name, member, getattr(module, member)) for member in members.split()]
    return "\n".join(parts)


def _entry(module: str, name: str, value: Any) -> str:
    stub, members = _stub(name, value), _members(value)
    block = f"```text\n{stub}\n```\n\n" if stub else ""
    text = _paragraphs(_doc(module, name, value))
    if inspect.isclass(value) and issubclass(value, BaseModel) and value.__module__.startswith("skyrange.scenario."):
        text += "\n\nIts fields are [the keys of a file](scenario.md)."
    return f"#### `{module}.{name}`\n\n{block}{text}\n" + (f"\n{members}" if members else "")


def _paragraphs(doc: str | None, most: int = 99) -> str:
    """The first paragraphs of a docstring, each on one line."""
    parts = inspect.cleandoc(doc or "").split("\n\n")[:most]
    return "\n\n".join(part if part.startswith("- ") else " ".join(part.split()) for part in parts)


def _doc(module: str, name: str, value: Any) -> str | None:
    """An object's docstring; of a value, the string below its assignment."""
    if _is_ours(value) or inspect.isroutine(value):
        return inspect.getdoc(value)
    home, original = exports_of(module)[name]
    if inspect.ismodule(value):
        return f"The module `{value.__name__}`."
    source = inspect.getsource(importlib.import_module(home))
    return _documented(ast.parse(source).body).get(original) or f"`{value!r}`"


def _documented(body: Sequence[ast.stmt]) -> dict[str, str]:
    """By name, the strings below the assignments of a module or a class."""
    documented = {}
    for statement, below in itertools.pairwise(body):
        target: ast.expr | None = statement.target if isinstance(statement, ast.AnnAssign) else None
        target = statement.targets[0] if isinstance(statement, ast.Assign) else target
        if isinstance(target, ast.Name) and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            documented[target.id] = str(below.value.value)
    return documented


def _stub(name: str, value: Any) -> str:
    """An object as it would stand in a stub file."""
    if inspect.isroutine(value):
        return f"{name}{_signature(value)}"
    if not _is_ours(value) or issubclass(value, BaseModel):
        return ""
    if _is_protocol(value):
        lines = [f"class {name}(Protocol)", *(f"    {key}: {kind}" for key, kind in _attributes(value).items())]
        return "\n".join([*lines, *(f"    {key}{_signature(each)}" for key, each in _methods(value).items())])
    if issubclass(value, Enum):
        lines = [f"class {name}({value.__mro__[1].__name__})", *(f"    {one.name} = {one.value!r}" for one in value)]
        return "\n".join(lines)
    return f"class {name}{_signature(value)}" if "__init__" in _own(value) or not _is_error(value) else f"class {name}"


def _is_ours(value: Any) -> bool:
    """Whether this is a class of this project, and no other name for one of Python's own."""
    return inspect.isclass(value) and value.__module__.startswith("skyrange.")


def _is_protocol(value: Any) -> bool:
    return bool(getattr(value, "_is_protocol", False))


def _is_error(value: Any) -> bool:
    return issubclass(value, Exception)


def _own(value: Any) -> set[str]:
    """The names that a class and its bases of this project define."""
    return {key for base in value.__mro__ if base.__module__.startswith("skyrange.") for key in vars(base)}


def _attributes(value: Any) -> dict[str, str]:
    """The attributes that a protocol asks for, those of its bases first."""
    attributes: dict[str, str] = {}
    for base in reversed(value.__mro__):
        if _is_protocol(base):
            attributes |= {key: str(kind) for key, kind in inspect.get_annotations(base).items()}
            properties = {key: each for key, each in vars(base).items() if isinstance(each, property)}
            attributes |= {key: str(each.fget.__annotations__["return"]) for key, each in properties.items()}
    return attributes


def _methods(value: Any) -> dict[str, Any]:
    """The public methods of a class, those of its bases first."""
    methods: dict[str, Any] = {}
    for base in reversed(value.__mro__):
        if base.__module__.startswith("skyrange."):
            for key, each in vars(base).items():
                method = each.__func__ if isinstance(each, classmethod | staticmethod) else each
                if key.startswith("_") or key in HIDDEN or isinstance(method, cached_property):
                    continue
                if inspect.isroutine(method):
                    methods[key] = method
    return methods


def _signature(value: Any, *, wide: bool = False) -> str:
    """A signature without `self`; one parameter a line where it is long, unless it shall be `wide`."""
    signature = inspect.signature(value)
    kept = [p.replace(annotation=_plain(p.annotation)) for p in signature.parameters.values()]
    kept = [p for p in kept if p.name not in ("self", "cls")]
    returned = _plain(signature.return_annotation) if not inspect.isclass(value) else inspect.Signature.empty
    text = str(signature.replace(parameters=kept, return_annotation=returned))
    text = re.sub(r"(?<=: )'([^']*)'|(?<=-> )'([^']*)'", lambda match: match[1] or match[2], text)
    text = re.sub(r"\"ForwardRef\('(.*?)'\)\"", lambda match: match[1], text)
    text = re.sub(r"<[^>]*>", "…", text).replace(str(NEVER), "NEVER")
    if wide or len(text) <= 100 or not kept:
        return text
    inside, _, rest = text[1:].rpartition(")")
    lines = "".join(f"    {parameter},\n" for parameter in _split(inside))
    return f"(\n{lines}){rest}"


def _plain(annotation: Any) -> Any:
    """An annotation by its own name; most are text already."""
    if annotation is inspect.Parameter.empty or isinstance(annotation, str):
        return annotation
    return annotation.__name__ if isinstance(annotation, type) else str(annotation)


def _split(parameters: str) -> list[str]:
    """Parameters at the commas between them."""
    parts, depth, begin = [], 0, 0
    for at, char in enumerate(parameters):
        depth += (char in "([{") - (char in ")]}")
        if char == "," and depth == 0:
            parts.append(parameters[begin:at].strip())
            begin = at + 1
    return [*parts, parameters[begin:].strip()]


def _members(value: Any) -> str:
    """Attributes and methods of a class with what is said of each."""
    if not _is_ours(value):
        return ""
    docs: dict[str, str] = {}
    for base in reversed(value.__mro__):
        if not base.__module__.startswith("skyrange.") or "<locals>" in base.__qualname__:
            continue
        tree = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        assert isinstance(tree, ast.ClassDef)
        docs |= {key: doc for key, doc in _documented(tree.body).items() if key != "__slots__"}
        methods = _methods(base)
        for key, each in vars(base).items():
            if not key.startswith("_") and isinstance(each, (property, cached_property)) and each.__doc__:
                docs[key] = each.__doc__
            elif not key.startswith("_") and key in methods and methods[key].__doc__:
                docs[key] = methods[key].__doc__
    signed = {} if _is_protocol(value) else _methods(value)
    shown = {key: _paragraphs(doc, 1) for key, doc in docs.items() if not key.startswith("_")}
    named = {key: f"{key}{_signature(signed[key], wide=True)}" if key in signed else key for key in shown}
    return "".join(f"- `{named[key]}`: {doc}\n" for key, doc in shown.items() if doc)
