"""Report of a run: one self-contained file with what the record says, for complete, killed and hostile records."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jinja2 import UndefinedError

from skyrange.report import write_report
from skyrange.report.rendering import environment
from tests.unit.study_sample import SampleRun, fleet_of, fly, small_city, squares

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


def data_of(text: str) -> dict[str, Any]:
    data: dict[str, Any] = json.loads(find_group(r'<script type="application/json" id="run">(.*?)</script>', text))
    return data


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
    assert all(str(target)[1:] in page.ids for target in targets)


def test_nothing_is_fetched(text: str) -> None:
    page = Page(text)
    assert not [attrs for _, attrs in page.elements if "src" in attrs]
    assert not [tag for tag, _ in page.elements if tag in ("link", "img", "iframe", "object", "embed", "base")]
    addresses = set(re.findall(r"https?://[^\s\"'<>)]+", text))
    assert addresses == {"http://www.w3.org/2000/svg"}  # a name, not an address
    assert not re.search(r"@import|url\(|fetch\(|XMLHttpRequest|WebSocket|import\(|eval\(|innerHTML", text)


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
    assert len(data["buildings"]["h"]) == 6
    court = next(rings for rings in data["buildings"]["r"] if len(rings) == 2)
    assert np.cumsum(np.array(court[0]).reshape(-1, 2), axis=0).tolist() == [
        [-140, -380],
        [80, -380],
        [80, -270],
        [-140, -270],
    ]


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
    record.path = tmp_path / "</code><b>"
    text = written(record, tmp_path)
    page = Page(text)
    assert sum(tag == "script" for tag, _ in page.elements) == 2
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
def test_a_hundred_aircraft_over_a_city_stay_under_five_megabytes(tmp_path: Path) -> None:
    block = small_city()
    city = [
        {**b, "rings": [[[e + 100 * i, n + 100 * j] for e, n in ring] for ring in b["rings"]]}
        for i in range(-20, 20) for j in range(-20, 20) for b in block
    ]  # fmt: skip
    record = fly(tmp_path, fleet_of(100, 4), {f"op{k}": "" for k in range(4)}, city, seconds=120, rate_hz=4)
    text = written(record, tmp_path)
    assert len(text.encode()) < 5_000_000
    data = data_of(text)
    assert len(data["vehicles"]) == 100
    assert all(len(v["truth"]["t"]) > 5 for v in data["vehicles"])


def test_what_is_left_out_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skyrange.report.run.contents.MAX_TRUTH_POINTS", 50)
    monkeypatch.setattr("skyrange.report.run.contents.MAX_CITY_VERTICES", 10)
    page = Page(written(squares(tmp_path), tmp_path))
    assert "of 6 buildings" in page.text
    assert "samples of tracks" in page.text


def test_long_tables_are_cut_and_say_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skyrange.report.run.timeline.MAX_ROWS", 7)
    page = Page(written(squares(tmp_path), tmp_path))
    assert "The first 7 of 60" in page.text
    assert sum("data-t" in attrs for _, attrs in page.elements) == 14  # events and decisions


def test_an_unwritable_place_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(OSError):
        write_report(squares(tmp_path), tmp_path / "missing" / "report.html")
    (tmp_path / "taken").mkdir()
    with pytest.raises(OSError):
        write_report(squares(tmp_path), tmp_path / "taken")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
