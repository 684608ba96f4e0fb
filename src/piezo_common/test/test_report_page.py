# SPDX-License-Identifier: BSD-3-Clause
"""A page holds its pictures' numbers, needs no network, and says what it says without scripts."""

import base64
import gzip
import json
import re

import numpy as np
import pytest

from piezo_common import interactive_picture
from piezo_common.interactive_picture import interactive_item
from piezo_common.picture_data import picture_table
from piezo_common.picture_style import MEASURED, MODELLED, label, new_figure, outline
from piezo_common.report_page import Section, pictured, render_page


@pytest.fixture
def figure():
    figure = new_figure()
    above, below = figure.subplots(2, 1, sharex=True)
    time_s = np.linspace(0.0, 1.0, 50)
    above.plot(time_s, np.sin(time_s), **MEASURED)
    above.plot(time_s, np.sin(time_s) + 0.1, **MODELLED)
    below.semilogy(time_s[1:], time_s[1:] ** 2, color="k")
    below.fill_between(time_s[1:], time_s[1:], 2.0 * time_s[1:], label="band")
    below.axhline(0.5)
    label(above, y="displacement (um)")
    label(below, "time (s)", "size (1)")
    return figure


def test_the_numbers_of_a_picture_are_those_of_its_curves(figure, page_parts):
    page = page_parts(render_page("A page", ["Text."], [Section("S", pictures=[
        pictured("Two panels", figure, "Caption.")])]))
    numbers = page.numbers("Two panels")
    assert list(numbers) == ["time (s)", "measured: displacement (um)",
                             "modelled: displacement (um)", "size (1)",
                             "band, outline: size (1)"]
    assert numbers["modelled: displacement (um)"] == pytest.approx(
        np.sin(np.linspace(0.0, 1.0, 50)) + 0.1, rel=1e-5)
    assert numbers["size (1)"][-1] == 1.0
    assert max(numbers["band, outline: size (1)"]) == 2.0
    assert page.is_picture("Two panels")
    assert page.external == []


def test_wide_tables_name_each_cell_for_narrow_screens(page_parts):
    table = [["a", "b", "c", "d", "e"], ["x", "1", "2", "3", "<4>"]]
    text = render_page("T", [], [Section("S", table=table), Section("S", table=[["a"], ["1"]])])
    assert text.count('class="table many"') == 1
    assert '<td class="text" data-head="e">&lt;4&gt;</td>' in text
    assert page_parts(text).tables[0] == table


def test_a_page_without_bokeh_has_its_static_pictures_alone(figure, monkeypatch):
    monkeypatch.setattr(interactive_picture, "is_available", lambda: False)
    text = render_page("T", [], [Section("S", pictures=[
        pictured("P", figure, "Caption.", closer=True)])])
    assert "<script" not in text and "<details" not in text and "data:application/gzip" in text


@pytest.mark.usefixtures("interactive_pages")
def test_the_closer_look_holds_the_same_curves_and_loads_nothing(figure, page_parts):
    pytest.importorskip("bokeh")
    item = json.dumps(interactive_item(figure, picture_table(figure).columns))
    kinds = set(re.findall(r'"name": ?"(Line|Patch|Span|LogScale)"', item))
    assert kinds == {"Line", "Patch", "Span", "LogScale"}
    # The curves are the columns of the picture's table, which the page has in any case.
    assert "ndarray" not in item
    assert set(re.findall(r'"type": ?"column", ?"index": ?(\d)', item)) == set("0123456")
    text = render_page("T", [], [Section("S", pictures=[
        pictured("P", figure, "Caption.", closer=True)])])
    assert page_parts(text).external == []
    assert not re.search(r"<script[^>]+src=|<link", text)
    shown = re.search(r'<div></div><script type="application/gzip">(.*?)</script>', text)[1]
    assert json.loads(gzip.decompress(base64.b64decode(shown)))["root_id"]
    assert len(text) < 700_000  # which is a third of Bokeh's script and a picture


def test_numbers_of_a_large_map_are_those_of_every_so_manieth_cell():
    figure = new_figure()
    values = np.arange(400.0 * 300.0).reshape(400, 300)
    figure.subplots().pcolormesh(values)
    rows = picture_table(figure).csv().splitlines()
    assert 10_000 < len(rows) <= 20_001
    assert rows[1] == "0.5,0.5,0"


def test_a_dense_line_keeps_its_lowest_and_highest_values():
    y = np.random.default_rng(5).normal(size=100_000)
    y[4321], y[98_765] = 50.0, -60.0
    x, thinned = outline(np.arange(y.size, dtype=float), y)
    assert thinned.size <= 2400 and (thinned.max(), thinned.min()) == (50.0, -60.0)
    assert np.all(np.diff(x) >= 0.0)


def test_no_word_of_a_narrow_table_is_broken_on_a_phone(page_faults):
    reason = "levels are held for a hundredth of a second only: hold them for two at least"
    rows = [["can stand for", "verdict", "because"], ["hysteresis", "no", reason],
            ["validation", "yes", "any motion that the others did not have"]]
    assert page_faults(render_page("A page", [], [Section("S", table=rows)]), "phone") == []


@pytest.mark.usefixtures("interactive_pages")
def test_a_browser_draws_the_closer_look(figure, page_faults):
    pytest.importorskip("bokeh")
    text = render_page("T", [], [Section("S", pictures=[
        pictured("P", figure, "Caption.", closer=True)])])
    opened = text.replace("</body>", """<script>
        document.querySelector("details").open = true</script></body>""")
    word, = page_faults(opened, "desk")
    assert re.search(r"bokeh .* document idle", word)


@pytest.mark.usefixtures("interactive_pages")
def test_a_map_to_look_closer_at_takes_one_byte_for_each_cell():
    pytest.importorskip("bokeh")
    figure = new_figure()
    values = np.ma.masked_less(np.arange(400.0 * 300.0).reshape(400, 300), 500.0)
    figure.subplots().pcolormesh(values)
    text = json.dumps(interactive_item(figure, []))
    assert '"dtype": "uint8"' in text and len(text) < 1.5 * values.size
