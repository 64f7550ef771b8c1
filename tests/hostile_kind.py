"""An attack on links that every range has: it orders aircraft home over `gcs`. For tests of the framework alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.attack.radio import check_vehicle
from skyrange.codec.mavlink import Packer, dialect
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Schedule, TapPlacement
from skyrange.contracts.params import Number, Params
from skyrange.contracts.verdicts import Inject, Verdict
from skyrange.core.ids import endpoint, operator_of
from skyrange.core.time import NS_PER_S, Time, from_seconds
from tests.registered_kinds import registered

KIND = "test.homeward"


class Homeward(Params):
    """Orders an aircraft to return to launch."""

    vehicle: str = Field(description="Which.")
    every_s: Number = Field(default=1.0, gt=0, description="Time from order to order in seconds.")


@dataclass(slots=True)
class Orders:
    """Injects `RTL`, or in the sham a message that asks for nothing, towards the aircraft."""

    src: str
    dst: str
    period_ns: Time
    sham: bool
    schedule: Schedule
    packer: Packer
    turn: int = 0

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return ()

    def next_wakeup(self) -> Time | None:
        return self.turn * self.period_ns

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        self.turn = now // self.period_ns + 1
        command = 0 if self.sham else dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH
        order = dialect.MAVLink_command_long_message(1, 1, command, 0, 0, 0, 0, 0, 0, 0, 0)
        return [Inject(self.packer.pack(order), "fwd", self.src, self.dst)]


@dataclass(frozen=True, slots=True)
class _Make:
    orders: tuple[str, str, Time, bool]
    schedule: Schedule

    def __call__(self, link: str) -> Orders:
        return Orders(*self.orders, self.schedule, Packer(255, 190))


def make(params: Homeward, context: AttackContext) -> Attack:
    check_vehicle(context, "vehicle", params.vehicle)
    src, dst = endpoint(operator_of(params.vehicle), "gcs"), endpoint(params.vehicle, "companion")
    orders = (src, dst, from_seconds(params.every_s), context.sham)
    return Attack(taps=[TapPlacement(f"gcs:{params.vehicle}", "companion", _Make(orders, context.schedule))])


HOMEWARD = AttackPlugin(Homeward, make, "Orders an aircraft home.", technique="T0855")


@contextmanager
def offered() -> Iterator[None]:
    """The kind is registered inside."""
    with registered((KIND, HOMEWARD)):
        yield


def scenario(start_s: float = 12.0, duration_s: float = 40.0) -> str:
    """TOML: two aircraft fly squares, one of them is ordered home."""
    return f"""
name = "homeward"
seed = 4
duration_s = {duration_s}
origin = [40.778, -73.955]
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan.square = {{ side_m = 20, alt_m = 10 }}
  [[operators.vehicles]]
  id = "b2"
  start = [60, 0]
  plan.square = {{ side_m = 20, alt_m = 10 }}
[[attacks]]
id = "home"
kind = "{KIND}"
start_s = {start_s}
for_s = 3
params.vehicle = "blue/b1"
"""


ONCE_NS = NS_PER_S
