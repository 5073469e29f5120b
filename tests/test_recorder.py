"""The record of a run: its hash as documented, and a file that restores every number."""

import csv
import hashlib
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.messages.links import LinkSettings
from bus.ticks import detection_rows
from flights import DT, HERE, escort
from outrider.running.flying import InProcess, fly, make_pilots
from sim.engine.monitor import NEVER
from sim.scenario.types import Detections, LinkTable, Scenario
from sim.scenario.vehicle_types import Uav, Ugv
from sim.server import recorder
from sim.server.flight import Flight


@pytest.fixture(scope="module")
def flight() -> Flight:
    """Fly with failed detections and velocities of -0.0."""
    return fly(wobbling(), 6)[0]


def wobbling(**changes: Any) -> Scenario:
    return escort(
        "logarithmic",
        uav=Uav(position=HERE, velocity=(-0.0, -0.0)),
        ugv=Ugv(position=(20.0, 21.0), velocity=(0.0, -0.0), goals=((26.0, 21.0),)),
        detections=Detections(noise=0.1, dropout=0.2, rate=10.0),
        duration=60.0,
        **changes,
    )


def _documented(flight: Flight, ticks: int) -> str:
    """Hash for each tick and vehicle in name order p and v at k, and the command applied during k; -0.0 as 0.0."""
    digest = hashlib.sha256()
    for row in flight.recorder.states[:ticks].tolist():
        for vehicle in row:
            digest.update(
                struct.pack("<6d", *(0.0 if number == 0.0 else number for number in vehicle))
            )
    return digest.hexdigest()


def test_the_hash_is_the_documented_one(flight: Flight) -> None:
    states = flight.recorder.states
    assert (np.signbit(states) & (states == 0.0)).any()
    assert flight.recorder.ticks == 1200
    assert flight.recorder.sha256() == _documented(flight, 1200)
    assert flight.recorder.sha256(ticks=100) == _documented(flight, 100)
    assert flight.recorder.sha256(ticks=10**9) == flight.recorder.sha256()


def test_long_flight_grows_the_arrays_unchanged(flight: Flight, monkeypatch) -> None:
    monkeypatch.setattr(recorder, "_ROOM", 100)
    longer = fly(wobbling(), 6)[0].recorder
    np.testing.assert_array_equal(longer.states, flight.recorder.states)
    np.testing.assert_array_equal(longer.escorts, flight.recorder.escorts)


def test_arrivals_are_detections_with_their_errors() -> None:
    """Compare late, reordered and duplicated detections with the true positions at their ticks."""
    late = LinkSettings(delay=0.3, jitter=0.3, duplicates=0.2, loss=0.2)
    flown = Flight(wobbling(links=LinkTable(detections=late)), 6)
    pilots = InProcess(make_pilots(flown.scenario, 6))
    newest = largest = silent = 0
    while flown.fly_tick(pilots):
        flown.take_down()
        arrival = flown.recorder.arrivals[0]
        detections = detection_rows(flown.world.received(0), DT)
        errors = []
        for taken, x, y in detections:
            (p_x, p_y), (g_x, g_y) = flown.recorder.states[taken, :, :2].tolist()
            errors.append(math.hypot(x - (p_x - g_x), y - (p_y - g_y)))
        assert arrival["newest"] == max((one.taken for one in detections), default=NEVER)
        assert arrival["error"] == pytest.approx(max(errors, default=0.0), abs=1e-12)
        newest, silent = max(newest, len(detections)), silent + (not detections)
        largest = max(largest, arrival["error"])
        if flown.over:
            break
    assert newest > 1
    assert silent > 100
    assert 0.1 < largest <= 0.3


def test_vehicles_are_recorded_in_name_order_with_commands(flight: Flight) -> None:
    assert flight.world.names == ("uav_0", "ugv_0")
    states = flight.recorder.states
    assert states[0, :, :2].tolist() == [[20.0, 20.0], [20.0, 21.0]]
    moved = states[:-1, :, :2] + 0.5 * DT * (states[:-1, :, 2:4] + states[1:, :, 2:4])
    np.testing.assert_allclose(states[1:, :, :2], moved, rtol=1e-13)
    faster = states[:-1, :, 2:4] + DT * states[:-1, :, 4:6]
    below = np.hypot(*np.moveaxis(faster, -1, 0)) < (0.6, 0.2)
    np.testing.assert_allclose(states[1:, :, 2:4][below], faster[below], atol=1e-14)
    assert np.isnan(states[-1, :, 4:6]).all()
    assert not np.isnan(states[:-1]).any()


def test_the_file_gives_back_every_number_exactly(flight: Flight, tmp_path: Path) -> None:
    flight.recorder.write(tmp_path / "trajectory.csv")
    with (tmp_path / "trajectory.csv").open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    found = np.array([[math.nan if field == "" else float(field) for field in row] for row in rows])
    record = flight.recorder
    count = record.rows
    time = np.arange(count) * DT
    wanted = np.column_stack(
        (
            np.arange(count),
            time,
            record.states.reshape(count, -1),
            record.escorts.reshape(count, -1),
        )
    )
    assert found.tobytes() == wanted.tobytes()
    assert len(header) == len(rows[0]) == wanted.shape[1]
    assert header[:4] == ["tick", "time [s]", "uav_0.x [m]", "uav_0.y [m]"]
    assert all(" [" in name for name in header[1:] if name != "uav_0.certified")
    assert "nan" not in (tmp_path / "trajectory.csv").read_text(encoding="utf-8")
