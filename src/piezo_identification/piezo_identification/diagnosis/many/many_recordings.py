# SPDX-License-Identifier: BSD-3-Clause
"""Many diagnoses from a table, spread over processes or machines by Dask, and resumable.

Each row of the table is diagnosed into a folder of its own. A row whose model and recordings are
those of the results in its folder, by their SHA-256, is not diagnosed again.
"""

import csv
import hashlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piezo_common.extras import how_to_install
from piezo_recorder.reading.reader import sha256_of

if TYPE_CHECKING:
    from distributed import Client, Future

REQUIRED = ("model", "data")
OPTIONAL = ("holdout", "identified_from", "name", "stage", "recorded")
COLUMNS = (*REQUIRED, *OPTIONAL)
BETWEEN = ";"
"""Stands between the files of one cell."""
CONTENT = "content.json"
"""In the folder of a row: from what its results came."""
CONNECT_S = 10
LONELY_S = 120.0
"""How long a scheduler may be without any worker: one that died is started again within a quarter
of that, and a row may kill four in a row."""
KILLED = "killed"
ASKED_S = 0.5
"""How often it is asked whether there are workers."""


@dataclass(frozen=True)
class DiagnosisRow:
    """A row of the table: what is diagnosed together, and where the results go.

    Attributes
    ----------
    name : str
        Of its folder.
    model : Path
    data, identified_from : tuple of Path
    holdout : Path or None
    directory : Path
        For the results.
    stage : str
        Of a fleet; empty where the table does not say.
    recorded : datetime or None
        When the data were recorded.
    """

    name: str
    model: Path
    data: tuple[Path, ...]
    holdout: Path | None
    identified_from: tuple[Path, ...]
    directory: Path
    stage: str = ""
    recorded: datetime | None = None

    def content(self) -> str:
        """Return the SHA-256 of all that the results depend on."""
        digest = hashlib.sha256(self.model.read_bytes())
        for kind, files in (("data", self.data), ("from", self.identified_from),
                            ("holdout", (self.holdout,) if self.holdout else ())):
            for path in files:
                digest.update(f"{kind} {sha256_of(path)}\n".encode())
        return digest.hexdigest()


def read_table(table: Path, output: Path) -> list[DiagnosisRow]:
    """Read the table of what is to be diagnosed.

    Parameters
    ----------
    table : Path
        CSV with the columns model and data, and if need be `OPTIONAL` ones. Several files in a
        cell have a semicolon between them; relative paths count from the table's folder.
    output : Path
        In which each row gets a folder.

    Raises
    ------
    ValueError
        If a column is missing or not known, a cell is empty, two rows have the same name, or a
        time of recording is none of ISO 8601.
    """
    try:
        with table.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream)
            given, entries = reader.fieldnames or [], list(reader)
    except UnicodeDecodeError:
        raise ValueError(f"{table} is no text: give a CSV with the columns model,data") from None
    missing = [name for name in REQUIRED if name not in given]
    unknown = [name for name in given if name not in COLUMNS]
    if missing or unknown:
        wrong = f"lacks {', '.join(missing)}" if missing else f"has {', '.join(unknown)}"
        raise ValueError(f"the header of {table} {wrong}: its columns are model and data, and if "
                         f"need be {', '.join(OPTIONAL)}")
    rows = [_row(table, number, entry, output) for number, entry in enumerate(entries, start=1)]
    names = [row.name for row in rows]
    for number, name in enumerate(names, start=1):
        if name in names[: number - 1]:
            raise ValueError(f"row {number} of {table} has the name {name}, as one before it: "
                             "give each row a name of its own")
    if not rows:
        raise ValueError(f"{table} has no rows: give one for each recording to diagnose")
    return rows


def _row(table: Path, number: int, entry: dict[str, str | None], output: Path) -> DiagnosisRow:
    def paths(column: str) -> tuple[Path, ...]:
        cell = entry.get(column) or ""
        return tuple((table.parent / each.strip()).absolute()
                     for each in cell.split(BETWEEN) if each.strip())

    for column in REQUIRED:
        if not paths(column):
            raise ValueError(f"row {number} of {table} has no {column}: name the file")
    for column in ("model", "holdout"):
        if len(paths(column)) > 1:
            raise ValueError(f"row {number} of {table} has several files as {column}: give one")
    name = (entry.get("name") or "").strip() or f"{number:03}_{paths('data')[0].stem}"
    if name in (".", "..") or Path(name).name != name:
        raise ValueError(f"row {number} of {table} has the name {name}: give the name of a folder")
    said = (entry.get("recorded") or "").strip()
    try:
        # Without a zone it is of this machine's.
        recorded = datetime.fromisoformat(said).astimezone() if said else None
    except ValueError:
        raise ValueError(f"row {number} of {table} was recorded '{said}': give a day or a time as "
                         "2026-03-04 or 2026-03-04T10:11:12") from None
    return DiagnosisRow(name, paths("model")[0], paths("data"), next(iter(paths("holdout")), None),
                        paths("identified_from"), output.absolute() / name,
                        (entry.get("stage") or "").strip(), recorded)


def diagnose_row(row: DiagnosisRow) -> dict[str, Any]:
    """Diagnose a row unless its results are there already; bad input is told, not raised.

    Returns
    -------
    dict
        `name`, and `verdict`, the content of verdict.json, or `error`; and in `is_new` whether it
        was diagnosed now.
    """
    # In a worker its libraries are imported once, and here not at all where all is done.
    from piezo_identification.diagnosis.report.results import diagnose_files

    verdict, kept = row.directory / "verdict.json", row.directory / CONTENT
    try:
        content = row.content()
        is_new = not (verdict.exists() and _kept(kept) == content)
        if is_new:
            kept.unlink(missing_ok=True)
            diagnose_files(row.model, row.data, row.holdout, row.directory,
                           lambda step, fraction: None, identified_from=row.identified_from)
            kept.write_text(json.dumps({"sha256": content}) + "\n", encoding="utf-8")
        return {"name": row.name, "is_new": is_new,
                "verdict": json.loads(verdict.read_text(encoding="utf-8"))}
    except (ValueError, OSError) as error:
        return {"name": row.name, "is_new": True, "error": str(error)}


def _kept(path: Path) -> str:
    try:
        return str(json.loads(path.read_text(encoding="utf-8"))["sha256"])
    except (OSError, ValueError, KeyError, TypeError):
        return ""


def diagnose_rows(client: "Client", rows: Sequence[DiagnosisRow],
                  progress: Callable[[int], None]) -> list[dict[str, Any]]:
    """Diagnose the rows of a table through Dask.

    Parameters
    ----------
    client : distributed.Client
        Its workers see the same files at the same paths.
    progress : callable
        Called with how many are done.

    Returns
    -------
    list of dict
        Of `diagnose_row`, in the order of the rows. The row of a worker that died goes to another
        one. A row that no worker can do is an error of it: it kills workers again and again, the
        scheduler is gone, or it has no worker for `LONELY_S`.
    """
    results = _diagnose_together(client, rows, progress)
    killed = [number for number, result in enumerate(results) if result.pop(KILLED, False)]
    if len(killed) > 1:
        # Dask blames all that a worker had; alone, only the row that kills it is blamed.
        for number in killed:
            result, = _diagnose_together(client, [rows[number]], lambda done: None)
            result.pop(KILLED, False)
            results[number] = result
    return results


def _diagnose_together(client: "Client", rows: Sequence[DiagnosisRow],
                       progress: Callable[[int], None]) -> list[dict[str, Any]]:
    """Diagnose rows; those after which workers died have `KILLED`."""
    waiting = {number: client.submit(diagnose_row, row, pure=False)
               for number, row in enumerate(rows)}
    results: dict[int, dict[str, Any]] = {}
    alone_since = time.monotonic()
    while waiting and time.monotonic() - alone_since <= LONELY_S:
        if client.nthreads():  # of each worker
            alone_since = time.monotonic()
        _wait_for_one(list(waiting.values()))
        for number, future in list(waiting.items()):
            # What a worker that died had done already is lost, and done again: so it is fetched.
            if future.status == "finished":
                with suppress(TimeoutError, CancelledError):
                    results[number] = future.result(ASKED_S)
            elif future.status in ("error", "cancelled"):
                results[number] = _not_diagnosed(rows[number], _why_not(future), future)
            if number in results:
                del waiting[number]
                future.release()
                progress(len(results))
    why = (f"the scheduler has had no worker for {LONELY_S:g} s; start one with `dask worker "
           "ADDRESS`, and begin again")
    client.cancel(list(waiting.values()))
    return [results[number] if number in results else _not_diagnosed(row, why)
            for number, row in enumerate(rows)]


def _wait_for_one(waiting: "Sequence[Future[Any]]") -> None:
    """Wait until one more row is done, or it is time to ask for workers."""
    from distributed import wait

    # One that the scheduler lost is seen by its status.
    with suppress(TimeoutError, CancelledError):
        wait(waiting, timeout=ASKED_S, return_when="FIRST_COMPLETED")


def _not_diagnosed(row: DiagnosisRow, why: str,
                   future: "Future[Any] | None" = None) -> dict[str, Any]:
    return {"name": row.name, "is_new": True, "error": f"not diagnosed: {why}",
            KILLED: future is not None and _has_killed(future)}


def _has_killed(future: "Future[Any]") -> bool:
    from distributed import KilledWorker

    return future.status == "error" and isinstance(future.exception(), KilledWorker)


def _why_not(future: "Future[Any]") -> str:
    if future.status == "cancelled":
        return "the scheduler is gone; start it, and begin again"
    if _has_killed(future):
        return ("the workers that tried it died, as of too little memory: give them more, or a "
                "shorter recording")
    return str(future.exception())


def cluster_client(scheduler: str | None) -> "Client":
    """Return a client of a Dask scheduler, or of processes of this machine.

    Parameters
    ----------
    scheduler : str or None
        Address, as tcp://host:8786.

    Raises
    ------
    ValueError
        If Dask is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise ValueError(
            "distributed is not installed: "
            f"{how_to_install('dask distributed', 'cluster')}") from None
    try:
        if scheduler:
            return Client(scheduler, timeout=CONNECT_S)
    except OSError as error:
        raise ValueError(f"no scheduler at {scheduler}: {error}") from None
    return Client(LocalCluster(threads_per_worker=1, dashboard_address=None))


def errors_of(results: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield a sentence on each row that could not be diagnosed."""
    for result in results:
        if "error" in result:
            yield f"{result['name']} was skipped: {result['error']}"
