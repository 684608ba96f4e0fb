# SPDX-License-Identifier: BSD-3-Clause
import base64
import io
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from piezo_common.report_page import Picture, Section, render_page
from piezo_models.cascade import StageModel
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag
from piezo_studies.demo.demo_plant import demo_plant
from piezo_studies.demo.demo_report import drawn_runs, render_report, report_sections
from piezo_studies.demo.extended_model_section import ExtendedModel, drawn_models
from piezo_studies.demo.operation_section import format_operation, operation_sections
from piezo_studies.demo.summary import summarise, summarise_run
from piezo_studies.demo.tracked_run import read_tracked_run
from piezo_studies.demo.tracking_pictures import amplitude_spectrum

RATE_HZ = 40_000.0
MODES = ("open_loop", "feedforward", "composite")
MODE = VibrationMode(8796.0, 0.01, 0.004)
FREQUENCIES_HZ = (100.0,)
OPERATION = {
    "monitor": {
        "change_s": 65.0, "since_s": 65.1, "sentence": "mode_2_frequency_rad_per_s 4909 -> 5056",
        "before_rms_um": 0.41, "after_rms_um": 0.0123, "e_rms_before_percent": 1.234,
        "e_rms_after_percent": 0.567, "extended_model": "extended_model.json"},
    "decision": {
        "hidden": "a lag of the sensor of 0.1 ms", "experiment": "a sweep",
        "before": {"delay": 0.6, "sensor_lag": 0.39, "creep": 1e-5},
        "after": {"sensor_lag": 0.95, "delay": 2e-4, "something_else": 0.0498},
        "decision": "decided after 1 experiment: sensor_lag has probability 0.950",
        "sentence": "The model lacks sensor_lag.", "report": "report.html"}}


@pytest.fixture(scope="module")
def model():
    return StageModel(
        PreisachModel(-20.0, 120.0, np.tril(np.full((8, 8), 0.01)), -10.0),
        CreepDynamics((0.5,), (0.52,)),
        ElectricVibrationDynamics(5e-4, (2850.0,), (0.7,)))


def measured(model, voltage_v, sample_period_s, noise_um=0.0):
    """Return the recording of what the model itself would have measured."""
    displacement_um = model.simulate(voltage_v, sample_period_s)
    displacement_um += noise_um * np.random.default_rng(1).standard_normal(voltage_v.size)
    stride = round(sample_period_s * RATE_HZ)
    return Recording(
        "made", RATE_HZ, np.arange(voltage_v.size) * stride,
        np.full(voltage_v.size, sample_period_s), voltage_v, displacement_um,
        np.full(voltage_v.size, Flag.PLAYING, dtype=np.uint32))


def square_wave(period_samples, periods):
    half = period_samples // 2
    return np.tile(np.repeat([71.0, 29.0], half), periods)


@pytest.fixture(scope="module")
def recordings(model):
    time_s = np.arange(20_000) / RATE_HZ
    arcs_v = 50.0 - 70.0 * np.cos(2 * np.pi * 4.0 * time_s) * (1.0 - 0.8 * time_s)
    return {"creep": measured(model, square_wave(2000, 1), 0.01),
            "dynamics": measured(model, square_wave(800, 15), 1 / RATE_HZ, noise_um=0.009),
            "validation": measured(model, arcs_v, 1 / RATE_HZ)}


@pytest.fixture(scope="module")
def drawn(model, recordings, tracking_recordings, tmp_path_factory, picture_faults):
    """Return the report, and what is wrong with its pictures."""
    directory = tmp_path_factory.mktemp("runs")
    runs = [read_tracked_run(tracking_recordings.write(
        directory / f"{mode}_{frequency_hz:g}", mode, frequency_hz, error_um=0.1))
        for frequency_hz in FREQUENCIES_HZ for mode in MODES]
    runs_after = [read_tracked_run(tracking_recordings.write(
        directory / f"after_{mode}_{frequency_hz:g}", mode, frequency_hz, error_um=0.0248))
        for frequency_hz in FREQUENCIES_HZ for mode in MODES[1:]]
    verdict = {
        "verdict": "explained", "effects": [{
            "name": "vibration_mode", "parameters": MODE.parameters(),
            "standard_deviations": {"frequency_rad_per_s": 0.678},
            "error_reduction_percent": 50.0}],
        "before": {"rms_um": 0.0317, "e_y_percent": 0.1}, "after": {"rms_um": 0.0104,
                                                                  "e_y_percent": 0.05}}
    summary = {
        **summarise(runs, {"e_y_percent": 0.0412}, directory), "diagnosis": verdict,
        "tracking_after": [summarise_run(run, directory) for run in runs_after]}
    pages = []

    def draw():
        first = drawn_runs(summary["identification"], IdentifiedModel(model, (-20.0, 120.0)),
                           recordings, runs, directory)
        models = drawn_models(model, replace(model, effects=(MODE,)), recordings["validation"])
        extended = ExtendedModel("The model lacks a mode.", verdict, models, runs_after)
        pages.append(render_report(demo_plant("beam"), "demo --output <here>", [
            *report_sections(summary, first, extended), *operation_sections(OPERATION)]))

    faults = picture_faults(draw)
    return pages[0], faults


@pytest.fixture(scope="module")
def report(drawn):
    return drawn[0]


class Page(HTMLParser):
    """Collects tags with their attributes, and the text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text = [], ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_data(self, data):
        if self.tags and self.tags[-1][0] != "script":
            self.text += data


def test_the_report_refers_to_nothing_outside_itself(report, page_parts):
    assert page_parts(report).external == []
    tags = Page(report).tags
    assert not {tag for tag, _ in tags} & {"link", "iframe", "object", "embed"}
    assert all("src" not in attributes for tag, attributes in tags if tag == "script")
    assert "@import" not in report


def test_the_second_part_tells_both_before_and_after(report):
    rows = re.findall(r"<tr>(.*?)</tr>", report, re.S)
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in rows]
    assert ["residual of the model, RMS nm", "410.0", "12.3"] in cells
    assert ["tracking error e_rms by the sensor, %", "1.234", "0.567"] in cells
    assert ["delay", "0.600", "0.000"] in cells
    assert ["sensor_lag", "0.390", "0.950"] in cells
    assert ["something_else", "-", "0.050"] in cells
    assert not any(row[:1] == ["creep"] for row in cells)


def test_the_terminal_has_a_line_for_each_of_the_second_part():
    monitor, decision = format_operation(OPERATION).split("\n")
    assert "65.0 s, suspected since 65.1 s" in monitor and "1.234 -> 0.567 %" in monitor
    assert "delay 0.60, sensor_lag 0.39" in decision and "sensor_lag 0.95" in decision
    assert format_operation({**OPERATION, "monitor": None}) == decision


def test_paper_takes_no_picture_and_no_row_apart(report):
    print_rules = report.partition("@media print")[2].partition("</style>")[0]
    assert re.search(r"figure, tr \{ break-inside: avoid; \}", print_rules)


@pytest.mark.parametrize("device", ["phone", "desk"])
def test_the_report_fits_its_device_and_shows_all_pictures(report, page_faults, device):
    assert page_faults(report, device) == []


def test_a_page_that_does_not_fit_and_lacks_a_picture_is_found_out(page_faults):
    page = '<div style="width: 900px">wide</div><img src="data:image/png;base64,AA" alt="loops">'
    assert page_faults(page, "phone") == ["is 908 px wide", "lacks the picture loops"]


def test_every_picture_is_in_the_report_and_can_be_decoded(report):
    pictures = {attributes["alt"]: attributes["src"] for tag, attributes in Page(report).tags
                if tag == "img"}
    assert set(pictures) == {
        "Errors over frequency", "Displacement", "Loops", "Residual over frequency", "Density",
        "Fit of the creep", "Fit of the dynamics", "Frequency response",
        "Model error before and after", "Response before and after",
        "Tracking errors before and after",
        *(f"{what} at {frequency_hz:g} Hz" for frequency_hz in FREQUENCIES_HZ
          for what in ("Tracking", "Voltages", "Spectra"))}
    for source in pictures.values():
        with Image.open(io.BytesIO(base64.b64decode(source.partition(",")[2]))) as picture:
            assert np.ptp(np.asarray(picture.convert("RGB"))) > 127


def test_the_pictures_can_be_read_in_grey_and_have_units(drawn):
    assert drawn[1] == []


def test_the_report_tells_the_numbers_and_the_command_literally(report):
    text = Page(report).text
    assert "0.250" in text and "0.041" in text and "1.21" in text
    assert "demo --output <here>" in text


def test_the_report_tells_what_the_model_lacked_and_the_errors_before_and_after(report):
    text = Page(report).text
    assert "The model lacks a mode." in text
    assert "frequency_rad_per_s (rad/s)" in text and "8796" in text and "0.678" in text
    assert "31.7" in text and "10.4" in text
    # 0.0248 um over 40 um peak to peak.
    assert "0.062" in text


def test_text_of_a_page_cannot_become_markup():
    point = io.BytesIO()
    Image.new("RGB", (1, 1)).save(point, "png")
    page = Page(render_page("<b>&", ["a `<i>` b"], [Section(
        "<u>", table=[["<s>"], ["1"]], pictures=[Picture('"<em>', "<q>", point.getvalue())])]))
    assert not {tag for tag, _ in page.tags} & {"b", "i", "u", "s", "em", "q"}
    assert "a <i> b" in page.text


def test_the_spectrum_gives_a_sine_its_amplitude():
    time_s = np.arange(4000) / RATE_HZ
    signal = 3.0 + 0.5 * np.sin(2 * np.pi * 200.0 * time_s)
    frequency_hz, amplitude = amplitude_spectrum(signal, RATE_HZ)
    assert frequency_hz[np.argmax(amplitude)] == pytest.approx(200.0)
    assert amplitude.max() == pytest.approx(0.5)
