"""States of a matrix's cells, and the page that shows them."""

from __future__ import annotations

import re
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.study.matrix.page import draw_matrix, write_matrix_report
from skyrange.study.matrix.states import SIGNS, State, describe_cells, find_state
from skyrange.study.matrix.summary import attack_rows, describe_cell
from tests.unit.matrix_sample import make_matrix


@given(st.integers(0, 999), st.integers(1, 20))
@settings(max_examples=12, deadline=None)
def test_a_state_says_what_the_flights_of_its_cell_show(seed: int, seeds: int) -> None:
    result = make_matrix(Path("m"), seed, seeds)
    states = {}
    for row in attack_rows(result):
        for column in result.matrix.columns:
            cell, without, text = (
                result.cell(row.id, column.id),
                result.cell(row.id),
                describe_cell(result, row, column.id),
            )
            state = states[row.id, column.id] = find_state(result, row.id, column.id)
            assert (state is State.REFUSED) == bool(cell.refused)
            assert (state is State.IDLE) == (column.id in without.idle)
            assert (state is State.STOPS) == text.stops
            if state in (State.STOPS, State.EVERY_FLIGHT, State.NOT_SHOWN):
                assert all(cell.complete) or text.stops
            if state in (State.NOT_SHOWN, State.REMAINS) and text.share is not None:
                assert (text.share >= 0.5) == (state is State.REMAINS)
    sentence = describe_cells(result)
    counted = State.STOPS if State.STOPS in states.values() else State.EVERY_FLIGHT
    assert ("shown to stop" in sentence) == (counted is State.STOPS)
    for row in attack_rows(result):
        never = counted not in [state for (attack, _), state in states.items() if attack == row.id]
        last = sentence.rpartition(" None ")[2] if " None " in sentence else ""
        if not sentence.startswith("No defence"):
            assert (re.search(rf"\b{row.id}(?![\w-])", last) is not None) == never, (row.id, sentence)


def test_the_page_tells_states_by_colour_and_sign_and_where_the_flights_are(tmp_path: Path) -> None:
    result = make_matrix(tmp_path / "a folder")
    result.path.mkdir()
    page = write_matrix_report(result).read_text(encoding="utf-8")
    drawn = draw_matrix(result).svg
    heat = page[page.index('<table class="heat"') : page.index("</table>")]
    for row in attack_rows(result):
        for column in result.matrix.columns:
            state = find_state(result, row.id, column.id)
            anchor = f"cell-{row.id}-{column.id}"
            found = re.search(rf'<td class="s-(\w+)"><a href="#{anchor}".*?</td>', heat, re.S)
            assert found is not None
            assert found[1] == state
            assert SIGNS[state].sign in found[0]
            detail = re.search(rf'<tr id="{anchor}">.*?</tr>', page, re.S)
            assert detail is not None
            cell = result.cell(row.id, column.id)
            command = f"skyrange watch &#39;{result.path}&#39; --run {row.id}/{column.id}"
            flown = state not in (State.REFUSED, State.IDLE)
            assert (command in detail[0]) == (flown and not cell.folder)
            assert (f'href="{cell.folder}/report.html"' in detail[0]) == (flown and bool(cell.folder)), (row, column)
    assert {State.STOPS, State.NOT_SHOWN, State.LOST, State.REMAINS} <= {
        find_state(result, row.id, column.id) for row in attack_rows(result) for column in result.matrix.columns
    }
    assert all(sign.ink in drawn and sign.meaning in drawn for sign in SIGNS.values())
