"""A sweep's folder: what was asked for, and the results so far, which a kill at any time leaves whole.

Every finished task of about a second is a Parquet file of its own in `parts/`, written beside it and renamed. The
end merges all of them into `results.parquet`. So a kill loses the runs in flight and no others.
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

HEAD = "sweep.json"
FILE = "sweep.toml"
RESULTS = "results.parquet"
PARTS = "parts"
_LOCK = ".lock"
_MOST_PARTS = 200
"""Beyond so many small files they are merged into one: reading them takes a millisecond each."""
_MOST_HEAD, _MOST_TABLE = 4 << 20, 1 << 30
"""Of a head and of a table with results [bytes]."""
_BATCH = 1000
"""Rows that are unpacked at once."""


class SweepHead(msgspec.Struct, frozen=True, kw_only=True):
    """The head of a folder: enough to tell it from another sweep's, and to report on it."""

    outrider: str
    """The version that made it."""
    command: str
    digest: str
    runs: int
    columns: dict[str, str]
    sweep: Sweep


def read_head(folder: Path) -> SweepHead | None:
    """Read a folder's head; None where it is no sweep's.

    Raises:
        ScenarioError: If its head is damaged.
    """
    try:
        return msgspec.json.decode(read_regular(folder / HEAD, _MOST_HEAD), type=SweepHead)
    except FileNotFoundError:
        return None
    except msgspec.MsgspecError as error:
        raise ScenarioError(
            f"{folder / HEAD}: damaged: {error}; --fresh starts the sweep over"
        ) from error


def _write_table(path: Path, table: pa.Table) -> None:
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    write_whole(path, sink.getvalue().to_pybytes())


def _read_table(path: Path, columns: dict[str, str]) -> pa.Table:
    remedy = "delete it and its runs are flown again"
    content = pa.BufferReader(read_regular(path, _MOST_TABLE))
    try:  # without Arrow's threads: at the end of a process they may abort it (apache/arrow#34314)
        table = _unpacked(path, pq.ParquetFile(content, pre_buffer=False), columns)
    except pa.ArrowException as error:
        reason = " ".join(str(error).split()).rstrip(".")
        raise ScenarioError(f"{path}: damaged: {reason}; {remedy}") from error
    return table


def _unpacked(path: Path, file: pq.ParquetFile, columns: dict[str, str]) -> pa.Table:
    """Return the table of a file, whose size is checked before it is unpacked.

    Raises:
        ScenarioError: If it has other columns, or too many rows or bytes.
    """
    if not file.schema_arrow.equals(schema_of(columns)):
        raise ScenarioError(
            f"{path}: has not the columns of this sweep; delete it and its runs are flown again"
        )
    rows, size = file.metadata.num_rows, 0
    if rows > MOST_RUNS:
        raise ScenarioError(f"{path}: {rows:,} rows; allowed: {MOST_RUNS:,} at most")
    batches = []
    for batch in file.iter_batches(_BATCH, use_threads=False):
        size += batch.nbytes
        if size > _MOST_TABLE:
            raise ScenarioError(f"{path}: unpacks to more than {_MOST_TABLE >> 30} GiB")
        batches.append(batch)
    return pa.Table.from_batches(batches, schema=file.schema_arrow)


def schema_of(columns: dict[str, str]) -> pa.Schema:
    """The Parquet schema of a sweep's table."""
    return pa.schema([(name, pa.type_for_alias(kind)) for name, kind in columns.items()])


def read_results(folder: Path, columns: dict[str, str]) -> dict[str, list[Any]]:
    """All rows of a folder, finished or not, column by column, in the order of their numbers.

    Args:
        folder: A sweep's.
        columns: From its head.

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
    # a run may be there twice: a part that is merged already, or one that first failed
    for k, run in enumerate(runs):
        if run not in best or errors[best[run]] is not None:
            best[run] = k
    found: dict[str, list[Any]] = table.take([best[run] for run in sorted(best)]).to_pydict()
    return found


class SweepFolder:
    """The folder of a sweep that is being flown; nobody else writes into it meanwhile.

    Args:
        path: Is made if it is not there.
        plan: What is flown.
        command: That began it.
        text: Of the sweep's file, kept beside the results.
        fresh: Whether to start over if there is something.

    Raises:
        ScenarioError: If it holds another sweep or other files, or is in use.
        OSError: If it cannot be written.
    """

    def __init__(
        self, path: Path, plan: SweepPlan, *, command: str, text: str = "", fresh: bool = False
    ) -> None:
        self.path, self._plan = path, plan
        self._columns = plan.columns
        # all there can be before there is a head
        there = path.is_dir() and any(
            entry.name not in (_LOCK, FILE) and not entry.name.endswith(UNFINISHED)
            for entry in path.iterdir()
        )
        if there and not (path / HEAD).exists():
            raise ScenarioError(f"{path}: not empty, and no sweep's folder; choose another --out")
        path.mkdir(parents=True, exist_ok=True)
        self._lock = (path / _LOCK).open("w")
        self._rows: dict[int, tuple[bool, bool]] = {}
        """Of each run whether it failed, and whether the UGV was lost."""
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if fresh:
                self._clear()
            self._claim(command, text)
            self.take_stock()
        except BlockingIOError as error:
            self.close()
            raise ScenarioError(f"{path}: another sweep is writing there now") from error
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def take_stock(self) -> None:
        """See what is there, and remove what a kill has left half written."""
        for left in self.path.rglob(f"*{UNFINISHED}"):
            left.unlink()
        begun = read_results(self.path, self._columns)
        kept = zip(begun["run"], begun["error"], begun["violated"], strict=True)
        self._rows = {run: (error is not None, bool(violated)) for run, error, violated in kept}
        self._number = max((int(part.stem) for part in self._parts()), default=0)

    def _clear(self) -> None:
        """Throw a sweep away; its head goes last, so that after a kill nobody takes the rest for another's."""
        if (self.path / HEAD).exists():
            shutil.rmtree(self.path / PARTS, ignore_errors=True)
            for name in (RESULTS, FILE, HEAD):
                (self.path / name).unlink(missing_ok=True)

    def _claim(self, command: str, text: str) -> None:
        """Make sure that the folder is this sweep's."""
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
            made = f"made by outrider {head.outrider}, this is {plan.version}"
            raise ScenarioError(
                f"{self.path}: {made}; choose another --out, or start over with --fresh"
            )
        elif head.digest != plan.digest:
            raise ScenarioError(
                f"{self.path}: holds another sweep; choose another --out, or start over with --fresh"
            )
        self.path.joinpath(PARTS).mkdir(exist_ok=True)

    def _parts(self) -> list[Path]:
        return sorted((self.path / PARTS).glob("*.parquet"))

    @property
    def done(self) -> set[int]:
        """Numbers of the runs that are flown and did not fail."""
        return {run for run, (failed, _) in self._rows.items() if not failed}

    @property
    def failed(self) -> int:
        """Number of runs that failed."""
        return sum(failed for failed, _ in self._rows.values())

    @property
    def violated(self) -> int:
        """In how many runs the UGV was lost from sight."""
        return sum(violated for _, violated in self._rows.values())

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self._rows)

    def add(self, results: Iterable[dict[str, Any]]) -> None:
        """Keep the results of some runs; when this returns, a kill does not lose them.

        Args:
            results: Each with its run's number.
        """
        rows = [{**self._plan.head(result["run"]), **result} for result in results]
        self._keep(pa.Table.from_pylist(rows, schema=schema_of(self._columns)))
        self._rows |= {
            row["run"]: (row["error"] is not None, bool(row["violated"])) for row in rows
        }
        if self._number % _MOST_PARTS == 0:
            # one file of several small ones; a kill in between leaves rows twice, which reading mends
            parts = self._parts()[-_MOST_PARTS:]
            self._keep(pa.concat_tables([_read_table(part, self._columns) for part in parts]))
            for part in parts:
                part.unlink()

    def _keep(self, table: pa.Table) -> None:
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
        """Let others write there."""
        self._lock.close()
