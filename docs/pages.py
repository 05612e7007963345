"""`make pages`: fills what stands between `<!-- made: NAME -->` and `<!-- /made -->` in the pages, from the code.

The words of a page are written by hand, its tables, diagrams and figures are made here: of the tables in the code, of
`hazards.toml` and of the evidence in `docs/evidence`.
"""

from __future__ import annotations

import ast
import json
import re
import runpy
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from fsai_hil.evidence.campaign.catalogue import ROWS
from fsai_hil.rules.checker import RULES
from fsai_hil.simulator.as_machine import transition_table
from fsai_hil.simulator.profiles import SPECIFICATION
from fsai_nodes.composed import CLASSES
from fsai_nodes.qos import FRAMES, TOPICS
from fsai_vcu.core.control.settings import ControllerSettings
from fsai_vcu.core.planning.course import (
    AGAIN_NS,
    DOUBTED_M,
    DOUBTED_S,
    FLOOR,
    FLOOR_AGAIN,
    MOVED_M,
    SLOWLY_M,
    SURE_AGAIN,
    TURNED_M,
)
from fsai_vcu.core.supervision.config import TO_DO_UNSEEN, BridgeConfig, Reason
from fsai_vcu.core.supervision.gate import LIMITERS
from fsai_vcu.core.supervision.readiness import Circumstances, why_not_driving
from fsai_vcu.core.supervision.start_conditions import CONDITIONS
from fsai_vcu.core.supervision.supervisor import (
    NEXT,
    OUTPUT,
    REACTIONS,
    ROLES,
    STEERS_WHILE_STOPPING,
    Asked,
    Brake,
    Consequence,
    Latch,
    Mode,
    Output,
    Phase,
    Steer,
    Step,
    SupervisorState,
)
from fsai_vcu.diagnostics.explain.causes import CAUSES
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.messages import VehicleState
from fsai_vcu.interface.units import MS
from fsai_vcu.runtime.configuration import KEYS
from fsai_vcu.runtime.toml_lines import tomllib

ROOT: Final = Path(__file__).resolve().parents[1]
EVIDENCE: Final = ROOT / "docs" / "evidence"
BLOCK: Final = re.compile(r"(<!-- made: (\w+) -->\n).*?(<!-- /made -->)", re.DOTALL)

_FOLLOWS = {
    Consequence.REPORT: "reported",
    Consequence.HOLD: "torque 0 while it lasts",
    Consequence.STOP: "service-brake stop, latched",
    Consequence.STOP_MANUAL: "service-brake stop, latched, and manual mode",
    Consequence.ESTOP: "ESTOP_REQUEST, latched",
}
_STEERING = {
    Steer.ZERO: "0",
    Steer.HELD: "held",
    Steer.COMMAND: "by command",
    Steer.HELD_OR_COMMAND: "by command if the cause of the stop leaves steering to the planner, else held",
}
_BRAKE = {
    Brake.ZERO: "0",
    Brake.HOLDING: "holding brake",
    Brake.COMMAND: "by command",
    Brake.KEPT: "as before",
    Brake.SERVICE: "service brake",
}


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows))


def _sent(row: Output) -> list[str]:
    status = "SELECTED once the mission is acknowledged" if row.mission_status is None else row.mission_status.label
    torque = "by command" if row.torque else "0"
    return [status, row.direction.label, _STEERING[row.steer], _BRAKE[row.brake], torque]


def _after(step: Step) -> str:
    return "at once" if step.after is None else f"{getattr(BridgeConfig(), step.after) / MS:.0f} ms"


def _reaction(reason: Reason, steps: Sequence[Step]) -> list[str]:
    steers = "yes" if reason in STEERS_WHILE_STOPPING else ""
    follows = "; ".join(f"{_after(step)}: {_FOLLOWS[step.consequence]}" for step in steps)
    return [f"`{reason.slug}`", reason.words, follows, steers]


def _flow() -> list[str]:
    """Return the diagram's lines on what ends a drive: reasons that do the same are one box."""
    alike: dict[tuple[Step, ...], list[Reason]] = {}
    for reason, steps in REACTIONS.items():
        alike.setdefault(steps, []).append(reason)
    lines = [f'{one.name}(["{words}"])' for one, words in _FOLLOWS.items()]
    for number, (steps, reasons) in enumerate(alike.items()):
        lines.append(f'R{number}["{"<br>".join(reason.slug for reason in reasons)}"]')
        lines += [f"R{number} -->|{_after(step)}| {step.consequence.name}" for step in steps]
    return lines


def _diagram(kind: str, lines: Iterable[str]) -> str:
    return "\n".join(["```mermaid", kind, *(f"  {line}" for line in lines), "```"])


# ---------------------------------------------------------------- docs/supervision.md


def sent() -> str:
    rows = ([phase.value, *_sent(row)] for phase, row in OUTPUT.items())
    return _table(("phase", "MISSION_STATUS", "direction", "steering", "brake", "torque"), rows)


def reactions() -> str:
    rows = (_reaction(reason, steps) for reason, steps in REACTIONS.items())
    return _table(("reason", "what it says", "after, and what follows", "the planner steers in that stop"), rows)


def flow() -> str:
    return _diagram("flowchart LR", _flow())


def sequence() -> str:
    steps = [f"{before.name} --> {then.name}: {state.label}" for (before, state), then in NEXT.items()]
    return _diagram("stateDiagram-v2", ["[*] --> NONE", *steps])


def limiters() -> str:
    rows = ((str(place), f"`{one.__name__}`", (one.__doc__ or "").strip()) for place, one in enumerate(LIMITERS, 1))
    return _table(("", "limiter", "rule"), rows)


def give_up() -> str:
    """Return the text on runs that the controller ends, and on the planner's confidence, with the code's limits."""
    seconds = ControllerSettings().give_up_s
    return (
        f"If the car has stood for {seconds:.0f} s in AS_DRIVING where it should drive, without a path for instance,"
        "\nthe controller ends the run (`give_up_s`): ESTOP_REQUEST, with the reason in words. If the car drives along"
        "\nits own driven path again without passing the line, it has lost the lane: it gets no path any more, stops,"
        "\nand the run ends in the same manner."
        "\n"
        "\nThe planner's confidence falls when it sees another lane than a moment ago, a car beside its path, cones"
        "\nwhere none stood, or cones that are not where skidpad or acceleration have them; and when its path crosses"
        f"\na border, or each look moves it (by more than {MOVED_M[0]:g} m in the mean, before the car could stop)."
        "\nWhere another path through the cones is nearly as good, the path counts as confirmed only as far as the two"
        "\ncoincide, and confidence falls if they part before the car can stop; sooner without colours or among"
        "\nfalse cones. Off the map it also counts only up to where it leaves the path of the look before by"
        f"\n{TURNED_M:g} m, or passes between the last two cones of one colour that border it; with its nose at those"
        "\ncones confidence falls, and the car stops."
        "\nWhile its average over some looks is under"
        f"\n{FLOOR_AGAIN:g}, the car drives slowly, as if at most {SLOWLY_M:g} m of the path were confirmed."
        "\nIf that average"
        f"\nstays under {FLOOR:g} for {DOUBTED_M:g} m of driving, or for {DOUBTED_S:g} s if that is longer,"
        "\nthe planner is *lost*: it plans a stop at once, along the last path that was not in doubt."
        "\n`/planner_status`, `fsai-vcu status` and the pit wall show that it is lost, and why. Once the car stands and"
        f"\neach look of {AGAIN_NS / 1e9:g} s has shown the lane with a confidence of {SURE_AGAIN:g} at least,"
        "\nit drives on."
    )


# ---------------------------------------------------------------- docs/architecture.md


def arrows() -> str:
    """The rooms of fsai_vcu and fsai_hil, and what may import what; an arrow that others imply is left out."""
    table = runpy.run_path(str(ROOT / "tests" / "test_architecture.py"))["ARROWS"]
    big = {room: ".".join(room.split(".")[:2]) for room in table}
    edges: dict[str, set[str]] = {}
    for room, targets in table.items():
        wide = {big[to] for to in targets} | ({"fsai_vcu.runtime"} if "fsai_vcu" in targets else set())
        edges.setdefault(big[room], set()).update(wide - {big[room], "fsai_vcu", "fsai_hil"})
    edges = {room: targets for room, targets in edges.items() if room not in ("fsai_vcu", "fsai_hil")}

    def reach(room: str) -> set[str]:
        return {further for to in edges[room] for further in {to, *reach(to)}}

    def name(room: str) -> str:  # none is that of a subgraph
        return "nodes" if room == "fsai_nodes" else room.replace(".", "_")

    lines = []
    for package in ("fsai_nodes", "fsai_hil", "fsai_vcu"):
        inside = sorted(room for room in edges if room.split(".")[0] == package)
        boxes = (f'  {name(room)}["{name(room).removeprefix(package + "_")}"]' for room in inside)
        lines += [f"subgraph {package}", *boxes, "end"]
    for room, targets in sorted(edges.items()):
        implied = {further for to in targets for further in reach(to)}
        lines += [f"{name(room)} --> {name(to)}" for to in sorted(targets - implied)]
    return _diagram("flowchart TD", lines)


def as_states() -> str:
    """The car's states as the simulated VCU has them, by the specification; why it brakes is a table of its own."""
    labels: dict[tuple[str, str], list[str]] = {}
    emergencies: dict[str, list[str]] = {}
    for state, rows in transition_table(SPECIFICATION).items():
        for row in rows:
            if row.target is AsState.EMERGENCY_BRAKE:
                emergencies.setdefault(row.why, []).append(state.label)
            why = "emergency" if row.target is AsState.EMERGENCY_BRAKE else row.why
            labels.setdefault((state.label, row.target.label), []).append(why)
    steps = (f"{a} --> {b}: {'<br/>'.join(dict.fromkeys(why))}" for (a, b), why in labels.items())
    diagram = _diagram("stateDiagram-v2", ["[*] --> AS_INIT", *steps])
    return f"{diagram}\n\n{_table(('emergency', 'in'), ((why, ', '.join(at)) for why, at in emergencies.items()))}"


# ---------------------------------------------------------------- docs/troubleshooting.md


_SAID: Final = ("it says", "what to do")


def _causes(first: str, end: str | None, without: Sequence[str] = ()) -> str:
    slugs = list(CAUSES)
    chosen = slugs[slugs.index(first) : slugs.index(end) if end else None]
    return _table(_SAID, (_cause(slug) for slug in chosen if slug not in without))


def _cause(slug: str) -> tuple[str, str]:
    one = CAUSES[slug]
    return one.words, one.remedy + (f". Next time record {one.record}" if one.record else "")


# The order in which somebody at the car can look: power, this computer, switches, display, this software, faults.
_AS_OFF: Final = (
    *("vcu_unheard", "listen_only", "no_ai_data", "ai_data_incomplete", "link_lost"),
    *("power_cycle", "pushbar", "charging", "shutting_down", "asms", "tsms", "ts_not_running", "ebs_not_armed"),
    *("no_mission", "manual", "unconfirmed", "status_not_selected", "status_running", "status_finished"),
    *("latched", "estop_latched", "fault", "op_fault", "status_frozen"),
)


def as_off() -> str:
    """The conditions of AS_OFF: those that the bus shows, and those that only the bridge knows."""
    known = _bridge_knows()
    lacking = {one.slug for one in CONDITIONS if AsState.AS_OFF in one.states} - set(_AS_OFF)
    assert not lacking, f"conditions of AS_OFF without a place in the order: {lacking}"
    rows = (known.get(slug) or _cause(slug) for slug in _AS_OFF)
    return _table(("", *_SAID), ((str(place), *row) for place, row in enumerate(rows, 1)))


def _bridge_knows() -> dict[str, tuple[str, str]]:
    """Return the reasons for not driving that the bridge itself knows: each one's words, and what to do."""
    ready = SupervisorState(mode=Mode.AUTONOMOUS)
    asked = Latch(Asked.OPERATOR, 0)
    rows = {
        "listen_only": (BridgeConfig(listen_only=True), ready, "`[can] listen_only = false`, once sending is meant"),
        "manual": (BridgeConfig(), SupervisorState(), "`fsai-vcu mode autonomous`, or `[car] autonomous_at_power_up`"),
        "unconfirmed": (
            BridgeConfig(),
            SupervisorState(mode=Mode.AUTONOMOUS, mission=Ami.AUTOCROSS, confirmed=frozenset(ROLES[1:])),
            "start the node that is named; your own confirms each new `run_id` (`fsai-vcu check-stack`)",
        ),
        "latched": (
            BridgeConfig(),
            SupervisorState(mode=Mode.AUTONOMOUS, emergency=asked),
            "find out why it was asked for, then `fsai-vcu reset` in AS_OFF",
        ),
    }
    idle = Circumstances(Phase.IDLE)
    return {
        name: (why_not_driving(config, state, VehicleState(), idle, 0)[0], todo)
        for name, (config, state, todo) in rows.items()
    }


def endings() -> str:
    return _causes(next(iter(CAUSES)), "no_ai_data")


def starting() -> str:
    return _causes("no_ai_data", "torque_not_given", without=_AS_OFF)


def driving() -> str:
    return _causes("torque_not_given", None)


def guards() -> str:
    rows = ((f"`{one.slug}`", one.words, to_do) for one, to_do in TO_DO_UNSEEN.items())
    return _table(("reason", "what it says", "what to do"), rows)


# ---------------------------------------------------------------- settings


def keys() -> str:
    rows = (
        (f"`{key.spelt}`", f"`{_value(key.default)}`", _range(key), key.meaning, f"`{key.node}`" if key.node else "")
        for key in KEYS
    )
    return _table(("key", "default", "may be", "meaning", "parameter of"), rows)


def parameters() -> str:
    rows = (
        (node, f"`{one.name}`", f"`{_value(one.default)}`", _range(one), one.description, "live" if one.live else "")
        for node in (*CLASSES, "ackermann_adapter")
        for one in import_module(f"fsai_nodes.{node}").SETTINGS
    )
    return _table(("node", "parameter", "default", "may be", "meaning", ""), rows)


_PARTS = {"vcu_bridge": ("bridge_outputs", "mission_server")}  # files beside a node's own that make its topics


def _interface() -> Iterator[tuple[str, str, str, str, str]]:
    """Yield a row for each topic, service and action of a node.

    It holds the node's name; publisher, subscription, service or action; the name and the type that others see; and
    the docstring of the function that is called.
    """
    files = [(node, file) for node in CLASSES for file in (node, *_PARTS.get(node, ()))]
    for node, file in files:
        source = ROOT / "nodes" / "fsai_nodes" / "fsai_nodes" / f"{file}.py"
        tree = list(ast.walk(ast.parse(source.read_text(encoding="utf-8"))))
        imports = [
            (one.module or "", alias.name) for one in tree if isinstance(one, ast.ImportFrom) for alias in one.names
        ]
        places = {kind: module.replace(".", "/") for module, kind in imports}
        words = {one.name: ast.get_docstring(one) or "" for one in tree if isinstance(one, ast.FunctionDef)}
        for call in tree:
            name = ast.unparse(call.func).rpartition(".")[2] if isinstance(call, ast.Call) else ""
            if name in ("publisher", "subscription", "service", "action"):
                given = [ast.unparse(one) for one in (*call.args, *(keyword.value for keyword in call.keywords))]
                kind, topic = given[given[0] in ("self", "node") :][:2]
                called = next(filter(None, (words.get(one.removeprefix("self."), "") for one in given)), "")
                yield node, name, "/" + topic.strip("/'"), _type(places[kind], kind), " ".join(called.split())


def _type(place: str, kind: str) -> str:
    """Return a type's name in ROS; one of this project leads to its definition."""
    name = f"{place.partition('/')[0]}/{kind}"
    file = f"{place}/{kind}.{place.rpartition('/')[2]}"
    return f"[{name}]({file})" if (ROOT / "nodes" / file).is_file() else name


def _quality(profile: Any) -> str:
    kept = ", transient local" if profile.durability is DurabilityPolicy.TRANSIENT_LOCAL else ""
    lifespan = f", lifespan {profile.lifespan.nanoseconds // MS} ms" if profile.lifespan.nanoseconds else ""
    words = "reliable" if profile.reliability is ReliabilityPolicy.RELIABLE else "best effort"
    return f"{words}{kept}, keep-last {profile.depth}{lifespan}"


def topics() -> str:
    made = list(_interface())

    def row(name: str, profile: Any) -> Sequence[str]:
        (kind,) = {kind for _, _, topic, kind, _ in made if topic == name}
        ends = {
            end: ", ".join(node for node, what, topic, *_ in made if (what, topic) == (end, name))
            for end in ("publisher", "subscription")
        }
        return f"`{name}`", kind, *ends.values(), _quality(profile)

    rows = (row("/" + name.strip("/"), profile) for name, profile in {**TOPICS, **FRAMES}.items())
    return _table(("topic", "type", "sent by", "read by", "quality of service"), rows)


def services() -> str:
    made = [row for row in _interface() if row[1] in ("service", "action")]
    rows = ((f"`{name}`", kind + " (action)" * (what == "action"), words) for _, what, name, kind, words in made)
    return _table(("name", "type", "what"), rows)


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else "[]" if value == () else str(value) or '""'


def _range(one: Any) -> str:
    if one.choices:
        return ", ".join(one.choices)
    return "" if one.low is None else f"{one.low:g} … {one.high:.9g}"


# ---------------------------------------------------------------- docs/safety-case.md, and figures of the evidence


def _read(name: str) -> str:
    return (EVIDENCE / name).read_text(encoding="utf-8")


def _found(pattern: str, text: str) -> tuple[str, ...]:
    match = re.search(pattern, text)
    assert match, f"the evidence has no longer: {pattern}"
    return match.groups()


def shown() -> str:
    """Results in the committed evidence, with the command that shows each; one line for each of its pages."""
    faults, missions, response, mutation = map(_read, ("faults.md", "missions.md", "response-time.md", "mutation.md"))
    worse, runs = _found(r"Worse than the rules allow: (\d+) of (\d+) runs", faults)
    (kinds,) = _found(r"(\d+) kinds of fault", faults)
    failed, driven = _found(r"Failed: (\d+) of (\d+) runs", missions)
    echoes, slowest = _found(r"of (\d+) echoes it saw the slowest took ([\d.]+) ms", response)
    idle = next(line.split(" | ") for line in response.splitlines() if line.startswith("| idle |"))
    counted = [row.split(" | ") for row in re.findall(r"^\| (`\w+` \|.*)$", mutation, re.MULTILINE)]
    told = _scores()
    mutants, killed, survived = (sum(int(row[place]) for row in counted) for place in (1, 2, 4))
    rows = (
        (
            f"{runs} runs with a fault in each, {kinds} kinds of fault",
            "make campaign",
            f"[worse than the rules allow: {worse}]({{evidence}}faults.md)",
        ),
        (f"{driven} drives, each mission to its end", "make missions", f"[failed: {failed}]({{evidence}}missions.md)"),
        (
            f"{echoes} handshakes on a vcan0, idle and under load; the car allows 100 ms",
            "make scrutineering",
            f"[slowest {slowest} ms]({{evidence}}response-time.md); idle p50 {idle[2]} ms, p99 {idle[3]} ms"
            f" (a polling C loop: {idle[7]}, {idle[8]})",
        ),
        (
            f"{mutants} small mistakes put into supervisor and gate",
            "make mutation",
            f"[not noticed by a test: {survived}]({{evidence}}mutation.md)"
            f" ({mutants - killed - survived} change nothing)",
        ),
        (
            " and ".join(f"{logs} logs with {what}" for what, logs, _, _ in told) + ", explained",
            "make explanations",
            f"[rightly: {' and '.join(right for _, _, right, _ in told)}]({{evidence}}explanations.md);"
            f" wrongly called OK: {sum(int(green) for *_, green in told)}",
        ),
    )
    return _table(("what was done", "command", "result"), ((done, f"`{how}`", said) for done, how, said in rows))


def _scores() -> list[tuple[str, str, str, str]]:
    """Counts of each half of the explanations: its kind, its logs, those told rightly, those wrongly called OK."""
    rows = r"^\| ([a-z ]+) \| (\d+) \| (\d+) \| \d+ \| \d+ \| (\d+) \|$"
    return re.findall(rows, _read("explanations.md"), re.MULTILINE)


def explained() -> str:
    """The score of the explanations, in a sentence."""
    scores = " and ".join(f"{right} of {logs} logs with {what}" for what, logs, right, _ in _scores())
    return f"It names the right cause in {scores} ([evidence]({{evidence}}explanations.md))."


def speeds() -> str:
    """Beside others in the same run."""
    ratios = {row["name"]: row["ratio"]["median"] for row in json.loads(_read("bench.json"))["results"]}
    frames = "{decode a frame:.1f} and {encode a frame:.1f} times as fast as cantools".format_map(ratios)
    logs = "{decode random, wall:.0f} to {decode recorded, wall:.0f} times as fast as cantools decode".format_map(
        ratios
    )
    slower = (
        f"{1 / ratios['answer a 0x520']:.1f} times as long as a loop of cantools and python-can that checks nothing"
    )
    return _table(
        ("what was done", "[result]({evidence}bench.json)"),
        (
            ("frames that repeat, decoded and encoded; a log decoded to text", f"{frames}; {logs}"),
            ("0x520 answered, every check made", slower),
        ),
    )


def machines() -> str:
    """Return the table of what `make fresh-machine` has tried, a line for each trial."""
    rows = json.loads(_read("fresh-machines.json"))
    results = (f"passed, {row['date']}" if row["passed"] else f"**failed**: {row['failed']}" for row in rows)
    return _table(
        ("a machine that had nothing", "tried there", "commands", "result"),
        (
            (f"{row['system']}, {row['python']}", row["what"], ", ".join(row["commands"]), result)
            for row, result in zip(rows, results, strict=True)
        ),
    )


def targets() -> str:
    """Return the table of the targets that show something, in the Makefile's words."""
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    part = text[text.index("##@ Is it safe?") : text.index("##@ For others")]
    found = [("test", text), *((name, part) for name in re.findall(r"^([a-z-]+):.*## ", part, re.MULTILINE))]
    found += [("fresh-machine", text)]
    rows = ((f"`make {name}`", *_found(rf"(?m)^{name}:.*## (.*)$", where)) for name, where in found)
    return _table(("command", "what it does"), rows)


def hazards() -> str:
    return "\n\n".join(_hazards())


def _hazards() -> Iterator[str]:
    """Yield a section for each hazard: what prevents it, its rules, its tests and the evidence."""
    rows = {row[0].strip("| `"): row for row in (line.split(" | ") for line in _read("faults.md").splitlines())}
    for number, one in enumerate(tomllib.loads((ROOT / "docs" / "hazards.toml").read_text())["hazard"], 1):
        yield "\n".join(
            (
                f"### {number}. {one['name']}",
                "",
                one["what"],
                "",
                *(f"- **Prevented by** {measure}" for measure in one["prevented_by"]),
                *(f"- **Rule** {rule}: {RULES[rule]}" for rule in one["rules"]),
                f"- **Tests** {', '.join(f'`{test}`' for test in one['tests'])}",
                *(f"- **Evidence** {figure}" for figure in (one.get("figure"),) if figure),
                f"- **Evidence** {_campaign([rows[fault] for fault in one['faults']], one['faults'])}",
            )
        )


def _campaign(rows: Sequence[Sequence[str]], names: Sequence[str]) -> str:
    """Return what the campaign's table says of these faults.

    Its columns count from the end: texts may hold anything.
    """

    begin = {kind.name for kind in ROWS if not kind.from_start}  # what is there from power-up on has no such time
    worse = sum(int(row[-1].strip("| ")) for row in rows)
    text = f"{sum(int(row[-6]) for row in rows)} runs of the campaign with {', '.join(f'`{name}`' for name in names)}"
    text += f": {worse} worse than the rules allow"
    for words, column in (("slowest reaction", -5), ("slowest safe state", -3)):
        times = [int(row[column]) for row in rows if row[0].strip("| `") in begin and row[column].isdigit()]
        text += f"; {words} {max(times)} ms" if times else ""
    return text


BLOCKS: Final[Mapping[str, Callable[[], str]]] = {
    make.__name__: make
    for make in (
        *(sent, flow, reactions, give_up, sequence, limiters, arrows, as_states),
        *(endings, as_off, starting, driving, guards),
        *(keys, parameters, topics, services, shown, explained, speeds, machines, targets, hazards),
    )
}


def renewed(page: Path) -> str:
    """The page with its blocks made again."""
    evidence = "docs/evidence/" if page.parent == ROOT else "evidence/"

    def block(match: re.Match[str]) -> str:
        return match[1] + BLOCKS[match[2]]().replace("{evidence}", evidence) + "\n" + match[3]

    return BLOCK.sub(block, page.read_text(encoding="utf-8"))


def pages() -> list[Path]:
    """The pages that have such blocks."""
    found = (ROOT / "README.md", ROOT / "nodes" / "README.md", *sorted((ROOT / "docs").glob("*.md")))
    return [page for page in found if BLOCK.search(page.read_text(encoding="utf-8"))]


if __name__ == "__main__":
    for page in pages():
        if (text := renewed(page)) != page.read_text(encoding="utf-8"):
            page.write_text(text, encoding="utf-8")
            print(f"renewed {page.relative_to(ROOT)}")
    sys.exit(0)
