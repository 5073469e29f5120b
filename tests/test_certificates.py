"""Certificates instead of passwords: admission over real TLS, error messages, and renewal."""

import json
import stat
import threading
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
import pytest

pytest.importorskip("cryptography", reason="the extra [tls] is not installed")
import zenoh

from bus import joining
from bus.certificates import check_identity, hosts_of, issue, new_authority
from bus.credentials import (
    Credential,
    CredentialSet,
    new_certificates,
    new_credentials,
    read_credential,
    read_credentials,
    write_credentials,
)
from bus.errors import AccessDenied
from bus.identities import Identity, expiry_warning
from bus.joining import open_session
from bus.keys import COMMAND, Role
from bus.messages.vehicle import UavCommand
from bus.session import Session
from processes import free_port
from staging import client_of, hosted, raw_session, zenoh_of

RUN = "run"
AUTHORITY, FOREIGN = new_authority(RUN), new_authority(RUN)
GIVEN = new_certificates(AUTHORITY, ["uav_0"], ["ugv_0"], hosts=("10.0.0.7", "base.example"))
SIMULATOR = GIVEN.of("simulator").party
UAV = GIVEN.of("uav_0")


pytestmark = pytest.mark.usefixtures("impatient")


@pytest.fixture
def endpoint() -> str:
    return f"tls/127.0.0.1:{free_port()}"


def identity(name="uav_0", *, days=365.0, authority=AUTHORITY, hosts=()):
    return issue(authority, name, days=days, hosts=hosts)


def known_as(found: Identity) -> Credential:
    return Credential(name="uav_0", role=Role.UAV, tls=found)


def refusal(endpoint: str, credential: Credential | None) -> str:
    """Return the line with which our client reports that it is not admitted."""
    with (
        pytest.raises(AccessDenied) as caught,
        open_session(UAV.party, RUN, connect=endpoint, credential=credential),
    ):
        pass
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


def test_each_party_has_its_own_name_and_key(tmp_path: Path) -> None:
    files = write_credentials(GIVEN, tmp_path / "made", AUTHORITY)
    assert {stat.S_IMODE(path.stat().st_mode) for path in files.values()} == {0o600}
    assert read_credentials(files["router"]) == GIVEN.for_router()
    for credential in GIVEN.parties:
        assert read_credential(files[credential.name]) == credential
        key = json.dumps(credential.tls.key)[1:-1]  # type: ignore[union-attr]
        assert [
            name for name, path in files.items() if key in path.read_text(encoding="utf-8")
        ] == [credential.name]
        assert "PRIVATE" not in repr(credential) + repr(credential.tls)
    assert "PRIVATE" not in repr(GIVEN) + repr(AUTHORITY)
    hosts = ("localhost", "127.0.0.1", "::1", "router", "10.0.0.7", "base.example")
    assert hosts_of(GIVEN.tls) == hosts  # type: ignore[arg-type]
    assert hosts_of(UAV.tls) == ()  # type: ignore[arg-type]


def mixed(**parts: str) -> Identity:
    return msgspec.structs.replace(identity(), **parts)


@pytest.mark.parametrize(
    ("invalid", "phrase"),
    [
        (identity("ugv_0"), "the certificate of uav_0 is for ugv_0"),
        (identity(days=-0.5), "the certificate of uav_0 has expired on"),
        (mixed(key=identity().key), "and its key do not match"),
        (mixed(authority=FOREIGN.certificate), "was issued by another authority than the one"),
        (mixed(certificate="garbage"), "not a certificate in PEM"),
        (mixed(key="garbage"), "not a private key in PEM"),
    ],
    ids=["another's", "expired", "another key", "another authority", "garbage", "garbage key"],
)
def test_invalid_certificate_is_named_before_connecting(invalid, phrase):
    with pytest.raises(AccessDenied, match=phrase):
        check_identity(invalid, "uav_0")
    assert phrase in refusal("tls/127.0.0.1:1", known_as(invalid))


OTHERS = identity(authority=FOREIGN)
TRUSTING = msgspec.structs.replace(OTHERS, authority=AUTHORITY.certificate)
STRANGERS = {
    "no certificate": (None, "requires certificates; make them with `outrider credentials --tls`"),
    "a password": (
        new_credentials(RUN, ["uav_0"], []).of("uav_0"),
        "requires certificates; make them with `outrider credentials --tls`",
    ),
    "a foreign authority": (
        known_as(OTHERS),
        "has a certificate that was issued by another authority than this process' own",
    ),
    "a foreign authority that trusts ours": (
        known_as(TRUSTING),
        "does not trust the authority of this certificate",
    ),
    "a router's certificate": (
        known_as(identity(hosts=("127.0.0.1",))),
        "says that this certificate is not for a client",
    ),
    "expired": (known_as(identity(days=-0.5)), "says that this certificate has expired"),
}


@pytest.mark.parametrize(("credential", "phrase"), STRANGERS.values(), ids=STRANGERS)
def test_router_refuses_strangers_with_a_reason(endpoint, credential, phrase, monkeypatch):
    monkeypatch.setattr(joining, "_check_certificate", lambda *_: None)  # the router decides here
    with hosted(endpoint, GIVEN):
        with pytest.raises(zenoh.ZError):
            raw_session(endpoint, credential)
        assert phrase in refusal(endpoint, credential)


def test_client_trusts_only_its_router(endpoint, monkeypatch):
    """Neither a router with another name in its certificate nor another listening party is trusted."""
    elsewhere = endpoint.replace("127.0.0.1", "127.0.0.2")
    with hosted(elsewhere, GIVEN):
        line = refusal(elsewhere, UAV)
    assert "has a certificate that is not for '127.0.0.2'" in line
    assert "`outrider credentials --tls --router HOST`" in line
    thief = CredentialSet(run=RUN, parties=GIVEN.parties, tls=GIVEN.of("ugv_0").tls)
    monkeypatch.setattr(joining, "_check_certificate", lambda *_: None)
    with hosted(endpoint, thief):
        assert "is not a router's" in refusal(endpoint, UAV)


def test_certificates_need_encrypted_endpoints() -> None:
    with pytest.raises(AccessDenied, match="must begin with tls/"), hosted("tcp/[::1]:0", GIVEN):
        pass
    assert "must begin with tls/" in refusal("tcp/127.0.0.1:1", UAV)
    with (
        pytest.raises(AccessDenied, match="requires certificates"),
        open_session(SIMULATOR, RUN, listen=("tls/127.0.0.1:1",)),
    ):
        pass


def passes(router: Session, client: Session) -> bool:
    """Return whether a command of the UAV arrives."""
    inbox = router.inbox_of_all({"uav_0": COMMAND[Role.UAV]})
    outbox = client.outbox(COMMAND[Role.UAV], "uav_0")
    for _ in range(50):
        outbox.send(UavCommand(tick=0, acceleration=(0.0, 0.0)))
        if inbox.receive(0.02) is not None:
            return True
    return False


def test_unknown_name_receives_nothing_and_is_logged(endpoint, caplog):
    stranger = known_as(identity("nobody"))
    with hosted(endpoint, GIVEN) as router:
        receives = zenoh_of(router).declare_subscriber("**", zenoh.handlers.RingChannel(10))
        with raw_session(endpoint, stranger) as opened:
            received = opened.declare_subscriber("outrider/**", zenoh.handlers.RingChannel(10))
            # its own subscriber does not receive its own messages
            sent, there = threading.Event(), {"allowed_destination": zenoh.Locality.REMOTE}
            for k in range(250):
                opened.put(f"outrider/{RUN}/uav_0/command", b"{}", **there)
                zenoh_of(router).put(f"outrider/{RUN}/uav_0/observation", b"{}", **there)
                if k >= 20 and caplog.records:
                    break
                sent.wait(0.02)
            assert receives.try_recv() is None
            assert received.try_recv() is None
    phrase = "'nobody' has a certificate of this run's authority, but is not a party of the run"
    assert phrase in caplog.text


def test_certificates_are_renewed_while_the_router_goes_on(endpoint, monkeypatch):
    """A session stays open when its certificate expires.

    A new session needs the new certificate.
    """
    monkeypatch.setattr(joining, "_check_certificate", lambda *_: None)
    seconds = 2.0
    ends = time.monotonic() + seconds
    old = known_as(identity(days=seconds / 86400))
    with hosted(endpoint, GIVEN) as router, client_of(endpoint, old) as early:
        assert passes(router, early)
        while time.monotonic() < ends + 1.1:  # X.509 counts whole seconds
            time.sleep(0.1)
        assert "has expired" in refusal(endpoint, old)
        with client_of(endpoint, known_as(identity())) as late:
            assert passes(router, late)
        assert passes(router, early)


def test_expiry_is_reported_a_month_ahead(endpoint: str, caplog: pytest.LogCaptureFixture) -> None:
    now = datetime.now(UTC)
    assert expiry_warning("uav_0", now + timedelta(days=30, hours=1)) == ""
    assert "uav_0 expires in 30 days" in expiry_warning("uav_0", now + timedelta(days=29, hours=23))
    theirs = issue(AUTHORITY, "router", days=20, hosts=("127.0.0.1",))
    ending = msgspec.structs.replace(GIVEN, tls=theirs)
    with hosted(endpoint, ending), client_of(endpoint, known_as(identity(days=10))):
        lines = [record.getMessage() for record in caplog.records]
    assert [line.partition(", on")[0] for line in lines] == [
        "the certificate of router expires in 20 days",
        "the certificate of uav_0 expires in 10 days",
    ]


def test_the_command_makes_checks_and_renews(tmp_path, command):
    folder = str(tmp_path / "made")

    def credentials(*arguments: str) -> tuple[int, Any]:
        run = command("credentials", folder, *arguments, "--json")
        return run.returncode, json.loads(run.stdout)

    assert credentials("--tls", "--run", RUN, "--router", "10.0.0.7")[0] == 0
    code, report = credentials("--check")
    days = {Path(row["file"]).stem: row["days"] for row in report["credentials"]}
    assert (code, days.pop("router"), set(days.values())) == (0, 3649, {364})
    assert credentials("--renew", "--party", "uav_0", "--days", "3")[1] == {
        "run": RUN,
        "files": {"uav_0": f"{folder}/uav_0.json"},
    }
    assert stat.S_IMODE((tmp_path / "made" / "uav_0.json").stat().st_mode) == 0o600
    assert not list((tmp_path / "made").glob(".*"))
    code, report = credentials("--check")
    notes = {Path(row["file"]).stem: row["note"] for row in report["credentials"] if row["note"]}
    assert code == 0
    assert list(notes) == ["uav_0"]
    assert "expires in 3 days" in notes["uav_0"]
    (tmp_path / "made" / "ugv_0.json").write_bytes((tmp_path / "made" / "uav_0.json").read_bytes())
    code, report = credentials("--check")
    assert code == 1
    bad = [row["note"] for row in report["credentials"] if not row["good"]]
    assert bad == ["the certificate of ugv_0 is for uav_0"]
    refused = command("credentials", folder, "--renew", "--party", "uav_7")
    assert "no party of the run" in refused.stderr
