"""Work of `outrider ros2`: a run on topics of ROS 2."""

from bus.keys import SIMULATOR_NAME, Role
from bus.presence import Presence
from bus.session import Session
from outrider.cli.console import ERR, print_json
from outrider.cli.stopping import Stop
from outrider.cli.waiting import AWAY, RouterTimer, print_waiting
from outrider.view.operator import RunClient
from outrider_ros2.observing import RosObserver
from outrider_ros2.ros_commands import RosCommands
from outrider_ros2.ros_node import RosNode


def observe(
    session: Session, stop: Stop, *, domain: int, namespace: str, every_tick: bool
) -> tuple[RosObserver, bool]:
    """Publish until the run ends or the user stops it; return the observer and True if the router disconnected."""
    node = RosNode(session, domain=domain, name="outrider", namespace=namespace)
    observer = RosObserver(session, node, namespace=namespace, every_tick=every_tick)
    client = None
    if session.party.role is Role.OPERATOR:
        client = RunClient(session, read=())
        observer.commands = RosCommands(
            node, client, namespace=namespace, refusals=observer.refusals
        )
    try:
        return observer, _follow(session, observer, stop)
    finally:
        if observer.commands is not None and client is not None:
            observer.commands.hand_back()
            client.close()
        observer.close()
        node.close()


def _follow(session: Session, observer: RosObserver, stop: Stop) -> bool:
    simulator, router = Presence(session, SIMULATOR_NAME), RouterTimer(session)
    announced = False
    while not stop:
        observer.step(0.2)
        over = observer.status is not None and observer.status.over
        if router.has_gone():
            return not over
        if over and simulator.absent_for() > AWAY:
            return False
        if not announced and observer.status is None:
            announced = True
            print_waiting(session.run)
    return False


def print_counts(
    observer: RosObserver, domain: int, *, lost: bool, every_tick: bool, json: bool
) -> None:
    """Print the number of published messages and rejections."""
    found = {
        "domain": domain,
        "topics": observer.topics,
        "missing_ticks": observer.missing_ticks,
        "commands": observer.commands.accepted if observer.commands else 0,
        "refused": dict(observer.refusals.counts),
        "router_lost": lost,
    }
    if json:
        print_json(found)
    else:
        sent = sum(observer.topics.values())
        missing = f", {observer.missing_ticks} ticks missing" if every_tick else ""
        ERR.tell(f"{sent} messages on {len(observer.topics)} topics{missing}")
