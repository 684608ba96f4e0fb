# SPDX-License-Identifier: BSD-3-Clause
"""Many diagnoses from a table, distributed over processes or machines by Dask, and resumable.

Each row of the table is diagnosed into its own folder. A row is not diagnosed again if the results
in its folder come from the same model and recordings, compared by SHA-256.
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
"""Separator of the files in a cell."""
CONTENT = "content.json"
"""File in the folder of a row that identifies the data of its results."""
CONNECT_S = 10
LONELY_S = 120.0
"""Time in s that a scheduler may have no worker: a worker that died is restarted within a quarter
of it, and a row may kill four in succession."""
KILLED = "killed"
ASKED_S = 0.5
"""Interval in s of the checks for workers."""


@dataclass(frozen=True)
class DiagnosisRow:
    """A row of the table: what is diagnosed together, and the folder for the results."""

    name: str
    """Name of its folder."""
    model: Path
    data: tuple[Path, ...]
    holdout: Path | None
    identified_from: tuple[Path, ...]

    directory: Path
    """Folder for the results."""
    stage: str = ""
    """Stage of a fleet; empty if the table does not contain it."""
    recorded: datetime | None = None
    """Time at which the data were recorded."""

    def content(self) -> str:
        """Return the SHA-256 of all files on which the results depend."""
        digest = hashlib.sha256(self.model.read_bytes())
        for kind, files in (("data", self.data), ("from", self.identified_from),
                            ("holdout", (self.holdout,) if self.holdout else ())):
            for path in files:
                digest.update(f"{kind} {sha256_of(path)}\n".encode())
        return digest.hexdigest()


def read_table(table: Path, output: Path) -> list[DiagnosisRow]:
    """Read the table of recordings to diagnose.

    It is a CSV with the columns model and data, and optionally those of `OPTIONAL`. Several files
    in a cell are separated by semicolons; relative paths are relative to the table's folder.
    `output` contains the folder of each row. Raise ValueError if a column is missing or unknown, a
    cell is empty, two rows have the same name, or a time of recording is not in ISO 8601 format.
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
    text = (entry.get("recorded") or "").strip()
    try:
        # A time without a zone is local.
        recorded = datetime.fromisoformat(text).astimezone() if text else None
    except ValueError:
        raise ValueError(f"row {number} of {table} was recorded '{text}': give a day or a time as "
                         "2026-03-04 or 2026-03-04T10:11:12") from None
    return DiagnosisRow(name, paths("model")[0], paths("data"), next(iter(paths("holdout")), None),
                        paths("identified_from"), output.absolute() / name,
                        (entry.get("stage") or "").strip(), recorded)


def diagnose_row(row: DiagnosisRow) -> dict[str, Any]:
    """Diagnose a row unless its results exist; input errors are returned, not raised.

    Return `name`, and either `verdict`, the content of verdict.json, or `error`; `is_new` is True
    if it was diagnosed now.
    """
    # A worker imports the libraries once; they are not needed here if all rows are done.
    from piezo_identification.diagnosis.report.diagnosis_results import diagnose_files

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
    """Return the results of `diagnose_row` for the rows of a table, in their order, through Dask.

    The workers of the client have the same files at the same paths. `progress` is called with the
    number of finished rows. The row of a worker that died is given to another one. It becomes an
    error if it kills workers repeatedly, if the scheduler is gone, or if there is no worker for
    `LONELY_S`.
    """
    results = _diagnose_together(client, rows, progress)
    killed = [number for number, result in enumerate(results) if result.pop(KILLED, False)]
    if len(killed) > 1:
        # Dask blames all rows of a worker; run alone, only the row that kills it is blamed.
        for number in killed:
            result, = _diagnose_together(client, [rows[number]], lambda done: None)
            result.pop(KILLED, False)
            results[number] = result
    return results


def _diagnose_together(client: "Client", rows: Sequence[DiagnosisRow],
                       progress: Callable[[int], None]) -> list[dict[str, Any]]:
    """Diagnose rows; the results of those whose workers died have `KILLED`."""
    waiting = {number: client.submit(diagnose_row, row, pure=False)
               for number, row in enumerate(rows)}
    results: dict[int, dict[str, Any]] = {}
    alone_since = time.monotonic()
    while waiting and time.monotonic() - alone_since <= LONELY_S:
        if client.nthreads():  # of each worker
            alone_since = time.monotonic()
        _wait_for_one(list(waiting.values()))
        for number, future in list(waiting.items()):
            # Results are fetched at once, because those of a worker that dies later are lost.
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
    """Wait until another row is done, or until the next check for workers."""
    from distributed import wait

    # A row that the scheduler lost shows in its status.
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
    """Return a client of a Dask scheduler (as tcp://host:8786), or of processes of this machine.

    Raise ValueError if Dask is not installed, or the scheduler does not respond.
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
