# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from piezo_interfaces.msg import Reference

from piezo_client.references import harmonic, multi_frequency, sampled, triangle


@pytest.mark.parametrize(("fields", "kind", "frequency_hz", "amplitude_um", "phase_rad"), [
    (harmonic(40, 20, 50), "harmonic", [40.0], [20.0], []),
    (triangle(40, 20, 50), "triangle", [40.0], [20.0], []),
    (multi_frequency([100, 300], [2, 1], 50, [0, 1]), "multi_frequency", [100.0, 300.0],
     [2.0, 1.0], [0.0, 1.0]),
])
def test_components_are_those_of_the_message(fields, kind, frequency_hz, amplitude_um, phase_rad):
    message = Reference(**fields)
    assert message.kind == kind
    assert message.centre_um == 50.0
    assert list(message.frequency_hz) == frequency_hz
    assert list(message.amplitude_um) == amplitude_um
    assert list(message.phase_rad) == phase_rad


def test_sampled_trajectory_is_written_at_the_sample_rate(tmp_path):
    message = Reference(**sampled([0.0, 1.0, 0.5], tmp_path / "new" / "way.csv", 1000.0))
    assert message.kind == "file"
    assert np.loadtxt(message.file, delimiter=",", skiprows=1).tolist() == [
        [0.0, 0.0], [1e-3, 1.0], [2e-3, 0.5]]
    with pytest.raises(ValueError, match="2 dimensions"):
        sampled(np.zeros((2, 2)), tmp_path / "plane.csv")
