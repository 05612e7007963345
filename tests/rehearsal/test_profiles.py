"""Flame graphs: what a profiler has seen becomes bars of the right share."""

from __future__ import annotations

import re

from fsai_hil.rehearsal.profiles import drawn, graph_of

SEEN = """\
process 7;<module> (x.py:1);turn (fsai_hil/bench.py:9);act (fsai_vcu/runtime/turns.py:80);send (can/bus.py:3) 60
process 7;<module> (x.py:1);turn (fsai_hil/bench.py:9);on_frame (fsai_vcu/core/bridge.py:50) 39
process 7;<module> (x.py:1);turn (fsai_hil/bench.py:9);rare <lambda> (x.py:2) 0
process 7;<module> (x.py:1);_find_and_load (<frozen importlib>:1) 25
"""


def test_only_what_is_below_the_root_is_counted() -> None:
    graph, everything = graph_of(SEEN, r"turn \(")
    assert (graph.samples, everything) == (99, 124)
    assert list(graph.below) == ["turn (fsai_hil/bench.py)"]


def test_a_bar_is_as_wide_as_its_share_of_the_time() -> None:
    picture = drawn(graph_of(SEEN, r"turn \(")[0], "what & why")
    bars = re.findall(r"<title>(\S+) .*?: (\d+) %</title><rect x=\"([\d.]+)\" y=\"\d+\" width=\"([\d.]+)\"", picture)
    assert [(name, share) for name, share, _, _ in bars] == [
        ("turn", "100"),
        ("act", "61"),
        ("send", "61"),
        ("on_frame", "39"),
    ]
    (_, _, left, width), on_frame = bars[1], bars[3]
    assert abs(float(left) + float(width) - float(on_frame[2])) < 1, "the next bar begins where this one ends"
    assert "what &amp; why" in picture and "rare" not in picture
