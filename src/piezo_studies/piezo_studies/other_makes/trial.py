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
"""Standard deviations of an interval that holds 90 % of the errors."""

TIMES_NOISE, LEAST_PERCENT = 3.0, 0.2
"""An error on unseen motion is small below so many times the noise, or below so much."""

LAGS = {"amplifier_lag": ("front_lag_s", "time_constant_s"),
        "sensor_lag": ("behind_lag_s", "time_constant_s"), "delay": ("delay_s", "delay_s")}
"""What an effect's parameter is called among what is true."""


@dataclass(frozen=True)
class Interval:
    """A parameter beside what is true.

    Attributes
    ----------
    value, deviation : float or None
        None where the model does not have the parameter, or gives no interval.
    """

    name: str
    true: float
    value: float | None
    deviation: float | None

    @property
    def holds(self) -> bool:
        """Return whether the interval of 90 % has the true value."""
        return self.value is not None and self.deviation is not None and (
            abs(self.value - self.true) <= INTERVAL_DEVIATIONS * self.deviation)


@dataclass(frozen=True)
class Outcome:
    """What came of a make.

    Attributes
    ----------
    cpu_s, wall_s : float
        Time of the processor and of the clock that the identification took.
    errors_percent, noise_percent : dict of str to float
        e_y (4.20) on each unseen motion, and the part of it that is the sensor's.
    inadequate : list of str
        Components that the model file calls inadequate.
    failure : str
        Why there is no model; empty if there is one.
    verdict : str
        Of the diagnosis of the mixed motion, with the effects that it names; empty without one.
    """

    cpu_s: float
    wall_s: float
    errors_percent: dict[str, float]
    noise_percent: dict[str, float]
    inadequate: list[str]
    intervals: list[Interval]
    failure: str = ""
    verdict: str = ""
    diagnosis_cpu_s: float = 0.0

    def is_small(self, motion: str) -> bool:
        """Return whether the error on an unseen motion is near the noise."""
        return self.errors_percent[motion] <= max(
            TIMES_NOISE * self.noise_percent[motion], LEAST_PERCENT)


def failed(failure: str) -> Outcome:
    """Return the outcome of a trial without a model."""
    return Outcome(np.nan, np.nan, {}, {}, [], [], failure)


def run(folder: Path, is_diagnosed: bool) -> Outcome:
    """Identify the make whose recordings a folder has, and predict the unseen motion.

    Parameters
    ----------
    folder : Path
        Of `recordings.record`; the model and the diagnosis are written there.
    is_diagnosed : bool
        Diagnose the mixed motion with the model, and hold the fast one out.
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
    """Return e_y (4.20) of a recording between two instants, read as the model's own were."""
    recording, _ = read_as_identified(identified, read_recording(path))
    prediction = predict(identified.model, recording)
    return prediction.e_y_percent((prediction.time_s >= counted_s[0])
                                  & (prediction.time_s <= counted_s[1]))


def intervals(identified: IdentifiedModel, true: dict[str, list[float]]) -> list[Interval]:
    """Set the parameters of a model beside those that are true.

    Each true mode is compared with that mode of the model which is nearest in frequency, in series
    with others or added as an effect. A lag or delay that is truly zero counts where the model has
    one.

    Parameters
    ----------
    true : dict of str to list of float
        As in `makes.Make`.
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
"""A value and its standard deviation, which is None where the model gives none."""


def modes_of(identified: IdentifiedModel) -> list[tuple[Estimated, Estimated]]:
    """Return frequency (rad/s) and damping of the modes in series and of those that are added."""
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
    """Return the time of the processor that this process and its ended children took."""
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
