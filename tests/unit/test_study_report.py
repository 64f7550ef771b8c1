"""Report of a run: one self-contained file with what the record says, for complete, killed and hostile records."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import zlib
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from jinja2 import UndefinedError

from skyrange.report import write_report
from skyrange.report.rendering import environment
from skyrange.view.inline import viewer_script
from skyrange.view.stream.messages import Message, decode_file
from skyrange.view.stream.recorded import THINNED, RecordedArms
from skyrange.view.stream.scene import ArmRecord
from tests.unit.study_sample import SampleRun, fleet_of, fly, small_city, squares

pytestmark = pytest.mark.rotating

VOID = {"meta", "input", "br", "img", "link", "hr"}


class Page(HTMLParser):
    """Tags balanced, ids once, every element's attributes at hand."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self.ids += [value for key, value in attrs if key == "id" and value]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] not in ("script", "style"):
            self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", "".join(self.words))


def written(record: SampleRun, folder: Path) -> str:
    path = write_report(record, folder / "report.html")
    assert path == folder / "report.html"
    assert list(folder.glob("*.part")) == []
    return path.read_text(encoding="utf-8")


def find_group(pattern: str, text: str) -> str:
    match = re.search(pattern, text, re.S)
    assert match is not None
    return str(match[1])


def unpack(packed: str) -> str:
    return zlib.decompress(base64.b64decode(packed)).decode()


def data_of(text: str) -> dict[str, Any]:
    packed = find_group(r'<script type="application/octet-stream" id="run">(.*?)</script>', text)
    data: dict[str, Any] = json.loads(unpack(packed))
    return data


def stream_of(text: str) -> list[Message]:
    found = find_group(r'<script type="application/octet-stream" id="viewer-stream">(.*?)</script>', text)
    return list(decode_file(base64.b64decode(found)))


@pytest.fixture(scope="module")
def text(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("report")
    return written(squares(folder, hostile=True), folder)


def test_the_page_is_well_formed_and_says_the_run(text: str) -> None:
    page = Page(text)
    assert len(page.ids) == len(set(page.ids))
    for words in ("squares", "5 of 5 missions complete", "9f2c51d0a7e44b6c", "blue/b1", "hostile act", "31.6"):
        assert words in page.text
    assert page.text.count("mission flown, landed, disarmed") == 5
    sections = {attrs["id"] for tag, attrs in page.elements if tag == "section"}
    assert {"scene", "missions", "operators", "paths", "belief", "timeline", "links", "log", "data"} <= sections
    assert sum("panel" in (attrs.get("class") or "") for tag, attrs in page.elements if tag == "figure") == 2


def test_links_within_the_page_have_their_targets(text: str) -> None:
    page = Page(text)
    targets = [attrs["href"] for tag, attrs in page.elements if tag == "a"]
    assert targets
    moments = [str(target) for target in targets if str(target).startswith("#t=")]
    assert all(str(target)[1:] in page.ids for target in targets if target not in moments)
    assert len(moments) == 72 + 15, "a link for each event, act and decision"
    start_s, end_s = (stream_of(text)[0].head[key] for key in ("start_s", "end_s"))
    assert all(start_s <= float(moment[3:].partition("&")[0]) <= end_s for moment in moments)
    assert {moment.partition("&select=")[2] for moment in moments} == {
        vehicle["id"] for vehicle in data_of(text)["vehicles"]
    }


def test_nothing_is_fetched(text: str) -> None:
    page = Page(text)
    assert not [attrs for _, attrs in page.elements if "src" in attrs]
    assert not [tag for tag, _ in page.elements if tag in ("link", "img", "iframe", "object", "embed", "base")]
    addresses = set(re.findall(r"https?://[^\s\"'<>)]+", text))
    assert addresses == {"http://www.w3.org/2000/svg"}  # a name, not an address
    own = text.replace(viewer_script(), "")
    assert own != text
    assert not re.search(r"@import|url\(|fetch\(|XMLHttpRequest|WebSocket|import\(|eval\(|innerHTML", own)


def test_the_policy_seals_this_very_style_and_script(text: str) -> None:
    policy = html.unescape(find_group(r'Content-Security-Policy" content="([^"]*)"', text))
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy
    for tag in ("style", "script"):
        body = find_group(rf"<{tag}>(.*?)</{tag}>", text)
        digest = base64.b64encode(hashlib.sha256(body.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy
    assert not [attrs for _, attrs in Page(text).elements if "style" in attrs]  # it would be refused
    assert not [key for _, attrs in Page(text).elements for key in attrs if key.startswith("on")]


def test_the_scene_gets_the_tracks_as_they_were(text: str, tmp_path: Path) -> None:
    data = data_of(text)
    assert [v["id"] for v in data["vehicles"]] == ["blue/b1", "blue/b2", "green/g1", "green/g2", "green/g3"]
    assert [o["id"] for o in data["operators"]] == ["blue", "green"]
    record = squares(tmp_path)
    rows = [row for row in record._rows["truth"] if row["vehicle"] == "green/g3"]
    packed = data["vehicles"][4]["truth"]
    t, n = np.cumsum(packed["t"]) / 100, np.cumsum(packed["n"]) / 100
    at = [row for row in rows if row["time_ns"] * 1e-9 <= data["end"]]
    drawn = np.interp([row["time_ns"] * 1e-9 for row in at], t, n)
    assert (
        np.abs(drawn - [row["north_m"] for row in at]).max() < 0.04
    )  # 2 cm of thinning, 1 cm of rounding, 1 cs of time


def test_the_viewer_gets_the_flight_and_a_sentence(text: str) -> None:
    scene, *others = stream_of(text)
    assert scene.head["verdict"] == "5 of 5 missions complete; no collision, crash or failsafe, 12 hostile acts."
    assert scene.head["arms"][0]["missions"] == [5, 5]
    assert [vehicle["id"] for vehicle in scene.head["vehicles"]] == [v["id"] for v in data_of(text)["vehicles"]]
    assert len(scene.arrays["heights"]) == 6
    assert {message.head.get("layer") for message in others} == {None, "truth", "station"}


def test_the_clock_stops_when_all_is_calm(text: str) -> None:
    assert data_of(text)["end"] == pytest.approx(40.7, abs=0.5)  # the last outcome at 37.2 s, a little later
    assert "the clock of this page stops before" in Page(text).text


def test_statistics_of_the_links_stand_in_the_table(text: str) -> None:
    said = Page(text).text
    assert "companion → gcs" in said
    assert "8 links" in said  # blue's
    assert "12 links" in said  # green's


@pytest.mark.parametrize("status", ["running", "interrupted", "failed"])
def test_a_run_that_did_not_complete_says_so(status: str, tmp_path: Path) -> None:
    page = Page(written(squares(tmp_path, status=status, seconds=15), tmp_path))
    banners = [attrs for _, attrs in page.elements if attrs.get("class") == "banner"]
    assert len(banners) == 1
    assert banners[0]["role"] == "alert"
    assert "0 of 5 missions complete" in page.text
    assert page.text.count("unfinished") == 5


def test_a_complete_run_has_no_banner(text: str) -> None:
    assert 'class="banner"' not in text


@pytest.mark.parametrize(
    "manifest",
    [
        {},
        {"name": "empty", "status": "complete", "vehicles": [], "operators": []},
        {"name": "named", "status": "running", "operators": [{"id": "a"}], "vehicles": [{"id": "a/x"}], "links": []},
    ],
)
def test_empty_tables_make_a_page(manifest: dict[str, Any], tmp_path: Path) -> None:
    page = Page(written(SampleRun(tmp_path, manifest, [], {}), tmp_path))
    assert "No link is on record" in page.text
    assert "No event is on record" in page.text


def test_one_aircraft_is_enough(tmp_path: Path) -> None:
    record = fly(tmp_path, {"solo/s1": ((0, 0), 5.0, 5.0)}, {"solo": ""}, [], seconds=30)
    assert "1 of 1 missions complete" in Page(written(record, tmp_path)).text


def test_hostile_names_stay_text(tmp_path: Path) -> None:
    record = fly(tmp_path, {"a/x": ((0, 0), 3.0, 4.0)}, {"a": '"><img src=x onerror=alert(1)>'}, [], seconds=20)
    attack = "</script><script>alert(1)</script><!--\u2028'\"&"
    record.manifest["name"] = attack
    record.manifest["seed"] = attack
    record.manifest["versions"] = {attack: attack}
    record.manifest["vehicles"][0] |= {"airframe": attack, "plan": attack}
    record.manifest["outcomes"]["a/x"] = {"state": attack, "reason": attack, "finished_s": 1}
    record.manifest["links"].append({"name": f"{attack}:a/x", "a": attack, "b": attack})
    record.manifest["digests"] = {attack: attack, "fingerprint": attack}
    for row in record._rows["events"]:
        row["kind"] = row["source"] = attack
        row["data"] = json.dumps({attack: attack})
        row["causes"] = [attack]
    record.move(tmp_path / "</code><b>")
    text = written(record, tmp_path)
    page = Page(text)
    assert sum(tag == "script" for tag, _ in page.elements) == 3
    assert not [1 for tag, _ in page.elements if tag in ("img", "b") and "onerror" in _]
    assert attack.replace("\u2028", " ")[:30] in page.text
    data_of(text)


def test_templates_escape_what_they_are_given_and_miss_nothing() -> None:
    given = environment().from_string("<b title='{{ value }}'>{{ value }}</b>").render(value="'><i>")
    assert given == "<b title='&#39;&gt;&lt;i&gt;'>&#39;&gt;&lt;i&gt;</b>"
    with pytest.raises(UndefinedError):
        environment().from_string("{{ nothing }}").render()
    names = environment().list_templates()
    assert "run/page.html.jinja" in names
    for name in names:
        source, *_ = environment().loader.get_source(environment(), name)  # type: ignore[union-attr]
        assert not re.search(r"\|\s*safe\b|autoescape", source), name


def test_embedded_json_cannot_close_its_element() -> None:
    value = {"a": "</script><!-- & \u2028\u2029", "b": [1, -2.5, None]}
    element = environment().from_string("{{ value|tojson }}")
    text = element.render(value=value)
    assert not set("<>&\u2028\u2029") & set(text)
    assert json.loads(text) == value
    with pytest.raises(ValueError):
        element.render(value=float("nan"))


@pytest.mark.slow
def test_five_hundred_aircraft_over_a_city_stay_under_three_megabytes(tmp_path: Path) -> None:
    block = small_city()
    city = [
        {**b, "rings": [[[e + 100 * i, n + 100 * j] for e, n in ring] for ring in b["rings"]]}
        for i in range(-20, 20) for j in range(-20, 20) for b in block
    ]  # fmt: skip
    record = fly(tmp_path, fleet_of(500, 10), {f"op{k}": "" for k in range(10)}, city, seconds=120, rate_hz=4)
    text = written(record, tmp_path)
    assert len(text.encode()) <= 3_000_000
    assert all(len(v["truth"]["t"]) > 5 for v in data_of(text)["vehicles"])
    scene = stream_of(text)[0]
    assert len(scene.head["vehicles"]) == 500
    assert len(Page(text).elements) < 15_000


def test_what_is_left_out_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skyrange.report.run.contents.MAX_TRUTH_POINTS", 50)
    page = Page(written(squares(tmp_path), tmp_path))
    assert "samples of tracks" in page.text


@given(st.floats(0.0, 1.2))
@example(0.0)
@settings(deadline=None)
def test_a_stream_is_thinned_before_it_is_left_out_and_says_what_is_missing(part: float) -> None:
    arms = sample_arms()
    whole = arms.encode()
    stream = arms.encode_within(int(part * len(whole)))
    if stream is None:
        assert int(part * len(whole)) < len(arms.encode(THINNED[-1]))
        return
    assert len(stream) <= part * len(whole)
    scene, *messages = decode_file(stream)
    said = scene.head["left_out"]
    positions = [message for message in messages if message.kind == "P"]
    layers, steps = ({message.head[key] for message in positions} for key in ("layer", "step_s"))
    assert ("station" in layers) == (said.get("layers of positions", [3, 3])[0] > 1)
    assert said.get("positions a second", [5.0, 5.0]) == [1.0 / steps.pop(), 5.0]
    assert (stream == whole) == (not said)


@cache
def sample_arms() -> RecordedArms:
    return RecordedArms([ArmRecord("run", "squares", squares(Path("squares")))], name="squares")


def test_a_flight_that_is_too_long_for_the_page_names_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skyrange.report.viewer.MAX_STREAM_BYTES", 100)
    text = written(squares(tmp_path), tmp_path)
    assert f"skyrange watch {tmp_path}" in Page(text).text
    assert "viewer-stream" not in text
    assert "5 of 5 missions complete; no collision" in Page(text).text


@pytest.mark.parametrize("operators", [1, 7])
def test_rows_beyond_the_first_are_packed_and_none_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, operators: int
) -> None:
    monkeypatch.setattr("skyrange.report.rendering.MAX_ROWS_READY", 10_000)
    monkeypatch.setattr("skyrange.report.rendering.MAX_ROWS_WHOLE", 10_000)
    record = fly(tmp_path, fleet_of(20, operators), {f"op{k}": "" for k in range(operators)}, [], seconds=20, rate_hz=4)
    whole = written(record, tmp_path)
    monkeypatch.setattr("skyrange.report.rendering.MAX_ROWS_READY", 3)
    monkeypatch.setattr("skyrange.report.rendering.MAX_ROWS_WHOLE", 3)
    folded = written(record, tmp_path)
    assert len(REST.findall(folded)) > 4
    assert len(folded) < len(whole)
    assert folded.count("<tr") < whole.count("<tr") / 2
    assert rows_of(folded) == rows_of(whole)


REST = re.compile(
    r'<p class="note more".*?</p><script type="application/octet-stream" class="rest">(.*?)</script>', re.S
)
ROW = re.compile(r"<tr .*?</tr>|<tr>.*?</tr>|<div class=.lane.*?</svg></div>", re.S)


def rows_of(text: str) -> list[str]:
    """The rows of all tables and lanes, those that are packed as well."""
    packed = [row for part in REST.findall(text) for row in ROW.findall(unpack(part))]
    return sorted([*ROW.findall(REST.sub("", text)), *packed])


def test_long_tables_are_cut_and_say_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skyrange.report.run.timeline.MAX_ROWS", 7)
    page = Page(written(squares(tmp_path), tmp_path))
    assert "The first 7 of 60" in page.text
    assert sum((attrs.get("href") or "").startswith("#t=") for _, attrs in page.elements) == 14  # events and decisions


def test_an_unwritable_place_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(OSError):
        write_report(squares(tmp_path), tmp_path / "missing" / "report.html")
    (tmp_path / "taken").mkdir()
    with pytest.raises(OSError):
        write_report(squares(tmp_path), tmp_path / "taken")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
