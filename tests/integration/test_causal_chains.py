"""Chains from attacks on links: a mission of which one item was altered, and a link that was cut."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.codec.mavlink import Packer, decode, dialect
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.params import Params
from skyrange.contracts.verdicts import Drop, Replace, Verdict
from skyrange.core.time import Time
from skyrange.scenario.toml_files import load_text
from skyrange.study.pairing import pair
from skyrange.twins.pair_folder import Pair
from tests.registered_kinds import registered

pytestmark = pytest.mark.rotating

FLEET = """
name = "chains"
seed = 4
duration_s = 34
origin = [47.3977, 8.5456]

[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  params = { FS_GCS_ENABLE = 1 }
  plan = { path = { points = [[0, 20], [0, 40], [0, 60]], alt_m = 8 }, speed_mps = 4 }
"""
EAST_E7 = 4_000
"""Longitude, in 1e-7 degrees, by which an item is moved: 30 m here."""


class OnLink(Params):
    """Acts on the link between a ground station and an aircraft."""

    vehicle: str = Field(default="blue/b1", description="The aircraft.")


@dataclass(slots=True)
class ItemMover:
    """Moves an item of a mission eastwards, and back when it is read; the sham sends it as it was."""

    sham: bool

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        message = decode(frame.payload)
        if not isinstance(message, dialect.MAVLink_mission_item_int_message) or message.seq != 3:
            return ()
        moved, forward = copy(message), frame.direction == "fwd"
        if not self.sham:
            moved.y += EAST_E7 if forward else -EAST_E7  # what is read back looks as it was sent
        return [Replace(Packer(*((255, 190) if forward else (1, 1))).pack(moved))]

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        return ()


class Cutter:
    """Drops everything."""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return [Drop()]

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        return ()


@dataclass(frozen=True, slots=True)
class MakeTap:
    """Makes the tap of a link."""

    cuts: bool
    sham: bool

    def __call__(self, link: str) -> Any:
        return Cutter() if self.cuts else ItemMover(self.sham)


def move(params: OnLink, context: AttackContext) -> Attack:
    return Attack(taps=[TapPlacement(f"gcs:{params.vehicle}", "gcs", MakeTap(False, context.sham))])


def cut(params: OnLink, context: AttackContext) -> Attack:
    return Attack(taps=[TapPlacement(f"gcs:{params.vehicle}", "gcs", MakeTap(True, context.sham))])


@pytest.fixture(scope="module", autouse=True)
def kinds() -> Iterator[None]:
    offered = (
        ("test.move", AttackPlugin(OnLink, move, "Moves a mission item.")),
        ("test.cut", AttackPlugin(OnLink, cut, "Cuts a link.", counterfactual="mute")),
    )
    with registered(*offered):
        yield


def flown(folder: Path, attacks: str) -> tuple[Pair, list[dict[str, Any]]]:
    made = pair(load_text(FLEET + attacks), folder, jobs=1)
    return made, made.propagation.to_pylist()


def test_a_mission_keeps_the_contributor_of_each_of_its_items(tmp_path: Path) -> None:
    made, rows = flown(tmp_path / "pair", '[[attacks]]\nid = "mover"\nkind = "test.move"\n')
    label = made.run("attacked").table("labels").to_pylist()[0]
    assert label["action"] == "replace"
    (mission,) = (row for row in rows if row["kind"] == "event.mission")
    assert (mission["attack"], mission["way"]) == ("mover", "frame"), "its last frame was not altered"
    reached = [json.loads(row["data"])["seq"] for row in rows if row["kind"] == "event.item_reached"]
    assert 3 in reached
    (effect,) = (row for row in rows if row["phase"] == "effect")
    assert (effect["attack"], effect["relation"], effect["path"]) == ("mover", "both", True)
    assert effect["departure_m"] == pytest.approx(30.0, abs=3.0)


def test_a_cut_link_leads_to_what_follows_from_silence(tmp_path: Path) -> None:
    made, rows = flown(tmp_path / "pair", '[[attacks]]\nid = "cutter"\nkind = "test.cut"\nstart_s = 15\n')
    assert made.arms == ["nominal", "attacked"]
    silent = {row["kind"]: row for row in rows if row["way"] == "link"}
    lost = silent["decision.link_lost"]
    assert lost["vehicle"] == "blue/b1"
    assert lost["origin"].startswith("gcs:blue/b1|"), "the frame that would have come"
    (effect,) = (row for row in rows if row["phase"] == "effect")
    assert (effect["attack"], effect["relation"], effect["path"]) == ("cutter", "both", True)
    failsafe = silent["event.mode"]
    assert json.loads(failsafe["data"])["reason"] == "gcs_failsafe"
