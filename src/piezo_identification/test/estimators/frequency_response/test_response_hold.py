# SPDX-License-Identifier: BSD-3-Clause
"""A response and samples agree: what was fitted to one simulates the other, without half a sample.

The truth is SciPy's: responses of transfer functions, and their zero-order-hold samples.
"""

import numpy as np
import pytest
from scipy import signal

from piezo_identification.commands.diagnose_command import main as diagnose_main
from piezo_identification.commands.identify_command import main as identify_main
from piezo_identification.diagnosis.response.response_diagnosis import diagnose_response
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.estimators.frequency_response.response_fit import (
    ResponseOrder,
    estimate_from_response,
)
from piezo_identification.estimators.frequency_response.response_hold import (
    hold_response,
    sampled_response,
    without_hold,
)
from piezo_models.cascade import StageModel
from piezo_models.effects.delay import Delay
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_file import save_model

PERIOD_S = 100e-6
FREQUENCY_HZ = np.geomspace(2.0, 2000.0, 120)
LAG_S, MODE, DAMPING, GAIN = 3e-4, 2300.0, 0.05, 0.6
# GAIN / (LAG s + 1) / ((s / MODE)^2 + 2 DAMPING s / MODE + 1)
NUMERATOR = [GAIN]
DENOMINATOR = np.polymul([LAG_S, 1.0], [MODE**-2, 2.0 * DAMPING / MODE, 1.0])
ORDER = ResponseOrder(0, 1, 0)
LINE = PreisachModel(-10.0, 10.0, np.zeros((4, 4)), 0.0, np.full(4, 0.5))


def continuous_gain(frequency_hz=FREQUENCY_HZ, delay_s=0.0):
    s = 2j * np.pi * frequency_hz
    return signal.freqs(NUMERATOR, DENOMINATOR, s.imag)[1] * np.exp(-s * delay_s)


def held_gain(frequency_hz=FREQUENCY_HZ, late=0):
    """From held samples to samples, some samples later."""
    b, a, _ = signal.cont2discrete((NUMERATOR, DENOMINATOR), PERIOD_S)
    turn = 2.0 * np.pi * frequency_hz * PERIOD_S
    return signal.freqz(np.ravel(b), a, turn)[1] * np.exp(-1j * turn * late)


def response(gain, noise=1e-5, hold_s=0.0, frequency_hz=FREQUENCY_HZ):
    random = np.random.default_rng(1)
    error = noise * (random.normal(size=gain.size) + 1j * random.normal(size=gain.size))
    return FrequencyResponse("sweep", frequency_hz, gain + error, hold_s)


def samples(voltage_v):
    """What the stage does with held samples, from rest at zero."""
    b, a, _ = signal.cont2discrete((NUMERATOR, DENOMINATOR), PERIOD_S)
    return signal.lfilter(np.ravel(b), a, voltage_v)


def simulated(model, voltage_v):
    """What a model of a response makes of held samples; the hysteresis is a line of gain one."""
    line = PreisachModel(-10.0, 10.0, np.zeros((4, 4)), 0.0, np.full(4, 1.0))
    effects = (Delay(model.delay_s),) if model.delay_s else ()
    stage = StageModel(line, model.creep, model.dynamics, effects=effects)
    level = line.simulate([0.0])[0]
    return model.gain * (stage.simulate(voltage_v, PERIOD_S) - level)


@pytest.fixture(scope="module")
def voltage_v():
    return np.concatenate([[0.0], np.random.default_rng(2).uniform(-9.0, 9.0, 400)])


@pytest.mark.parametrize("measured", [
    response(continuous_gain()), response(held_gain(), hold_s=PERIOD_S)],
    ids=["continuous", "zero-order-hold"])
def test_a_model_of_either_response_simulates_the_samples(measured, voltage_v):
    model = estimate_from_response(measured, ORDER).model
    truth = samples(voltage_v)
    error = np.std(simulated(model, voltage_v) - truth) / np.std(truth)
    assert error < 2e-3
    assert model.delay_s < 0.02 * PERIOD_S
    np.testing.assert_allclose(
        model.response(FREQUENCY_HZ), continuous_gain(), atol=2e-3 * GAIN)


def test_a_hold_that_is_not_told_is_half_a_sample_of_delay():
    """And a hold that is told but not there would be early by as much, which no delay can be."""
    delay_s = 3.0 * PERIOD_S
    untold = estimate_from_response(response(held_gain(late=3)), ORDER).model.delay_s
    told = estimate_from_response(response(held_gain(late=3), hold_s=PERIOD_S), ORDER).model.delay_s
    wrong = estimate_from_response(
        response(continuous_gain(delay_s=delay_s), hold_s=PERIOD_S), ORDER).model.delay_s
    assert told == pytest.approx(delay_s, abs=0.02 * PERIOD_S)
    assert untold - delay_s == pytest.approx(0.5 * PERIOD_S, rel=0.1)
    assert delay_s - wrong == pytest.approx(0.5 * PERIOD_S, rel=0.1)


def test_samples_have_the_response_of_the_hold(voltage_v):
    """The other way round: the spectra of samples give the response that is told to be held."""
    period_v = np.tile(voltage_v, 60)
    shown = samples(period_v)[-voltage_v.size:]
    spectrum = np.fft.rfft(shown)[1:] / np.fft.rfft(voltage_v)[1:]
    frequency_hz = np.fft.rfftfreq(voltage_v.size, PERIOD_S)[1:]
    part = frequency_hz <= 2000.0
    measured = FrequencyResponse("samples", frequency_hz[part], spectrum[part]).held(PERIOD_S)
    model = estimate_from_response(measured, ORDER).model
    np.testing.assert_allclose(
        model.response(FREQUENCY_HZ), continuous_gain(), atol=1e-3 * GAIN)
    np.testing.assert_allclose(
        model.gain * sampled_response(model.linear(), model.delay_s, frequency_hz, PERIOD_S),
        held_gain(frequency_hz), atol=1e-3 * GAIN)


@pytest.mark.parametrize("late", [0, 2])
def test_the_response_of_samples_is_that_of_scipy(late):
    dynamics = ElectricVibrationDynamics(LAG_S, (MODE,), (DAMPING,))
    found = GAIN * sampled_response(
        dynamics.state_space(), late * PERIOD_S, FREQUENCY_HZ, PERIOD_S)
    np.testing.assert_allclose(found, held_gain(late=late), atol=1e-12)


def test_a_delay_of_part_of_a_sample_is_in_the_response_of_samples():
    """Of a first-order lag, by its step response: exp(-(T - d) / tau) is left of each sample."""
    delay_s = 0.3 * PERIOD_S
    z = np.exp(2j * np.pi * FREQUENCY_HZ * PERIOD_S)
    decay, before = np.exp(-PERIOD_S / LAG_S), np.exp(-(PERIOD_S - delay_s) / LAG_S)
    pulse = (1.0 - before) / z + (before - decay) / z**2
    found = sampled_response(
        ElectricVibrationDynamics(LAG_S).state_space(), delay_s, FREQUENCY_HZ, PERIOD_S)
    np.testing.assert_allclose(found, pulse / (1.0 - decay / z), atol=1e-12)


def test_the_hold_is_that_of_the_impulse_of_one_period():
    """By integration of exp(-s t) over one period, in many small steps."""
    time_s = (np.arange(20_000) + 0.5) * PERIOD_S / 20_000
    by_steps = np.exp(-2j * np.pi * FREQUENCY_HZ[:, None] * time_s).mean(axis=1)
    np.testing.assert_allclose(hold_response(FREQUENCY_HZ, PERIOD_S), by_steps, atol=1e-8)
    plain = response(continuous_gain())
    assert without_hold(plain) is plain


@pytest.mark.long
def test_a_diagnosis_does_not_take_the_hold_for_a_delay(tmp_path, capsys):
    model = StageModel(LINE, CreepDynamics(), ElectricVibrationDynamics(LAG_S, (MODE,), (DAMPING,)))
    held = response(held_gain(), 1e-4, PERIOD_S)
    assert diagnose_response(model, held).verdict == "none"
    untold = diagnose_response(model, response(held_gain(), 1e-4))
    assert untold.effects[0]["name"] in ("delay", "sensor_lag")

    save_model(tmp_path / "model.json", IdentifiedModel(model, (-10.0, 10.0)))
    data = tmp_path / "response.csv"
    np.savetxt(data, np.column_stack([FREQUENCY_HZ, held.gain.real, held.gain.imag]),
               delimiter=",", header="frequency_hz,gain_re,gain_im", comments="")
    arguments = ["--model", str(tmp_path / "model.json"), "--data", str(data), "--output",
                 str(tmp_path / "out")]
    assert diagnose_main(
        [*arguments, "--response", "zero-order-hold", "--response-rate-hz", "1e4"]) == 0
    printed = capsys.readouterr().out
    assert "samples held for 100 us" in printed
    assert "verdict: none" in printed


@pytest.mark.parametrize(("more", "said"), [
    (["--response", "zero-order-hold", "--response-rate-hz", "4000"], "below half of that"),
    (["--response", "zero-order-hold", "--response-rate-hz", "0"], "give a positive rate"),
    (["--response-rate-hz", "40000"], "give --response zero-order-hold as well"),
    (["--response", "sampled"], "invalid choice"),
])
def test_options_that_do_not_fit_the_response_are_refused(tmp_path, capsys, save_csv, more, said):
    data, hysteresis = tmp_path / "response.csv", tmp_path / "hysteresis.csv"
    gain = continuous_gain()
    np.savetxt(data, np.column_stack([FREQUENCY_HZ, gain.real, gain.imag]), delimiter=",",
               header="frequency_hz,gain_re,gain_im", comments="")
    save_csv(hysteresis, np.arange(50) * 1e-3, np.arange(50.0), np.arange(50.0))
    try:
        status = identify_main(["--dynamics", str(data), "--hysteresis", str(hysteresis),
                                "--output", str(tmp_path / "model.json"), *more])
    except SystemExit as end:
        status = end.code
    assert status == 2
    assert said in capsys.readouterr().err


def test_an_option_of_responses_is_refused_for_samples(tmp_path, capsys, save_csv):
    data = save_csv(tmp_path / "data.csv", np.arange(50) * 1e-3, np.arange(50.0), np.arange(50.0))
    assert identify_main(["--hysteresis", str(data), "--output", str(tmp_path / "model.json"),
                          "--response", "continuous"]) == 2
    assert "--response has nothing to act on" in capsys.readouterr().err
    assert diagnose_main(["--model", str(data), "--data", str(data), "--output",
                          str(tmp_path / "out"), "--response", "continuous"]) == 2
    assert "--response has nothing to act on" in capsys.readouterr().err
