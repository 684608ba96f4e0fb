# SPDX-License-Identifier: BSD-3-Clause
"""Responses that analysers export are read to the gain of a resonance in closed form."""

import numpy as np
import pytest

from piezo_identification.estimators.frequency_response.response_file import (
    is_frequency_response,
    read_frequency_response,
)

FREQUENCY_HZ = np.geomspace(1.0, 1000.0, 80)
GAIN_UM_PER_V = 0.3 / (1.0 - (FREQUENCY_HZ / 400.0) ** 2 + 0.04j * FREQUENCY_HZ / 400.0)
DB, DEG = 20.0 * np.log10(np.abs(GAIN_UM_PER_V)), np.degrees(np.angle(GAIN_UM_PER_V))
RE, IM = GAIN_UM_PER_V.real, GAIN_UM_PER_V.imag


def rows(*columns, delimiter=","):
    return "".join(delimiter.join(f"{value:.9g}" for value in row) + "\n"
                   for row in zip(*columns, strict=True))


EXPORTS = {
    "decibels": "Frequency (Hz),Magnitude (dB),Phase (deg)\n" + rows(FREQUENCY_HZ, DB, DEG),
    "unwrapped, behind metadata": "Analyser,X\nAverages,10\n\nfreq_hz;mag_db;phase_deg\n"
        + rows(FREQUENCY_HZ, DB, DEG - 360.0, delimiter=";"),
    "units in the names": "frequency_rad_per_s,magnitude_nm_per_V,phase_deg\n" + rows(
        2.0 * np.pi * FREQUENCY_HZ, 1e3 * np.abs(GAIN_UM_PER_V), DEG),
    "complex in kHz": "Freq [kHz]\tReal\tImag\tCoherence\n" + rows(
        1e-3 * FREQUENCY_HZ, RE, IM, np.ones(80), delimiter="\t"),
    "nm/V and rad": "Frequency;Gain;Phase\nrad/s;nm/V;rad\n" + rows(
        2.0 * np.pi * FREQUENCY_HZ, 1e3 * np.abs(GAIN_UM_PER_V), np.radians(DEG), delimiter=";"),
    "downwards from above, with 0 Hz": "f [Hz];|H| magnitude;phase [°]\n" + rows(
        *(np.append(values[::-1], last) for values, last in (
            (FREQUENCY_HZ, 0.0), (np.abs(GAIN_UM_PER_V), 0.3), (DEG, 0.0))), delimiter=";"),
    "Touchstone in dB": "! analyser\n# Hz S DB R 50\n" + rows(
        FREQUENCY_HZ, DB, DEG, delimiter=" "),
    "Touchstone complex": "# kHz S RI R 50\n! remark\n" + rows(
        1e-3 * FREQUENCY_HZ, RE, IM, delimiter=" "),
}


@pytest.mark.parametrize("export", EXPORTS)
def test_export_is_read_to_its_gain(tmp_path, export):
    path = tmp_path / "response.txt"
    path.write_text(EXPORTS[export], encoding="utf-8")
    assert is_frequency_response(path)
    response = read_frequency_response(path)
    np.testing.assert_allclose(response.frequency_hz, FREQUENCY_HZ, rtol=1e-6)
    np.testing.assert_allclose(response.gain, GAIN_UM_PER_V, rtol=1e-6)


def test_frequency_at_which_two_bands_meet_has_their_mean_gain(tmp_path):
    path = tmp_path / "bands.csv"
    path.write_text("Frequency (Hz),Re,Im\n" + rows([1.0, 5.0, 5.0, 9.0], [2.0, 1.9, 1.7, 1.0],
                                                    [0.0, 0.2, 0.4, 0.3]))
    response = read_frequency_response(path)
    np.testing.assert_array_equal(response.frequency_hz, [1.0, 5.0, 9.0])
    np.testing.assert_allclose(response.gain, [2.0, 1.8 + 0.3j, 1.0 + 0.3j])


@pytest.mark.parametrize("text, said", [
    ("Frequency (Hz),Magnitude (dB)\n" + rows(FREQUENCY_HZ, DB), "no column is plainly the phase"),
    ("Frequency,Magnitude,Phase (deg)\n" + rows(FREQUENCY_HZ, DB, DEG), r"frequency \[Hz\]"),
    ("Frequency (Hz),Magnitude,Phase\n" + rows(FREQUENCY_HZ, DB, DEG), r"phase \[rad\]"),
    ("frequency_hz,gain_re\n1,2\n", "no column is plainly the imaginary"),
    ("frequency_hz,gain_re,gain_im\n0,1,1\n", "no row with a positive frequency"),
    ("frequency_hz,gain_re,gain_im\n1,nan,3\n", "row 2: no finite gain"),
    ("Frequency (Hz),Re,Im\n" + rows(FREQUENCY_HZ, RE, IM) + "2000,,3\n", "row 82: no finite gain"),
    ("Frequency (Hz),Re,Im\n" + rows(FREQUENCY_HZ, RE, IM) + "2000,x,3\n", "row 82: Re is 'x'"),
])
def test_export_that_leaves_something_open_is_refused_in_one_line(tmp_path, text, said):
    path = tmp_path / "response.csv"
    path.write_text(text)
    assert is_frequency_response(path)
    with pytest.raises(ValueError, match=said) as refusal:
        read_frequency_response(path)
    assert "\n" not in str(refusal.value) and str(path) in str(refusal.value)


@pytest.mark.parametrize("text", [
    "time_s,voltage_v,displacement_um\n0,1,2\n1,1,2\n",
    "Time [s];Drive frequency [Hz];Amplitude [V];Position [um]\n0;1;2;3\n1;1;2;3\n",
    "t [s];f;gain;u [V];x [um]\n0;1;2;3;4\n1;1;2;3;4\n", "0 1 2\n1 1 2\n", "words\n", ""])
def test_samples_are_no_response(tmp_path, text):
    path = tmp_path / "samples.csv"
    path.write_text(text)
    assert not is_frequency_response(path)
