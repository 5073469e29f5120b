"""Traces: Mahimahi files of delivery opportunities, and tables with each message's sent time and delay.

A scenario contains the file itself, so that every copy of the scenario replays the same link. It is converted to whole
ticks and milliseconds; only the position at which a run starts is random.
"""

import csv
import functools
import hashlib
import io
import math
import zlib
from array import array
from collections.abc import Iterator, Sequence
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from bus.errors import ScenarioError
from bus.messages.base import Text
from bus.messages.links import LinkSettings
from bus.numbers import exact
from sim.compiling.compile import FloatArray, IntArray
from sim.input.faults import Fault, shown

MOST_BYTES = 50 << 20
"""Maximum size of a trace file [bytes]."""
MOST_LINES = 1_000_000
TRACE_RULE = "a Mahimahi file (a whole number of ms a line) or a CSV table with the columns sent [s] and delay [s]"
OPPORTUNITY = 1500
"""Bytes that can leave at each line of a Mahimahi file."""

_DRAWN = ("jitter", "loss", "burst_length", "blackout_interval", "duplicates", "reorder")
_LONGEST_TIME = 1e12
"""Largest time in a trace [s], and in a Mahimahi file [ms]: whole nanoseconds stay exact."""


class RecordedLink(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """File of a trace, as read with the scenario."""

    name: Text
    """Name of the trace, as in `links.<kind>.trace`."""
    sha256: Annotated[str, Meta(pattern=r"^[0-9a-f]{64}$(?!\n)")]
    """SHA-256 of the file."""
    content: bytes
    """Content of the file, compressed by zlib; base64 in TOML and JSON."""


class Fates(NamedTuple):
    """Table of messages with sent times and delays. Shapes (rows,)."""

    sent: FloatArray
    """Time since the first message was sent [s], increasing."""
    delay: FloatArray
    """Delay [s]; NaN: lost."""

    @property
    def duration(self) -> float:
        """Duration of the table [s]: the last row lasts as long as the gap before it."""
        gaps = np.diff(self.sent)
        last = gaps[gaps > 0.0][-1:]
        return float(self.sent[-1] + last.sum())


class Opportunities(NamedTuple):
    """Delivery opportunities of a Mahimahi file."""

    times: IntArray
    """Times at which 1,500 bytes can leave [ms], increasing; the last is the period. Shape (lines,)."""


LinkRecording = Fates | Opportunities


def pack(name: str, data: bytes) -> RecordedLink:
    """Return the trace for a file's content, in the form stored in a scenario."""
    digest = hashlib.sha256(data).hexdigest()
    return RecordedLink(name=name, sha256=digest, content=zlib.compress(data, 9))


def unpack(recorded: RecordedLink, *, where: str) -> bytes:
    """Return the content of the file.

    Raises:
        ScenarioError: If it differs from the packed content.
    """
    inflater = zlib.decompressobj()
    try:
        data = inflater.decompress(recorded.content, MOST_BYTES + 1)
    except zlib.error as error:
        raise ScenarioError(f"{where}: damaged: {error}; allowed: {TRACE_RULE}") from error
    if hashlib.sha256(data).hexdigest() != recorded.sha256:
        raise ScenarioError(
            f"{where}: damaged: not the content with SHA-256 {recorded.sha256}; allowed: {TRACE_RULE}"
        )
    return data


@functools.lru_cache(maxsize=16)
def recording_of(recorded: RecordedLink) -> LinkRecording:
    """Return the decoded trace.

    Raises:
        ScenarioError: If it is invalid.
    """
    where = f"trace {recorded.name}"
    return read_recording(unpack(recorded, where=where), where=where)


def read_recording(data: bytes, *, where: str) -> LinkRecording:
    """Read a trace of either form.

    Args:
        data: Content of the file.
        where: Prefix of error messages.

    Raises:
        ScenarioError: One line with the line, its value, what is wrong and what is allowed.
    """
    if len(data) > MOST_BYTES:
        raise ScenarioError(f"{where}: larger than {MOST_BYTES >> 20} MiB; allowed: {TRACE_RULE}")
    if data.count(b"\n") > MOST_LINES + 1:
        wrong = f"more than {MOST_LINES:,} rows"
        raise ScenarioError(f"{where}: {wrong}; allowed: {TRACE_RULE}")
    if b"\0" in data:
        raise ScenarioError(f"{where}: not text but binary; allowed: {TRACE_RULE}")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ScenarioError(
            f"{where}: byte {error.start}: not text in UTF-8; allowed: {TRACE_RULE}"
        ) from error
    first = next((line for _, line in _lines(text)), None)
    if first is None:
        raise ScenarioError(f"{where}: empty; allowed: {TRACE_RULE}")
    try:
        return _opportunities(text) if first.isdecimal() else _fates(text)
    except _Wrong as error:
        raise error.fault.error(where) from None


class _Wrong(Exception):
    def __init__(self, line: int, value: object, wrong: str, allowed: str) -> None:
        self.fault = Fault(f"line {line}", value, wrong, allowed)


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield the lines with their numbers, except empty lines and comments."""
    for number, line in enumerate(io.StringIO(text), 1):
        content = line.strip()
        if content and not content.startswith("#"):
            yield number, content


def _opportunities(text: str) -> Opportunities:
    times, before = array("q"), 0
    for number, line in _lines(text):
        if not (line.isascii() and line.isdecimal() and len(line) <= 12):
            raise _Wrong(number, line, "not a whole number of ms", TRACE_RULE)
        time = int(line)
        if time < before:
            raise _Wrong(number, time, f"before {before}", "non-decreasing times, in ms")
        times.append(time)
        before = time
    if before == 0:
        raise _Wrong(1, 0, "the recording lasts 0 ms", "a last line above 0 ms")
    found: IntArray = np.array(times, dtype=np.int64)
    at_start = int(
        np.searchsorted(found, 1)
    )  # the start of a period is the end of the previous one
    return Opportunities(np.concatenate([found[at_start:], np.full(at_start, before)]))


def _fates(text: str) -> Fates:
    sent, delay, columns, before = array("d"), array("d"), dict[str, int](), -math.inf
    number = 0

    def numbered_lines() -> Iterator[str]:
        nonlocal number
        for at, line in _lines(text):
            number = at
            yield line

    try:
        for cells in csv.reader(numbered_lines()):
            if not columns:
                columns = _columns(cells, number)
                continue
            if len(cells) <= max(columns.values()):
                raise _Wrong(number, ",".join(cells), "too few cells", "as many as in the header")
            time, took = _seconds(cells[columns["sent"]], number, "sent"), math.nan
            if time < before:
                raise _Wrong(number, time, f"sent before {exact(before)} s", "non-decreasing times")
            if cells[columns["delay"]].strip().lower() not in ("", "lost"):
                took = _seconds(cells[columns["delay"]], number, "delay")
                if took < 0.0:
                    raise _Wrong(number, took, "a negative delay", "0 s or more, or lost")
            sent.append(time)
            delay.append(took)
            before = time
    except csv.Error as error:
        raise _Wrong(number, None, f"not CSV: {error}", TRACE_RULE) from error
    if not sent:
        raise _Wrong(number, None, "a header without rows", "one row or more")
    times: FloatArray = np.array(sent)
    return Fates(times - times[0], np.array(delay))


def _columns(cells: list[str], number: int) -> dict[str, int]:
    """Return the indices of the columns sent and delay; their names may include a unit."""
    found = {cell.strip().lower().removesuffix("[s]").strip(): k for k, cell in enumerate(cells)}
    if not {"sent", "delay"} <= found.keys():
        raise _Wrong(number, ",".join(cells), "not a trace", TRACE_RULE)
    return {name: found[name] for name in ("sent", "delay")}


def _seconds(cell: str, number: int, name: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not abs(value) <= _LONGEST_TIME:
        rule = "a time in s" + (", empty or lost" if name == "delay" else "")
        raise _Wrong(number, cell, f"{name} is not a time", rule)
    return value


def found(traces: Sequence[RecordedLink], name: str) -> RecordedLink | None:
    """Return the trace with this name; None if it is not among these."""
    return next((one for one in traces if one.name == name), None) if name else None


def longest_recorded(settings: LinkSettings, traces: Sequence[RecordedLink]) -> float:
    """Return the longest delay in the table that a link replays, in addition to `delay` [s]; 0 without a table."""
    recorded = found(traces, settings.trace)
    recording = None if recorded is None else recording_of(recorded)
    if not isinstance(recording, Fates) or np.isnan(recording.delay).all():
        return 0.0
    return float(np.nanmax(recording.delay))


def trace_faults(
    settings: LinkSettings, path: str, traces: Sequence[RecordedLink]
) -> Iterator[Fault]:
    """Yield the reasons why a link cannot replay its trace, alone or with its other settings."""
    if not settings.trace:
        return
    recorded = found(traces, settings.trace)
    if recorded is None:
        known = ", ".join(shown(one.name) for one in traces) or "none"
        wrong = "not among the traces that were read with the scenario"
        yield Fault(f"{path}trace", settings.trace, wrong, known)
        return
    table = isinstance(recording_of(recorded), Fates)
    rejected = (*_DRAWN, "bandwidth") if table else ("bandwidth",)
    what = "a table of delays" if table else "a Mahimahi file"
    allowed = "delay and blackouts" if table else "all but bandwidth"
    for field in rejected:
        if getattr(settings, field):
            yield Fault(
                f"{path}{field}",
                getattr(settings, field),
                f"cannot be combined with {what}",
                f"0; {allowed} can be combined",
            )


def first_ticks(recording: Fates, delay: float, dt: float, tolerance: float) -> IntArray:
    """Return the table in ticks: rows (first tick, delay in ticks; -1: lost). Shape (rows, 2).

    Args:
        recording: The table.
        delay: Fixed delay, added to each [s].
        dt: Duration of a tick [s].
        tolerance: Share of a tick by which a time may exceed a tick and still count as this tick.
    """
    start = np.ceil(recording.sent / dt - tolerance).astype(np.int64)
    took = np.ceil((recording.delay + delay) / dt - tolerance)
    rows = np.stack([start, np.where(np.isnan(took), -1.0, took).astype(np.int64)], axis=1)
    last = np.append(start[1:] != start[:-1], True)
    kept: IntArray = rows[last]  # of several rows for one tick, keep the last
    return kept
