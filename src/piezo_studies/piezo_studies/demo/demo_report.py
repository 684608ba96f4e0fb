# SPDX-License-Identifier: BSD-3-Clause
"""The report of the demo: text, tables and figures of the results."""

import shlex
from dataclasses import dataclass

from piezo_common.report_page import Section, pictured, render_page
from piezo_identification.prediction import predict
from piezo_identification.report.component_evidence import component_evidence
from piezo_identification.report.identification_pictures import (
    bode_picture,
    density_picture,
    fit_picture,
)
from piezo_identification.report.simulation_report import prediction_pictures
from piezo_models.model_file import load_model
from piezo_recorder.reading.reader import read_recording
from piezo_studies.demo import tracking_pictures
from piezo_studies.demo.extended_model_section import extended_model_sections
from piezo_studies.demo.summary import table_rows
from piezo_studies.demo.tracked_run import read_tracked_run

TITLE = "A piezo stage, identified and controlled"
SHOWN_EXPERIMENTS = "creep", "dynamics", "validation"


def render_report(plant, command, sections):
    """Return the report as one HTML page."""
    return render_page(TITLE, _introduction(plant, command), sections)


@dataclass(frozen=True, eq=False)
class DrawnRuns:
    """The runs with the identified model, and the sections of the report on them."""

    errors: dict
    """Errors of the model on unseen data, by name."""
    runs: list
    sections: list


def draw_runs(errors, model, recordings, tracks, directory):
    """Read the identified model, recordings of `SHOWN_EXPERIMENTS` and runs, and draw them."""
    runs = [read_tracked_run(track) for track in tracks]
    read = dict(zip(SHOWN_EXPERIMENTS, map(read_recording, recordings), strict=True))
    return drawn_runs(errors, load_model(model), read, runs, directory)


def drawn_runs(errors, identified, recordings, runs, directory):
    """Draw runs and recordings already read; see `draw_runs`."""
    return DrawnRuns(errors, runs, [
        _identification_section(errors, identified, recordings, directory),
        *(_frequency_section(frequency_hz, [run for run in runs
                                            if run.frequency_hz == frequency_hz])
          for frequency_hz in sorted({run.frequency_hz for run in runs})),
    ])


def report_sections(summary, drawn, extended):
    """Return the sections of the report on the first part of the demo; see `summary.summarise`."""
    return [
        _errors_section(summary), *drawn.sections,
        *extended_model_sections(summary, drawn.runs, extended),
        _measures_section(summary),
    ]


def _introduction(plant, command):
    return (
        "A simulated stage was identified from its own measurements. It then followed sines, "
        "controlled with the identified model.",
        plant.sentence,
        "A diagnostic recording was searched for effects missing from the model, the model was "
        "extended by them, and the stage followed the same sines again. Stage, recorder, "
        "identification and controller ran as separate ROS 2 nodes in lockstep: the speed of the "
        "machine changes no number except the speed itself.",
        f"All numbers and pictures come from one run of `{command}`. The recordings, the model and "
        "the numbers (`summary.json`) lie next to this page.",
    )


def _errors_section(summary):
    return Section(
        "Tracking errors",
        ("Each run lasts one second after an approach. Before it the stage was at its lowest "
         "voltage, then at rest for a minute of its own time: no run inherits the creep of "
         "another. The table gives e_rms, the RMS of the error over the reference's "
         "peak-to-peak value, by the sensor; the thesis' figure; e_rms of the simulator's true "
         "position; e_rms by the sensor with the mean error removed; and the largest error by "
         "the sensor.",
         "Open loop divides the reference by the gain of the stage over the whole range. "
         "Feedforward inverts the identified model, but repeats one period throughout: the creep "
         "within the run stays in its error as a drift. Composite adds the feedback.",
         "The thesis' figures were measured on a real stage, ours on a simulated one: they show "
         "the order of magnitude. A dash stands where the thesis gives none."),
        table_rows(summary),
        (pictured("Errors over frequency", tracking_pictures.draw_errors(
                      summary["tracking"], summary["tracking_after"]),
                  "Tracking error of each mode over the frequency; that of composite also "
                  "with the extended model. The distance between hollow and full circles is the "
                  "sensor's noise.", closer=True),))


def _identification_section(errors, identified, recordings, directory):
    creep, dynamics = component_evidence(
        identified, {name: recordings[name] for name in ("creep", "dynamics")})
    rows = [["error on unseen data", "%"],
            *([_words(name), f"{value:.3f}"] for name, value in errors.items())]
    return Section(
        "Identification",
        ("The model is a Preisach hysteresis, then creep, then electric and vibration dynamics. "
         "The table gives e_y, the norm of the difference over the norm of the measured "
         "displacement without its mean, on a recording that no parameter was fitted to: the "
         "whole of it, its slow part (hysteresis) and its fast part (dynamics). The first again: "
         f"`{_first_again(directory)}`.",),
        rows,
        (*prediction_pictures(predict(identified.model, recordings["validation"])),
         density_picture(identified), fit_picture(creep), fit_picture(dynamics),
         bode_picture(identified, dynamics)))


def _first_again(directory):
    return shlex.join(["./run", "piezo_identification", "simulate", "--model",
                       f"{directory}/model.json", "--data", f"{directory}/validation"])


def _frequency_section(frequency_hz, runs):
    by_mode = {run.mode: run for run in runs}
    name = f"{frequency_hz:g} Hz"
    run = by_mode["composite"]
    feedforward_v = by_mode["feedforward"].voltage_v
    feedback_v = run.voltage_v - feedforward_v
    return Section(
        f"{name}, {run.amplitude_um:g} um peak to peak about {run.centre_um:g} um",
        pictures=(
            pictured(f"Tracking at {name}", tracking_pictures.draw_tracking(by_mode),
                     "The last periods of the runs by the sensor, and the error of each on a scale "
                     "of its own.", tall=True, closer=True),
            pictured(f"Voltages at {name}",
                     tracking_pictures.draw_voltages(feedforward_v, feedback_v, run),
                     "The feedforward carries the trajectory, the feedback the slow remainder. The "
                     "feedback is what composite adds to the voltage of feedforward.", closer=True),
            pictured(f"Spectra at {name}", tracking_pictures.draw_spectra(
                         feedforward_v, feedback_v, run.sample_rate_hz),
                     "Spectra of both voltages over the whole run, through a Hann window. The "
                     "feedback changes once a millisecond, so its spectrum repeats around "
                     "multiples of 1 kHz; the inverse hysteresis that it passes shapes it in "
                     "between.", closer=True)))


def _measures_section(summary):
    closed = [entry for entry in summary["tracking"] if entry["mode"] == "composite"]
    missed = sum(entry["missed_feedback"] for entry in closed)
    return Section(
        "The closed loop's speed",
        (f"The composite runs went at {summary['lockstep_ratio']:.2f} simulated seconds per second "
         "of the clock on the wall, by the times at which the recorder received the blocks from "
         "the first of the loop to the last. The stage evaluated the feedback that the controller "
         f"had uploaded. Ticks without an answer: {missed}.",))


def _words(name):
    return {"e_y_percent": "whole recording", "hysteresis_e_y_percent": "slow part (hysteresis)",
            "dynamics_e_y_percent": "fast part (dynamics)"}.get(name, name.replace("_", " "))
