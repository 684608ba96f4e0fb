# SPDX-License-Identifier: BSD-3-Clause
import re
from contextlib import redirect_stdout
from functools import partial, partialmethod
from hashlib import sha256
from importlib.resources import files
from io import StringIO

import pytest
import yaml

from piezo_common.command_line import Command
from piezo_controller.commands import design_work
from piezo_controller.commands.design_command import main
from piezo_controller.feedback.controller_file import load_controller
from piezo_controller.feedback.robustness import PlantErrors
from piezo_controller.feedback.sample_rate.named_feedbacks import feedback_at_margin
from piezo_controller.feedback.synthesis.weights import WeightsError, load_weights


@pytest.fixture(scope="module")
def designed(model_path, tmp_path_factory, picture_faults, short_search):
    """Run the command; return the path of its controller, and what it prints."""
    output = tmp_path_factory.mktemp("designed") / "controller.json"
    with redirect_stdout(StringIO()) as printed, pytest.MonkeyPatch.context() as patch:
        patch.setattr(PlantErrors, "robustness", partialmethod(PlantErrors.robustness, samples=20))
        patch.setattr(design_work, "DRAWN", 10)
        faults = picture_faults(main, ["--model", str(model_path), "--output", str(output)])
    assert faults == []
    return output, printed.getvalue()


@pytest.mark.usefixtures("without_pictures")
def test_a_feedback_by_its_name_is_written_with_what_it_is_worth(
        model_path, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(design_work, "feedback_at_margin", partial(feedback_at_margin, effort=0.05))
    output = tmp_path / "pi.json"
    assert main(["--model", str(model_path), "--feedback", "pi", "--output", str(output),
                 "--no-report"]) == 0
    controller = load_controller(output)
    assert (controller.report["method"], controller.sample_period_s) == ("pi", 25e-6)
    printed = capsys.readouterr().out
    assert re.search(r"^pi +[\d.]+ .* 2(\.00\d*)? .* 1$", printed, re.M)
    assert output.with_name("pi_comparison.png").read_bytes().startswith(b"\x89PNG")
    assert printed.splitlines()[-1].endswith(f"--controller {output} --output runs")
    assert main(["--model", str(model_path), "--feedback", "pi", "--method", "pid",
                 "--output", str(output)]) == 2
    assert "--method is of the laws of a tick" in capsys.readouterr().err


def default_weights():
    return yaml.safe_load((files("piezo_controller") / "weights.yaml").read_text())


def test_command_writes_the_controller_and_pictures_and_prints_the_report(
        model_path, designed, page_parts):
    output, printed = designed
    controller = load_controller(output)
    assert controller.model_sha256 == sha256(model_path.read_bytes()).hexdigest()
    for name in "bode", "nyquist", "weights", "mu":
        picture = output.with_name(f"controller_{name}.png").read_bytes()
        assert picture.startswith(b"\x89PNG") and len(picture) > 10000
    assert f"{controller.report['bandwidth_hz']:.1f} Hz" in printed
    assert f"{controller.report['gamma']:.3f}" in printed
    assert f"{controller.report['mu']:.3f}" in printed
    assert re.search(r"^sample clock of the stage +40000 Hz; --rate takes another one$", printed,
                     re.M)
    assert "1000 Hz, 40 samples a tick; by (5.10) " in printed
    assert "20 of 20 drawn" in printed
    assert printed.splitlines()[-1] == (
        f"next: ./run piezo_client stage track --model {model_path} --controller {output} "
        "--output runs")
    report = output.with_name("controller_report.html")
    page = page_parts(report)
    assert f"report: {report}" in printed
    margins = {row[0]: row[1:] for row in page.tables[0][1:]}
    assert margins["gain margin (1)"] == [
        f"{controller.report[f'gain_margin{where}']:.3g}"
        for where in ("_at_lowest_gain", "", "_at_highest_gain")]
    assert f"gain margin {controller.report['gain_margin']:.2g}" in page.title
    for name in "Bode diagram", "Nyquist diagram", "Step responses", "Sensitivity", "Weights":
        assert page.is_picture(name), name
    assert page.external == []
    _assert_the_pictures_hold_the_margins(page, controller.report)


def _assert_the_pictures_hold_the_margins(page, report):
    """The ends of the marks are those of the margins, the step ends at 1, and S peaks at Ms."""
    bode, nyquist = page.numbers("Bode diagram"), page.numbers("Nyquist diagram")
    phase, = (values for head, values in bode.items() if head.startswith("phase margin"))
    assert max(phase) - min(phase) == pytest.approx(report["phase_margin_deg"], abs=0.2)
    assert min(phase) % 360.0 == pytest.approx(180.0)
    gain, = (values for head, values in bode.items() if head.startswith("gain margin"))
    assert max(gain) / min(gain) == pytest.approx(report["gain_margin"], rel=1e-3)
    assert -1.0 in nyquist["real part (1)"]
    steps = page.numbers("Step responses")
    assert steps["gain 1.00: displacement (um)"][-1] == pytest.approx(1.0, abs=0.06)
    assert steps["gain 1.00: error (um)"][0] == pytest.approx(1.0, abs=0.01)
    sensitivity = page.numbers("Sensitivity")["sensitivity S: gain (um/um)"]
    assert max(sensitivity) == pytest.approx(report["peak_sensitivity"], rel=0.01)


@pytest.mark.parametrize("method", ["pid", pytest.param("pi", marks=pytest.mark.long)])
@pytest.mark.usefixtures("without_pictures", "few_draws")
def test_other_methods_need_no_weights_and_have_no_picture_of_them_at_another_clock(
        model_path, tmp_path, method, capsys):
    output = tmp_path / "controller.json"
    arguments = ["--model", str(model_path), "--output", str(output), "--no-report"]
    assert main([*arguments, "--method", method, "--rate", "20000"]) == 0
    controller = load_controller(output)
    assert (controller.report["method"], controller.weights) == (method, {})
    assert {path.name for path in tmp_path.glob("*.png")} == {
        "controller_bode.png", "controller_nyquist.png"}
    printed = capsys.readouterr().out
    assert "ultimate gain" in printed
    assert "20000 Hz; --rate takes another one" in printed
    assert "1000 Hz, 20 samples a tick; by (5.10) " in printed
    assert controller.sample_period_s == pytest.approx(1e-3)
    assert main([*arguments, "--rate", "0"]) == 2
    assert "--rate is 0: give a positive number" in capsys.readouterr().err


def test_options_reach_the_design(model_path, tmp_path, monkeypatch):
    asked = []

    def take(model, weights, *others):
        asked.append((load_weights(weights).model_dump(), others[6]))
        raise ValueError("this is enough")

    monkeypatch.setattr(design_work, "design_for_stage", take)
    weights = default_weights()
    weights["performance"]["gain"] = 0.05
    weights_path = tmp_path / "weights.yaml"
    weights_path.write_text(yaml.safe_dump(weights))
    output = tmp_path / "controller.json"
    assert main(["--model", str(model_path), "--weights", str(weights_path),
                 "--delay-ticks", "0", "--output", str(output)]) == 2
    assert asked == [(weights, 0)]


def test_bad_input_ends_with_status_2_and_one_line(model_path, tmp_path, capsys):
    (tmp_path / "broken.yaml").write_text("performance: [")
    output = tmp_path / "controller.json"
    for arguments in (
        ["--model", tmp_path / "none.json", "--output", output],
        ["--model", model_path, "--output", tmp_path / "none" / "controller.json"],
        ["--model", model_path, "--weights", tmp_path / "broken.yaml", "--output", output],
    ):
        assert main([str(a) for a in arguments]) == 2
        line = capsys.readouterr().err
        assert line.count("\n") == 1 and line.startswith("design: ")


def test_output_that_cannot_be_written_is_refused_before_the_work(
        model_path, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(Command, "_load", lambda command: pytest.fail("it worked first"))
    for output, said in ((tmp_path / "none" / "controller.json",
                          "is no file in an existing directory"), (tmp_path, "is a folder")):
        assert main(["--model", str(model_path), "--output", str(output)]) == 2
        assert said in capsys.readouterr().err


def test_weights_of_the_thesis_are_its_but_for_the_integrators_pole():
    weights = load_weights("thesis")
    assert load_weights().model_dump() == default_weights()
    assert weights.performance.zeros == [-1.0] and weights.performance.poles[0] < 1
    z = 1j
    assert weights.control.state_space(1e-3)(z) == pytest.approx(
        1.2496 * (z - 0.2283) ** 2 / (z + 0.7254) ** 2)
    assert weights.noise.state_space(1e-3)(z) == pytest.approx(0.0395 * (z - 0.9691) / (z + 0.222))
    assert weights.disturbance.state_space(1e-3)(z) == pytest.approx(
        0.1182 * (z + 1) / (z - 0.8818))
    assert weights.reference.state_space(1e-3)(z) == pytest.approx(1.0)
    assert (weights.feedforward_error, weights.hysteresis_uncertainty) == (0.05, 0.12)


@pytest.mark.parametrize("path, value, message", [
    (("performance", "poles"), [1.0], "on or outside the unit circle"),
    (("performance", "gain"), -0.1,
     "performance.gain is out of range .found -0.1.; give a number above 0"),
    (("noise", "zeros"), [0.1, 0.2], "more zeros than poles"),
    (("noise", "zeros"), ["a"], "noise.zeros.0. is not a finite number"),
    (("feedforward_error",), "much", 'feedforward_error is not a finite number .found "much"'),
    (("sample_period_s",), float("nan"), "sample_period_s is not a finite number .found NaN"),
    (("disturbance",), 3, "disturbance is not an object .found 3"),
    (("surprise",), 1, "surprise is unknown"),
])
def test_weights_that_describe_no_design_are_refused(tmp_path, path, value, message):
    weights = default_weights()
    entry = weights
    for name in path[:-1]:
        entry = entry[name]
    entry[path[-1]] = value
    file = tmp_path / "weights.yaml"
    file.write_text(yaml.safe_dump(weights))
    with pytest.raises(WeightsError, match=message) as refusal:
        load_weights(file)
    assert str(file) in str(refusal.value)
