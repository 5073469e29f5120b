"""Runs in containers, with disturbances.

Builds the image; flies, kills, pauses and disconnects containers; tries forbidden access.

    make compose-test

Exit code 0: all checks hold; 1: one does not; 77: there is no Docker engine with Compose here, so nothing was checked.
It publishes two ports, the dashboard's and MAVLink's, to this machine alone, writes only to a temporary folder, and
removes every container, network, volume and image that it has made.
"""

import argparse
import contextlib
import http.client
import json
import os
import re
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
NO_ENGINE = 77
RUN = "flight"
LONG = "1000"  # simulated time [s]: some ten seconds of wall time, long enough to disturb the run
ENDLESS = "100000"
LARGEST = 1000  # largest size of the image [MB]
PAGE_LARGEST = 150  # largest additional size of the dashboard's image [MB]
MAVLINK_LARGEST = 150  # largest additional size of the MAVLink bridge's image [MB]
STATION = bytes.fromhex("fd09000000ffbe0000000000000006080004033d48")
"""The HEARTBEAT of a ground station, MAVLink 2: a bridge sends to each address that has sent one."""
# for a package mirror
PIP_SETTINGS = {
    "PIP_INDEX_URL": "index-url",
    "PIP_TRUSTED_HOST": "trusted-host",
}
Json = dict[str, Any]
UP = ("up", "--exit-code-from", "simulator")

# Scripts that run inside the containers, where the project's packages are installed.
FOLLOW = """
import os, sys, time
from pathlib import Path
from bus.credentials import read_credentials
from bus.keys import STATUS, Party, Role
from bus.joining import open_session
given = read_credentials(Path(os.environ["OUTRIDER_CREDENTIALS"]))
observer = Party(role=Role.OBSERVER, name="observer")
with open_session(observer, given.run, connect="tcp/127.0.0.1:17447", credential=given.of("observer")) as session:
    inbox, limit = session.inbox(STATUS), time.monotonic() + 40
    while time.monotonic() < limit:
        envelope = inbox.receive(1.0)
        if envelope is not None and envelope.message.tick >= int(sys.argv[1]):
            sys.exit(0)
sys.exit("the flight has not come to tick " + sys.argv[1])
"""
CLIENT = """
import json, os, sys, time
from pathlib import Path
import zenoh
from bus.access import client_settings
from bus.credentials import read_credential
zenoh.init_log_from_env_or("off")
def client(endpoint, known, seconds=2.0):
    settings = {
        "mode": "client", "scouting/multicast/enabled": False, "connect/timeout_ms": int(1000 * seconds),
        "connect/exit_on_failure": True, "connect/endpoints": [endpoint],
    }
    config = zenoh.Config()
    for setting, value in (settings | known).items():
        config.insert_json5(setting, json.dumps(value))
    return zenoh.open(config)
"""
LISTEN = (
    CLIENT
    + """
name, password, seconds, spoiled, *keys = sys.argv[1:]
if password == "own":
    credentials = json.load(open(os.environ["OUTRIDER_CREDENTIALS"]))
    password = next(party for party in credentials.get("parties", [credentials]) if party["name"] == name)["password"]
known = {"transport/auth/usrpwd/user": name, "transport/auth/usrpwd/password": password} if name else {}
try:
    session = client(os.environ.get("OUTRIDER_CONNECT", "tcp/127.0.0.1:17447"), known)
except zenoh.ZError:
    print(json.dumps("refused"))
    sys.exit()
received = {}
def count(sample):
    key = str(sample.key_expr)  # by the key of the sample, not of the subscription
    received[key] = received.get(key, 0) + 1
with session:
    kept = [session.declare_subscriber(key, count) for key in keys]
    for key in filter(None, spoiled.split(",")):
        session.put(key, b"nonsense", allowed_destination=zenoh.Locality.REMOTE)
    time.sleep(float(seconds))
print(json.dumps(received))
"""
)
TAP = (
    CLIENT
    + """
import socket, threading
protocol, _, address = os.environ["OUTRIDER_CONNECT"].partition("/")
host, port = address.rsplit(":", 1)
key, seconds = sys.argv[1], float(sys.argv[2])
seen = bytearray()
def copy(source, sink):
    while part := source.recv(65536):
        seen.extend(part)
        sink.sendall(part)
def between(server):
    near, far = server.accept()[0], socket.create_connection((host, int(port)))
    threading.Thread(target=copy, args=(near, far), daemon=True).start()
    copy(far, near)
server = socket.create_server(("127.0.0.1", 0))
threading.Thread(target=between, args=(server,), daemon=True).start()
known = client_settings(read_credential(Path(os.environ["OUTRIDER_CREDENTIALS"])))
received = 0
def count(sample):
    global received
    received += 1
with client(f"{protocol}/127.0.0.1:{server.getsockname()[1]}", known, 5.0) as session:
    kept = session.declare_subscriber(key, count)
    limit = time.monotonic() + seconds
    while time.monotonic() < limit and received < 100:
        time.sleep(0.05)
readable = [text for text in ("outrider/", "relative_position", "velocity") if text.encode() in seen]
print(json.dumps({"received": received, "bytes": len(seen), "readable": readable}))
os._exit(0)
"""
)
CERTIFIED = (
    CLIENT
    + """
import socket, ssl
import msgspec
from bus.certificates import issue, new_authority
own = read_credential(Path(os.environ["OUTRIDER_CREDENTIALS"]))
address = os.environ["OUTRIDER_CONNECT"].partition("/")[2]
foreign = issue(new_authority(os.environ["OUTRIDER_RUN"]), own.name)
trusting = msgspec.structs.replace(foreign, authority=own.tls.authority)
anonymous = client_settings(own)
for part in ("certificate", "private_key"):
    del anonymous[f"transport/link/tls/connect_{part}_base64"]
anonymous["transport/link/tls/enable_mtls"] = False
def tried(protocol, known):
    try:
        client(f"{protocol}/{address}", known).close()
    except zenoh.ZError:
        return "refused"
    return "open"
found = {
    "own": tried("tls", client_settings(own)),
    "no certificate": tried("tls", anonymous),
    "another authority's": tried("tls", client_settings(msgspec.structs.replace(own, tls=trusting))),
    "no TLS": tried("tcp", {}),
}
host, port = address.rsplit(":", 1)
context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
context.load_verify_locations(cadata=own.tls.authority)
Path("/tmp/own.pem").write_text(own.tls.certificate + own.tls.key)
context.load_cert_chain("/tmp/own.pem")
with (
    socket.create_connection((host, int(port)), 5) as plain,
    context.wrap_socket(plain, server_hostname=host) as opened,
):
    found["version"] = opened.version()
print(json.dumps(found))
"""
)
KILL = """
import os
from pathlib import Path
for process in Path("/proc").iterdir():
    if process.name.isdigit() and process.name not in ("1", str(os.getpid())):
        words = (process / "cmdline").read_bytes().split(b"\\0")
        if any(word.endswith(b"/bin/outrider") for word in words):
            os.kill(int(process.name), 9)
"""
ANSWER = """
import socket
with socket.create_server(("0.0.0.0", 9000)) as server:
    while True:
        server.accept()[0].close()
"""
CALL = """
import json, socket, sys
def call(host, port):
    try:
        socket.create_connection((host, int(port)), 2).close()
    except ConnectionRefusedError:
        return "refused"  # a host answered
    except OSError as error:
        return "unreachable"
    return "open"
print(json.dumps({target: call(*target.rsplit(":", 1)) for target in sys.argv[1:]}))
"""
PILOT = """
import os
from pathlib import Path
from agents.process import fly
from bus.credentials import read_credential
from bus.messages.vehicle import UavCommand
class Hover:
    def __init__(self, briefing):
        pass
    def act(self, observation):
        (detection, *_) = observation.detections or [None]
        x, y = detection.relative_position if detection else (0.0, 0.0)
        v_x, v_y = observation.velocity
        return UavCommand(tick=observation.tick, acceleration=(-0.2 * x - v_x, -0.2 * y - v_y))
credential = read_credential(Path(os.environ["OUTRIDER_CREDENTIALS"]))
fly(credential.party, Hover, connect=os.environ["OUTRIDER_CONNECT"], run=os.environ["OUTRIDER_RUN"],
credential=credential)
"""
LOSSY = """
title = "Commands that are lost and carry trajectories, detections over a recorded link"
duration = 60.0
[detections]
noise = 0.1
dropout = 0.1
[law]
name = "certified"
[certificate]
max_measurement_age = 3.0
max_command_delay = 0.2
max_command_interval = 3.0
[links.detections]
trace = "wifi-far.csv"
[links.commands]
delay = 0.1
jitter = 0.1
loss = 0.4
[[uav]]
position = [7.0, 9.0]
[[ugv]]
position = [7.0, 8.0]
driver = "evade"
"""
PILOT_IMAGE = (
    'ARG BASE\nFROM ${BASE}\nCOPY pilot.py /pilot.py\nENTRYPOINT ["python", "/pilot.py"]\n'
)


# Opening handshake of a browser; the server's frames are plain text and can be searched undecoded.
UPGRADE = (
    "GET /frames HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nCookie: "
    "{cookie}\r\n"
    "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)


class CheckFailed(Exception):
    """A failed check, with its reason."""


def expect(holds: bool, otherwise: str) -> None:
    """Check a condition.

    Raises:
        CheckFailed: If it is false.
    """
    if not holds:
        raise CheckFailed(otherwise)


def say(line: str) -> None:
    """Print a line at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def free_port() -> int:
    """Return a port on which no process listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def fetch(port: int, path: str) -> tuple[int, str]:
    """Return the status of a local page, and its cookie."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    try:
        connection.request("GET", path)
        response = connection.getresponse()
        return response.status, (response.getheader("Set-Cookie") or "").partition(";")[0]
    finally:
        connection.close()


def ticks_shown(port: int, cookie: str, seconds: float) -> list[int]:
    """Return the ticks that a passive browser receives in this time; none if it is not admitted."""
    with (
        contextlib.suppress(TimeoutError),
        socket.create_connection(("127.0.0.1", port), timeout=seconds) as channel,
    ):
        channel.sendall(UPGRADE.format(port=port, cookie=cookie).encode())
        received, limit = b"", time.monotonic() + seconds
        while time.monotonic() < limit and (part := channel.recv(1 << 16)):
            received += part
            found = [int(tick) for tick in re.findall(rb'"truth":\{"tick":(\d+)', received)]
            if len(found) > 1 or not received.startswith(b"HTTP/1.1 101"):
                return found
    return []


def received_by_station(port: int, seconds: float) -> dict[int, set[int]]:
    """Return the identifiers of the MAVLink 2 messages that a local ground station receives, by system."""
    received: dict[int, set[int]] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as channel:
        channel.settimeout(0.5)
        limit = time.monotonic() + seconds
        while time.monotonic() < limit and (
            len(received) < 2 or min(map(len, received.values())) < 3
        ):
            channel.sendto(STATION, ("127.0.0.1", port))
            with contextlib.suppress(TimeoutError, ConnectionRefusedError):
                packet = channel.recv(1 << 16)
                while len(packet) >= 12 and packet[0] == 0xFD:
                    received.setdefault(packet[5], set()).add(
                        int.from_bytes(packet[7:10], "little")
                    )
                    packet = packet[12 + packet[1] + 13 * (packet[2] & 1) :]
    return received


def own_address() -> str:
    """Return the host's address towards the outside; no packet is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            return "127.0.0.1"
        address: str = probe.getsockname()[0]
        return address


class Docker:
    """The Docker engine, and a Compose project with its own name and folder."""

    def __init__(self, program: str, folder: Path) -> None:
        name = f"outrider-test-{os.getpid()}"
        root = os.getuid() == 0
        self.program, self.folder, self.project = program, folder, name
        self.image, self.pilot_image, self.page_image, self.mavlink_image = (
            f"{name}:{part}" for part in ("image", "pilot", "page", "mavlink")
        )
        self.runs = folder / "runs"
        self.runs.mkdir()
        if root:
            os.chown(self.runs, 1000, 1000)
        user = "1000:1000" if root else f"{os.getuid()}:{os.getgid()}"
        kept = {
            key: value
            for key, value in os.environ.items()
            if not key.startswith(("OUTRIDER_", "COMPOSE_"))
        }
        self.environment = kept | {
            "COMPOSE_PROJECT_NAME": name,
            "OUTRIDER_IMAGE": self.image,
            "OUTRIDER_UAV_IMAGE": self.pilot_image,
            "OUTRIDER_DASHBOARD_IMAGE": self.page_image,
            "OUTRIDER_MAVLINK_IMAGE": self.mavlink_image,
            "OUTRIDER_SECRETS": str(folder / "credentials"),
            "OUTRIDER_RUNS": str(self.runs),
            "OUTRIDER_USER": user,
            "OUTRIDER_RUN": RUN,
            "OUTRIDER_SECRET": secrets.token_hex(16),
        }

    def __call__(self, *words: str, limit: float = 60.0, check: bool = True, **more: str) -> str:
        """Run `docker WORDS` with additional environment variables, and return its output.

        Raises:
            CheckFailed: If it fails or takes too long.
        """
        done = self.ended(*words, limit=limit, **more)
        if check and done.returncode:
            last = " / ".join((done.stderr.strip() or done.stdout.strip()).splitlines()[-4:])
            what = " ".join(words[:6])
            raise CheckFailed(f"docker {what} ... ended with {done.returncode}: {last}")
        return done.stdout

    def ended(
        self, *words: str, limit: float = 60.0, **more: str
    ) -> "subprocess.CompletedProcess[str]":
        """Run `docker WORDS` with additional environment variables, and return its result, good or bad.

        Raises:
            CheckFailed: If it takes too long.
        """
        try:
            return subprocess.run(
                [self.program, *words],
                cwd=ROOT,
                env=self.environment | more,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                timeout=limit,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            what = " ".join(words[:6])
            raise CheckFailed(f"docker {what} ... has not ended within {limit:g} s") from error

    def compose(self, *words: str, limit: float = 60.0, check: bool = True, **more: str) -> str:
        """Run `docker compose WORDS`."""
        return self("compose", *words, limit=limit, check=check, **more)

    def python(self, service: str, script: str, *words: str) -> str:
        """Run a script in a service's container."""
        return self.compose("exec", "-T", service, "python", "-c", script, *words)

    def found(self, service: str, script: str, *words: str) -> Any:
        """Return the JSON output of a script in a service's container."""
        return json.loads(self.python(service, script, *words))

    def container(self, service: str) -> str:
        """Return the id of a service's container."""
        return self.compose("ps", "--all", "--quiet", service).strip()

    def inspect(self, what: str) -> Json:
        """Return the description of an image or a container."""
        found: Json = json.loads(self("inspect", what))[0]
        return found

    def clean(self) -> None:
        """Remove everything that belongs to the project."""
        images = (self.pilot_image, self.page_image, self.mavlink_image, self.image)
        with contextlib.suppress(CheckFailed):
            self.down()
        with contextlib.suppress(CheckFailed):
            self("image", "rm", "--force", *images, limit=120.0, check=False)

    @contextlib.contextmanager
    def standing(self, *services: str, **more: str) -> Iterator[None]:
        """Run services, by default the whole stack, and take them down afterwards."""
        try:
            self.compose("up", "--detach", *services, limit=120.0, **more)
            yield
        finally:
            self.down()

    @contextlib.contextmanager
    def flying(self, *, duration: str, at_tick: int = 1000) -> Iterator[None]:
        """Run the stack, continue at a tick, and take it down afterwards."""
        with self.standing(OUTRIDER_DURATION=duration):
            self.python("router", FOLLOW, str(at_tick))
            yield

    def down(self) -> None:
        """Take the stack down and remove its volumes."""
        words = ("--profile", "*", "down", "--volumes", "--remove-orphans", "--timeout", "5")
        self.compose(*words, limit=90.0, check=False)

    def flown(self, *words: str, **more: str) -> Json:
        """Return the summary of a complete run, by default with `UP`, and take the stack down."""
        self.compose(*(words or UP), limit=180.0, **more)
        summary = self.summary()
        self.down()
        return summary

    def landed(self) -> tuple[int, str]:
        """Wait until the simulator ends; return its exit code and its log."""
        container = self.container("simulator")
        code = int(self("wait", container, limit=120.0))
        return code, self.compose("logs", "--no-log-prefix", "simulator")

    def summary(self) -> Json:
        """Return the summary of the last run, and delete its file."""
        path = self.runs / RUN / "summary.json"
        expect(path.exists(), "the simulator has left no summary")
        found: Json = json.loads(path.read_text())
        path.unlink()
        return found

    def reference(self, duration: str | None = None, scenario: str = "escort") -> Json:
        """Return the summary of the same run in one process, in the same image."""
        words = ["run", scenario, "--in-process", "--no-files", "--json"] + (
            ["--duration", duration] if duration else []
        )
        apart = [
            "--rm",
            "--env=OUTRIDER_SECRET",
            "--network=none",
            "--read-only",
            "--tmpfs=/tmp",
            "--volume=/var/cache/outrider",
            f"--volume={self.runs}:/runs:ro",
        ]
        found: Json = json.loads(self("run", *apart, self.image, *words, limit=180.0))
        return found


def same_flight(flown: Json, reference: Json) -> str:
    """Check that two runs have the same bits, and describe them.

    Raises:
        CheckFailed: If they differ.
    """
    for field in ("platform", "ticks", "secret", "trajectory_sha256"):
        expect(
            flown[field] == reference[field],
            f"{field} is {flown[field]!r}, in one process {reference[field]!r}",
        )
    expect(
        flown["complete"] and flown["deterministic"],
        f"first missing command at tick {flown['first_missing_tick']}",
    )
    return f"{flown['ticks']} ticks, {flown['ticks_per_second']:,.0f} ticks/s, sha256 {flown['trajectory_sha256'][:12]}"


class Checks:
    """The checks: one public method each, in the order of execution."""

    def __init__(self, docker: Docker) -> None:
        self.docker = docker
        self._references: dict[str | None, Json] = {}

    def _reference(self, duration: str | None = None) -> Json:
        if duration not in self._references:
            self._references[duration] = self.docker.reference(duration)
        return self._references[duration]

    def build(self) -> str:
        """The image is built, is small, and does not run as root."""
        image = self._build(self.docker.image)
        size = image["Size"] / 1e6
        expect("Healthcheck" in image["Config"], "it has no health check")
        expect(size < LARGEST, f"it has {size:.0f} MB; allowed are {LARGEST} MB")
        return f"{size:.0f} MB, user {image['Config']['User']}"

    def _build_target(self, target: str, tag: str, largest: int) -> float:
        """Build a larger image; return its additional size [MB]."""
        size = self._build(tag, "--target", target)["Size"]
        more = (size - self.docker.inspect(self.docker.image)["Size"]) / 1e6
        expect(more < largest, f"it takes {more:.0f} MB more; allowed are {largest} MB")
        return float(more)

    def _build(self, tag: str, *more: str) -> Json:
        """Build an image that does not run as root."""
        docker = self.docker
        words = ["build", "--tag", tag, *more]
        proxies = [
            name for name in os.environ if name.upper() in ("HTTP_PROXY", "HTTPS_PROXY", "NO_PROXY")
        ]
        for name in proxies:
            # predefined arguments: passed on, and not stored in the image
            words += ["--build-arg", name]
        if any(host in os.environ[name] for name in proxies for host in ("127.0.0.1", "localhost")):
            words.append("--network=host")
        index = [
            f"{key} = {os.environ[name]}"
            for name, key in PIP_SETTINGS.items()
            if name in os.environ
        ]
        if index:
            pip = docker.folder / "pip.conf"
            pip.write_text("\n".join(["[global]", *index]) + "\n")
            words += ["--secret", f"id=pip_conf,src={pip}"]
        docker(*words, ".", limit=900.0, DOCKER_BUILDKIT="1")
        image = docker.inspect(tag)
        user = image["Config"]["User"]
        expect(user == "1000:1000", f"it runs as {user!r}")
        return image

    def credentials(self) -> str:
        """`docker compose run credentials` creates the credentials."""
        docker = self.docker
        docker.compose("run", "--rm", "credentials")
        files = sorted((docker.folder / "credentials").glob("*.json"))
        modes = {path.stat().st_mode & 0o777 for path in files}
        expect(modes == {0o600}, f"modes {[oct(mode) for mode in modes]}")
        return ", ".join(path.stem for path in files)

    def escort(self) -> str:
        """`docker compose up` flies the escort scenario to its end."""
        docker, same = self.docker, ""
        docker.compose("up", limit=120.0)
        same_flight(docker.summary(), self._reference())
        self._all_end_well()
        docker.down()
        for _ in range(2):
            same = same_flight(docker.flown(), self._reference())
        return same + "; three times, exit 0"

    def _all_end_well(self) -> None:
        """Check that every container ends with the run."""
        for service in ("router", "simulator", "uav", "ugv"):
            code = self.docker("wait", self.docker.container(service), limit=20.0).strip()
            expect(code == "0", f"{service} ended with {code}")

    def lossy(self) -> str:
        """Lost commands with backup trajectories, and a recorded link: the same run."""
        docker, scenario = self.docker, "/runs/lossy.toml"
        shutil.copy(ROOT / "examples" / "networks" / "wifi-far.csv", docker.runs)
        (docker.runs / "lossy.toml").write_text(LOSSY)
        flown = docker.flown(OUTRIDER_SCENARIO=scenario)
        same = same_flight(flown, docker.reference(scenario=scenario))
        detections, commands = (
            flown["links"][f"uav_0/{kind}"] for kind in ("detections", "commands")
        )
        share, lost = flown["certified_share"], commands["lost"]["loss"]
        expect("wifi-far.csv" in flown["traces"], "no recorded link was played")
        expect(
            detections["max_age"] > detections["mean_age"] > 0.0, "the recorded link delays nothing"
        )
        expect(lost > 0, "no command was lost")
        expect(share > 0.99, f"certified in {share} of the ticks")
        return f"{same}; {lost} commands lost, certified in {share:.1%} of the ticks"

    def hazards(self) -> str:
        """A UGV that navigates each shipped ground with hazards: the same runs."""
        results = []
        for scenario in ("minefield", "rubble", "rescue"):
            flown = self.docker.flown(OUTRIDER_SCENARIO=scenario)
            same_flight(flown, self.docker.reference(scenario=scenario))
            mission = flown["mission"]
            expect(mission["hazards_hit"] == 0, f"{scenario}: {mission['hazards_hit']} hazards hit")
            when = f"after {mission['mission_time']:.0f} s" if mission["arrived"] else "not in time"
            results.append(f"{scenario}: no hazard hit, arrived {when}")
        return f"the same bits; {'; '.join(results)}"

    def town(self) -> str:
        """A minute in a town, with a map of the buildings and without: the same runs, certified throughout."""
        docker, results = self.docker, []
        known = (ROOT / "sim" / "scenario" / "shipped" / "town.toml").read_text()
        unknown = known.replace("building_clearance = 1.5", "building_clearance = 1.0")
        unknown += "\n[buildings]\nknown = false\n\n[ground]\nsensing_range = 2.0\n"
        for name, text in (("known", known), ("unknown", unknown)):
            (docker.runs / f"{name}.toml").write_text(text)
            file = f"/runs/{name}.toml"
            flown = docker.flown(OUTRIDER_SCENARIO=file, OUTRIDER_DURATION="60")
            same = same_flight(flown, docker.reference("60", file))
            share, near = flown["certified_share"], flown["mission"]["near_building"]
            expect(share == 1.0, f"{name}: certified in {share:.1%} of the ticks")
            expect(near == 0, f"{name}: {near} ticks too near to a building")
            results.append(f"{name}: {same}")
        return "; ".join(results)

    def team(self) -> str:
        """A guard and two scouts, each in a container: the same run, with a certified guard throughout."""
        docker = self.docker
        own = {
            "COMPOSE_FILE": "docker-compose.yml:docker-compose.team.example.yml",
            "OUTRIDER_SCENARIO": "scouts",
            "OUTRIDER_SECRETS": str(docker.folder / "team-credentials"),
            "OUTRIDER_DURATION": "60",
        }
        docker.compose("run", "--rm", "credentials", **own)
        try:
            flown = docker.flown(**own)
        finally:
            docker.compose("--profile", "*", "down", "--volumes", limit=90.0, check=False, **own)
        same = same_flight(flown, docker.reference("60", "scouts"))
        share = flown["team"]["team_certified_share"]
        expect(share == 1.0, f"a guard was certified in {share:.1%} of the ticks")
        for name in ("team_certified_while_lost", "team_certificate_broken"):
            expect(flown["team"][name] == 0, f"{name} = {flown['team'][name]}")
        return same

    def failure(self) -> str:
        """An invalid scenario ends with the simulator's exit code."""
        done = self.docker.ended("compose", *UP, limit=90.0, OUTRIDER_SCENARIO="no-such-scenario")
        self.docker.down()
        expect(done.returncode == 2, f"exit code {done.returncode}")
        return "exit code 2"

    def networks(self) -> str:
        """The UAV's container reaches the router and no other host."""
        docker = self.docker
        with docker.flying(duration=ENDLESS, at_tick=100):
            addresses = {}
            for service in ("ugv", "simulator"):
                docker.compose("exec", "--detach", service, "python", "-c", ANSWER)
                (network,) = docker.inspect(docker.container(service))["NetworkSettings"][
                    "Networks"
                ].values()
                addresses[service] = network["IPAddress"]
            time.sleep(1)
            others = [
                f"{host}:9000"
                for service, address in addresses.items()
                for host in (service, address)
            ]
            for service, address in addresses.items():  # a process listens there
                received = docker.found("router", CALL, f"{service}:9000", f"{address}:9000")
                expect(
                    set(received.values()) == {"open"},
                    f"the router, which shares a network with {service}, finds {received}",
                )
            found = docker.found("uav", CALL, "router:17447", *others)
            with socket.create_server(("", 0)) as host:  # a service on all addresses of the host
                gateway = docker.inspect(f"{docker.project}_uav")["IPAM"]["Config"][0][
                    "Gateway"
                ].partition("/")[0]
                port = host.getsockname()[1]
                hosts = (f"{address}:{port}" for address in {gateway, own_address()})
                outside = docker.found("uav", CALL, *hosts)
            expect(found.pop("router:17447") == "open", "it does not reach the router")
            expect(set((found | outside).values()) == {"unreachable"}, f"found {found | outside}")
            return f"router: open; {', '.join(addresses)} by name and address, the host, near and far: unreachable"

    def keys(self) -> str:
        """The UAV's container receives and writes only its own keys, and strangers are not admitted."""
        docker, prefix = self.docker, f"outrider/{RUN}"
        own = f"{prefix}/uav_0/observation"
        topics = (
            "ugv_0/observation",
            "ugv_0/command",
            "ugv_0/briefing",
            "truth",
            "status",
            "*/observation",
        )
        others = [f"{prefix}/{topic}" for topic in topics]

        def listen(service: str, name: str, password: str, *keys: str, spoiled: str = "") -> Any:
            return docker.found(service, LISTEN, name, password, "2", spoiled, *keys)

        with docker.flying(duration=ENDLESS), ThreadPoolExecutor() as pool:
            spoiled = f"{prefix}/ugv_0/command,{prefix}/uav_0/command"
            tasks = {
                "uav": pool.submit(
                    listen, "uav", "uav_0", "own", own, *others, "**", spoiled=spoiled
                ),
                "ugv": pool.submit(listen, "ugv", "ugv_0", "own", others[0]),
                "simulator": pool.submit(listen, "simulator", "simulator", "own", others[1]),
                "observer": pool.submit(listen, "router", "observer", "own", *others[3:5]),
            }
            received = {who: answer.result() for who, answer in tasks.items()}
            for who, allowed in {
                "ugv": others[:1],
                "simulator": others[1:2],
                "observer": others[3:5],
            }.items():
                expect(
                    set(received[who]) == set(allowed),
                    f"{who} should receive {allowed}, and receives {received[who]}",
                )
            expect(
                set(received["uav"]) == {own},
                f"the UAV should receive {own}, and receives {received['uav']}",
            )
            strangers = {
                "a wrong password": listen("uav", "uav_0", "wrong-password", own),
                "no password": listen("uav", "", "", own),
                "another's name": listen("uav", "ugv_0", "own-is-not-known-here", others[0]),
            }
            expect(set(strangers.values()) == {"refused"}, f"strangers: {strangers}")
            crossing = docker.found("uav", TAP, own, "20")
            expect(
                "relative_position" in crossing["readable"],
                f"with passwords all can be read, and here is {crossing}",
            )
            docker.compose("stop", "simulator", limit=60.0)
            faults = docker.summary()["faults"]
            expect(
                "uav_0" in faults and "ugv_0" not in faults,
                f"nonsense in the commands of: {list(faults)}",
            )
        return (
            f"{received['uav'][own]} of its own observations, nothing else; strangers are refused; it cannot "
            "write for the UGV"
        )

    def tls(self) -> str:
        """With certificates: the same run, no readable data on the network, and no strangers."""
        docker = self.docker
        certified = {
            "OUTRIDER_PROTOCOL": "tls",
            "OUTRIDER_SECRETS": str(docker.folder / "certificates"),
        }
        docker.compose("run", "--rm", "credentials", **certified)
        same = same_flight(docker.flown(**certified), self._reference())
        with docker.standing(OUTRIDER_DURATION=ENDLESS, **certified):
            crossing = docker.found("uav", TAP, f"outrider/{RUN}/uav_0/observation", "30")
            expect(crossing["received"] >= 100, f"its observations do not come: {crossing}")
            expect(not crossing["readable"], f"of what crosses one can read: {crossing}")
            found = docker.found("uav", CERTIFIED)
        expect(
            (found.pop("own"), found.pop("version")) == ("open", "TLSv1.3"),
            "its own certificate does not let it in over TLS 1.3",
        )
        expect(set(found.values()) == {"refused"}, f"others: {found}")
        return (
            f"{same}; of {crossing['bytes']} bytes nothing is readable; refused: {', '.join(found)}"
        )

    def _disturbed(self, disturb: Callable[[], object], *, lost: str) -> str:
        """Disturb a run, and compare it with the undisturbed one."""
        reference = self._reference(LONG)
        with self.docker.flying(duration=LONG):
            disturb()
            code, log = self.docker.landed()
        expect(code == 0, f"the simulator ended with {code}: {log[-300:]}")
        found = re.search(rf"{lost} disconnected(?: at tick (\d+))?", log)
        expect(found is not None, f"the simulator has not noticed: {log[-300:]}")
        same = same_flight(self.docker.summary(), reference)
        at = found.group(1) if found else None
        return f"disconnected at tick {at}; {same}" if at else same

    def kill(self) -> str:
        """The UAV's process is killed with SIGKILL, and Docker restarts it."""
        return self._disturbed(lambda: self.docker.python("uav", KILL), lost="uav_0")

    def pause(self) -> str:
        """The UAV's container is paused for 3 s."""

        def disturb() -> None:
            self.docker.compose("pause", "uav")
            time.sleep(3)
            self.docker.compose("unpause", "uav")

        return self._disturbed(disturb, lost="uav_0")

    def disconnect(self) -> str:
        """The UGV's container is disconnected from its network for 3 s."""

        def disturb() -> None:
            docker, container, network = (
                self.docker,
                self.docker.container("ugv"),
                f"{self.docker.project}_ugv",
            )
            docker("network", "disconnect", network, container)
            time.sleep(3)
            docker("network", "connect", "--alias", "ugv", network, container)

        return self._disturbed(disturb, lost="ugv_0")

    def router(self) -> str:
        """The router's container is killed and restarted."""

        def disturb() -> None:
            container = self.docker.container("router")
            self.docker("kill", container)
            time.sleep(1)
            self.docker("start", container)

        return self._disturbed(disturb, lost="router")

    def router_crash(self) -> str:
        """The router's process is killed with SIGKILL, and Docker restarts it."""
        return self._disturbed(lambda: self.docker.python("router", KILL), lost="router")

    def realtime(self) -> str:
        """The real-time profile keeps the clock."""
        words = ("up", "--exit-code-from", "simulator-realtime", "simulator-realtime")
        flown = self.docker.flown(*words, OUTRIDER_REALTIME="10", OUTRIDER_DURATION="60")
        factor = flown["realtime_factor"]
        expect(flown["complete"] and abs(factor - 10.0) < 0.5, f"factor {factor:.2f} instead of 10")
        return f"factor {factor:.3f} of 10, {flown['late_ticks']} of {flown['ticks']} ticks late"

    def dashboard(self) -> str:
        """The page is served to local browsers that know the token, and shows the run live."""
        docker, port = self.docker, free_port()
        more = self._build_target("dashboard", docker.page_image, PAGE_LARGEST)
        words = ("simulator-realtime", "dashboard")
        with docker.standing(*words, OUTRIDER_DURATION=ENDLESS, OUTRIDER_PORT=str(port)):
            address = self._address_of_the_page(port)
            bound = docker.inspect(docker.container("dashboard"))["NetworkSettings"]["Ports"][
                f"{port}/tcp"
            ]
            expect([row["HostIp"] for row in bound] == ["127.0.0.1"], f"it is published at {bound}")
            expect(fetch(port, "/")[0] == 401, "it is served without the token")
            expect(
                fetch(port, "/?token=not-the-token")[0] == 401, "it is served with a wrong token"
            )
            expect(not ticks_shown(port, "", 5.0), "the run is shown without the token")
            status, cookie = fetch(port, address)
            expect(status == 303 and bool(cookie), f"the address in the log gives {status}")
            ticks, limit = [0], time.monotonic() + 40.0
            while ticks[-1:] == ticks[:1] and time.monotonic() < limit:  # until both vehicles fly
                ticks = ticks_shown(port, cookie, 3.0)
                time.sleep(1.0)
            expect(len(ticks) > 1 and ticks[-1] > ticks[0], f"it shows the ticks {ticks}")
            found = docker.found("uav", CALL, f"dashboard:{port}")
            vehicles = ("uav:9000", "ugv:9000", "simulator-realtime:9000")
            found |= docker.found("dashboard", CALL, *vehicles)
            expect(set(found.values()) == {"unreachable"}, f"found {found}")
        return (
            f"{more:.0f} MB more; 127.0.0.1:{port}, no token, no page; ticks {ticks}; no way to a vehicle, nor "
            "from one"
        )

    def ros2(self) -> str:
        """A node on the network ros2 receives the run in ROS 2's wire format, and no vehicle's own topics."""
        docker, folder = self.docker, self.docker.folder / "ros2-credentials"
        more = {"OUTRIDER_SECRETS": str(folder), "OUTRIDER_DURATION": ENDLESS}
        docker.compose("run", "--rm", "credentials", OUTRIDER_ROLES="ros2", **more)
        received: dict[str, Json] = {}
        with docker.standing("simulator-realtime", "ros2", **more):
            limit = time.monotonic() + 60.0
            while time.monotonic() < limit and not received.get("observer"):
                received["observer"] = self._received_by_node("ros2_observer", folder)
            received["uav"] = self._received_by_node("uav_0", folder)
        topics = {"/".join(key.split("/")[1:-2]) for key in received["observer"]}
        expect(
            {"clock", "tf", "uav_0/odom", "ugv_0/odom"} <= topics,
            f"an observing node receives {sorted(topics)}",
        )
        own = {
            key for key in received["observer"] if "/pilot/" in key or key.startswith("outrider/")
        }
        expect(not own, f"an observing node receives {own}")
        others = {key for key in received["uav"] if "uav_0" not in key}
        expect(not others, f"with the UAV's credentials a node receives {others}")
        return f"{len(topics)} topics, {sum(received['observer'].values())} messages in 3 s"

    def _received_by_node(self, name: str, folder: Path) -> Json:
        docker = self.docker
        words = [
            "--rm",
            f"--network={docker.project}_ros2",
            f"--user={docker.environment['OUTRIDER_USER']}",
            f"--volume={folder / f'{name}.json'}:/own.json:ro",
            "--env=OUTRIDER_CREDENTIALS=/own.json",
            "--env=OUTRIDER_CONNECT=tcp/router:17447",
            "--entrypoint=python",
        ]
        keys = ["0/*/**/RIHS01_$*", f"outrider/{RUN}/truth", f"outrider/{RUN}/status"]
        printed = docker("run", *words, docker.image, "-c", LISTEN, name, "own", "3", "", *keys)
        found: Json = json.loads(printed)
        return found

    def mavlink(self) -> str:
        """A local ground station that sends to the port receives both vehicles."""
        docker, port = self.docker, free_port()
        more = self._build_target("mavlink", docker.mavlink_image, MAVLINK_LARGEST)
        words = ("simulator-realtime", "mavlink")
        with docker.standing(*words, OUTRIDER_DURATION=ENDLESS, OUTRIDER_MAVLINK_PORT=str(port)):
            bound = docker.inspect(docker.container("mavlink"))["NetworkSettings"]["Ports"]
            hosts = [row["HostIp"] for row in bound["14550/udp"]]
            expect(hosts == ["127.0.0.1"], f"it is published at {bound}")
            received = received_by_station(port, 60.0)
        expect(len(received) == 2, f"it receives the systems {received}")
        for system, kinds in received.items():
            expect(0 in kinds and len(kinds) >= 3, f"from system {system} it receives {kinds}")
        counts = ", ".join(f"system {system}: {len(kinds)}" for system, kinds in received.items())
        return f"{more:.0f} MB more; kinds of messages received at 127.0.0.1:{port}: {counts}"

    def _address_of_the_page(self, port: int) -> str:
        """Return the page's path with the token, from the log."""
        limit = time.monotonic() + 60.0
        while time.monotonic() < limit:
            log = self.docker.compose("logs", "--no-log-prefix", "dashboard")
            if found := re.search(rf"http://127\.0\.0\.1:{port}(/\?token=[\w-]+)", log):
                return found.group(1)
            time.sleep(0.5)
        raise CheckFailed("its log does not tell where it is")

    def override(self) -> str:
        """The override file replaces the UAV's image by the user's."""
        docker = self.docker
        (docker.folder / "pilot").mkdir()
        (docker.folder / "pilot" / "pilot.py").write_text(PILOT)
        (docker.folder / "pilot" / "Dockerfile").write_text(PILOT_IMAGE)
        words = ["build", "--tag", docker.pilot_image, "--build-arg", f"BASE={docker.image}"]
        docker(*words, str(docker.folder / "pilot"), limit=120.0, DOCKER_BUILDKIT="1")
        files = ("-f", "docker-compose.yml", "-f", "docker-compose.override.example.yml")
        flown = docker.flown(*files, *UP)
        missing = flown["missing_commands"]
        expect(
            flown["complete"] and not any(missing.values()), f"commands that are missing: {missing}"
        )
        expect(
            flown["trajectory_sha256"] != self._reference()["trajectory_sha256"],
            "it flew like the image's own pilot",
        )
        return f"flown to the end, mean distance {flown['mean_distance']:.2f} m"

    def stop(self) -> str:
        """SIGTERM during a run ends every container soon, and the summary so far is kept."""
        docker = self.docker
        with docker.flying(duration=ENDLESS):
            services = ("simulator", "uav", "ugv", "router")
            containers = [docker.container(service) for service in services]
            started = time.monotonic()
            # all at once: otherwise the vehicles would see the end of the run first
            docker("stop", *containers)
            seconds = time.monotonic() - started
            codes = {
                service: docker.inspect(docker.container(service))["State"]["ExitCode"]
                for service in services
            }
            flown = docker.summary()
        expect(seconds < 8, f"it took {seconds:.1f} s")
        expect(all(code in (0, 143) for code in codes.values()), f"exit codes {codes}")
        expect(not flown["complete"] and flown["ticks"] > 0, "the flight so far is not kept")
        return f"{seconds:.1f} s, exit codes {', '.join(f'{name} {code}' for name, code in codes.items())}"


ORDER = tuple(name for name in vars(Checks) if not name.startswith("_"))


def engine() -> str | None:
    """Return the path of docker, if its engine and Compose are available."""
    program = shutil.which("docker")
    if program is None:
        return None
    try:
        for words in (["info"], ["compose", "version"]):
            subprocess.run([program, *words], capture_output=True, timeout=30, check=True)
    except subprocess.SubprocessError:
        return None
    return program


def run_checks(docker: Docker, chosen: list[str]) -> bool:
    """Run the checks, print a line for each, and return whether all hold."""
    checks = Checks(docker)
    failed = []
    for name in chosen:
        check: Callable[[], str] = getattr(checks, name)
        say(f"      {name}: {(check.__doc__ or '').splitlines()[0]}")
        started = time.monotonic()
        try:
            text, verdict = check(), "ok"
        except CheckFailed as error:
            text, verdict = str(error), "FAIL"
            failed.append(name)
            docker.down()
        say(f"{verdict:<6}{name:<14}{time.monotonic() - started:6.1f} s  {text}")
        if failed and name in ("build", "credentials"):
            break  # all other checks need these
    say(
        f"{len(failed)} of {len(chosen)} checks do not hold: {', '.join(failed)}"
        if failed
        else f"all {len(chosen)} checks hold"
    )
    return not failed


def _interrupted(_number: int, _frame: FrameType | None) -> None:
    raise SystemExit(143)


def main() -> int:
    """Run all checks, or `build`, `credentials` and the named ones."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("names", metavar="NAME", nargs="*", help=", ".join(ORDER))
    names = parser.parse_args().names
    unknown = [name for name in names if name not in ORDER]
    if unknown:
        parser.error(f"{' '.join(unknown)}: unknown; allowed: {', '.join(ORDER)}")
    program = engine()
    if program is None:
        say("compose-test: skipped, no Docker engine with Compose v2 answers here")
        return NO_ENGINE
    signal.signal(signal.SIGTERM, _interrupted)
    chosen = [name for name in ORDER if not names or name in ("build", "credentials", *names)]
    with tempfile.TemporaryDirectory(
        prefix="outrider-compose-", ignore_cleanup_errors=True
    ) as folder:
        docker = Docker(program, Path(folder))
        try:
            return 0 if run_checks(docker, chosen) else 1
        finally:
            docker.clean()


if __name__ == "__main__":
    sys.exit(main())
