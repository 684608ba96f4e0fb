# SPDX-License-Identifier: BSD-3-Clause
"""A controller is shown in a line, a table of its loop, and a picture of it or of the loop."""

import numpy as np
import pytest


def test_line_and_table_hold_what_the_report_holds(controller):
    report = controller.report
    assert f"bandwidth {report['bandwidth_hz']:.4g} Hz" in repr(controller)
    cells = {row[0]: row[1:] for row in controller.summary().rows}
    assert cells["bandwidth (S at -3 dB)"] == (report["bandwidth_hz"], "Hz")
    assert cells["phase margin, at the highest"] == (
        report["phase_margin_deg_at_highest_gain"], "deg")
    assert "h_infinity" in controller._repr_html_()


def test_pictures_are_of_the_controller_or_of_its_loop(controller, stage_model):
    alone, loop = controller.plot(), controller.plot(stage_model)
    system = controller.state_space()
    frequency_hz, gain = alone.axes[0].lines[0].get_data()
    np.testing.assert_allclose(
        gain, np.abs(system(np.exp(2j * np.pi * frequency_hz * system.dt), squeeze=True)))
    drawn = {line.get_label(): line for line in loop.axes[0].lines}
    peak = np.abs(drawn["sensitivity S"].get_ydata()).max()
    assert peak == pytest.approx(controller.report["peak_sensitivity"], rel=1e-3)
