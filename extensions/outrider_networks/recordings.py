"""Recorded links in all formats: Mahimahi, CSV, rosbag2 and captures."""

from pathlib import Path

import msgspec

from bus.errors import ScenarioError
from bus.files import open_regular
from outrider_networks.message_times import MessageTimes, table_of
from outrider_networks.source import Source
from sim.channel.recorded import Fates, RecordedLink, recording_of
from sim.input.faults import one_line
from sim.scenario.recordings import read_link

_CAPTURES = tuple(map(bytes.fromhex, ("a1b2c3d4", "d4c3b2a1", "a1b23c4d", "4d3cb2a1", "0a0d0d0a")))
"""First bytes of pcap files, of both byte orders and resolutions, and of pcapng files."""


def read_source(source: Source) -> tuple[RecordedLink, tuple[str, ...]]:
    """Read a recorded link; convert a bag or captures to a table.

    Returns:
        The link, and what its format cannot show.

    Raises:
        ScenarioError: If it cannot be read, or an option belongs to another format.
    """
    name = one_line(str(source.file))
    if source.file.is_dir():
        _check(source, name, "a bag", "topic")
        from outrider_networks.bags import bag_times  # noqa: PLC0415 - an extra

        return _table(bag_times(source.file, source.topic), source.file)
    if _is_capture(source.file):
        _check(source, name, "a capture", "received", "port")
        if source.received is None:
            raise ScenarioError(
                f"{name}: one capture does not show delays; allowed: with --received, the capture at the receiver"
            )
        from outrider_networks.captures import capture_times  # noqa: PLC0415 - an extra

        return _table(capture_times(source.file, source.received, source.port), source.file)
    recorded = msgspec.structs.replace(read_link(str(source.file), name), name=source.file.name)
    if isinstance(recording_of(recorded), Fates):
        _check(source, name, "a table")
    else:
        _check(source, name, "a Mahimahi file", "rate", "message_bytes")
    return recorded, ()


def _table(times: MessageTimes, file: Path) -> tuple[RecordedLink, tuple[str, ...]]:
    return table_of(times, one_line(file.resolve().name)), times.notes


def _is_capture(file: Path) -> bool:
    try:
        with open_regular(file) as opened:
            return opened.read(4) in _CAPTURES
    except (OSError, ValueError):
        return False  # the reader reports it


def _check(source: Source, name: str, what: str, *allowed: str) -> None:
    """Check that the options belong to the format.

    Raises:
        ScenarioError: If one does not.
    """
    for field in ("received", "topic", "port", "rate", "message_bytes"):
        value = getattr(source, field)
        if value not in (None, "") and field not in allowed:
            options = " and ".join(f"--{one.replace('_', '-')}" for one in allowed)
            option = f"--{field.replace('_', '-')} {one_line(str(value))}"
            wrong = f"not for {what}, {name}"
            raise ScenarioError(f"{option}: {wrong}; allowed: {options or 'no option of a format'}")
