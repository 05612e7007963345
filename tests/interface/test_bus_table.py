"""The bus table says of every message what the databases say of it."""

from __future__ import annotations

import pytest

from fsai_vcu.interface import revisions
from fsai_vcu.interface.bus_table import BUS_TABLE, BY_ID, BY_NAME, Flow
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.database import dbc_dir, load_database
from fsai_vcu.interface.messages import VcuStatus, VcuSteer
from fsai_vcu.interface.reserved import AI_IDS, OPTIONAL_AI_ID, RESERVED_IDS, VCU_IDS
from fsai_vcu.interface.revisions import REVISIONS, Revision, revision
from fsai_vcu.interface.units import MS

OTHER_SPELLINGS = {"PCAN": "PCAN_GPS"}  # the 2021 database's name of the same device


@pytest.mark.parametrize("revision", REVISIONS.values(), ids=REVISIONS)
def test_the_table_holds_exactly_the_messages_of_a_revision(revision: Revision) -> None:
    database = load_database(dbc_dir() / name for name in revision.dbc_files)
    listed = {message.name: message for message in BUS_TABLE if revision.name in message.period_ns}
    assert set(listed) == {message.name for message in database.messages}
    for message in database.messages:
        entry = listed[message.name]
        assert entry.can_id == message.frame_id
        assert entry.dlc == message.length
        assert entry.period_ns[revision.name] == (message.cycle_time or 0) * MS
        sender = message.senders[0]
        assert entry.owner == OTHER_SPELLINGS.get(sender, sender)


def test_names_and_identifiers_are_unique() -> None:
    assert len(BY_ID) == len(BY_NAME) == len(BUS_TABLE)


def test_flow_and_time_out_follow_from_who_speaks() -> None:
    for message in BUS_TABLE:
        assert (message.flow is Flow.TO_VCU) == (message.owner == "AI")
        assert (message.flow is Flow.FROM_SENSOR) == (message.owner == "PCAN_GPS")
        assert message.flow is not Flow.FROM_VCU or message.owner == "VCU"
        timeout_ns = message.timeout_ns
        assert timeout_ns is None or all(timeout_ns >= 10 * period_ns for period_ns in message.period_ns.values())
        assert timeout_ns is None or message.flow is not Flow.OTHER
        assert timeout_ns == 100 * MS or message.can_id not in (*AI_IDS, *VCU_IDS)


# ---------------------------------------------------------------- identifiers


def test_the_ai_computer_sends_510_to_514_unreserved() -> None:
    assert AI_IDS == (0x510, 0x511, 0x512, 0x513, 0x514)
    assert not RESERVED_IDS & {*AI_IDS, OPTIONAL_AI_ID}
    assert tuple(message.can_id for message in BUS_TABLE if message.flow is Flow.TO_VCU) == AI_IDS


def test_the_reserved_identifiers_are_those_of_the_specification() -> None:
    assert {0x000, 0x080, 0x084, 0x120, 0x124, 0x181, 0x184, 0x284, 0x301, 0x4E2, 0x550} <= RESERVED_IDS
    assert set(range(0x410, 0x420)) <= RESERVED_IDS
    assert set(range(0x450, 0x471)) <= RESERVED_IDS
    assert set(range(0x4FD, 0x500)) <= RESERVED_IDS
    assert set(range(0x581, 0x585)) <= RESERVED_IDS
    assert set(range(0x600, 0x641)) <= RESERVED_IDS
    assert set(range(0x650, 0x661)) <= RESERVED_IDS
    assert set(range(0x700, 0x706)) <= RESERVED_IDS
    assert len(RESERVED_IDS) == 1 + 5 + 5 + 4 + 1 + 1 + 16 + 33 + 1 + 3 + 1 + 4 + 65 + 17 + 6


# ---------------------------------------------------------------- revisions


def test_the_revisions_differ_in_their_steering_limit() -> None:
    assert {name: entry.steer_limit_deg for name, entry in REVISIONS.items()} == {"2021": 21.0, "2026": 30.0}


def test_an_unknown_revision_is_refused_with_the_valid_names() -> None:
    with pytest.raises(ValueError, match=r"unknown interface revision '2020': choose one of 2021, 2026"):
        revision("2020")


def test_what_tells_a_revision_is_where_its_database_has_it() -> None:
    later, earlier = Codec(revision("2026")), Codec(revision("2021"))
    states = ("op_state", "ts_state", "ebs_state")
    assert later.mask(VcuStatus, *states) == revisions._STATES_2026 and earlier.mask(VcuStatus, *states) == 0
    for codec in (earlier, later):
        assert codec.mask(VcuStatus, "as_state") == 0xF << revisions._AS_STATE_BIT
        assert codec.mask(VcuSteer, "angle_max_deg") == 0xFFFF << revisions._ANGLE_MAX_BIT
