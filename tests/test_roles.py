"""Roles of extensions: at most an operator's rows of the key table, and no key of a run."""

import pytest

from bus import plugins, roles
from bus.access import access_control, grants
from bus.credentials import new_credentials
from bus.errors import AccessDenied, ScenarioError
from bus.keys import OBSERVER_NAME, STATUS, UAV_OBSERVATION, Grant, Party, Role, check_reads
from bus.roles import Roles, check_roles, own_grants, party_of
from refusals import refused

VIEWER = Party(role=Role.OBSERVER, name="viewer", extension="viewer")


def granting(*keys: str) -> Roles:
    return Roles(
        parties={"viewer": Role.OBSERVER, "node": Role.GUEST},
        grants=lambda party: [Grant("put", "ingress", keys)],
    )


@pytest.mark.parametrize(
    "key",
    [
        *("outrider/run/uav_0/observation", "outrider/**", "**", "*/run/**", "*/*/truth"),
        *("outr$*/run/truth", "outrider/run/uav_0/alive/0", "*/*/*/alive/uav", "outrider/new"),
        *("*/*/*/$*vation", "$*/a/b", "outrider", "a//b", ""),
    ],
)
def test_a_key_of_a_run_is_refused(key: str) -> None:
    with refused(AccessDenied, "of an extension's role"):
        own_grants(granting("0/tf/RIHS01_a", key), VIEWER)


def test_keys_of_its_own_are_granted() -> None:
    keys = ("*/*/**/RIHS01_$*", "@viewer/**", "viewer/outrider/run/truth")
    (grant,) = own_grants(granting(*keys), VIEWER)
    assert grant.keys == keys
    assert grant in grants(VIEWER, "run", [granting(*keys)])


@pytest.mark.parametrize("base", [Role.SIMULATOR, Role.UAV, Role.UGV])
def test_role_with_vehicle_or_simulator_keys_is_refused(base: Role) -> None:
    with refused(ValueError, "allowed: guest, observer, operator"):
        check_roles(Roles(parties={"spy": base}, grants=lambda party: []), set())


def test_a_package_that_breaks_a_rule_is_left_out(monkeypatch, capsys) -> None:
    given = {
        "thief": Roles(parties={"uav": Role.GUEST}, grants=lambda party: []),
        "spy": Roles(parties={"spy": Role.UAV}, grants=lambda party: []),
        "view": granting("view/**"),
        "again": granting("again/**"),
    }
    monkeypatch.setattr(plugins, "load_all", lambda group, kind: given)
    found = roles.extension_roles.__wrapped__()
    assert set(found) == {"view"}
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition("'")[2].partition("'")[0] for line in lines] == ["thief", "spy", "again"]


def test_its_parties_have_credentials_and_rows_of_their_base(monkeypatch) -> None:
    monkeypatch.setattr(roles, "extension_roles", lambda: {"view": granting("view/**")})
    given = new_credentials("run", ["uav_0"], ["ugv_0"], extensions=["view"])
    viewer, node = given.of("viewer").party, given.of("node").party
    assert viewer == VIEWER
    check_reads(STATUS, viewer)
    for party in (viewer, node):
        with pytest.raises(AccessDenied):
            check_reads(UAV_OBSERVATION, party, "uav_0")
    with pytest.raises(AccessDenied):
        check_reads(STATUS, node)
    for made, wanted in ((given, True), (new_credentials("run", ["uav_0"], ["ugv_0"]), False)):
        keys = {key for rule in access_control(made)["rules"] for key in rule["key_exprs"]}
        assert ("view/**" in keys) is wanted
    with refused(ValueError, "two parties have this name"):
        new_credentials("run", ["viewer"], ["ugv_0"], extensions=["view"])
    with refused(ScenarioError, "--roles vew: unknown roles; available: view"):
        new_credentials("run", ["uav_0"], ["ugv_0"], extensions=["vew"])


def test_a_role_that_is_not_installed_is_unknown() -> None:
    for role in ("nothing", "guest"):
        with refused(AccessDenied, f"role {role!r} is unknown; is its extension installed"):
            party_of(role, "x")
    assert party_of("observer", OBSERVER_NAME) == Party(role=Role.OBSERVER, name=OBSERVER_NAME)
