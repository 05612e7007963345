"""`fsai-vcu plot`: any signals of a log over time, as a picture."""

from __future__ import annotations

import argparse
from io import BytesIO
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Final

from fsai_vcu.cli import report
from fsai_vcu.cli.decoding import Decoding, add_database_arguments
from fsai_vcu.cli.sources import LOG_HELP, Sources, add_part_arguments, part_of
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.record import Record, Series
from fsai_vcu.diagnostics.log.filters import name_and_filters
from fsai_vcu.diagnostics.page.curves import BREAK_NS
from fsai_vcu.files import is_there, write_whole
from fsai_vcu.interface.errors import UserError, WrongUse
from fsai_vcu.interface.lights import BAND_ALPHA, light_of
from fsai_vcu.printable import drawn

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EXAMPLE = "fsai-vcu plot run.log STEER_REQUEST ANGLE 'VCU2AI_Speeds.*' -o wheels.png"
ABOUT = """\
A signal is NAME or MESSAGE.NAME, with * and ?. Signals of one unit share an axis;
the colour behind it is the AS state. The ending of the file is the format: png,
svg or pdf, which need matplotlib (pip install 'fsai-vcu[plot]'), or html, which
saves the page of report with these signals on top, with report's exit status."""

_FORMATS: Final = ("", "png", "svg", "pdf")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="LOG", help=f"{LOG_HELP}; filters as for dump")
    signals = "more logs, read as one; then signals: NAME or MESSAGE.NAME, with * and ?"
    parser.add_argument("words", nargs="*", metavar="SIGNAL", help=signals)
    parser.add_argument("-o", "--output", type=Path, default=Path("plot.png"), metavar="FILE", help="default: plot.png")
    add_part_arguments(parser)
    add_database_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Tell logs from signals among the arguments, read the logs and save the picture."""
    more = list(takewhile(lambda word: is_there(name_and_filters(word)[0]), args.words))
    logs, signals = [args.source, *more], args.words[len(more) :]
    if not signals:
        example = f"fsai-vcu plot {args.source} ANGLE 'VCU2AI_Speeds.*'"
        raise WrongUse(f"no signal is named: {example}; fsai-vcu dbc show lists them")
    decoding = Decoding("plot", args)
    decoding.patterns(",".join(signals))
    sources = Sources("plot", logs, part=part_of(args, decoding))
    if sources.live:
        raise UserError(f"{sources.name} is a bus; plot takes a log (fsai-vcu record {sources.name} makes one)")
    if args.output.suffix == ".html":
        page = vars(args) | {"sources": logs, "signals": ",".join(signals), "seconds": None, "json": False}
        return report.run(argparse.Namespace(**page))
    sources.check_output(args.output)
    if args.output.suffix[1:].lower() not in _FORMATS:  # pgf would take names in the log for TeX
        raise WrongUse(f"cannot write {args.output}: a picture is {', '.join(filter(None, _FORMATS))}")
    frames = sources.everything()
    if not len(frames):
        return 1
    record = Record(frames, args.revision, decoding.databases if args.dbc else None)
    groups = record.matching(signals)
    if not groups:
        raise UserError(f"no signal {' or '.join(signals)} in {sources.name}")
    record.begin_ns = sources.first_ns or record.begin_ns
    _save(args.output, record, groups, sources.name)
    print(f"saved {args.output}: {', '.join(name for group in groups.values() for name, _ in group)}")
    return sources.status


def _save(path: Path, record: Record, groups: dict[str, list[tuple[str, Series]]], title: str) -> None:
    """Draw each group of signals into axes of its own, and save the picture to `path`."""
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
    except ImportError:
        raise UserError("matplotlib is not installed; install it with: pip install 'fsai-vcu[plot]'") from None
    figure, rows = pyplot.subplots(len(groups), figsize=(12, 1 + 3 * len(groups)), sharex=True, squeeze=False)
    for axes, (unit, group) in zip(rows[:, 0], groups.items(), strict=True):
        for name, series in group:
            axes.plot(
                (series.t_ns - record.begin_ns) / 1e9, series.values, drawstyle="steps-post", label=drawn(name), lw=1
            )
        _shade_states(axes, record, named=axes is rows[0, 0])
        axes.set_ylabel(drawn(unit or "raw"))
        axes.grid(alpha=0.3)
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small")  # beside, so that it hides nothing
    rows[0, 0].set_title(drawn(title))
    rows[-1, 0].set_xlabel("seconds since the log's first frame")
    figure.tight_layout()
    try:
        picture = BytesIO()
        figure.savefig(picture, format=path.suffix[1:].lower() or "png")
        write_whole(path, picture.getvalue())
    except (OSError, ValueError) as error:
        raise UserError(f"cannot write {path}: {getattr(error, 'strerror', None) or error}") from error
    finally:
        pyplot.close(figure)


def _shade_states(axes: Axes, record: Record, *, named: bool) -> None:
    """Colour the background by AS state; each has its name in the legend once."""
    found: set[str] = set()
    for span in record.series(sig.AS_STATE).spans_within(BREAK_NS):
        state = sig.label(sig.AS_STATE, span.value)
        begin_s, end_s = ((t_ns - record.begin_ns) / 1e9 for t_ns in (span.begin_ns, span.end_ns))
        label = state if named and state not in found else "_"
        axes.axvspan(begin_s, end_s, color=light_of(state).fill, alpha=BAND_ALPHA, linewidth=0, zorder=0, label=label)
        found.add(state)
