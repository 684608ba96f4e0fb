# SPDX-License-Identifier: BSD-3-Clause
"""Identify a make from its files by the command, and measure the model on unseen motion."""

import argparse
import json
import resource
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import numpy as np

from piezo_identification.commands.diagnose_command import main as diagnose
from piezo_identification.commands.identify_command import main as identify
from piezo_identification.prediction import predict
from piezo_identification.prediction.row_reading import read_as_identified
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import load_model
from piezo_recorder.reading.reader import read_recording
from piezo_studies.other_makes.makes import MAKES
from piezo_studies.other_makes.recordings import IDENTIFICATION, KNOWN, UNSEEN, record

MODEL, DIAGNOSIS, OUTCOME = "model.json", "diagnosis", "outcome.json"
INTERVAL_DEVIATIONS = 1.645
"""Half width of a 90 % interval in standard deviations."""

TIMES_NOISE, LEAST_PERCENT = 3.0, 0.2
"""An error on unseen motion is small if it is below this multiple of the noise, or below this
percentage."""

LAGS = {"amplifier_lag": ("front_lag_s", "time_constant_s"),
        "sensor_lag": ("behind_lag_s", "time_constant_s"), "delay": ("delay_s", "delay_s")}
"""Name of the true value, and name of the parameter, by effect."""


@dataclass(frozen=True)
class Interval:
    """A parameter and its true value."""

    name: str
    true: float

    value: float | None
    deviation: float | None
    """Estimate and standard deviation; None if the model does not have the parameter, or gives no
    interval."""

    @property
    def holds(self) -> bool:
        """Whether the 90 % interval contains the true value."""
        return self.value is not None and self.deviation is not None and (
            abs(self.value - self.true) <= INTERVAL_DEVIATIONS * self.deviation)


@dataclass(frozen=True)
class Outcome:
    """The result for a make."""

    cpu_s: float
    wall_s: float
    """Processor time and wall time of the identification."""
    errors_percent: dict[str, float]
    noise_percent: dict[str, float]
    """Error e_y (4.20) on each unseen motion, and its part from the sensor."""
    inadequate: list[str]
    """Components that are inadequate according to the model file."""
    intervals: list[Interval]

    failure: str = ""
    """Reason if there is no model; empty otherwise."""
    verdict: str = ""
    """Verdict and named effects of the diagnosis of the mixed motion; empty without a diagnosis."""
    diagnosis_cpu_s: float = 0.0

    def is_small(self, motion: str) -> bool:
        """Return whether the error on an unseen motion is near the noise."""
        return self.errors_percent[motion] <= max(
            TIMES_NOISE * self.noise_percent[motion], LEAST_PERCENT)


def failed(failure: str) -> Outcome:
    """Return the outcome of a trial without a model."""
    return Outcome(np.nan, np.nan, {}, {}, [], [], failure)


def run(folder: Path, is_diagnosed: bool) -> Outcome:
    """Identify a make from the recordings in a folder, and predict the unseen motions.

    If `is_diagnosed`, the mixed motion is diagnosed with the model, with the fast one held out.
    Model and diagnosis are written into the folder.
    """
    model = folder / MODEL
    model.unlink(missing_ok=True)
    files = [word for name in IDENTIFICATION for word in (f"--{name}", f"{folder / name}.csv")]
    cpu_s, wall_s = used_cpu_s(), time.perf_counter()
    status = identify([*files, "--output", str(model), "--no-report"])
    cpu_s, wall_s = used_cpu_s() - cpu_s, time.perf_counter() - wall_s
    if status:
        return failed(f"identify ended with status {status}")
    known = json.loads((folder / KNOWN).read_text(encoding="utf-8"))
    identified = load_model(model)
    errors_percent = {name: unseen_error_percent(
        identified, folder / f"{name}.csv", known["recordings"][name]["counted_s"])
        for name in UNSEEN}
    noise_percent = {name: known["recordings"][name]["noise_percent"] for name in UNSEEN}
    verdict, before_s = "", used_cpu_s()
    if is_diagnosed:
        verdict = diagnosed(folder)
    return Outcome(cpu_s, wall_s, errors_percent, noise_percent,
                   [name for name, part in identified.adequacy.items()
                    if part["verdict"] != "adequate"],
                   intervals(identified, known["true"]), verdict=verdict,
                   diagnosis_cpu_s=used_cpu_s() - before_s)


def diagnosed(folder: Path) -> str:
    """Diagnose the mixed motion; return the verdict with the effects that it names."""
    output = folder / DIAGNOSIS
    status = diagnose(["--model", str(folder / MODEL), "--data", str(folder / "mixed.csv"),
                       "--holdout", str(folder / "fast.csv"), "--output", str(output)])
    if status:
        return f"diagnose ended with status {status}"
    document = json.loads((output / "verdict.json").read_text(encoding="utf-8"))
    return " ".join([document["verdict"], *(each["name"] for each in document["effects"])])


def unseen_error_percent(identified: IdentifiedModel, path: Path,
                         counted_s: tuple[float, float]) -> float:
    """Return e_y (4.20) of a recording between two times, with rows aligned to the model."""
    recording, _ = read_as_identified(identified, read_recording(path))
    prediction = predict(identified.model, recording)
    return prediction.e_y_percent((prediction.time_s >= counted_s[0])
                                  & (prediction.time_s <= counted_s[1]))


def intervals(identified: IdentifiedModel, true: dict[str, list[float]]) -> list[Interval]:
    """Compare the parameters of a model with the true ones of a make.

    Each true mode is compared with the mode of the model that is nearest in frequency, in series or
    parallel. A lag or delay with the true value 0 is included only if the model has one.
    """
    modes = modes_of(identified)
    found = []
    for place, frequency in enumerate(true["mode_frequencies_rad_per_s"]):
        nearest = min(modes, key=lambda mode: abs(mode[0][0] - frequency),
                      default=((None, None), (None, None)))
        found += [
            Interval(f"{name}[{place}]", true[name][place], *nearest[number])
            for number, name in enumerate(("mode_frequencies_rad_per_s", "damping_ratios"))]
    lags = lags_of(identified)
    for name in ("front_lag_s", "behind_lag_s", "delay_s"):
        if name in true and (true[name][0] or name in lags):
            found.append(Interval(name, true[name][0], *lags.get(name, (None, None))))
    return found


Estimated = tuple[float, float | None]
"""A value and its standard deviation, which is None if the model gives none."""


def modes_of(identified: IdentifiedModel) -> list[tuple[Estimated, Estimated]]:
    """Return frequency (rad/s) and damping of the modes in series and of those in effects."""
    dynamics = identified.model.dynamics
    spread = identified.uncertainties.get("dynamics", {})

    def in_series(name: str) -> list[Estimated]:
        values = [float(value) for value in getattr(dynamics, name)]
        return list(zip(values, spread.get(name, [None] * len(values)), strict=True))

    return [*zip(in_series("mode_frequencies_rad_per_s"), in_series("damping_ratios"),
                 strict=True),
            *(((numbers["frequency_rad_per_s"], deviations.get("frequency_rad_per_s")),
               (numbers["damping_ratio"], deviations.get("damping_ratio")))
              for name, numbers, deviations in effects_of(identified)
              if name in ("vibration_mode", "coupled_mode"))]


def effects_of(identified: IdentifiedModel) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, parameters and standard deviations of each effect of a model."""
    spreads = chain(identified.uncertainties.get("effects", []), repeat({}))
    for effect, spread in zip(identified.model.effects, spreads, strict=False):
        yield effect.name, effect.parameters(), spread


def lags_of(identified: IdentifiedModel) -> dict[str, Estimated]:
    """Return the lags and the delay that a model has."""
    dynamics = identified.model.dynamics
    found: dict[str, Estimated] = {}
    if dynamics.time_constant_s:
        found["behind_lag_s"] = (dynamics.time_constant_s, identified.uncertainties.get(
            "dynamics", {}).get("time_constant_s"))
    for effect, parameters, deviations in effects_of(identified):
        if effect in LAGS:
            meant, parameter = LAGS[effect]
            found.setdefault(meant, (parameters[parameter], deviations.get(parameter)))
    return found


def used_cpu_s() -> float:
    """Return the processor time of this process and its ended children."""
    return sum(usage.ru_utime + usage.ru_stime for usage in map(
        resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)))


def read_outcome(path: Path) -> Outcome:
    """Read an outcome from its file."""
    document = json.loads(path.read_text(encoding="utf-8"))
    document["intervals"] = [Interval(**each) for each in document["intervals"]]
    return Outcome(**document)


def main(arguments: list[str] | None = None) -> None:
    """Run one trial in this process, and write its outcome into its folder."""
    parser = argparse.ArgumentParser(prog="other_makes.trial", description=__doc__)
    parser.add_argument("--stage", choices=MAKES, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--diagnose", action="store_true")
    parser.add_argument("--cpu-minutes", type=int, required=True)
    options = parser.parse_args(arguments)
    limit_s = 60 * options.cpu_minutes
    resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 10))
    record(MAKES[options.stage](options.seed), options.folder, options.seed)
    outcome = run(options.folder, options.diagnose)
    (options.folder / OUTCOME).write_text(json.dumps(asdict(outcome), indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
