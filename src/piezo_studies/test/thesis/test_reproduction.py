# SPDX-License-Identifier: BSD-3-Clause
"""The reproduction: its cheap studies, its table, and the page that was last written."""

import json
import math
from pathlib import Path

import pytest

from piezo_studies.thesis import chirp_response, excitation, known_density
from piezo_studies.thesis.figure_table import Row, as_json, as_markdown, as_text
from piezo_studies.thesis.pictures import small_png

DOCS = Path(__file__).resolve().parents[4] / "docs"
SECTIONS = {"2.2.4", "2.3.3", "2.4.1", "2.4.2", "2.4.3", "3.4.1", "3.4.2", "3.4.3", "3.4.4",
            "3.4.5", "4.6.1", "4.6.2", "4.7.1", "4.7.2", "5.3.1", "5.3.2", "5.3.3", "A.2",
            "3.3.2, Algorithm 1", "3.4.4, Table 3.1", "4.7.2, Table 4.1", "beyond"}
FIGURES = {"2.2", "2.3", "2.7", "2.8", "2.11", "3.5", "3.6", "3.8", "3.10", "4.9", "4.10", "4.11",
           "4.12", "4.14", "5.4", "5.6", "5.9"}
LARGEST_PICTURE_BYTES = 60_000


def by_quantity(study):
    return {row.quantity: row for row in study.rows}


def page_rows():
    """Return the cells of the table on the page."""
    lines = (DOCS / "reproduction.md").read_text(encoding="utf-8").splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines
             if line.startswith("| ")]
    return cells[2:]


def test_the_designed_input_tells_ten_densities_apart_and_the_usual_ones_seven():
    assert [row.ours for row in excitation.study().rows] == [10, 7, 7]


def fault_free(study, picture_faults):
    """Return a study, whose pictures can be read in grey and have units."""
    assert picture_faults(lambda: list(map(small_png, study.pictures.values()))) == []
    return study


@pytest.mark.long
def test_few_noisy_samples_give_no_density_by_least_squares_and_a_good_one_when_smoothed(
        picture_faults):
    study = fault_free(known_density.study(), picture_faults)
    rows = by_quantity(study)
    assert rows["sampled points"].ours == 66
    assert rows["rank of A^T A"].ours == 55
    assert rows["density error, least squares, 66 points"].ours > 50.0
    assert rows["density error, smoothed non-negative, all samples"].ours < 2.0
    assert all(math.isfinite(row.ours) and row.unit for row in study.rows)


def test_hysteresis_that_is_ignored_pulls_the_mode_down_and_known_hysteresis_does_not(
        picture_faults):
    rows = by_quantity(fault_free(chirp_response.study(), picture_faults))
    assert rows["Fig. 4.10: shift of the mode, hysteresis ignored"].ours < -1.0
    assert abs(rows["Fig. 4.10: shift of the mode, hysteresis known"].ours) < 0.05


def test_a_row_reads_alike_in_every_form():
    rows = [Row("1.2", "error", 3.0, 0.12345678, "%", "because", below=True),
            Row("1.3", "rank", None, 7, "1")]
    assert json.loads(as_json(rows))[0] == {
        "section": "1.2", "quantity": "error", "thesis": 3.0, "ours": 0.12345678, "unit": "%",
        "remark": "because", "below": True,
    }
    assert as_text(rows).splitlines()[1:] == [
        "1.2      error     < 3     0.1235  %     because", "1.3      rank      -       7"
    ]
    assert "| 1.2 | error | < 3 | 0.1235 | % | because |" in as_markdown(rows)


def test_a_figure_that_is_not_finite_is_refused():
    with pytest.raises(ValueError):
        as_json([Row("1.2", "error", 3.0, math.nan, "%")])


def test_the_page_has_every_section_with_finite_figures():
    rows = page_rows()
    assert {row[0] for row in rows} == SECTIONS
    assert len({(row[0], row[1]) for row in rows}) == len(rows)
    for _, quantity, thesis, ours, *_ in rows:
        assert math.isfinite(float(ours)), quantity
        assert thesis == "-" or math.isfinite(float(thesis.removeprefix("< "))), quantity


def test_the_page_answers_every_figure_with_a_small_picture():
    text = (DOCS / "reproduction.md").read_text(encoding="utf-8")
    for figure in FIGURES:
        picture = DOCS / "pictures" / "reproduction" / f"figure_{figure}.png"
        assert f"({picture.relative_to(DOCS)})" in text
        assert 2_000 < picture.stat().st_size < LARGEST_PICTURE_BYTES
