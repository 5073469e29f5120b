"""Flights along an autopilot in simulated time; a small vehicle model, or none, stands in for a real one."""

from test_mavlink import Station, select
from vehicle_model import HOVER, heartbeat, position_report

from flights import flown_by
from outrider.running.summary import summarize
from outrider_mavlink.autopilot import AutopilotPilot
from outrider_mavlink.autopilot_link import AutopilotLink
from outrider_mavlink.udp import Address, Network
from sim.scenario.loading import load_scenario

DECLARED = 0.3
"""Declared bound of the tracking error [m]."""
CHANGES = (
    "law.name=certified",
    "uav.0.body=reported",
    f"certificate.max_tracking_error={DECLARED}",
    "detections.dropout=0",
)


class Autopilot(Station):
    """Flies a vehicle model, or is always at its setpoint, and reports its state."""

    def __init__(self, link, port, model=None):
        super().__init__(link, number=42)
        self.mav.srcComponent = 1
        self.to, self.model = ("127.0.0.1", port), model
        self.boot, self.place, self.velocity = 0, HOVER, (0.0, 0.0)
        self.setpoints, self.requests = [], []

    def report(self, **changes):
        self.boot += 50
        message = position_report(self.boot, self.place, self.velocity)
        for field, value in changes.items():
            setattr(message, field, value)
        return message

    def live(self, time, *, moves=True, reports=True):
        """Receive setpoints, fly up to a time [s], and report."""
        arrived = self.arrived()
        self.requests += select(arrived, "COMMAND_LONG")
        wanted = select(arrived, "SET_POSITION_TARGET_LOCAL_NED")
        self.setpoints += wanted
        if self.model is not None:
            for one in wanted:
                self.model.command(one)
            self.model.advance(time)
            self.place = (*self.model.position, self.model.down)
            self.velocity = tuple(self.model.velocity)
        elif not moves:
            self.velocity = (0.0, 0.0)
        elif wanted:
            one = wanted[-1]
            self.place, self.velocity = (one.x, one.y, one.z), (one.vx, one.vy)
        if reports:
            self.socket.sendto(self.report().pack(self.mav), self.to)


class Along:
    """A flight in this process with an autopilot, both in simulated time."""

    def __init__(self, *changes, model=None, duration=15.0):
        given = [*CHANGES, f"duration={duration}", *changes]
        self.scenario = load_scenario("escort", overrides=given)
        self.now = 0.0
        self.network = Network(listen=[Address("127.0.0.1", 0)])
        self.link = AutopilotLink(self.network, lambda: self.now)
        port = self.network._links[0].socket.getsockname()[1]
        self.autopilot = Autopilot(self.link, port, model)
        self.pilot = AutopilotPilot(self.link)
        self.reports = []

    def fly(
        self, each_tick=lambda _tick: None, *, moves=lambda _tick: True, reports=lambda _tick: True
    ):
        arrived = self.autopilot.send(heartbeat(), self.autopilot.report())
        self.autopilot.requests += select(arrived, "COMMAND_LONG")

        def act(seen):
            self.now = seen.time
            each_tick(seen.tick)
            self.link.turn(0.0)
            command = self.pilot.act(seen)
            self.reports.append(command.report)
            self.pilot.prepare()
            self.link.refresh()
            after = (seen.tick + 1) * self.scenario.dt
            self.autopilot.live(after, moves=moves(seen.tick), reports=reports(seen.tick))
            return command

        return flown_by(self.pilot, self.scenario, act)

    def close(self):
        self.network.close()
        self.autopilot.socket.close()


def flown_with(model, *changes, duration=15.0, **events):
    """Fly with a vehicle model; return the flight, its summary, and the pilot."""
    along = Along(*changes, model=model, duration=duration)
    flight = along.fly(**events)
    along.close()
    return flight, summarize(flight, seconds=1.0), along.pilot


def kept(summary):
    """Return whether no counter shows an error in the certificate."""
    return (summary.certified_while_lost, summary.certificate_broken) == (0, 0)


def uav_of(flight):
    return flight.world.names.index("uav_0")
