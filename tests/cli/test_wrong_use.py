"""What is typed wrong, or cannot be read, is one clear line: nothing is printed besides, and nothing is written."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from fsai_vcu.cli.main import main

GOOD = "(1.000000) can0 523#640064006400\n(1.010000) can0 510#0000000000000000\n"
FOREIGN = b'VERSION ""\n\nBU_: A\n\nBO_ 291 Engine: 8 A\n SG_ Rpm : 0|16@1+ (1,0) [0|0] "rpm" A\n'
BUS = "loopback:wrong-use"
LONG = "x" * 255  # with an ending more than a file's name can have
WRITERS = (
    ("report run.log", "html"),
    ("plot run.log ANGLE", "png"),
    ("export run.log", "csv"),
    (f"record {BUS} --seconds 1", "log"),
)
READERS = ("decode", "explain", "monitor", "pitwall")
USES = [
    # ---------------------------------------------------------------- what no verb or no file is
    ("fly", 2, "no verb 'fly'"),
    ("mode auto", 2, "there is no mode 'auto'; did you mean autonomous?"),
    ("mode sport", 2, "there is no mode 'sport'; there are: manual, autonomous"),
    ("status --wait nan", 2, "--wait is nan, but must be 0 or more"),
    *((f"{verb} gone.log", 1, "gone.log: No such file or directory") for verb in READERS),
    *((f"{verb} no0", 1, "no CAN interface 'no0'") for verb in ("decode", "dump", "monitor", "pitwall --port 0")),
    *((f"{verb} -i no0", 1, "no CAN interface 'no0'") for verb in ("dump -t z", "check", "foxglove --port 0")),
    *((f"{verb} empty.log", 1, "no frames in it") for verb in ("decode", "explain", "monitor")),
    *((f"{verb} garbage.log", 1, "line 1: not text") for verb in ("decode", "explain", "monitor")),
    *((f"explain run.log {option} nan", 2, f"{option} is nan") for option in ("--from", "--to")),
    *((f"{verb} run.log --revision 2030", 2, "choose one of 2021, 2026") for verb in ("decode", "monitor")),
    *((f"{verb} run.log --dbc gone.dbc", 1, "gone.dbc: cannot be read: No such") for verb in ("decode", "monitor")),
    *(
        (f"{verb} run.log --from 500", 1, "run.log is in the chosen part")
        for verb in ("decode", "dump", "check", "explain")
    ),
    *(
        (f"{verb} {BUS} --seconds 0", 2, "--seconds is 0, not a time")
        for verb in ("explain", "report -o x.html", "check")
    ),
    *(
        (f"{verb} run.log --from 2 --to 1", 2, "--from 2 is after --to 1")
        for verb in ("check", "explain", "dump", "decode", "report -o x.html", "compare run.log")
    ),
    *(
        (f"{verb} run.log --seconds 3", 2, "--seconds is for live buses; --from and --to choose a part of a log")
        for verb in ("check", "explain", "report -o x.html")
    ),
    *(
        (f"{verb} -o run.log", 2, "run.log is the log that is read, and would be overwritten")
        for verb in (
            "export run.log --format mf4",
            "export folder/../run.log --format mcap",
            "report run.log",
            "plot run.log ANGLE",
        )
    ),
    (
        "export run.log --format csv -o tables --dbc foreign.dbc",
        1,
        "nothing to export: the databases name none of the 2",
    ),
    ("check run.log --bitrate 0", 2, "--bitrate is 0, not a bit rate"),
    ("record -i no0", 2, "-o is missing: fsai-vcu record can0 -o run.log"),
    ("record -i no0 -o x.log --config x.toml", 2, "--config goes with --service"),
    ("record --service --config gone.toml", 1, "gone.toml: cannot be read: No such file"),
    ("decode folder", 1, "folder: no log in this folder"),
    ("drive --mision acceleration", 2, "unrecognized arguments: --mision acceleration; did you mean --mission"),
    ("config chek", 2, "fsai-vcu config: invalid choice: 'chek'; did you mean check?"),
    ("dump run.log -t q", 2, "argument -t: invalid choice: 'q'; there are: a, A, d, z"),
    ("plot run.log", 2, "no signal is named: fsai-vcu plot run.log ANGLE 'VCU2AI_Speeds.*'"),
    (f"report {BUS} --seconds 1", 2, "-o is missing: -o report.html"),
    ("send no0 513#3200", 2, "'513#3200' is a raw frame, for cansend; send takes: AI2VCU_Steer STEER_REQUEST=…"),
    (
        "send no0 7FF#00",
        2,
        "'7FF#00' is a raw frame, for cansend; send takes: send takes BUS MESSAGE SIGNAL=VALUE, and ",
    ),
    ("send no0", 1, "no message 'no0'; send takes BUS MESSAGE SIGNAL=VALUE, and fsai-vcu dbc show lists"),
    (
        "send",
        2,
        "are required: MESSAGE, SIGNAL=VALUE, as in fsai-vcu send AI2VCU_Steer STEER_REQUEST=5 --as-ai --dr",
    ),
    ("replay", 2, "are required: LOG[,FILTER…], as in fsai-vcu replay run.log vcan0 "),
    ("mode", 2, "are required: autonomous|manual, as in fsai-vcu mode autonomous"),
    # ---------------------------------------------------------------- databases and dumps
    ("dbc show VCU2AI_Stear", 1, "no message or signal VCU2AI_Stear in 2026; did you mean VCU2AI_Steer"),
    ("dbc show 0x513 nothing", 1, "no message or signal nothing in 2026"),
    ("dbc diff 2021", 2, "diff takes two databases"),
    ("dbc list --dbc absent.dbc", 1, "absent.dbc"),
    ("dump run.log -n 0", 2, "-n is 0, but must be at least 1"),
    ("dump run.log -T nan", 2, "-T is nan, not a time"),
    ("dump run.log -L -a", 2, "-a and -t A work only with dump, and not with -L"),
    ("decode run.log -t A", 2, "-a and -t A work only with dump, and not with -L"),
    ("dump run.log --signals NO_SUCH", 1, "no signal NO_SUCH"),
    ("dump run.log --from noon", 2, "--from is noon"),
    ("dump run.log,520", 2, "'520' is not a filter; a filter is ID:MASK"),
    ("dump run.log vcan0", 2, "logs and live interfaces cannot be read together"),
    (f"dump {'x' * 5000}", 1, "xxx: File name too long"),
    # ---------------------------------------------------------------- export
    *(
        (f"export {use} --format csv -o tables", status, words)
        for use, status, words in (
            ("gone.log", 1, "gone.log: No such file or directory"),
            ("no0", 2, "no0 is an interface; export reads logs"),
            ("empty.log", 1, "no frames in it"),
            ("run.log,nonsense", 2, "'nonsense' is not a filter"),
            ("run.log --dbc gone.dbc", 1, "gone.dbc: cannot be read: No such file or directory"),
            ("run.log --raster 10ms", 2, "--raster goes with --wide"),
            ("run.log --wide --raster 10", 2, "'10' is not a raster: a raster is a time like 10ms, 0.5s or 100us"),
            ("run.log --wide --raster 0ms", 2, "'0ms' is not a raster"),
        )
    ),
    *((f"{each} -o {LONG}.{end}", 1, "File name too long") for each, end in WRITERS),
    ("plot run.log ANGLE -o picture.pgf", 2, "cannot write picture.pgf: a picture is png, svg, pdf"),
    ("export run.log --format csv -o absent/tables", 1, "cannot write absent/tables: No such file or directory"),
    # ---------------------------------------------------------------- monitor and pit wall
    ("monitor run.log --rate -1", 2, "--rate is -1, but must be 0 or more"),
    ("monitor run.log --at nan", 2, "--at is nan: neither seconds from 0 on, nor minutes and"),
    ("monitor run.log --every 0", 2, "--every is 0, but must be 0.02 or more"),
    ("monitor run.log --seconds 3", 2, "--seconds is for live buses"),
    (f"monitor {BUS} --rate 1", 2, "--at, --from, --to and --rate are for logs"),
    (f"monitor {BUS} --from 1", 2, "--at, --from, --to and --rate are for logs"),
    (f"pitwall {BUS} --to 1", 2, "--from, --to, --rate and --loop are for logs"),
    ("monitor run.log --signals AS_STATE,NOTHING*", 1, "no signal NOTHING*; fsai-vcu dbc show lists them"),
    ("pitwall can0 --loop", 2, "--rate and --loop are for logs"),
    ("pitwall - --loop", 2, "--loop is for logs that are files"),
    ("pitwall run.log --seconds 1", 2, "--seconds is for a live bus, and run.log is a log"),
    ("pitwall run.log --ros", 2, "--ros is for a live bus, and run.log is a log"),
    ("pitwall can0 --namespace /car1", 2, "--namespace goes with --ros"),
    ("pitwall run.log --rate 0", 2, "--rate is 0, but must be 0.01 or more"),
    ("pitwall run.log --port 70000", 2, "--port is 70000, but must be 0 to 65535"),
    # ---------------------------------------------------------------- replay and record
    ("replay run.log -i pcan:PCAN_USBBUS1", 1, "pcan:PCAN_USBBUS1 may be a real bus, with a car on it"),
    ("replay run.log", 2, "the last argument is the bus to send on: fsai-vcu replay run.log vcan0"),
    ("replay run.log run.log", 2, "the last argument is the bus to send on: fsai-vcu replay run.log vcan0"),
    ("record -o x.log", 2, "the bus is missing: fsai-vcu record can0 -o run.log"),
    ("record no0 -i no1 -o x.log", 2, "two buses: no0, and -i no1"),
    ("send no0 AI2VCU_Steer -i no1", 1, "no message 'no0'"),
    ("send BenchLamp", 1, "no message 'BenchLamp'"),
    ("send AI2VCU_Steer STEER_REQUEST=1 --as-ai", 2, "the bus is missing: fsai-vcu send can0 AI2VCU_Steer"),
    ("send no0 AI2VCU_Steer STEER_REQUEST=1 --as-ai", 1, "no CAN interface 'no0'"),
    ("export run.log -o x", 2, "--format is missing: csv, parquet, mcap, mf4"),
    ("decode run.log --messages VCU2AI_Stear", 1, "no message VCU2AI_Stear; did you mean VCU2AI_Steer"),
    ("replay run.log -i no0", 1, "no CAN interface 'no0'"),
    ("explain rnu.log", 1, "rnu.log: No such file or directory; did you mean run.log"),
    ("explain nothing/run.log", 1, "nothing/run.log: No such file or directory"),
    ("replay run.log -i no0 --physical", 1, "no CAN interface 'no0'"),
    *(
        (f"replay {use} -i {BUS}", status, words)
        for use, status, words in (
            ("run.log --rate 0", 2, "--rate is 0, but must be 0.01 or more"),
            ("run.log --rate nan", 2, "--rate is nan, but must be 0.01 or more"),
            ("run.log --loop -1", 2, "--loop is -1, but must be 0 or more"),
            ("run.log --from 2 --to 1", 2, "--from 2 is after --to 1"),
            ("run.log --from=-3", 2, "--from is -3: neither seconds from 0 on"),
            ("run.log --from soon", 2, "--from is soon: neither seconds from 0 on, nor minutes"),
            ("run.log,510:7FF", 1, "nothing is left to send"),
            ("vcan0", 2, "vcan0 is an interface; replay reads logs"),
            ("gone.log", 1, "gone.log: No such file or directory"),
        )
    ),
    *(
        (f"record -i {BUS} -o {use}", status, words)
        for use, status, words in (
            ("new.log --max-total 1G", 2, "--max-total goes with a folder, but new.log is a file"),
            ("new --max-total much", 2, "--max-total is 'much', not a size like 64M or 4G"),
            ("new --max-total 10K", 2, "--max-total is 10K, but must be at least 1M"),
            ("new --segment-time 5", 2, "--segment-time is '5', not a time like 30s, 10min or 1h"),
            ("new.log --seconds -1", 2, "--seconds is -1, but must be 0 or more"),
            ("new --ros", 2, "--ros goes with --mcap"),
            ("new --topic /x", 2, "--topic goes with --ros"),
            ("new.log --limits gone.toml", 1, "cannot read the operational limits gone.toml: No such file"),
            ("new.log --revision 1999", 1, "choose one of 2021, 2026"),
            ("run.log", 1, "run.log exists already; name another file, or a folder to continue in"),
        )
    ),
    # ---------------------------------------------------------------- drives, tracks, campaigns
    ("drive --laps many", 2, "argument --laps: invalid int value: 'many'"),
    ("drive --mission rally", 1, "unknown mission 'rally'"),
    ("drive --revision 2030", 1, "choose one of 2021, 2026"),
    ("drive --track gone.csv", 1, "gone.csv: cannot be read"),
    ("drive --seed -1", 1, "seed is -1, but must be 0 or more"),
    ("drive --max-speed nan", 1, "max_speed_mps is nan"),
    ("drive --limits gone.toml", 1, "gone.toml"),
    ("drive --log absent/bus.log", 1, "absent/bus.log: No such file or directory"),
    ("drive --fault steering_frozn", 1, "unknown fault 'steering_frozn'; did you mean steering_frozen"),
    ("drive --fault nothing", 1, "unknown fault 'nothing'; --list-faults shows"),
    ("drive --fault go_off --track small_oval", 1, "--track does not go with --fault"),
    ("drive --fault go_off --noise 2", 1, "do not go with --fault"),
    ("drive --fault go_off --mission picnic", 1, "unknown mission 'picnic'"),
    ("track", 2, "give a file, a name, or --seed N"),
    ("track autocross --seed 1", 2, "give a file, a name, or --seed N"),
    ("track autocross --style tight", 2, "give a file, a name, or --seed N"),
    ("track --seed -1", 1, "generated--1: no such track"),
    ("track gone.csv", 1, "gone.csv: cannot be read"),
    ("track small_oval -o absent/folder.csv", 1, "absent/folder.csv: No such file"),
    ("track small_oval --plot absent/folder.png", 1, "absent: No such file"),
    ("campaign --runs 0 --full 0", 1, "one of them at least 1"),
    ("campaign --faults gremlins", 1, "unknown fault 'gremlins'"),
    ("campaign --missions picnic", 1, "unknown mission 'picnic'"),
    ("campaign --revisions 1999", 1, "1999"),
    ("campaign --jobs 0", 1, "--jobs is 0, but must be at least 1"),
    ("campaign --window 0.1", 1, "1 to 100 s"),
    ("campaign --faults planner_silent --missions static_inspection_a", 1, "none of these faults applies"),
    ("campaign --table absent/record.jsonl", 1, "absent/record.jsonl: No such file"),
]


@pytest.mark.parametrize(("use", "status", "words"), USES, ids=[use for use, *_ in USES])
def test_wrong_use_is_one_clear_line_and_writes_nothing(
    use: str,
    status: int,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder").mkdir()
    files = {"run.log": GOOD.encode(), "empty.log": b"", "garbage.log": b"\xff\xfe\x00\n", "foreign.dbc": FOREIGN}
    for name, data in files.items():
        Path(name).write_bytes(data)
    try:
        assert main(shlex.split(use)) == status
    except SystemExit as ended:
        assert ended.code == status
    said = capsys.readouterr()
    (line,) = (line for line in said.err.splitlines() if "left out" not in line)
    assert words in line
    assert Path("run.log").read_text() == GOOD and len(list(tmp_path.iterdir())) == 1 + len(files)
    assert said.out == "" or use.startswith(("track small_oval", "dbc show 0x513"))
