"""`outrider record track.csv --format csv`: positions of the vehicles, one per line."""

from bus.messages.telemetry import Truth


class CsvSink:
    """Recorder of the true states; `outrider.recording.observer.RunSink` documents the methods."""

    next_start = 0.0

    def __init__(self, path):
        self._file = path.open("x", encoding="utf-8")
        self._file.write("time,vehicle,x,y\n")

    def begin(self, head, scenario):
        pass

    def take(self, topic, message, seconds):
        if isinstance(message, Truth):
            for name, vehicle in message.vehicles.items():
                x, y = vehicle.position
                self._file.write(f"{seconds},{name},{x},{y}\n")

    def flush_if_due(self):
        self._file.flush()

    def close(self):
        self._file.close()
