# SPDX-License-Identifier: BSD-3-Clause
"""Figures of the tracking runs: errors over frequency, signals, voltages and their spectra."""

import numpy as np

from piezo_common.picture_style import (
    BLACK,
    FEEDBACK,
    FEEDFORWARD,
    GREEN,
    MODE_STYLES,
    REFERENCE,
    label,
    new_figure,
    plain_numbers,
)

SHOWN_PERIODS = 2
SPECTRUM_HZ = (1.0, 20000.0)
SMALLEST_AMPLITUDE_V = 1e-6
# Broad and below the composite line, which it would cover where the model lacks nothing.
EXTENDED = {"color": GREEN, "linestyle": "-", "linewidth": 5.0, "alpha": 0.6, "markersize": 10.0,
            "zorder": 1.5}
TRUE_POSITION = {"color": GREEN, "linestyle": (0, (1, 2)), "linewidth": 1.0,
                 "markerfacecolor": "white"}
MODE_MARKERS = {"open_loop": "s", "feedforward": "^", "composite": "o"}


def draw_errors(entries, entries_after=()):
    """Draw the error e_rms of every mode over the frequency, and the thesis' composite controller.

    The entries are those of `summary.summarise_run`; with the extended model, in `entries_after`,
    only composite is drawn.
    """
    figure = new_figure(4.2)
    axes = figure.subplots()
    for mode, style in MODE_STYLES.items():
        _plot_errors(axes, [e for e in entries if e["mode"] == mode], "e_rms_percent",
                     marker=MODE_MARKERS[mode], **style)
    composite = [e for e in entries if e["mode"] == "composite"]
    after = [e for e in entries_after if e["mode"] == "composite"]
    _plot_errors(axes, after, "e_rms_percent", marker="D", label="composite, extended model",
                 **EXTENDED)
    _plot_errors(axes, after or composite, "e_rms_true_percent", marker="o",
                 label="the same, true position", **TRUE_POSITION)
    _plot_errors(axes, composite, "thesis_e_rms_percent", color=BLACK,
                 linestyle="-.", linewidth=1.0, marker="x", label="thesis, composite (real stage)")
    frequencies = sorted({e["frequency_hz"] for e in entries})
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(frequencies, minor=False)
    axes.minorticks_off()
    plain_numbers(axes.xaxis)
    plain_numbers(axes.yaxis)
    label(axes, "frequency (Hz)", "e_rms (% of peak to peak)")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return figure


def _plot_errors(axes, entries, key, **style):
    points = sorted((e["frequency_hz"], e[key]) for e in entries if e[key] is not None)
    if points:
        axes.plot(*zip(*points, strict=True), **style)


def draw_tracking(runs):
    """Draw reference, displacement and error of the runs of one frequency, by mode."""
    shown, time_ms = _last_periods(next(iter(runs.values())))
    figure = new_figure(2.4 + 1.3 * len(runs))
    above, *below = figure.subplots(1 + len(runs), 1, sharex=True,
                                    height_ratios=(2, *[1] * len(runs)))
    above.plot(time_ms, next(iter(runs.values())).reference_um[shown], **REFERENCE)
    label(above, y="displacement (um)")
    for axes, (mode, run) in zip(below, runs.items(), strict=True):
        style = MODE_STYLES[mode]
        above.plot(time_ms, run.displacement_um[shown], **style)
        error, unit = _scaled(run.error_um[shown])
        axes.axhline(0.0, color=BLACK, linewidth=0.6)
        axes.plot(time_ms, error, color=style["color"], linewidth=0.9)
        label(axes, y=f"error ({unit})", title=str(style["label"]))
    below[-1].set_xlabel("time (ms)")
    figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=4,
                  frameon=False, handlelength=1.6, columnspacing=1.2)
    figure.align_ylabels()
    return figure


def draw_voltages(feedforward_v, feedback_v, run):
    """Draw the feedforward voltage over the last periods, feedback voltage over the whole run."""
    shown, time_ms = _last_periods(run)
    figure = new_figure(4.4)
    above, below = figure.subplots(2, 1)
    above.plot(time_ms, feedforward_v[shown], **FEEDFORWARD)
    label(above, "time (ms), the last periods", "feedforward (V)")
    below.plot(run.time_s, feedback_v, **FEEDBACK)
    label(below, "time (s), the whole run", "feedback (V)")
    figure.align_ylabels()
    return figure


def draw_spectra(feedforward_v, feedback_v, sample_rate_hz):
    """Draw the spectra of the feedforward and the feedback voltage over the whole run."""
    figure = new_figure(3.6)
    axes = figure.subplots()
    for voltage_v, style in ((feedforward_v, FEEDFORWARD), (feedback_v, FEEDBACK)):
        frequency_hz, amplitude_v = amplitude_spectrum(voltage_v, sample_rate_hz)
        axes.loglog(frequency_hz, np.maximum(amplitude_v, SMALLEST_AMPLITUDE_V), **style)
    axes.set(xlim=SPECTRUM_HZ, ylim=(SMALLEST_AMPLITUDE_V, 200.0))
    axes.legend()
    plain_numbers(axes.xaxis)
    label(axes, "frequency (Hz)", "amplitude (V)")
    return figure


def amplitude_spectrum(signal, sample_rate_hz):
    """Return the frequencies and the amplitudes of the sines in a signal, without the mean, (M,).

    A Hann window reduces the leakage of a drift.
    """
    window = np.hanning(len(signal) + 1)[:-1]
    harmonics = np.fft.rfft((signal - signal.mean()) * window)
    amplitude = 2.0 * np.abs(harmonics) / window.sum()
    return np.fft.rfftfreq(len(signal), 1.0 / sample_rate_hz)[1:], amplitude[1:]


def _last_periods(run):
    """Return the slice of the last periods of a run, and their time in ms."""
    count = round(SHOWN_PERIODS * run.sample_rate_hz / run.frequency_hz)
    return slice(-count, None), 1e3 * np.arange(count) / run.sample_rate_hz


def _scaled(error_um):
    """Return an error in um or nm, whichever suits its size, and the unit."""
    return (error_um, "um") if np.abs(error_um).max() > 0.5 else (1e3 * error_um, "nm")
