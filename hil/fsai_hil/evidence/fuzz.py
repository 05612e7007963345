"""`python -m fsai_hil.evidence.fuzz`: no frames, commands, calls or times make the loop send what breaks a rule.

Hypothesis draws scripts: a station on the way of an ordinary drive, and what happens from there on, each step followed
by ordinary traffic. They are played to the real Bridge and its loop without IO, and the checker of the rules judges
every frame that goes out (`fuzz_drive`). A script that breaks a rule is cut down to the fewest steps and printed.
"""

from __future__ import annotations

import argparse
import copy
import itertools
import math
import os
import sys
import time
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import hypothesis
from hypothesis import strategies as st

from fsai_hil.evidence import fuzz_drive
from fsai_hil.evidence.fuzz_drive import WELL, Step, kept
from fsai_hil.evidence.seeded import SEEDS, Seed, patched
from fsai_hil.evidence.work import followed, spread
from fsai_hil.rules.numbers import MS
from fsai_vcu.core.supervision.config import Reason
from fsai_vcu.core.supervision.supervisor import Phase
from fsai_vcu.interface.bus_table import BUS_TABLE
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import VcuBrake, VcuDriveFront, VcuDriveRear, VcuStatus, VcuSteer, WheelSpeeds
from fsai_vcu.interface.reserved import AI_IDS

BATCH: Final = 10  # scripts of one seed
SEEDED_S: Final = 120.0  # of processor time for one seeded fault at most
FOUND: Final = 2 / 3  # of the seeded faults, at least: the search and the tests find the others
REACHED: Final = {one.name for one in Phase} | {one.slug for one in Reason}
Steps = st.SearchStrategy[list[Step]]

# ---------------------------------------------------------------- what may happen


def _of(*values: Any) -> st.SearchStrategy[Any]:
    return st.sampled_from(values)


def _step(name: str, /, **arguments: Any) -> Steps:
    """Draw one step; of a tuple of values one is drawn, and what is no strategy is given as it is."""
    drawn = {
        key: one if isinstance(one, st.SearchStrategy) else _of(*one) if isinstance(one, tuple) else st.just(one)
        for key, one in arguments.items()
    }
    return st.fixed_dictionaries(drawn).map(lambda given: [(name, given)])


def _steps(*parts: Steps, times: tuple[int, ...] = (1,)) -> Steps:
    """Draw steps that follow one another, that often."""
    return st.tuples(_of(*times), *parts).map(lambda drawn: drawn[0] * list(itertools.chain(*drawn[1:])))


def _run(*cycles: int) -> Steps:
    return _step("run", cycles=cycles)


def _number(low: float, high: float) -> st.SearchStrategy[Any]:
    odd = _of(math.nan, math.inf, -math.inf, -0.0, 5e-324, 1e308, -1e308, -1.0, 1.0000001, 2.0, -1e-9)
    return st.one_of(*[st.floats(low, high).map(lambda value: round(value, 3))] * 3, odd)


# The values are those at which something changes: a little before, at and after every time and limit.
_FEW = (1, 1, 1, 2, 2, 3, 4, 5, 6, 9, 10, 11, 14, 20, 29, 30, 31, 32, 49, 51, 59, 61, 69, 71, 99, 101, 120)
_EDGES_MS = (ms + off for ms in (5.0, 10.0, 50.0, 100.0, 300.0, 500.0, 1000.0) for off in (-1e-6, 0.0, 1e-6))
_MS = (0.5, 15.0, 20.0, 60.0, 150.0, 400.0, 700.0, 1500.0, 3000.0, *_EDGES_MS)
_OLD_MS = (0.0, 10.0, 99.0, 400.0, 500.0 - 1e-6, 500.0, 500.0 + 1e-6, 600.0, 600.0, 700.0, 5000.0, 1e12)
_FOR = (1, 1, 2, 4, 5, 9, 10, 11, 12, 29, 30, 31, 60, 99, 100, 101)
_FIELDS = {
    "steering_rad": _number(-0.5, 0.5),
    "throttle": _of(0.0, 0.4, 1.0) | _number(0.0, 1.0),
    "brake": _of(0.0, 0.0, 0.3, 1.0) | _number(0.0, 1.0),
    "speed_limit_mps": _number(0.0, 20.0),
    "mission_finished": st.booleans(),
    "estop_request": st.booleans(),
    "laps": _of(0, 1, 15, 16, -1, 10**30),
    "cones_count_all": _of(0, 65535, 65536, -5, 10**30),
    "age_ms": _of(*_OLD_MS, -10.0, -20.0, -20.0 - 1e-6, -50.0, -400.0, -1e12),
    "run_offset": _of(0, -1, 1),
}
_COMMAND = st.fixed_dictionaries({}, optional=_FIELDS)
_NARROW = ("as_switch", "ts_switch", "go_signal", "fault", "shutdown_request", "handshake", "bms", "hvil_open")
_WIDE = ("as_state", "as_state", "as_state", "ami", "shutdown_cause", "ebs_state", "ts_state", "op_state")
_SPEEDS = ("fl_rpm", "fr_rpm", "rl_rpm", "rr_rpm")
_BITS = (
    *[([VcuStatus], [(name,) for name in _WIDE], (*range(16),))] * 2,
    *[([VcuStatus], [(name,) for name in _NARROW], (0, 1))] * 2,
    ([VcuDriveFront, VcuDriveRear], [("torque_max_nm",)], (0, 1, 400, 500, 1950, 0xFFFF)),
    ([VcuSteer], [("angle_max_deg",), ("angle_deg",)], (0, 1, 30, 50, 210, 300, 0x8000, 0xFFFF)),
    ([VcuBrake], [("front_request_pct",), ("rear_request_pct",)], (0, 1, 200, 255)),
    *[([WheelSpeeds], [_SPEEDS, _SPEEDS[:1], _SPEEDS[:3]], (0xFFFF, 1250, 1251, 700, 10, 9, 0))] * 2,
)
_SPOILT = st.one_of(
    *(_step("spoil", kinds=kinds, names=(*names,), bits=bits, cycles=_FOR) for kinds, names, bits in _BITS)
)
_SPEAKS = (VcuStatus, VcuDriveFront, VcuDriveRear, VcuSteer, VcuBrake, WheelSpeeds)
_MISSING = _step("spoil", kinds=(*([kind] for kind in _SPEAKS), [*_SPEAKS]), names=[], bits=None, cycles=_FOR)
_OFF = AsState.AS_OFF


def _again(before: AsState = AsState.AS_FINISHED, ready: AsState = AsState.AS_READY, *, ami: Ami = Ami.TRACKDRIVE,
           mode: str = "autonomous", go: bool = False, cycles: int = 495) -> Steps:  # fmt: skip
    """Draw the whole way to a drive once more, with what is wrong on it."""
    return _steps(
        _step("command", **WELL),
        _step("car", as_state=before, go_signal=False),
        _run(2),
        _step("car", as_state=(_OFF, _OFF, AsState.AS_INIT), ami=ami),
        _run(2, 3, 60),
        _step("ask", what="reset"),
        _step("ask", what="set_mode", words=mode),
        _run(3),
        _step("car", as_state=ready, go_signal=go),
        _run(cycles),
        _step("car", as_state=AsState.AS_DRIVING, go_signal=True),
        _run(310),
    )


_AGAIN = st.one_of(
    *(_again(before) for before in (AsState.AS_FINISHED, AsState.EMERGENCY_BRAKE, AsState.AS_DRIVING)),
    *(_again(cycles=cycles) for cycles in (2, 489, 490, 491)),
    *(_again(ready=_OFF), _again(ami=Ami.NOT_SELECTED), _again(mode="manual"), _again(go=True)),
)
_FRAME = st.builds(
    lambda can_id, data, kind: Frame(can_id, b"" if kind == "remote" else data, **({kind: True} if kind else {})),
    _of(*(one.can_id for one in BUS_TABLE), *AI_IDS) | st.integers(0, (1 << 11) - 1),
    st.binary(min_size=8, max_size=8) | st.binary(max_size=12),
    _of(*[""] * 7, "extended", "remote", "error"),
)
_HAPPENS = (
    # Each in `_steps` is one among the others; a bare one_of would be as many as it has parts.
    *[_steps(_AGAIN)] * 2,
    *[_steps(_SPOILT), _steps(_SPOILT, _run(1, 2, 11), times=(2, 3, 5)), _MISSING] * 3,
    _steps(_step("frame", frame=_FRAME, ahead_ns=(0, 0, 0, MS, 50 * MS)), _run(0, 1), times=(1, 2, 5, 12)),
    *[_step("car", as_state=(*AsState,), go_signal=(True, True, False))] * 2,
    _steps(_step("car", as_state=AsState.EMERGENCY_BRAKE), _run(5, 20, 180), _step("car", as_state=_OFF)),
    *[_step("command", **WELL | {"steering_rad": (0.0, 0.3, -0.3), "throttle": (1.0, 0.0), "brake": (0.0, 0.0, 0.3)})]
    * 2,
    *[st.tuples(st.just(name), _COMMAND).map(lambda step: [step]) for name in ("once", "command")] * 2,
    _steps(
        *(_steps(_step("command", throttle=t, brake=b), _run(1, 1, 2)) for t, b in ((0.0, 0.5), (1.0, 0.0))),
        times=(2, 5),
    ),
    _steps(_step("now", silent=True), _run(5, 9, 10, 11, 29, 30, 31, 50, 69, 71), _step("now", silent=False)),
    _step("frame", frame=st.builds(Frame, _of(*AI_IDS), st.binary(max_size=8))),
    *[_step(name, ms=_MS) for name in ("quiet", "hang", "lose")] * 2,
    _step("restart"),
    _step("drop", cycles=(1, 2, 3, 5, 6, 7, 20), takes=(0, 1, 2, 3, 4)),
    _step("confirm", role=("planner", "controller", "bridge", ""), offset=(0, 1, -1, 10**12)),
    _step("ask", what="set_mode", words=("autonomous", "manual", "sideways", "", "ä" * 300)),
    *[_step("ask", what=what, words=("", "x" * 200)) for what in ("emergency_brake", "reset", "deactivate")],
    _step("now", held_rpm=(None, 0, 9, 10, 200, 300, 301, 701, 1250)),
    _step("now", stuck=(True, False), unconfirmed=(True, False)),
    _step("now", period_ns=(10 * MS, MS // 10, 2 * MS, 10 * MS - 1, 15 * MS - 1, 25 * MS, 50 * MS - 1, 50 * MS + 1)),
    _step("now", late_ns=(0, 1, MS, 5 * MS - 1, 5 * MS + 1, 8 * MS - 1, 50 * MS - 1)),
)
SCRIPTS: Final = st.tuples(
    _of(*["2026"] * 8, *["2021", "venue"] * 3, "staging", "listening"),
    _of("start", "awake", *["off", "ready", "launched"] * 2, *["driving"] * 5, *["moving"] * 8),
    st.lists(
        _steps(st.one_of(*_HAPPENS), _run(*[0] * 14, *_FEW, *_FEW, 150, 200, 299, 310, 330)), min_size=1, max_size=2
    ),
)
"""Many short scripts reach more than few long ones."""

# ---------------------------------------------------------------- the property


class Broken(Exception):
    """A script that breaks a rule, or at which the process fails, and how, in words."""


class Done(NamedTuple):
    """The outcome of the scripts of one seed."""

    failure: str
    reached: set[str]


def batch(seed: int, *, examples: int = BATCH, shrink: bool = True) -> Done:
    """Play the scripts of one seed, as far as the first that breaks a rule."""
    reached = set[str]()

    @hypothesis.seed(seed)
    @hypothesis.settings(
        max_examples=examples,
        phases=[hypothesis.Phase.generate, hypothesis.Phase.shrink][: 1 + shrink],
        database=None,
        deadline=None,
        suppress_health_check=list(hypothesis.HealthCheck),
        report_multiple_bugs=False,
        print_blob=False,
    )
    @hypothesis.given(SCRIPTS)
    def holds(script: tuple[str, str, list[list[Step]]]) -> None:
        setup, station, happens = script
        steps = [step for step in itertools.chain(*happens) if step != ("run", {"cycles": 0})]
        try:
            drive = copy.deepcopy(kept(setup, station)).play(steps)
        except Exception as error:
            calls = (f"{name}({', '.join(f'{key}={one!r}' for key, one in given.items())})" for name, given in steps)
            words = [f"{setup}, from {station}:", *calls, f"{type(error).__name__}: {error}"]
            raise Broken("\n  ".join(words)) from error
        reached.update(drive.reached)

    try:
        holds()
    except Broken as error:
        return Done(f"seed {seed}, {error}", reached)
    return Done("", reached)


def campaign(first_seed: int, jobs: int, minutes: float) -> bool:
    """Play one seed after the other in `jobs` processes until the time is over or a rule is broken. True: none is."""
    until_s, reached = time.monotonic() + 60.0 * minutes, set[str]()
    in_time = itertools.takewhile(
        lambda seed: seed == first_seed or time.monotonic() < until_s, itertools.count(first_seed)
    )
    for one in followed(spread(batch, in_time, jobs), "seeds", None, lambda one: one.failure, "broke a rule"):
        reached |= one.reached
        if one.failure:
            print("\nBROKEN: see above.")
            return False
    print(f"phases and reasons not reached: {', '.join(sorted(REACHED - reached))}\n\nEvery rule held on the wire.")
    return True


def sought(name: str) -> tuple[str, str]:
    """Put the seeded fault of that name into the rules; return it, and what breaks in `SEEDED_S` ("": nothing)."""
    until_s, broken = time.process_time() + SEEDED_S, ""
    seed = next((one for one in SEEDS if one.name == name), Seed("", "", ""))
    setups = {key: seed.configured(one) for key, one in fuzz_drive.SETUPS.items()}
    kept.cache_clear()  # where the code is changed on purpose, the ways must be gone again
    with patched(((fuzz_drive, "SETUPS", setups), *seed.patches)):
        for number in itertools.count(1):
            broken = batch(number, shrink=False).failure
            if broken or time.process_time() > until_s:
                break
    kept.cache_clear()
    return name, broken.rpartition("\n")[2].strip()


def seek_all(jobs: int) -> bool:
    """Seek every seeded fault, and nothing where there is none. True: so many are found, and nothing wrong is."""
    broken = dict[str, str]()
    for name, words in spread(sought, ["", *(seed.name for seed in SEEDS)], jobs):
        broken[name] = words
        print(f"  {name or 'none: the rules as they are':58} {(words or 'NOT FOUND')[:100]}", flush=True)
    sound, found = not broken.pop(""), sum(map(bool, broken.values()))
    print(f"{found} of {len(SEEDS)} found, at least {math.ceil(FOUND * len(SEEDS))} must be")
    print(f"the rules as they are: {'held' if sound else 'BROKEN'}")
    return sound and found >= FOUND * len(SEEDS)


def main(arguments: Sequence[str] | None = None) -> int:
    """0: every rule held; 1: one was broken, or too few seeded faults are found; 2: wrong use."""
    parser = argparse.ArgumentParser(
        prog="python -m fsai_hil.evidence.fuzz",
        description="Put strange frames, commands, services and times before the bridge; judge every frame it sends.",
        epilog="example: python -m fsai_hil.evidence.fuzz --minutes 5",
    )
    parser.add_argument("--minutes", type=float, default=1.0, metavar="M", help="for so long (default: %(default)s)")
    parser.add_argument("--seeded", action="store_true", help="put faults into the rules on purpose and seek each")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="the first seed (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="J", help="processes")
    options = parser.parse_args(arguments)
    if options.jobs < 1 or options.minutes <= 0:
        print("--jobs and --minutes are more than 0", file=sys.stderr)
        return 2
    held = seek_all(options.jobs) if options.seeded else campaign(options.seed, options.jobs, options.minutes)
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
