"""The permissions of encrypted DDS: who may publish and call what, held against the nodes' own tables."""

from __future__ import annotations

import re
from xml.etree import ElementTree

from install_rig import CHECKOUT

from fsai_nodes.qos import TOPICS

POLICY = CHECKOUT / "systemd" / "security" / "policy.xml"
# What the car obeys.
DANGEROUS_TOPICS = {"vehicle_cmd", "run_state", "reset_confirmation", "path", "planner_status"}
DANGEROUS_SERVICES = {"set_mode", "emergency_brake", "reset"}


def allowed(kind: str, how: str) -> dict[str, set[str]]:
    """Names of `kind` (topic, service, action) to the enclaves that may `how` them."""
    found: dict[str, set[str]] = {}
    for enclave in ElementTree.parse(POLICY).iter("enclave"):
        for group in enclave.iter(f"{kind}s"):
            if group.get(how) == "ALLOW":
                for entry in group.iter(kind):
                    found.setdefault(str(entry.text), set()).add(enclave.get("path", "").rpartition("/")[2])
    return found


def test_only_named_nodes_may_publish_what_the_car_obeys() -> None:
    publishers = allowed("topic", "publish")
    assert publishers["vehicle_cmd"] == {"vehicle_controller"}
    assert publishers["run_state"] == publishers["vehicle_state"] == {"vcu_bridge"}
    assert publishers["path"] == publishers["planner_status"] == {"path_planner"}
    assert publishers["reset_confirmation"] == {"path_planner", "vehicle_controller"}
    callers = allowed("service", "request")
    assert {name for name in callers if not name.endswith("/get_parameters")} == DANGEROUS_SERVICES
    assert {frozenset(who) for who in callers.values()} == {frozenset({"operator"})}
    assert allowed("action", "call") == {"run_mission": {"operator"}}


def test_an_observer_can_call_nothing_and_only_speak_of_itself() -> None:
    may = {
        (kind, how): {name for name, who in allowed(kind, how).items() if "observer" in who}
        for kind, how in (("topic", "publish"), ("service", "request"), ("service", "reply"), ("action", "call"))
    }
    assert may.pop(("topic", "publish")) == {"rosout", "parameter_events"}
    assert {name.partition("/")[0] for name in may.pop(("service", "reply"))} == {"~"}
    assert not any(may.values())


def test_each_node_may_publish_and_read_what_it_does() -> None:
    may = {how: allowed("topic", how) for how in ("publish", "subscribe")}
    made = re.compile(r'(publish|subscri)\w+\(\s*(?:self, |node, )?\w+, "/?([\w/]+)"')
    done = [
        (node.stem, "publish" if how == "publish" else "subscribe", topic)
        for node in (CHECKOUT / "nodes" / "fsai_nodes" / "fsai_nodes").glob("*.py")
        if any(node.stem in who for who in may["publish"].values())
        for how, topic in made.findall(node.read_text())
    ]
    assert {topic for _, _, topic in done} >= DANGEROUS_TOPICS
    assert [each for each in done if each[0] not in may[each[1]].get(each[2], ())] == []


def test_who_listens_may_read_every_topic_and_say_none() -> None:
    may = {
        how: {topic for topic, who in allowed("topic", how).items() if "listener" in who}
        for how in ("publish", "subscribe")
    }
    assert may == {
        "publish": {"parameter_events"},
        "subscribe": {*TOPICS, "tf", "tf_static", "clock", "parameter_events"},
    }


def test_every_node_of_a_service_has_an_enclave_of_its_name() -> None:
    enclaves = {each.get("path") for each in ElementTree.parse(POLICY).iter("enclave")}
    for unit in (CHECKOUT / "systemd" / "units").glob("*.service"):
        for word in unit.read_text().split():
            if word.startswith("fsai_nodes."):
                assert f"/fsai/{word.removeprefix('fsai_nodes.')}" in enclaves
