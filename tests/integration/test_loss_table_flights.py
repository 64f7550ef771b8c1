"""Runs on a loss table: signal strengths are those of the table, the city's where it ends, and the record says so."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pytest

from skyrange.assembly.build import build
from skyrange.assembly.city import build_city
from skyrange.contracts.medium import RadioSpec, TxBatch, Waveform
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.radio.builtin.listening import SNIFFER
from skyrange.radio.builtin.medium import BuiltinMedium, fixed_positions
from skyrange.radio.builtin.params import RadioEnvironment
from skyrange.radio.propagation.loss_table import NO_TABLE
from skyrange.radio_map.mapping import MapLayout
from skyrange.record import load as load_run
from skyrange.record.read.run import RunRecord
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import load_file, load_text
from skyrange.study.runs import fly
from tests.loss_tables import make_table

pytestmark = pytest.mark.rotating

SCENARIO = """
name = "tabled"
duration_s = 30
origin = [42.0, -71.0]
city.grid = { blocks = [2, 2], height_m = [20, 30] }
record = { truth_hz = 5 }
[radio]
chance = false
RADIO
[[radio.receivers]]
id = "mast"
operator = "blue"
place = [0, 0, 6]
[[operators]]
id = "blue"
[[operators.vehicles]]
id = "b1"
start = [0, -30]
remote_id = { transports = ["wifi_beacon"] }
plan.square = { side_m = 30, alt_m = 20 }
"""
MAST = (0.0, 0.0, 6.0)


def scenario(radio: str = "") -> Scenario:
    return load_text(SCENARIO.replace("RADIO", radio))


def table(path: Path, excess_db: float) -> Scenario:
    """The scenario on a table of a constant excess, which covers it whole."""
    city = build_city(scenario())
    assert city is not None
    layout = MapLayout((-150.0, -150.0, 150.0, 150.0), 20.0, (2.0, 60.0), 400.0)
    make_table(path, city, layout, [MAST], excess_db)
    return scenario(f'losses = "table"\ntable = "{path}"')


def levels(run: RunRecord) -> dict[int, float]:
    """Signal strength at the mast by time of reception."""
    rows = run.table("receptions").filter(pc.field("receiver") == "mast")
    return dict(zip(rows["time_ns"].to_pylist(), rows["rssi_dbm"].to_pylist(), strict=True))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[float, RunRecord]:
    folder = tmp_path_factory.mktemp("tabled")
    return {
        excess: fly(table(folder / f"{excess:g}.parquet", excess), folder / f"run-{excess:g}", report=excess == 0.0)
        for excess in (0.0, 12.5)
    }


def test_signals_weaken_by_what_the_table_adds(runs: dict[float, RunRecord]) -> None:
    near, far = levels(runs[0.0]), levels(runs[12.5])
    assert len(near) >= 20
    assert near.keys() == far.keys()
    for when, level in near.items():
        assert level - far[when] == pytest.approx(12.5, abs=0.01)


def test_the_record_holds_the_table_and_repeats_the_run(runs: dict[float, RunRecord], tmp_path: Path) -> None:
    run = runs[12.5]
    told = run.manifest["loss_table"]
    assert told["tracer"] == {"name": "free space", "version": "1"}
    assert len(told["sha256"]) == 64
    again = load_file(run.path / "scenario.toml")
    assert again.radio is not None
    assert again.radio.table == str(run.path / "radio" / "losses.parquet")
    repeated = fly(again, tmp_path / "again", report=False)
    assert levels(repeated) == levels(run)


def test_the_report_shows_the_map_and_its_coverage(runs: dict[float, RunRecord]) -> None:
    page = (runs[0.0].path / "report.html").read_text()
    assert "Radio coverage" in page
    assert "free space 1" in page
    assert "Loss from [0, 0, 6] m" in page
    assert "<th scope=row>mast</th><td class=num>100%</td>" in page


def test_a_run_on_the_city_has_no_such_section(tmp_path: Path) -> None:
    run = fly(scenario(), tmp_path / "plain", report=True)
    assert "loss_table" not in run.manifest
    assert not (run.path / "radio").exists()
    assert "Radio coverage" not in (run.path / "report.html").read_text()
    assert load_run(run.path).manifest.get("name") == "tabled"


def refusal(**changes: str) -> str:
    given = "\n".join(f"{key} = {json.dumps(value)}" for key, value in changes.items())
    try:
        build(scenario(given))
    except InputError as error:
        return str(error)
    pytest.fail("not refused")


def test_tables_that_do_not_fit_are_refused_before_the_run(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    fitting = table(path, 0.0)
    assert fitting.radio is not None
    assert "a file that exists" in refusal(losses="table", table=str(tmp_path / "none"))
    assert "because losses is table" in refusal(losses="table")
    assert "no file, because losses is city" in refusal(table=str(path))
    (tmp_path / "cut").write_bytes(path.read_bytes()[:-100])
    assert "undamaged" in refusal(losses="table", table=str(tmp_path / "cut"))
    with pytest.raises(InputError, match="a table of this scenario's buildings"):
        build(load_text(SCENARIO.replace("[20, 30]", "[20, 31]").replace("RADIO", f'losses="table"\ntable="{path}"')))
    without = SCENARIO.replace("city.grid", "#").replace("RADIO", f'losses="table"\ntable="{path}"')
    with pytest.raises(InputError, match="a scenario with buildings"):
        build(load_text(without))


def heard(medium: BuiltinMedium, sender: int) -> dict[str, float]:
    """The radios that decode a frame of one of them, with its strength."""
    one = np.array([sender])
    none = np.full(1, np.nan)
    medium.advance(-1, fixed_positions(medium.radios))
    medium.offer(
        0, TxBatch(one, np.zeros(1, np.int64), np.array([Waveform.OFDM_6M]), np.array([6]), none, np.array([100]), one)
    )
    told = medium.advance(NS_PER_S, fixed_positions(medium.radios)).heard
    return {medium.radios[int(row)].name: float(level) for row, level in zip(told.radio, told.rssi_dbm, strict=True)}


def test_the_city_decides_where_the_table_ends(tmp_path: Path) -> None:
    whole = scenario()
    city = build_city(whole)
    assert city is not None
    content = make_table(tmp_path / "t", city, MapLayout((-50, -50, 50, 50), 10.0, (2.0, 60.0), 40.0), [MAST], 7.0)
    specs = [
        RadioSpec("a", MAST),
        RadioSpec("b", (0.0, 40.0, 20.0), SNIFFER),
        RadioSpec("c", (0.0, 90.0, 20.0), SNIFFER),
    ]
    still = RadioEnvironment(chance=False)
    with_table, without = (
        BuiltinMedium(specs, Chance(1), city, still, table=each) for each in (content.table, NO_TABLE)
    )
    tabled, plain = heard(with_table, 0), heard(without, 0)
    assert plain["b"] - tabled["b"] == pytest.approx(7.0, abs=0.01)
    assert tabled["c"] == plain["c"]
    assert with_table.table_lookups.tolist() == [1, 1]
    assert without.table_lookups.tolist() == [0, 0]


def test_a_table_may_carry_signals_beyond_free_space(tmp_path: Path) -> None:
    city = build_city(scenario())
    assert city is not None
    layout = MapLayout((-50.0, -1500.0, 50.0, 50.0), 50.0, (2.0, 60.0), 4000.0)
    content = make_table(tmp_path / "t", city, layout, [MAST], -15.0)
    specs = [RadioSpec("a", MAST, wifi_dbm=-5.0), RadioSpec("b", (0.0, -900.0, 20.0), SNIFFER)]
    still = RadioEnvironment(chance=False)
    media = [BuiltinMedium(specs, Chance(1), city, still, table=each) for each in (NO_TABLE, content.table)]
    assert [sorted(heard(medium, 0)) for medium in media] == [[], ["b"]]
