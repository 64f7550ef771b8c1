"""Contracts for plugin authors: every protocol, and every type of value that crosses one.

What is exported here is public; the modules that it comes from are private and may change. How to use it: the guide
`docs/how-to/write-a-plugin.md`. `skyrange.testing` checks that a plugin keeps its contract.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from skyrange.core.lazy_exports import export_lazily

if TYPE_CHECKING:
    from skyrange.attack.bases.approval.links import OnApproval
    from skyrange.attack.bases.frame_acts import delay, drop, duplicate
    from skyrange.attack.bases.gnss.fixes import FalseFixes, Offset, OnFixes, OnReceivers, offset_fixes
    from skyrange.attack.bases.light import AltersLight, LightsSensor
    from skyrange.attack.bases.links import LinkNames, LinkTap, OnLinks, OnPath, PathPlace, on_path_place
    from skyrange.attack.bases.mavlink.injection import Clear, Injection, InjectionOnLinks, Script, Step, Upload
    from skyrange.attack.bases.mavlink.injection import Item as MissionItem
    from skyrange.attack.bases.mavlink.message_fields import Fields as MavlinkFields
    from skyrange.attack.bases.mavlink.message_fields import move_place, put
    from skyrange.attack.bases.mavlink.messages import OnMessages, alter_field, hold_field
    from skyrange.attack.bases.mavlink.orders import AUTOPILOT, STATION, Order, geodetic, mode_order
    from skyrange.attack.bases.mavlink.params import CopterMode, copter_mode
    from skyrange.attack.bases.mavlink.telemetry import AlteredTelemetry
    from skyrange.attack.bases.remote_id import ClaimedIdentity, claim_identity
    from skyrange.attack.bases.sensors import AddsSignal, OnSensors, Signal, alter_reading, hold_reading
    from skyrange.attack.bases.transmission import Jamming, Noise, Periodic, Reception, Transmission
    from skyrange.attack.bases.wifi_links import InAir
    from skyrange.attack.campaigns.adversary import Adversary, CampaignStage, Knowledge, Observation
    from skyrange.attack.campaigns.python_class import CampaignBase
    from skyrange.attack.contract import (
        Aircraft,
        AirLink,
        Attack,
        AttackContext,
        Controls,
        Place,
        ThreatModel,
        Transmitter,
    )
    from skyrange.attack.declaration import Composite, attack
    from skyrange.attack.exclusive import Exclusive
    from skyrange.attack.params import Victims, place_param
    from skyrange.attack.radio import Broadcaster, down_link, transmitter, up_link
    from skyrange.attack.tapped_links import CONTROL_LINKS, EVERY_LINK, Repetition
    from skyrange.attack.techniques import TechniqueBy, technique_by
    from skyrange.city.city import City
    from skyrange.codec.f3411 import BasicId, Location, MessagePack
    from skyrange.codec.f3411 import decode as decode_remote_id
    from skyrange.codec.f3411 import encode as encode_remote_id
    from skyrange.codec.f3411.conformance import deviations as find_remote_id_deviations
    from skyrange.codec.mavlink import Message as MavlinkMessage
    from skyrange.codec.mavlink import Packer as MavlinkPacker
    from skyrange.codec.mavlink import alter as alter_mavlink
    from skyrange.codec.mavlink import decode_anew as decode_mavlink
    from skyrange.codec.mavlink import dialect as mavlink
    from skyrange.codec.mavlink import message_id
    from skyrange.codec.mavlink import message_name as name_mavlink
    from skyrange.contracts.alerts import Alert
    from skyrange.contracts.claims import ClaimedTrack
    from skyrange.contracts.components import (
        Agent,
        BodyAct,
        BodyHook,
        BodyInputs,
        Contacts,
        Disturbances,
        Engine,
        EngineBase,
        Finished,
        Floats,
        InstanceStatus,
        Observer,
        Poses,
        SensorAct,
        SensorHook,
        Sensors,
        SimulatorEngine,
        Source,
        Tap,
        WallEngine,
        World,
    )
    from skyrange.contracts.frames import Fate, Frame, FrameBlock, Ints
    from skyrange.contracts.links import (
        Act,
        Channel,
        LinkSpec,
        NetworkPlace,
        OpenChannel,
        OwnRadio,
        RadioSite,
        Route,
        Schedule,
        TapPlacement,
        VariableChannel,
    )
    from skyrange.contracts.mailboxes import Arrival, Departure, Inbox, Note, Outbox
    from skyrange.contracts.medium import (
        ANY_CHANNEL,
        EmitterTable,
        Heard,
        Medium,
        MediumBase,
        OnAir,
        ProgramStatus,
        RadioSpec,
        RadioTable,
        ReceptionOutcome,
        ScanSchedule,
        ScanStep,
        Sent,
        TransmissionFate,
        TxBatch,
        Waveform,
    )
    from skyrange.contracts.monitors import DetectorContext, Monitor, MonitorPlacement, ObservedFrame, ObservedFrames
    from skyrange.contracts.params import Enu, Number, Params, Whole, items, refuse
    from skyrange.contracts.plugins.form import param, state
    from skyrange.contracts.plugins.registry import NoParams, Plugin, register
    from skyrange.contracts.scan_light import ScanHook, ScanLight
    from skyrange.contracts.verdicts import Delay, Drop, Inject, Label, Pass, Replace, Verdict, Verdicts
    from skyrange.core.chance import Chance
    from skyrange.core.errors import ComponentError, DecodeError, InputError, Problem, Problems, SkyrangeError, nearest
    from skyrange.core.geodesy import Origin
    from skyrange.core.ids import FrameId, Port, endpoint, hash64, link_name, operator_of, owner_of, vehicle_id
    from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, NS_PER_US, Epoch, Time, from_seconds, to_seconds
    from skyrange.core.volumes import Volume4D
    from skyrange.defence.bases.channels import ChannelDefence
    from skyrange.defence.bases.fix_checks import FixCheck
    from skyrange.defence.bases.link_ends import EndTap, SpeakingTap
    from skyrange.defence.contract import Defence, DefenceContext, defence
    from skyrange.defence.path_rules import Compares, ExpectsOrder, Holds, Passes, PathEnd, PathRule, Sends, Signs
    from skyrange.detect.bases import MessageDetector, ReceptionDetector, ScoreDetector, TelemetryDetector
    from skyrange.detect.declaration import Detector, detector
    from skyrange.detect.messages import ObservedMessages, read_messages
    from skyrange.detect.receptions import ObservedReceptions, read_receptions
    from skyrange.detect.series import Series, Steps, series
    from skyrange.detect.streams import table
    from skyrange.fault.bases import OnBodies
    from skyrange.fault.contract import FaultContext, FaultParts, fault
    from skyrange.radio.builtin.params import RadioEnvironment
    from skyrange.radio.contract import MediumContext, MediumPlugin
    from skyrange.radio.external.medium import ExternalMedium
    from skyrange.utm.approval_service import FlightApproval, policy_plugin
    from skyrange.utm.contract import (
        Alternative,
        ApprovalContext,
        ApprovalDecision,
        ApprovalPlugin,
        ApprovalPolicy,
        ApprovalService,
        OperationalIntent,
        intent_id,
    )
    from skyrange.utm.messages import Request as ApprovalRequest
    from skyrange.utm.messages import Response as ApprovalResponse
    from skyrange.utm.messages import decode_request as decode_approval_request
    from skyrange.utm.messages import decode_response as decode_approval_response
    from skyrange.utm.messages import encode as encode_approval
    from skyrange.utm.request_book import RequestOrder, RequestQueue, WaitingRequest
    from skyrange.vehicle.avoidance.contract import (
        Avoidance,
        AvoidanceAction,
        AvoidanceContext,
        AvoidanceDecision,
        AvoidanceLimits,
        AvoidancePlugin,
        Episode,
        Own,
        Tracks,
    )
    from skyrange.vehicle.contract import AutopilotContext, AutopilotPlugin, VehicleSpec
    from skyrange.world.airframes import AIRFRAMES, Airframe

__all__ = [
    "AIRFRAMES",
    "ANY_CHANNEL",
    "AUTOPILOT",
    "CONTROL_LINKS",
    "EVERY_LINK",
    "NEVER",
    "NS_PER_MS",
    "NS_PER_S",
    "NS_PER_US",
    "STATION",
    "Act",
    "AddsSignal",
    "Adversary",
    "Agent",
    "AirLink",
    "Aircraft",
    "Airframe",
    "Alert",
    "AlteredTelemetry",
    "Alternative",
    "AltersLight",
    "ApprovalContext",
    "ApprovalDecision",
    "ApprovalPlugin",
    "ApprovalPolicy",
    "ApprovalRequest",
    "ApprovalResponse",
    "ApprovalService",
    "Arrival",
    "Attack",
    "AttackContext",
    "AutopilotContext",
    "AutopilotPlugin",
    "Avoidance",
    "AvoidanceAction",
    "AvoidanceContext",
    "AvoidanceDecision",
    "AvoidanceLimits",
    "AvoidancePlugin",
    "BasicId",
    "BodyAct",
    "BodyHook",
    "BodyInputs",
    "Broadcaster",
    "CampaignBase",
    "CampaignStage",
    "Chance",
    "Channel",
    "ChannelDefence",
    "City",
    "ClaimedIdentity",
    "ClaimedTrack",
    "Clear",
    "Compares",
    "ComponentError",
    "Composite",
    "Contacts",
    "Controls",
    "CopterMode",
    "DecodeError",
    "Defence",
    "DefenceContext",
    "Delay",
    "Departure",
    "Detector",
    "DetectorContext",
    "Disturbances",
    "Drop",
    "EmitterTable",
    "EndTap",
    "Engine",
    "EngineBase",
    "Enu",
    "Episode",
    "Epoch",
    "Exclusive",
    "ExpectsOrder",
    "ExternalMedium",
    "FalseFixes",
    "Fate",
    "FaultContext",
    "FaultParts",
    "Finished",
    "FixCheck",
    "FlightApproval",
    "Floats",
    "Frame",
    "FrameBlock",
    "FrameId",
    "Heard",
    "Holds",
    "InAir",
    "Inbox",
    "Inject",
    "Injection",
    "InjectionOnLinks",
    "InputError",
    "InstanceStatus",
    "Ints",
    "Jamming",
    "Knowledge",
    "Label",
    "LightsSensor",
    "LinkNames",
    "LinkSpec",
    "LinkTap",
    "Location",
    "MavlinkFields",
    "MavlinkMessage",
    "MavlinkPacker",
    "Medium",
    "MediumBase",
    "MediumContext",
    "MediumPlugin",
    "MessageDetector",
    "MessagePack",
    "MissionItem",
    "Monitor",
    "MonitorPlacement",
    "NetworkPlace",
    "NoParams",
    "Noise",
    "Note",
    "Number",
    "Observation",
    "ObservedFrame",
    "ObservedFrames",
    "ObservedMessages",
    "ObservedReceptions",
    "Observer",
    "Offset",
    "OnAir",
    "OnApproval",
    "OnBodies",
    "OnFixes",
    "OnLinks",
    "OnMessages",
    "OnPath",
    "OnReceivers",
    "OnSensors",
    "OpenChannel",
    "OperationalIntent",
    "Order",
    "Origin",
    "Outbox",
    "Own",
    "OwnRadio",
    "Params",
    "Pass",
    "Passes",
    "PathEnd",
    "PathPlace",
    "PathRule",
    "Periodic",
    "Place",
    "Plugin",
    "Port",
    "Poses",
    "Problem",
    "Problems",
    "ProgramStatus",
    "RadioEnvironment",
    "RadioSite",
    "RadioSpec",
    "RadioTable",
    "Reception",
    "ReceptionDetector",
    "ReceptionOutcome",
    "Repetition",
    "Replace",
    "RequestOrder",
    "RequestQueue",
    "Route",
    "ScanHook",
    "ScanLight",
    "ScanSchedule",
    "ScanStep",
    "Schedule",
    "ScoreDetector",
    "Script",
    "Sends",
    "SensorAct",
    "SensorHook",
    "Sensors",
    "Sent",
    "Series",
    "Signal",
    "Signs",
    "SimulatorEngine",
    "SkyrangeError",
    "Source",
    "SpeakingTap",
    "Step",
    "Steps",
    "Tap",
    "TapPlacement",
    "TechniqueBy",
    "TelemetryDetector",
    "ThreatModel",
    "Time",
    "Tracks",
    "Transmission",
    "TransmissionFate",
    "Transmitter",
    "TxBatch",
    "Upload",
    "VariableChannel",
    "VehicleSpec",
    "Verdict",
    "Verdicts",
    "Victims",
    "Volume4D",
    "WaitingRequest",
    "WallEngine",
    "Waveform",
    "Whole",
    "World",
    "alter_field",
    "alter_mavlink",
    "alter_reading",
    "attack",
    "claim_identity",
    "copter_mode",
    "decode_approval_request",
    "decode_approval_response",
    "decode_mavlink",
    "decode_remote_id",
    "defence",
    "delay",
    "detector",
    "down_link",
    "drop",
    "duplicate",
    "encode_approval",
    "encode_remote_id",
    "endpoint",
    "fault",
    "find_remote_id_deviations",
    "from_seconds",
    "geodetic",
    "hash64",
    "hold_field",
    "hold_reading",
    "intent_id",
    "items",
    "link_name",
    "mavlink",
    "message_id",
    "mode_order",
    "move_place",
    "name_mavlink",
    "nearest",
    "offset_fixes",
    "on_path_place",
    "operator_of",
    "owner_of",
    "param",
    "place_param",
    "policy_plugin",
    "put",
    "read_messages",
    "read_receptions",
    "refuse",
    "register",
    "series",
    "state",
    "table",
    "technique_by",
    "to_seconds",
    "transmitter",
    "up_link",
    "vehicle_id",
]

if not TYPE_CHECKING:
    __getattr__ = export_lazily(
        __name__,
        {
            "skyrange.attack.bases.approval.links": "OnApproval",
            "skyrange.attack.bases.frame_acts": "delay drop duplicate",
            "skyrange.attack.bases.gnss.fixes": "FalseFixes Offset OnFixes OnReceivers offset_fixes",
            "skyrange.attack.bases.light": "AltersLight LightsSensor",
            "skyrange.attack.bases.links": "LinkNames LinkTap OnLinks OnPath PathPlace on_path_place",
            "skyrange.attack.bases.mavlink.injection": (
                "Clear Injection InjectionOnLinks Script Step Upload Item=MissionItem"
            ),
            "skyrange.attack.bases.mavlink.message_fields": "Fields=MavlinkFields move_place put",
            "skyrange.attack.bases.mavlink.messages": "OnMessages alter_field hold_field",
            "skyrange.attack.bases.mavlink.orders": "AUTOPILOT STATION Order geodetic mode_order",
            "skyrange.attack.bases.mavlink.params": "CopterMode copter_mode",
            "skyrange.attack.bases.mavlink.telemetry": "AlteredTelemetry",
            "skyrange.attack.bases.remote_id": "ClaimedIdentity claim_identity",
            "skyrange.attack.bases.sensors": "AddsSignal OnSensors Signal alter_reading hold_reading",
            "skyrange.attack.bases.transmission": "Jamming Noise Periodic Reception Transmission",
            "skyrange.attack.bases.wifi_links": "InAir",
            "skyrange.attack.campaigns.adversary": "Adversary CampaignStage Knowledge Observation",
            "skyrange.attack.campaigns.python_class": "CampaignBase",
            "skyrange.attack.contract": "Aircraft AirLink Attack AttackContext Controls Place ThreatModel Transmitter",
            "skyrange.attack.declaration": "Composite attack",
            "skyrange.attack.exclusive": "Exclusive",
            "skyrange.attack.params": "Victims place_param",
            "skyrange.attack.radio": "Broadcaster down_link transmitter up_link",
            "skyrange.attack.tapped_links": "CONTROL_LINKS EVERY_LINK Repetition",
            "skyrange.attack.techniques": "TechniqueBy technique_by",
            "skyrange.city.city": "City",
            "skyrange.codec.f3411": "BasicId Location MessagePack decode=decode_remote_id encode=encode_remote_id",
            "skyrange.codec.f3411.conformance": "deviations=find_remote_id_deviations",
            "skyrange.codec.mavlink": (
                "Message=MavlinkMessage Packer=MavlinkPacker alter=alter_mavlink decode_anew=decode_mavlink "
                "dialect=mavlink message_id message_name=name_mavlink"
            ),
            "skyrange.contracts.alerts": "Alert",
            "skyrange.contracts.claims": "ClaimedTrack",
            "skyrange.contracts.components": (
                "Agent BodyAct BodyHook BodyInputs Contacts Disturbances Engine EngineBase Finished "
                "Floats InstanceStatus Observer Poses SensorAct SensorHook Sensors SimulatorEngine Source "
                "Tap WallEngine World"
            ),
            "skyrange.contracts.frames": "Fate Frame FrameBlock Ints",
            "skyrange.contracts.links": (
                "Act Channel LinkSpec NetworkPlace OpenChannel OwnRadio RadioSite Route Schedule "
                "TapPlacement VariableChannel"
            ),
            "skyrange.contracts.mailboxes": "Arrival Departure Inbox Note Outbox",
            "skyrange.contracts.medium": (
                "ANY_CHANNEL EmitterTable Heard Medium MediumBase OnAir ProgramStatus RadioSpec "
                "RadioTable ReceptionOutcome ScanSchedule ScanStep Sent TransmissionFate TxBatch Waveform"
            ),
            "skyrange.contracts.monitors": "DetectorContext Monitor MonitorPlacement ObservedFrame ObservedFrames",
            "skyrange.contracts.params": "Enu Number Params Whole items refuse",
            "skyrange.contracts.plugins.form": "param state",
            "skyrange.contracts.plugins.registry": "NoParams Plugin register",
            "skyrange.contracts.scan_light": "ScanHook ScanLight",
            "skyrange.contracts.verdicts": "Delay Drop Inject Label Pass Replace Verdict Verdicts",
            "skyrange.core.chance": "Chance",
            "skyrange.core.errors": "ComponentError DecodeError InputError Problem Problems SkyrangeError nearest",
            "skyrange.core.geodesy": "Origin",
            "skyrange.core.ids": "FrameId Port endpoint hash64 link_name operator_of owner_of vehicle_id",
            "skyrange.core.time": "NEVER NS_PER_MS NS_PER_S NS_PER_US Epoch Time from_seconds to_seconds",
            "skyrange.core.volumes": "Volume4D",
            "skyrange.defence.bases.channels": "ChannelDefence",
            "skyrange.defence.bases.fix_checks": "FixCheck",
            "skyrange.defence.bases.link_ends": "EndTap SpeakingTap",
            "skyrange.defence.contract": "Defence DefenceContext defence",
            "skyrange.defence.path_rules": "Compares ExpectsOrder Holds Passes PathEnd PathRule Sends Signs",
            "skyrange.detect.bases": "MessageDetector ReceptionDetector ScoreDetector TelemetryDetector",
            "skyrange.detect.declaration": "Detector detector",
            "skyrange.detect.messages": "ObservedMessages read_messages",
            "skyrange.detect.receptions": "ObservedReceptions read_receptions",
            "skyrange.detect.series": "Series Steps series",
            "skyrange.detect.streams": "table",
            "skyrange.fault.bases": "OnBodies",
            "skyrange.fault.contract": "FaultContext FaultParts fault",
            "skyrange.radio.builtin.params": "RadioEnvironment",
            "skyrange.radio.contract": "MediumContext MediumPlugin",
            "skyrange.radio.external.medium": "ExternalMedium",
            "skyrange.utm.approval_service": "FlightApproval policy_plugin",
            "skyrange.utm.contract": (
                "Alternative ApprovalContext ApprovalDecision ApprovalPlugin ApprovalPolicy "
                "ApprovalService OperationalIntent intent_id"
            ),
            "skyrange.utm.messages": (
                "Request=ApprovalRequest Response=ApprovalResponse decode_request=decode_approval_request "
                "decode_response=decode_approval_response encode=encode_approval"
            ),
            "skyrange.utm.request_book": "RequestOrder RequestQueue WaitingRequest",
            "skyrange.vehicle.avoidance.contract": (
                "Avoidance AvoidanceAction AvoidanceContext AvoidanceDecision AvoidanceLimits "
                "AvoidancePlugin Episode Own Tracks"
            ),
            "skyrange.vehicle.contract": "AutopilotContext AutopilotPlugin VehicleSpec",
            "skyrange.world.airframes": "AIRFRAMES Airframe",
        },
    )


def __dir__() -> list[str]:
    return sorted(__all__)
