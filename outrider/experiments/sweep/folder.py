"""Folder of a sweep: its definition and the results so far, consistent after a kill at any time.

The rows of each finished task, of about a second, are appended to `results.jsonl`. When the sweep is complete, they are
merged into `results.parquet`. A kill loses only the runs in progress.
"""

import fcntl
import json
import logging
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader
from itertools import islice
from pathlib import Path
from typing import Any, Self

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from bus.errors import ScenarioError
from bus.files import UNFINISHED, open_regular, read_regular, write_whole, writing
from outrider.experiments.sweep.definition import Sweep
from outrider.experiments.sweep.plan import MOST_RUNS, SweepPlan
from sim.input.faults import one_line

_LOG = logging.getLogger("outrider.sweep")
HEAD = "sweep.json"
FILE = "sweep.toml"
RESULTS = "results.parquet"
ROWS = "results.jsonl"
"""Rows that are not merged yet, one JSON object per line; infinite numbers as Python's `json` writes them."""
_LOCK = ".lock"
_MOST_HEAD, _MOST_LINE, _MOST_TABLE = 4 << 20, 1 << 20, 1 << 30
"""Largest sizes of a head, of a line and of a table with results [bytes]."""
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


def _read_table(path: Path, columns: dict[str, str]) -> pa.Table:
    """Return the table of a Parquet file."""
    content = pa.BufferReader(read_regular(path, _MOST_TABLE))
    with _damage(path):
        # without Arrow's threads, which may abort a process at its exit (apache/arrow#34314)
        file = pq.ParquetFile(content, pre_buffer=False)
        if not file.schema_arrow.equals(schema_of(columns)):
            raise ValueError("columns of another sweep")
        _check_size(file.metadata.num_rows, 0)
        return _table_of(file.iter_batches(_BATCH, use_threads=False), columns)


def _read_rows(path: Path, columns: dict[str, str], on_notice: Callable[[str], None]) -> pa.Table:
    """Return the table of a JSONL file.

    A damaged last line is skipped with a notice: a kill may leave one, and a sweep in progress may be writing one.
    """

    def rows(file: BufferedReader) -> Iterator[dict[str, Any]]:
        while line := file.readline(_MOST_LINE):
            try:
                row = json.loads(line) if line.endswith(b"\n") else None
            except (ValueError, RecursionError):
                row = None
            if isinstance(row, dict) and row.keys() == columns.keys() and type(row["run"]) is int:
                yield row
            elif file.read(1):
                raise ValueError("a line that is no row of this sweep")
            else:
                on_notice(f"{path}: damaged last line skipped; its run counts as missing")

    with _damage(path), open_regular(path) as file:
        schema, lines = schema_of(columns), rows(file)
        parts = iter(lambda: list(islice(lines, _BATCH)), [])
        return _table_of((pa.RecordBatch.from_pylist(part, schema) for part in parts), columns)


def _drop_last_line(path: Path) -> None:
    with path.open("r+b") as file:
        begin = max(0, file.seek(0, os.SEEK_END) - _MOST_LINE)
        file.seek(begin)
        file.truncate(begin + file.read()[:-1].rfind(b"\n") + 1)


def _table_of(batches: Iterable[pa.RecordBatch], columns: dict[str, str]) -> pa.Table:
    """Return the table of some batches; its size is checked while they are unpacked."""
    kept, rows, size = [], 0, 0
    for batch in batches:
        rows, size = rows + batch.num_rows, size + batch.nbytes
        _check_size(rows, size)
        kept.append(batch)
    return pa.Table.from_batches(kept, schema=schema_of(columns))


def _check_size(rows: int, size: int) -> None:
    if rows > MOST_RUNS:
        raise ValueError(f"{rows:,} rows; allowed: {MOST_RUNS:,} at most")
    if size > _MOST_TABLE:
        raise ValueError(f"too large; allowed: {_MOST_TABLE >> 30} GiB unpacked")


@contextmanager
def _damage(path: Path) -> Iterator[None]:
    """Report a file that cannot be read as damaged."""
    try:
        yield
    except (pa.ArrowException, ValueError, TypeError, OverflowError) as error:
        reason = one_line(" ".join(str(error).split()).rstrip("."))
        remedy = "delete the file to fly its runs again"
        raise ScenarioError(f"{path}: damaged: {reason}; {remedy}") from error


def schema_of(columns: dict[str, str]) -> pa.Schema:
    """Return the Parquet schema of a sweep's table."""
    return pa.schema([(name, pa.type_for_alias(kind)) for name, kind in columns.items()])


def read_results(
    folder: Path, columns: dict[str, str], on_notice: Callable[[str], None] = _LOG.warning
) -> dict[str, list[Any]]:
    """Return all rows of a folder by column, in the order of run numbers; the sweep may be unfinished.

    Args:
        folder: Folder of a sweep.
        columns: Columns from its head.
        on_notice: Called with one line for the user, if a row is skipped.

    Raises:
        ScenarioError: If a file is damaged.
    """
    tables: list[pa.Table] = []
    with suppress(FileNotFoundError):  # first, as a sweep that finishes meanwhile moves its rows
        tables.append(_read_rows(folder / ROWS, columns, on_notice))
    with suppress(FileNotFoundError):
        tables.insert(0, _read_table(folder / RESULTS, columns))
    if not tables:
        return {name: [] for name in columns}
    table = pa.concat_tables(tables)
    runs, errors = table["run"].to_pylist(), table["error"].to_pylist()
    best: dict[int, int] = {}
    # A run may occur twice: in rows that are merged already, or after a failure.
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
        on_notice: Called with one line for the user, if a row is skipped.

    Raises:
        ScenarioError: If the folder holds another sweep or other files, or is in use.
        OSError: If the folder cannot be written.
    """

    def __init__(
        self,
        path: Path,
        plan: SweepPlan,
        *,
        command: str,
        text: str = "",
        fresh: bool = False,
        on_notice: Callable[[str], None] = _LOG.warning,
    ) -> None:
        self.path, self._plan, self._on_notice = path, plan, on_notice
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
        """Read the existing rows, and remove what a kill has left incomplete."""
        for left in self.path.rglob(f"*{UNFINISHED}"):
            left.unlink()
        notices: list[str] = []
        found = read_results(self.path, self._columns, notices.append)
        kept = zip(found["run"], found["error"], found["violated"], strict=True)
        self._rows = {run: (error is not None, bool(violated)) for run, error, violated in kept}
        for line in notices:
            _drop_last_line(self.path / ROWS)
            self._on_notice(line)

    def _clear(self) -> None:
        """Delete the sweep; its head last, so that the folder stays identifiable after a kill."""
        if (self.path / HEAD).exists():
            for name in (ROWS, RESULTS, FILE, HEAD):
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
        # a row as the table will hold it: all its columns, with Python's numbers
        plain = pa.Table.from_pylist(rows, schema=schema_of(self._columns)).to_pylist()
        path = self.path / ROWS
        with writing(path), path.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(row) + "\n" for row in plain)
            file.flush()
            os.fsync(file.fileno())
        self._rows |= {
            row["run"]: (row["error"] is not None, bool(row["violated"])) for row in rows
        }

    def finish(self) -> Path:
        """Merge all rows into one file."""
        rows = self.path / ROWS
        if rows.exists():
            found, sink = read_results(self.path, self._columns), pa.BufferOutputStream()
            table = pa.table(found, schema=schema_of(self._columns))
            pq.write_table(table, sink, compression="zstd")
            write_whole(self.path / RESULTS, sink.getvalue().to_pybytes())
            rows.unlink()
        return self.path / RESULTS

    def close(self) -> None:
        """Release the lock."""
        self._lock.close()
