# SPDX-License-Identifier: BSD-3-Clause
import re
from itertools import chain, pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from undrawn import save_point

from piezo_identification.commands.identify_command import COMMAND, EXPERIMENTS, PURPOSES
from piezo_identification.commands.identify_command import main as identify_main
from piezo_identification.commands.simulate_command import main as simulate_main
from piezo_identification.commands.waveforms_command import NAMES as NAMES_OF_WAVEFORMS
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.identification.identify import IdentificationCancelled, identify
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.model_file import load_model
from piezo_recorder.reading.reader import read_recording, sha256_of

HEADER = "time_s,voltage_v,displacement_um"
NAMES = ("creep", "dynamics", "hysteresis", "validation")
GRID = ("--grid", 40, "--smoothing", 1e-10, "--translation-weight", 1e-10)
FINE_GRID = ("--grid", 80, "--smoothing", 1e-13, "--translation-weight", 1e-12)


@pytest.fixture(scope="module")
def files(play, csv_of, tmp_path_factory):
    """Return the CSV files of the experiments: their rows are samples at their instants."""
    directory = tmp_path_factory.mktemp("with a space")
    makers = {
        "creep": lambda: play(experiments.creep(), 1, 100.0),
        "dynamics": lambda: play(experiments.dynamics(duration_s=0.25), 1),
        "hysteresis": lambda: play(experiments.hysteresis(level_count=16), 1, 1000.0),
        "validation": lambda: play(experiments.validation(arc_s=0.1, tones_s=0.4), 1),
    }
    return {name: csv_of(makers[name](), directory / f"{name}.csv") for name in NAMES}


@pytest.fixture(scope="module")
def short_files(play, csv_of, tmp_path_factory):
    """Return files of a few seconds, for what needs no accuracy."""
    directory = tmp_path_factory.mktemp("short")
    played = {
        "creep": play(experiments.creep(period_s=60.0), 1, 100.0),
        "dynamics": play(experiments.dynamics(duration_s=0.1), 1),
    }
    return {name: csv_of(each, directory / f"{name}.csv") for name, each in played.items()}


def options(files):
    return [text for name in files for text in (f"--{name}", str(files[name]))]


@pytest.fixture(scope="module")
def model_file(files, tmp_path_factory, without_search):
    path = tmp_path_factory.mktemp("models") / "model.json"
    arguments = [*options(files), "--output", path, "--creep-pairs", 4, "--modes", 2, *FINE_GRID]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", save_point)  # the demo and simulate draw them
        assert identify_main([str(argument) for argument in arguments]) == 0
    return path


def test_identify_writes_a_model_that_holds_on_unseen_data(plant, model_file):
    identified = load_model(model_file)
    # The sensor's noise alone makes 0.04 % and 0.2 %.
    assert identified.errors["hysteresis_e_y_percent"] < 0.1
    assert identified.errors["dynamics_e_y_percent"] < 0.3
    frequency_hz = np.array([100.0, 500.0, 1000.0])
    ratio = identified.model.response(frequency_hz) / plant.response(frequency_hz)
    assert np.abs(ratio - 1.0).max() < 1e-3
    assert {part["verdict"] for part in identified.adequacy.values()} == {"adequate"}
    assert list(identified.adequacy) == ["creep", "dynamics", "hysteresis"]


def test_identify_writes_a_page_that_tells_the_parameters_first(plant, model_file, page_parts):
    page = page_parts(model_file.with_name("model_report.html"))
    heads, *rows = page.tables[0]
    assert heads == ["parameter", "value", "standard deviation", "95 % interval", "in Hz"]
    rows = {row[0]: row[1:] for row in rows}
    truth = plant.dynamics.mode_frequencies_rad_per_s
    for name, true, deviation in zip(
            ("mode frequency 1 (rad/s)", "mode frequency 2 (rad/s)"), truth,
            load_model(model_file).uncertainties["dynamics"]["mode_frequencies_rad_per_s"],
            strict=True):
        value, spread, interval, hertz = rows[name]
        low, high = map(float, interval.split(" to "))
        assert high - low == pytest.approx(2 * 1.96 * deviation, rel=0.15)
        assert float(spread) == pytest.approx(deviation, rel=0.05)
        assert abs(float(value) - true) < 4.0 * deviation
        assert float(hertz.split(" ± ")[0]) == pytest.approx(true / (2.0 * np.pi), rel=1e-3)
    adequacy = load_model(model_file).adequacy
    assert [row[0] for row in page.tables[1][1:]] == list(adequacy)
    assert float(page.tables[1][1][1]) == pytest.approx(
        1e3 * adequacy["creep"]["residual_rms_um"], rel=0.01)
    assert page.external == []


def test_the_page_of_a_model_shows_each_component_with_its_numbers(plant, model_file, page_parts):
    page = page_parts(model_file.with_name("model_report.html"))
    for name in ("Fit of the creep", "Fit of the dynamics", "Fit of the hysteresis",
                 "Residual of the creep over time", "Frequency response", "Density",
                 "Residual of the hysteresis over frequency"):
        assert name in page.pictures, name
    bode = page.numbers("Frequency response")
    gain = dict(zip(bode["frequency (Hz)"], bode["modelled: gain (um/um)"], strict=False))
    for frequency_hz in list(gain)[::50]:
        assert gain[frequency_hz] == pytest.approx(
            abs(plant.response(np.array([frequency_hz]))[0]), rel=0.05, abs=2e-3)
    # Ten periods a second of the square wave are one of a tenth of a second on average.
    period = page.numbers("Fit of the dynamics")
    assert max(period["time in the period (ms)"]) < 101.0


def test_the_model_names_range_periods_and_recordings(files, model_file):
    identified = load_model(model_file)
    assert identified.voltage_range_v == pytest.approx((-20.0, 120.0))
    assert identified.sample_periods_s == pytest.approx(
        {"creep": 0.01, "dynamics": 25e-6, "hysteresis": 1e-3}
    )
    assert identified.recordings == [
        {"path": str(files[name]), "sha256": sha256_of(files[name])} for name in NAMES
    ]


@pytest.mark.parametrize("names", [
    ("creep",), pytest.param(("creep", "dynamics"), marks=pytest.mark.long)])
def test_identify_takes_orders_and_says_why_and_what_the_data_determine(
        short_files, tmp_path, capsys, names):
    output = tmp_path / "model.json"
    orders = {"creep": ("--creep-pairs", 1), "dynamics": ("--modes", 1)}
    arguments = [*options({name: short_files[name] for name in names}), "--output", output,
                 *chain.from_iterable(orders[name] for name in names), "--no-report", "--verbose"]
    assert identify_main([str(argument) for argument in arguments]) == 0
    model = load_model(output).model
    assert len(model.creep.poles_rad_per_s) == 1
    assert len(model.dynamics.mode_frequencies_rad_per_s) == ("dynamics" in names)
    printed = capsys.readouterr().out
    assert printed.count("<- given") == len(names)
    # Three creep pairs and a mode too few, on the data that were fitted themselves.
    adequacy = load_model(output).adequacy
    assert {name: part["verdict"] for name, part in adequacy.items()} == dict.fromkeys(
        names, "inadequate")
    assert "creep is inadequate: " in printed
    assert f"let diagnose name the cause from {short_files[names[-1]]}" in printed


@pytest.fixture(scope="module")
def response_file(plant, tmp_path_factory):
    """Return the plant's response in another unit, with a delay and a little noise."""
    frequency_hz = np.geomspace(1.0, 2000.0, 160)
    random = np.random.default_rng(5)
    noise = 1e-4 * random.normal(size=(2, 160))
    gain = 3.0 * plant.response(frequency_hz) * np.exp(-2j * np.pi * frequency_hz * 120e-6)
    gain = gain + noise[0] + 1j * noise[1]
    path = tmp_path_factory.mktemp("response") / "response.csv"
    np.savetxt(path, np.column_stack([frequency_hz, gain.real, gain.imag]), delimiter=",",
               header="frequency_hz,gain_re,gain_im", comments="")
    return path


def identified_with(files, tmp_path, dynamics, *more, beside=("creep", "hysteresis", "validation")):
    output = tmp_path / "model.json"
    given = {name: files[name] for name in beside}
    arguments = [*options(given | {"dynamics": dynamics}), "--output", output, "--no-report",
                 *(GRID if "hysteresis" in given else ()), *more]
    assert identify_main([str(argument) for argument in arguments]) == 0
    return load_model(output)


def assert_same_creep(found, truth):
    s = 1j * np.geomspace(0.01, 100.0, 80)
    responses = [np.prod([(s + zero) / (s + pole) for pole, zero in zip(
        creep.poles_rad_per_s, creep.zeros_rad_per_s, strict=True)], axis=0)
        for creep in (found, truth)]
    assert responses[0] == pytest.approx(responses[1], rel=5e-3)


@pytest.mark.long  # a whole identification
def test_identify_takes_the_dynamics_from_a_frequency_response(
        files, response_file, tmp_path, plant):
    identified = identified_with(
        files, tmp_path, response_file, "--creep-pairs", 4, "--modes", 2, "--antiresonances", 0)
    model = identified.model
    assert model.dynamics.mode_frequencies_rad_per_s == pytest.approx((2846.0, 4909.0), rel=2e-3)
    assert model.effects[0].delay_s == pytest.approx(120e-6, rel=0.01)
    assert model.dynamics.time_constant_s == pytest.approx(490e-6, rel=0.01)
    # The recordings have no such delay, for which further pairs make up that nearly cancel.
    assert_same_creep(model.creep, plant.creep)
    assert identified.uncertainties["dynamics"]["time_constant_s"] > 0.0
    assert identified.sample_periods_s.keys() == {"creep", "hysteresis"}
    # The validation has no such delay; the slow part hardly feels it.
    assert identified.errors["hysteresis_e_y_percent"] < 0.2


def test_identify_takes_the_orders_of_a_frequency_response_and_its_band(
        files, response_file, tmp_path, capsys):
    identified = identified_with(
        files, tmp_path, response_file, "--modes", 1, "--antiresonances", 0, "--band", 1, 500,
        "--verbose", beside=())
    assert len(identified.model.dynamics.mode_frequencies_rad_per_s) == 1
    assert "0+1-0" in capsys.readouterr().out


def test_what_the_data_do_not_tell_is_said_and_the_model_saved(files, tmp_path, capsys):
    """A response without creep does not tell where a pole lies that its zero cancels."""
    frequency_hz = np.geomspace(1.0, 2000.0, 60)
    gain = 3.0 / (1.0 + 2j * np.pi * frequency_hz * 500e-6)
    path = tmp_path / "no_creep.csv"
    np.savetxt(path, np.column_stack([frequency_hz, gain.real, gain.imag]), delimiter=",",
               header="frequency_hz,gain_re,gain_im", comments="")
    identified = identified_with(
        files, tmp_path, path, "--creep-pairs", 1, "--modes", 0, "--antiresonances", 0,
        beside=())
    (deviation,) = identified.uncertainties["creep"]["poles_rad_per_s"]
    assert deviation > identified.model.creep.poles_rad_per_s[0]
    assert identified.uncertainties["dynamics"]["time_constant_s"] < 1e-6
    assert identified.model.dynamics.time_constant_s == pytest.approx(500e-6, rel=1e-3)
    assert ("do not determine creep poles_rad_per_s, creep zeros_rad_per_s"
            in capsys.readouterr().out)


@pytest.mark.long
def test_identify_takes_the_dynamics_from_a_multisine(files, play, csv_of, tmp_path):
    path = csv_of(play(experiments.multisine(tones_s=0.4), 1), tmp_path / "multisine.csv")
    model = identified_with(files, tmp_path, path, "--modes", 2).model
    assert model.dynamics.mode_frequencies_rad_per_s == pytest.approx((2846.0, 4909.0), rel=2e-3)
    assert model.dynamics.time_constant_s == pytest.approx(490e-6, rel=0.01)


@pytest.mark.parametrize(("more", "said"), [
    (["--band", 1, 10], "--band has nothing to act on"),
    (["--antiresonances", 1], "--antiresonances has nothing to act on"),
])
def test_identify_refuses_options_without_use(more, said, short_files, tmp_path, capsys):
    arguments = [*options(short_files), "--output", tmp_path / "model.json", *more]
    assert said in refusal(identify_main, arguments, capsys)


@pytest.mark.parametrize(("text", "more", "said"), [
    ("frequency_hz,gain_re,gain_im\n1,1,x\n", [], "row 2: gain_im is 'x'"),
    ("frequency_hz,gain_re\n1,1\n", [], "no column is plainly the imaginary"),
    ("frequency_hz,gain_re,gain_im\n1,1,0\n", [], "1 frequencies, too few"),
    ("frequency_hz,gain_re,gain_im\n1,1,0\n", ["--band", 5, 9], "no frequency from 5 to 9 Hz"),
])
def test_identify_refuses_a_bad_response(text, more, said, files, tmp_path, capsys):
    data = tmp_path / "response.csv"
    data.write_text(text)
    arguments = ["--dynamics", data, "--hysteresis", files["hysteresis"],
                 "--output", tmp_path / "model.json", *more]
    assert said in refusal(identify_main, arguments, capsys)


def test_simulate_prints_the_error_and_draws_pictures(
        files, model_file, tmp_path, capsys, picture_faults, page_parts):
    output = tmp_path / "pictures"
    arguments = ["--model", str(model_file), "--data", str(files["validation"])]
    assert picture_faults(simulate_main, [*arguments, "--output", str(output)]) == []
    page = page_parts(output / "simulation_report.html")
    name, value = capsys.readouterr().out.splitlines()[0].split()
    assert name == "e_y_percent"
    assert float(value) == pytest.approx(load_model(model_file).errors["e_y_percent"], rel=1e-3)
    assert dict(page.tables[0][1:])["e_y (%)"] == f"{float(value):.3g}"
    assert page.is_picture("Displacement") and page.external == []
    for picture in ("displacement.png", "loops.png"):
        assert (output / picture).read_bytes().startswith(b"\x89PNG")


def test_cancelling_ends_the_work_before_the_next_stage(files):
    creep = read_recording(files["creep"])
    stages = []
    with pytest.raises(IdentificationCancelled):
        identify(creep, None, hysteresis=creep, cancelled=lambda: len(stages) == 1,
                 progress=lambda stage, fraction: stages.append((stage, fraction)))
    assert stages == [("creep", 0.0)]


def test_cancelling_ends_an_estimator_at_its_next_step(files):
    recordings = {name: read_recording(files[name]) for name in ("creep", "hysteresis")}
    asked = []
    with pytest.raises(IdentificationCancelled, match="cancelled: creep"):
        identify(**recordings, cancelled=lambda: asked.append(None) or len(asked) > 20)
    assert len(asked) == 21


def refusal(main, arguments, capsys):
    assert main([str(argument) for argument in arguments]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    return lines[0]


@pytest.mark.parametrize("name", ["creep", "dynamics", "hysteresis"])
def test_identify_refuses_a_file_that_does_not_exist(name, files, tmp_path, capsys):
    wrong = dict(files) | {name: tmp_path / "nothing.csv"}
    arguments = [*options(wrong), "--output", tmp_path / "model.json"]
    assert "nothing.csv" in refusal(identify_main, arguments, capsys)
    assert not (tmp_path / "model.json").exists()


def test_identify_refuses_an_output_that_cannot_be_written_before_it_works(files, capsys):
    arguments = [*options(files), "--output", "/nowhere/at/all/model.json"]
    assert "--output" in refusal(identify_main, arguments, capsys)


def test_simulate_refuses_a_missing_model(files, tmp_path, capsys):
    arguments = ["--model", tmp_path / "none.json", "--data", files["validation"]]
    assert "none.json" in refusal(simulate_main, arguments, capsys)


@pytest.mark.parametrize("text, named", [
    (f"{HEADER}\n0,0,0\n0.1,nan,0\n", "row 3: voltage_v is missing"),
    (f"{HEADER}\n0,0,0\n0.1,1,0\n0.2,2,0\n0.1,3,0\n", "row 5: time_s steps by -0.1 s"),
    (f"{HEADER}\n0,0,0\n0.1,1\n", "row 3: 2 values"),
    ("time_s,voltage_v\n0,0\n", "row 1: the column displacement_um is missing"),
])
def test_both_commands_name_the_row_of_damaged_data(text, named, model_file, tmp_path, capsys):
    data = tmp_path / "data.csv"
    data.write_text(text)
    simulated = ["--model", model_file, "--data", data]
    identified = ["--hysteresis", data, "--output", tmp_path / "model.json"]
    for main, arguments in ((simulate_main, simulated), (identify_main, identified)):
        assert f"data.csv, {named}" in refusal(main, arguments, capsys)


@pytest.fixture(scope="module")
def slow_stage():
    """Return a stage of another range, seen so slowly that it neither creeps nor rings."""
    density = np.tril(0.001 + 0.004 * np.exp(-np.subtract.outer(range(80), range(80)) / 15.0))
    return PreisachModel(-75.0, 75.0, density, 12.0)


@pytest.fixture
def slow_file(slow_stage, save_csv):
    """Write straight ways between reversals, as 0.2 s samples."""
    def write(path, sign, reversals_v):
        voltage_v = np.concatenate([
            np.linspace(start, end, 120, endpoint=False) for start, end in pairwise(reversals_v)])
        noise = np.random.default_rng(3).normal(scale=0.005, size=voltage_v.size)
        displacement_um = sign * slow_stage.simulate(voltage_v) + noise
        return save_csv(path, 3.0 + 0.2 * np.arange(voltage_v.size), voltage_v, displacement_um)

    return write


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_slow_recording_of_another_stage_is_enough(slow_file, sign, tmp_path, capsys):
    stairs_v = [v for top in np.linspace(-71.0, 75.0, 40) for v in (-75.0, top)]
    fitted = slow_file(tmp_path / "fitted.csv", sign, [*stairs_v, -75.0])
    unseen = slow_file(tmp_path / "unseen.csv", sign,
                       [-75.0, 60.0, -40.0, 30.0, -10.0, 70.0, -60.0])
    model = tmp_path / "model.json"
    arguments = ["--hysteresis", str(fitted), "--output", str(model), "--no-report",
                 *map(str, GRID)]
    assert identify_main(arguments) == 0
    identified = load_model(model)
    assert identified.visited.shape == identified.model.hysteresis.density_um_per_v2.shape
    assert identified.visited[0, 0]
    assert identified.model.dynamics.is_static
    assert identified.model.creep.poles_rad_per_s == ()
    told = capsys.readouterr().out
    assert ("its sign is changed" in told) == (sign < 0)
    assert "of the Preisach plane visited" in told
    assert simulate_main(["--model", str(model), "--data", str(unseen)]) == 0
    told = capsys.readouterr().out
    assert ("its sign is changed" in told) == (sign < 0)
    assert float(re.search(r"^e_y_percent (\S+)", told, re.M)[1]) < 0.3


def test_identify_needs_something_to_identify():
    with pytest.raises(ValueError, match="there is nothing to identify"):
        identify()


def test_recording_that_is_given_under_a_wrong_name_stops_the_identification(
        files, tmp_path, capsys):
    model = tmp_path / "model.json"
    assert identify_main(["--dynamics", str(files["creep"]), "--output", str(model)]) == 2
    told = capsys.readouterr().err
    assert "creep.csv can hardly stand for the dynamics: too slow to hold dynamics" in told
    assert "give it as --creep, which it can stand for, or go on with --anyway" in told
    assert not model.exists()


def test_waveforms_of_the_recipe_are_given_by_their_names():
    given = COMMAND.parser().parse_args([
        "--hysteresis", "a.csv", "b.csv", "--sweep", "c.csv", "--multisine", "d.csv",
        "--output", "model.json"])
    assert given.hysteresis == [Path("a.csv"), Path("b.csv"), Path("c.csv")]
    assert given.dynamics == [Path("d.csv")]
    assert {*NAMES_OF_WAVEFORMS} == {*EXPERIMENTS, *PURPOSES}
