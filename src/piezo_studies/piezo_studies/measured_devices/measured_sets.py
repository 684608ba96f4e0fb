# SPDX-License-Identifier: BSD-3-Clause
"""Public sets of measured data: files, source, licence, and how to obtain them."""

from dataclasses import dataclass
from pathlib import Path

from piezo_studies.measured_devices.further_sets import PLAYER_ARM, ROBOT_ARM, TANKS
from piezo_studies.measured_devices.measured import (
    CANTILEVER,
    MAJOR_LOOPS,
    NANOPOSITIONER,
    NESTED_LOOPS,
)
from piezo_studies.measured_devices.mirror import FILES as MIRROR_FILES
from piezo_studies.measured_devices.oscillators import (
    ARROW,
    BOUC_WEN,
    BOUC_WEN_MULTISINE,
    BOUC_WEN_SWEEP,
    CIRCUIT,
)

NO_LICENCE = "none known that lets others redistribute it"
DAISY = "https://homes.esat.kuleuven.be/~smc/daisy"
COLUMNS = "columns time_s, voltage_v, displacement_um"


@dataclass(frozen=True)
class MeasuredSet:
    """Files of one device below the directory of the measured sets."""

    name: str

    files: tuple[str, ...]
    """Required files, relative to the directory of the measured sets."""
    source: str
    licence: str
    fetch: str
    """Source, licence, and how to obtain the files, for messages."""

    def missing(self, directory: Path) -> str | None:
        """Return a message about the first missing file; None if all are present."""
        absent = next((name for name in self.files if not (directory / name).is_file()), None)
        if absent is None:
            return None
        return (f"skipped {self.name}: {directory / absent} is not there. Source: {self.source}; "
                f"licence: {self.licence}; to fetch: {self.fetch}")


SETS = tuple(MeasuredSet(*each) for each in (
    ("scanner", (NESTED_LOOPS, MAJOR_LOOPS), "x axis of a piezo scanner of an AFM, by its owners",
     NO_LICENCE, "ask the owners"),
    ("cantilever", (CANTILEVER,), "a piezo cantilever, by its owners", NO_LICENCE,
     "ask the owners"),
    ("nanopositioner", (NANOPOSITIONER,), "a flexure nanopositioner, by its owners", NO_LICENCE,
     "ask the owners"),
    ("the circuit", (CIRCUIT, ARROW), "https://www.nonlinearbenchmark.org/benchmarks/silverbox",
     NO_LICENCE, f"{COLUMNS}, from the Python package nonlinear-benchmarks"),
    ("Bouc-Wen", (BOUC_WEN, BOUC_WEN_MULTISINE, BOUC_WEN_SWEEP),
     "https://www.nonlinearbenchmark.org/benchmarks/bouc-wen", NO_LICENCE,
     f"{COLUMNS}, from that page"),
    ("steering mirror", MIRROR_FILES, "https://github.com/merijnfloren/fsm-benchmark-data",
     "CC BY 4.0", "the folder data of that repository, as fine_steering_mirror"),
    ("cascaded tanks", (TANKS,), "https://www.nonlinearbenchmark.org/benchmarks/cascaded-tanks",
     NO_LICENCE, "dataBenchmark.csv of that page, in cascaded_tanks"),
    ("robot arm", (ROBOT_ARM,), f"{DAISY}, set 96-009", NO_LICENCE,
     "robot_arm.dat of that page, in robot_arm"),
    ("CD player's arm", (PLAYER_ARM,), f"{DAISY}, set 96-007", NO_LICENCE,
     "CD_player_arm.dat of that page, in cd_player_arm"),
))
