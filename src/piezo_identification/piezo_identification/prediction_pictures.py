# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of measured and simulated displacement."""

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def draw_displacement(path, prediction):
    """Draw measured and simulated displacement over time, and their difference.

    Parameters
    ----------
    path : path-like
        Picture to write.
    prediction : Prediction
    """
    figure = new_figure()
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    above.plot(prediction.time_s, prediction.measured_um, label="measured")
    above.plot(prediction.time_s, prediction.simulated_um, "--", label="simulated")
    above.set_ylabel("displacement / um")
    above.legend(loc="upper right")
    above.set_title(f"e_y = {prediction.e_y_percent():.3g} %")
    error_nm = 1e3 * (prediction.measured_um - prediction.simulated_um)
    below.plot(prediction.time_s, error_nm, color="tab:red", linewidth=0.6)
    below.set(xlabel="time / s", ylabel="difference / nm")
    figure.savefig(path)


def draw_loops(path, prediction):
    """Draw measured and simulated displacement over voltage.

    Parameters
    ----------
    path : path-like
        Picture to write.
    prediction : Prediction
    """
    figure = new_figure()
    axes = figure.subplots()
    axes.plot(prediction.voltage_v, prediction.measured_um, label="measured")
    axes.plot(prediction.voltage_v, prediction.simulated_um, "--", label="simulated")
    axes.set(xlabel="voltage / V", ylabel="displacement / um")
    axes.legend(loc="upper left")
    figure.savefig(path)


def new_figure(width_in=8.0, height_in=5.0):
    """A figure of its own, apart from pyplot's global state and any display."""
    figure = Figure(figsize=(width_in, height_in), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    return figure
