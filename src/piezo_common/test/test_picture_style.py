# SPDX-License-Identifier: BSD-3-Clause
"""Lines that stand in one picture can be told apart in grey; the check of pictures finds faults."""

import pytest

from piezo_common import picture_style
from piezo_common.picture_style import (
    AFTER,
    BEFORE,
    CURVES,
    FEEDBACK,
    FEEDFORWARD,
    GREEN,
    GREY,
    LIMIT,
    MEASURED,
    MODE_STYLES,
    MODELLED,
    PID,
    REFERENCE,
    VERMILION,
)

TOGETHER = {
    "modes": (REFERENCE, *MODE_STYLES.values(), PID), "before and after": (BEFORE, AFTER, LIMIT),
    "measured and modelled": (MEASURED, MODELLED), "voltages": (FEEDFORWARD, FEEDBACK, LIMIT),
    "curves": CURVES,
}


def draw(styles, x="time (s)", y="displacement (um)"):
    figure = picture_style.new_figure()
    axes = figure.subplots()
    for number, style in enumerate(styles):
        axes.plot([0, 1, 2], [0, number, 1], **{"label": f"line {number}", **style})
    picture_style.label(axes, x, y)
    picture_style.to_png(figure)


@pytest.mark.parametrize("styles", TOGETHER.values(), ids=TOGETHER)
def test_lines_of_one_picture_are_told_apart_in_grey(picture_faults, styles):
    assert picture_faults(draw, styles) == []


@pytest.mark.parametrize(("styles", "fault"), [
    (({"color": VERMILION}, {"color": GREEN}), "line 0 and line 1 are alike in grey"),
    (({"color": GREY, "marker": "o"}, {"color": "0.6", "marker": "o"}),
     "line 0 and line 1 are alike in grey"),
    (({"color": "tab:red"},), "line 0 is tab:red, which is not in the palette"),
])
def test_lines_that_cannot_be_told_apart_are_found(picture_faults, styles, fault):
    assert picture_faults(draw, styles) == [fault]


def test_axes_without_label_or_unit_are_found(picture_faults):
    assert picture_faults(draw, [LIMIT], "time", None) == ["an axis y has no label",
                                                           "time has no unit"]
