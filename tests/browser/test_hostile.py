"""Hostile text in reports stays text: from a scenario as far as its schema admits it, and from a record everywhere."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skyrange.report import write_report
from skyrange.report.pair.page import write_comparison
from skyrange.scenario.toml_files import load_file
from skyrange.study.runs import fly
from skyrange.twins.pair_folder import EFFECTS, PROPAGATION, Pair, load_pair
from tests.browser.chromium import Opened, missing, visit
from tests.unit.study_sample import SampleRun, squares

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.external(missing=missing())

BREAKOUTS = (
    "<img src=x onerror=hacked()>",
    "<script>hacked()</script>",
    '"><svg onload=hacked()>',
    "' onmouseover='hacked()' x='",
    "</title></text></svg><iframe srcdoc='<script>parent.hacked()</script>'>",
    "</script><script>hacked()</script>",
    "</style><style>*{display:none}</style>",
    "<!--<script>",
    "]]><base href=//evil.example/>",
    "{{ 7 * 7 }}{% for x in y %}",
    "${hacked()}",
    "javascript:hacked()",
    "&lt;img src=x onerror=hacked()&gt;",
    "\u2028hacked()//\u2029",
    "\x1b[31m\x00\x07",
)
"""Ways out of an element, an attribute, a comment, a script, a style and a template."""

EVIL = "".join(BREAKOUTS)
HARMLESS = re.sub(r"[^\w/.:| ]", "_", EVIL)
"""The same without what could do harm."""
COUNTED = "script, style, svg, iframe, img, base, link, object, embed, form, meta, a, [src], [href], [style]"
"""What a way out would add to a page."""


def count_elements(opened: Opened) -> Mapping[str, Any]:
    """Counts of elements and handlers, which are the same for hostile and harmless text."""
    counts: Mapping[str, Any] = opened.page.evaluate(
        """(counted) => ({
          elements: document.querySelectorAll(counted).length,
          handlers: [...document.querySelectorAll("*")]
            .flatMap((e) => [...e.attributes]).filter((a) => a.name.startsWith("on")).length,
          comments: document.createTreeWalker(document, NodeFilter.SHOW_COMMENT).nextNode() !== null,
        })""",
        COUNTED,
    )
    return counts


@contextmanager
def exercised(browser: Browser, path: Path) -> Iterator[Opened]:
    """Open a page that would notice `hacked()`, move over all of it that answers to the mouse, and check it."""
    opened = visit(browser, path, script="window.hacked = () => { throw new Error('hacked') };")
    page = opened.page
    assert page.locator("main").is_visible()
    yield opened
    page.evaluate(
        """() => {
          for (const part of document.querySelectorAll("tr[data-v], .lane, .lane-marks g, .lane-marks rect, .sky-chip"))
            for (const name of ["pointerenter", "pointermove", "pointerleave"])
              part.dispatchEvent(new PointerEvent(name, { bubbles: name === "pointermove" }));
        }"""
    )
    for box in page.locator(".filter input").all():
        box.fill("<img")
    if page.locator(".sky-stage").count():
        page.locator(".sky-stage").focus()
        page.keyboard.press("n")
        opened.settle()
        assert page.locator(".sky-panel .sky-name").last.inner_text() != "Aircraft"
    opened.settle()
    assert opened.messages == []
    assert opened.dialogs == []
    assert opened.requests == [path.resolve().as_uri()]
    opened.close()


def check_same(browser: Browser, hostile: Path, harmless: Path) -> str:
    """The words of a page that is made of the same elements as a harmless one, and does nothing that it should not."""
    made = []
    words = ""
    for path in (harmless, hostile):
        with exercised(browser, path) as opened:
            made.append(count_elements(opened))
            words = opened.page.locator("body").inner_text()
    assert made[0] == made[1]
    return words


def replace_texts(value: Any, hostile: str) -> Any:
    """`value` with `hostile` in every text and name of a table inside."""
    if isinstance(value, str):
        return hostile
    if isinstance(value, dict):
        return {f"{hostile}{place}": replace_texts(inner, hostile) for place, inner in enumerate(value.values())}
    return [replace_texts(inner, hostile) for inner in value] if isinstance(value, list) else value


def recorded(folder: Path, text: str) -> SampleRun:
    """A record whose texts are all `text`; in ids without the characters that ids are split at."""
    run = squares(folder, hostile=True)
    word = re.sub("[/.:|]", "", text)
    name = {
        vehicle["id"]: f"{vehicle['operator']}{word}/{place}{word}"
        for place, vehicle in enumerate(run.manifest["vehicles"])
    }

    def renamed(value: str) -> str:
        for old, new in name.items():
            if value == old or value.startswith(f"{old}."):
                return new + value[len(old) :]
        return value

    manifest = run.manifest
    for key in ("name", "seed", "skyrange", "start_utc"):
        manifest[key] = text
    manifest["versions"] = {text: text}
    manifest["platform"] = {"system": text}
    manifest["digests"] = {text: text, "fingerprint": text}
    manifest["status"] = f"failed{text}"
    manifest["reason"] = text
    for row in manifest["operators"]:
        row |= {"id": row["id"] + word, "color": text}
    for row in manifest["vehicles"]:
        row |= {"id": name[row["id"]], "operator": row["operator"] + word, "airframe": text, "autopilot": text}
    for row in manifest["links"]:
        kind, _, owner = row["name"].partition(":")
        row |= {"name": f"{kind}{word}:{name[owner]}", "a": text, "b": text}
    manifest["outcomes"] = {
        name[key]: {"state": f"lost{text}", "reason": text, "finished_s": 1.0} for key in manifest["outcomes"]
    }
    for table in ("truth", "telemetry"):
        for row in run._rows[table]:
            row["vehicle"] = renamed(row["vehicle"])
            if "operator" in row:
                row["operator"] += word
    for row in run._rows["frames"]:
        kind, _, owner = row["link"].partition(":")
        row["link"] = f"{kind}{word}:{name[owner]}"
    notes = {
        "event.statustext": "text",
        "event.parameter": "name",
        "event.track_seen": "uas_id",
        "event.upload": "file",
    }
    for table in ("events", "decisions"):
        run._rows[table] += [
            {**run._rows[table][0], "kind": kind, "data": json.dumps({key: "", text: {"nested": [text]}})}
            for kind, key in notes.items()
        ]
        for row in run._rows[table]:
            details = json.loads(row["data"])
            mode = {"mode": text, "reason": text} if row["kind"] == "event.mode" else {}
            row |= {
                "kind": row["kind"] if mode or row["kind"] == "event.takeoff" else f"{row['kind']}{text}",
                "about": renamed(row["about"]),
                "source": text,
                "causes": [text, text],
                "data": json.dumps({**replace_texts(details, text), **mode}),
            }
    for row in run._rows["labels"]:
        row |= {"attack": text, "actor": text, "frame": f"gcs:{name['blue/b1']}|fwd|{word}|0"}
    collision = {"kind": "event.collision", "data": json.dumps({"with": text, "speed_mps": 9.0})}
    run._rows["events"].append({**run._rows["events"][0], **collision})
    if text == EVIL:
        run.move(folder / "</code><script>hacked()</script>")
    return run


def test_a_record_of_hostile_texts_makes_a_harmless_page(browser: Browser, tmp_path: Path) -> None:
    pages = []
    for name, text in (("hostile", EVIL), ("harmless", HARMLESS)):
        (tmp_path / name).mkdir()
        pages.append(write_report(recorded(tmp_path / name, text), tmp_path / name / "report.html"))
    words = check_same(browser, *pages)
    assert all(word.strip("\u2028\u2029") in words for word in BREAKOUTS[:12]), "it is shown as it is"


SCENARIO = """
name = "Hostile-but.admitted 1"
origin = [40.778, -73.955]
duration_s = 25
[city]
buildings = {buildings}
[radio]
[[radio.receivers]]
id = "mast"
operator = "blue"
place = [0, 20, 30]
[[operators]]
id = "blue"
color = "red"
  [[operators.vehicles]]
  id = "b1"
  start = [0, 0]
  plan = {{ file = {mission} }}
  remote_id = {{ operator_id = {operator_id}, text = {text} }}
  [[operators.vehicles]]
  id = "b2"
  start = [0, 40]
  plan = {{ path = {{ points = [[0, 0]], alt_m = 8 }}, end = "land" }}
[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 5
params = {{ form = "ghost", at = [30, 10, 20], uas_id = {ghost} }}
"""
MISSION = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t40.778\t-73.955\t0\t1
1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t10\t1
2\t0\t3\t21\t0\t0\t0\t0\t0\t0\t0\t1
"""
CORNERS = [[-73.954, 40.7785], [-73.9535, 40.7785], [-73.9535, 40.7789], [-73.954, 40.7789], [-73.954, 40.7785]]
BLOCK = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"building": "<script>hacked()</script>", "name": EVIL, "height": "20"},
            "geometry": {"type": "Polygon", "coordinates": [CORNERS]},
        }
    ],
}


def test_a_scenario_with_hostile_texts_flies_and_its_page_is_harmless(browser: Browser, tmp_path: Path) -> None:
    names = {
        "buildings": "<img src=x onerror=hacked()>.geojson",
        "mission": "\"><svg onload='hacked()'>.waypoints",
        "operator_id": "\"onload='hacked()'",
        "text": "<script>hacked()</",
        "ghost": "'><b onclick=hack()>",
    }
    folder = tmp_path / "<iframe onload=hacked()>"
    folder.mkdir()
    (folder / names["buildings"]).write_text(json.dumps(BLOCK))
    (folder / names["mission"]).write_text(MISSION)
    file = folder / "s.toml"
    file.write_text(SCENARIO.format(**{key: json.dumps(value) for key, value in names.items()}))
    record = fly(load_file(file), folder / '"><img src=x onerror="hacked()')
    with exercised(browser, record.path / "report.html") as opened:
        words = opened.page.locator("body").inner_text()
        assert names["ghost"] in words
        assert str(folder) in words


def rewritten(pair: Pair, folder: Path, text: str) -> Pair:
    """A copy of a pair in which every text that its page shows ends in `text`."""
    shutil.copytree(pair.path, folder)
    made = json.loads((folder / "pair.json").read_text())
    made["name"] += text
    (folder / "pair.json").write_text(json.dumps(made))
    for path in folder.rglob("manifest.json"):
        manifest = json.loads(path.read_text())
        for attack in manifest["attacks"]:
            attack["kind"] += text
            attack["technique"] = text
            attack["touches"] = [text]
            attack["params"] = {**attack["params"], text: text}
            attack["shown"] = {f"{name}{text}": place for name, place in attack["shown"].items()}
        path.write_text(json.dumps(manifest))
    for name, columns in ((EFFECTS, ("outcome",)), (PROPAGATION, ("source", "kind"))):
        table = pq.read_table(folder / name)
        for column in columns:
            values = [value if value in ("frame", "departure") else value + text for value in table[column].to_pylist()]
            place = table.schema.get_field_index(column)
            table = table.set_column(
                place, table.schema.field(column), pa.array(values, table.schema.field(column).type)
            )
        pq.write_table(table, folder / name)
    for path in folder.rglob("receptions.parquet"):
        table = pq.read_table(path)
        field = table.schema.field("receiver")
        values = pa.array([f"{value}{text}" for value in table["receiver"].to_pylist()]).cast(field.type)
        pq.write_table(table.set_column(table.schema.get_field_index("receiver"), field, values), path)
    return load_pair(folder)


def test_a_pair_of_hostile_texts_makes_a_harmless_page(browser: Browser, spoofed: Pair, tmp_path: Path) -> None:
    pages = []
    for name, text in (("hostile", EVIL), ("harmless", HARMLESS)):
        made = rewritten(spoofed, tmp_path / name, text)
        pages.append(write_comparison(made, made.report))
    words = check_same(browser, *pages)
    assert all(word.strip("\u2028\u2029") in words for word in BREAKOUTS[:12]), "it is shown as it is"
