"""Compilation of all that the simulator needs, before a run."""

from bus.messages.ground import MapUpdate
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.vehicle import BackupTrajectory
from sim.scenario.types import Scenario
from sim.server.flight import Flight

_BUSY = LinkSettings(delay=0.4, jitter=0.3, bandwidth=5.0, queue=1)


def warm_up(scenario: Scenario) -> None:
    """Compile or load all that a run compiles, using a temporary world.

    Covers link changes during the run, with messages in queues and in transit.
    """
    flight = Flight(scenario, scenario.seed)
    world, links = flight.world, flight.world.links
    objects = (LinkKind.RADIO, LinkKind.OPERATOR)
    carried = [row for row, (kind, _) in enumerate(links.names) if kind in objects]
    flight.take_down()
    if scenario.has_ground:
        block = MapUpdate(row=0, column=0, tiles=world.known_block(0, 0, 0))
        for ugv in scenario.ugv:
            world.receive_block(world.names.index(ugv.name), block)
    for settings in (_BUSY, LinkSettings()):
        for kind in LinkKind:
            flight.degrade(kind, None, settings)
        for _ in range(3):
            flight.observations()
            for k in range(len(world.names)):
                trajectory = BackupTrajectory(begins=world.tick, parent=-1, acceleration=(0.0, 0.0))
                world.send(k, world.tick, (0.0, 0.0), (trajectory,))
            for row in carried:
                for _ in range(3):
                    links.send_object(row, world.tick + 1, None, world.tick)
            flight.apply({})
    flight.take_down()
    flight.answers.end()
