"""Learning agents: PettingZoo and Gymnasium environments over runs, with the acts, rewards and baselines of one task.

What is exported here is public; the modules that it comes from are private and may change. It needs
`pip install 'skyrange[env]'`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from skyrange.core.lazy_exports import export_lazily

if TYPE_CHECKING:
    from skyrange.env.acts import BlueAct, RedAct
    from skyrange.env.hold_the_mission import HoldTheMission
    from skyrange.env.observations import FEATURES, Feature
    from skyrange.env.observations import describe as describe_observation
    from skyrange.env.outcomes import Rewards
    from skyrange.env.policies import Quiet, RandomPolicy, ScriptedBlue, ScriptedRed, play
    from skyrange.env.task import StepResult, make_scenario
    from skyrange.env.vector import HoldTheMissionVector
    from skyrange.env.worlds import HoldTheMissionWorlds

__all__ = [
    "FEATURES",
    "BlueAct",
    "Feature",
    "HoldTheMission",
    "HoldTheMissionVector",
    "HoldTheMissionWorlds",
    "Quiet",
    "RandomPolicy",
    "RedAct",
    "Rewards",
    "ScriptedBlue",
    "ScriptedRed",
    "StepResult",
    "describe_observation",
    "make_scenario",
    "play",
]

if not TYPE_CHECKING:
    __getattr__ = export_lazily(
        __name__,
        {
            "skyrange.env.acts": "BlueAct RedAct",
            "skyrange.env.hold_the_mission": "HoldTheMission",
            "skyrange.env.observations": "FEATURES Feature describe=describe_observation",
            "skyrange.env.outcomes": "Rewards",
            "skyrange.env.policies": "Quiet RandomPolicy ScriptedBlue ScriptedRed play",
            "skyrange.env.task": "StepResult make_scenario",
            "skyrange.env.vector": "HoldTheMissionVector",
            "skyrange.env.worlds": "HoldTheMissionWorlds",
        },
    )


def __dir__() -> list[str]:
    return sorted(__all__)
