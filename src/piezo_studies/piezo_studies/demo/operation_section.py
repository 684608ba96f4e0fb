# SPDX-License-Identifier: BSD-3-Clause
"""The demo's second part in the report and on the terminal."""

from piezo_common.report_page import Section
from piezo_identification.diagnosis.joint.probabilities import LISTED


def operation_sections(operation):
    """Return the sections of the report on the results of `operation.second_part`."""
    monitor = operation["monitor"]
    return [*([] if monitor is None else [_monitor_section(monitor)]),
            _decision_section(operation["decision"])]


def format_operation(operation):
    """Return one line of text for each of the two results of `operation.second_part`."""
    lines, monitor, decision = [], operation["monitor"], operation["decision"]
    if monitor is not None:
        lines.append(
            f"monitor: a mode became faster at {monitor['change_s']:.1f} s, suspected since "
            f"{monitor['since_s']:.1f} s; with the model offered e_rms "
            f"{monitor['e_rms_before_percent']:.3f} -> {monitor['e_rms_after_percent']:.3f} %")
    after = (f"after one recording {_listed(decision['after'])}" if decision["experiment"]
             else "sure without a recording")
    lines.append(f"decision on {decision['hidden']}: {_listed(decision['before'])}; {after}")
    return "\n".join(lines)


def _monitor_section(monitor):
    return Section(
        "A change while the stage tracks",
        ("Behind the second rest the second mode of the stage became faster by 3 %, while it "
         "tracked tones of 50, 400 and 750 Hz with the extended model. The node `monitor` ran the "
         f"model in parallel. The change was at {monitor['change_s']:.1f} s of the stage's time; "
         f"the monitor suspects it since {monitor['since_s']:.1f} s.",
         f"It diagnosed in the background, and offered a model: {monitor['sentence']}. `track` "
         "took it between two runs, when it was accepted."),
        [["", "before", "after"],
         ["residual of the model, RMS nm", *(f"{1e3 * monitor[name]:.1f}" for name in (
             "before_rms_um", "after_rms_um"))],
         ["tracking error e_rms by the sensor, %", *(f"{monitor[name]:.3f}" for name in (
             "e_rms_before_percent", "e_rms_after_percent"))]])


def _decision_section(decision):
    names = list({**decision["before"], **decision["after"]})
    rows = [["what the model lacks", "probability before", "after one recording"]]
    for name in names:
        values = [part.get(name) for part in (decision["before"], decision["after"])]
        if any(value is not None and value >= LISTED for value in values):
            rows.append([name, *("-" if value is None else f"{value:.3f}" for value in values)])
    played = (f"What was played: {decision['experiment']}." if decision["experiment"]
              else "The first diagnosis was sure, and nothing was played.")
    return Section(
        "A recording that decides",
        (f"The stage got {decision['hidden']}, hidden from the identification, and followed a scan "
         "line. The action `diagnose` was called with `experiments: 1`: where explanations remain, "
         "it designs the recording that decides between them, plays it, and diagnoses again.",
         f"{played} {decision['decision'].capitalize()}. {decision['sentence']} The whole "
         "diagnosis is in `decision/diagnosis/report.html`."),
        rows)


def _listed(probabilities):
    shown = sorted(probabilities.items(), key=lambda entry: -entry[1])[:3]
    return ", ".join(f"{name} {value:.2f}" for name, value in shown)
