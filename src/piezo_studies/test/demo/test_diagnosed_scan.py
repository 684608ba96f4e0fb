# SPDX-License-Identifier: BSD-3-Clause
"""The scan of the demo is distorted by a fault, which its diagnosis names and corrects."""

from itertools import permutations

import pytest

from piezo_common.report_page import render_page
from piezo_identification.axes import diagnosed_errors
from piezo_identification.axes.axis_effects import AxisEffect
from piezo_identification.experiments.several_axes import orthogonal_multisines
from piezo_models.axes_model_file import load_axes_model
from piezo_studies.coupled_scans import xy_stage
from piezo_studies.demo.diagnosed_scan import LEAK, diagnosed_scan, format_scan, scan_section


@pytest.fixture(scope="module")
def drawn(tmp_path_factory, picture_faults):
    """Return a scan with half the lines, its folder, and what is wrong with its pictures."""
    directory, scans = tmp_path_factory.mktemp("scan"), []
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(xy_stage, "axes_experiments", lambda *_: orthogonal_multisines(
            xy_stage.LIMITS, period_s=0.1, highest_hz=2500.0))
        # Which of all effects is named is asked in the tests of the diagnosis.
        patched.setattr(diagnosed_errors, "all_effects", lambda axes: [
            AxisEffect("cross_coupling", *pair) for pair in permutations(axes)])
        faults = picture_faults(lambda: scans.append(diagnosed_scan(directory, 64)))
    return scans[0], directory, faults


def test_fault_is_named_and_the_extended_model_corrects_the_image(drawn):
    scan, directory, _ = drawn
    effect, = scan.summary["effects"]
    gain = LEAK * load_axes_model(directory / "model.json").model.response(0.0)[0, 1, 1].real
    assert effect["name"] == "cross_coupling"
    assert effect["parameters"] == {"axis": "y", "from_axis": "x", "gain_um_per_v": pytest.approx(
        gain, abs=3.0 * effect["standard_deviations"]["gain_um_per_v"])}
    before, after = scan.summary["before"], scan.summary["after"]
    assert after["rms_pixels"] < 0.3 * before["rms_pixels"]
    assert {"verdict.json", "extended_model.json", "report.html", "before.gsf", "after.gsf"} <= {
        path.name for path in directory.iterdir()}


def test_report_and_terminal_give_the_error_before_and_after(drawn):
    scan, _, faults = drawn
    assert faults == []
    page = render_page("demo", [], [scan_section(scan)])
    assert "<code>cross_coupling[y,x]</code>" in page and len(page) < 150_000
    for part in ("before", "after"):
        rms = scan.summary[part]["rms_pixels"]
        assert f">{rms:.3g}<" in page and f"{rms:.2g}" in format_scan(scan.summary)


def test_report_fits_a_phone(drawn, page_faults):
    assert page_faults(render_page("demo", [], [scan_section(drawn[0])]), "phone") == []
