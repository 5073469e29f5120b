"""Folder of a sweep: its definition and the results so far, consistent after a kill at any time.

Every finished task, of about a second, is written to a Parquet file in `parts/`, under a temporary name that is changed
at the end. When the sweep is complete, all files are merged into `results.parquet`. A kill loses only the runs in
progress.
"""

import fcntl
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Self

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from bus.errors import ScenarioError
from bus.files import UNFINISHED, read_regular, write_whole
from outrider.experiments.sweep.definition import Sweep
from outrider.experiments.sweep.plan import MOST_RUNS, SweepPlan
from sim.input.faults import one_line

HEAD = "sweep.json"
FILE = "sweep.toml"
RESULTS = "results.parquet"
PARTS = "parts"
_LOCK = ".lock"
_MOST_PARTS = 200
"""Number of small files that are merged into one, as each takes a millisecond to read."""
_MOST_HEAD, _MOST_TABLE = 4 << 20, 1 << 30
"""Largest sizes of a head and of a table with results [bytes]."""
_BATCH = 1000
"""Number of rows unpacked at once."""


class SweepHead(msgspec.Struct, frozen=True, kw_only=True):
    """Head of a folder: identifies the sweep, and describes its table."""

    outrider: str
    """Version of Outrider that made the folder."""
    command: str
    digest: str
    runs: int
    columns: dict[str, str]
    sweep: Sweep


def read_head(folder: Path) -> SweepHead | None:
    """Read a folder's head; return None if the folder does not belong to a sweep.

    Raises:
        ScenarioError: If the head is damaged.
    """
    try:
        head = msgspec.json.decode(read_regular(folder / HEAD, _MOST_HEAD), type=SweepHead)
        schema_of(head.columns)
    except FileNotFoundError:
        return None
    except (msgspec.MsgspecError, RecursionError, ValueError) as error:
        raise _damaged(folder, str(error)) from error
    varied = {field for block in head.sweep.block for field in block.vary}
    if varied - head.columns.keys():
        raise _damaged(folder, f"no column {min(varied - head.columns.keys())!r}")
    return head


def _damaged(folder: Path, why: str) -> ScenarioError:
    return ScenarioError(f"{folder / HEAD}: damaged: {one_line(why)}; start again with --fresh")


def _write_table(path: Path, table: pa.Table) -> None:
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    write_whole(path, sink.getvalue().to_pybytes())


def _read_table(path: Path, columns: dict[str, str]) -> pa.Table:
    remedy = "delete the file to fly its runs again"
    content = pa.BufferReader(read_regular(path, _MOST_TABLE))
    try:  # without Arrow's threads, which may abort a process at its exit (apache/arrow#34314)
        table = _unpacked(path, pq.ParquetFile(content, pre_buffer=False), columns)
    except pa.ArrowException as error:
        reason = " ".join(str(error).split()).rstrip(".")
        raise ScenarioError(f"{path}: damaged: {reason}; {remedy}") from error
    return table


def _unpacked(path: Path, file: pq.ParquetFile, columns: dict[str, str]) -> pa.Table:
    """Return the table of a file; its size is checked before and while it is unpacked.

    Raises:
        ScenarioError: If the table has other columns, or too many rows or bytes.
    """
    if not file.schema_arrow.equals(schema_of(columns)):
        raise ScenarioError(
            f"{path}: columns of another sweep; delete the file to fly its runs again"
        )
    rows, size = file.metadata.num_rows, 0
    if rows > MOST_RUNS:
        raise ScenarioError(f"{path}: {rows:,} rows; allowed: {MOST_RUNS:,} at most")
    batches = []
    for batch in file.iter_batches(_BATCH, use_threads=False):
        size += batch.nbytes
        if size > _MOST_TABLE:
            raise ScenarioError(f"{path}: too large; allowed: {_MOST_TABLE >> 30} GiB unpacked")
        batches.append(batch)
    return pa.Table.from_batches(batches, schema=file.schema_arrow)


def schema_of(columns: dict[str, str]) -> pa.Schema:
    """Return the Parquet schema of a sweep's table."""
    return pa.schema([(name, pa.type_for_alias(kind)) for name, kind in columns.items()])


def read_results(folder: Path, columns: dict[str, str]) -> dict[str, list[Any]]:
    """Return all rows of a folder by column, in the order of run numbers; the sweep may be unfinished.

    Args:
        folder: Folder of a sweep.
        columns: Columns from its head.

    Raises:
        ScenarioError: If a file is damaged.
    """
    paths = (folder / RESULTS, *sorted((folder / PARTS).glob("*.parquet")))
    tables = [_read_table(path, columns) for path in paths if path.exists()]
    if not tables:
        return {name: [] for name in columns}
    table = pa.concat_tables(tables)
    runs, errors = table["run"].to_pylist(), table["error"].to_pylist()
    best: dict[int, int] = {}
    # A run may occur twice: in a part that is merged already, or after a failure.
    for k, run in enumerate(runs):
        if run not in best or errors[best[run]] is not None:
            best[run] = k
    found: dict[str, list[Any]] = table.take([best[run] for run in sorted(best)]).to_pydict()
    return found


class SweepFolder:
    """Folder of a sweep in progress, locked against other writers.

    Args:
        path: Path of the folder; created if missing.
        plan: Plan of the sweep.
        command: Command line that started the sweep.
        text: Text of the sweep's file, stored beside the results.
        fresh: True: delete existing results.

    Raises:
        ScenarioError: If the folder holds another sweep or other files, or is in use.
        OSError: If the folder cannot be written.
    """

    def __init__(
        self, path: Path, plan: SweepPlan, *, command: str, text: str = "", fresh: bool = False
    ) -> None:
        self.path, self._plan = path, plan
        self._columns = plan.columns
        # Files other than these imply that there is a head.
        has_files = path.is_dir() and any(
            entry.name not in (_LOCK, FILE) and not entry.name.endswith(UNFINISHED)
            for entry in path.iterdir()
        )
        if has_files and not (path / HEAD).exists():
            raise ScenarioError(f"{path}: not empty and not a sweep's folder; choose another --out")
        path.mkdir(parents=True, exist_ok=True)
        self._lock = (path / _LOCK).open("w")
        self._rows: dict[int, tuple[bool, bool]] = {}
        """Run numbers, each with two flags: the run failed, the UGV was out of sight."""
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if fresh:
                self._clear()
            self._claim(command, text)
            self.count_rows()
        except BlockingIOError as error:
            self.close()
            raise ScenarioError(f"{path}: in use by another sweep; choose another --out") from error
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def count_rows(self) -> None:
        """Read the existing rows, and remove files that a kill has left incomplete."""
        for left in self.path.rglob(f"*{UNFINISHED}"):
            left.unlink()
        found = read_results(self.path, self._columns)
        kept = zip(found["run"], found["error"], found["violated"], strict=True)
        self._rows = {run: (error is not None, bool(violated)) for run, error, violated in kept}
        self._number = max((int(part.stem) for part in self._parts()), default=0)

    def _clear(self) -> None:
        """Delete the sweep; its head last, so that the folder stays identifiable after a kill."""
        if (self.path / HEAD).exists():
            shutil.rmtree(self.path / PARTS, ignore_errors=True)
            for name in (RESULTS, FILE, HEAD):
                (self.path / name).unlink(missing_ok=True)

    def _claim(self, command: str, text: str) -> None:
        """Write the head of a new folder, or check that the folder belongs to this sweep."""
        plan, head = self._plan, read_head(self.path)
        if head is None:
            if text:
                write_whole(self.path / FILE, text.encode())
            head = SweepHead(
                outrider=plan.version,
                command=command,
                digest=plan.digest,
                runs=plan.runs,
                columns=plan.columns,
                sweep=plan.sweep,
            )
            write_whole(
                self.path / HEAD, msgspec.json.format(msgspec.json.encode(head), indent=2) + b"\n"
            )
        elif head.outrider != plan.version:
            made = f"made by Outrider {head.outrider}, this is {plan.version}"
            raise ScenarioError(
                f"{self.path}: {made}; choose another --out, or start again with --fresh"
            )
        elif head.digest != plan.digest:
            raise ScenarioError(
                f"{self.path}: holds another sweep; choose another --out, or start again with --fresh"
            )
        self.path.joinpath(PARTS).mkdir(exist_ok=True)

    def _parts(self) -> list[Path]:
        return sorted((self.path / PARTS).glob("*.parquet"))

    @property
    def done(self) -> set[int]:
        """Numbers of the successful runs."""
        return {run for run, (failed, _) in self._rows.items() if not failed}

    @property
    def failed(self) -> int:
        """Number of runs that failed."""
        return sum(failed for failed, _ in self._rows.values())

    @property
    def violated(self) -> int:
        """Number of runs in which the UGV was out of sight."""
        return sum(violated for _, violated in self._rows.values())

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self._rows)

    def add(self, results: Iterable[dict[str, Any]]) -> None:
        """Write the results of some runs; after the call, a kill does not lose them.

        Args:
            results: Results, each with its run number.
        """
        rows = [{**self._plan.head(result["run"]), **result} for result in results]
        self._write_part(pa.Table.from_pylist(rows, schema=schema_of(self._columns)))
        self._rows |= {
            row["run"]: (row["error"] is not None, bool(row["violated"])) for row in rows
        }
        if self._number % _MOST_PARTS == 0:
            # Merge the small files; a kill in between leaves rows twice, which reading handles.
            parts = self._parts()[-_MOST_PARTS:]
            self._write_part(pa.concat_tables([_read_table(part, self._columns) for part in parts]))
            for part in parts:
                part.unlink()

    def _write_part(self, table: pa.Table) -> None:
        """Write a table as the next part."""
        self._number += 1
        _write_table(self.path / PARTS / f"{self._number:08d}.parquet", table)

    def finish(self) -> Path:
        """Merge everything into one file."""
        parts = self._parts()
        if parts:
            table = pa.table(
                read_results(self.path, self._columns), schema=schema_of(self._columns)
            )
            _write_table(self.path / RESULTS, table)
            for part in parts:
                part.unlink()
        return self.path / RESULTS

    def close(self) -> None:
        """Release the lock."""
        self._lock.close()
