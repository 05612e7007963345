"""The pages on a terminal: shows pictures of a source, and moves in it as the keys say."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar, Final

from rich.text import Text
from textual import events
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.widget import Widget
from textual.widgets import Input, OptionList, Static

from fsai_vcu.diagnostics.explain.incident import TimelineEntry
from fsai_vcu.diagnostics.monitor import drawing
from fsai_vcu.diagnostics.monitor.sources import PlayedLog, Source
from fsai_vcu.interface.units import S

PAGES: Final = ("overview", "messages", "signals", "events")
HELP: Final = """\
q, Ctrl-C   end; the last picture stays in the terminal
p, space    pause or continue; in a log: stop or play
Tab, 1…4    overview, messages, signals, events
Enter       messages: the selected one's bytes, signals and changes
            events: go to that moment of a log
/           signals by name, with * and ?; several with commas
Esc         back

In a log:
← →         one second; , and . ten seconds
n, N        the next, the previous change of the AS state
g           go to a second

What changed within the last second is highlighted. The AS state
has the colour of the car's lights; its lamp flashes as they do.
Nothing is ever sent."""
# Keys and what they do, the most needed first: as many as fit
FOOT: Final = (("q", "quit"), ("?", "help"), ("p", "pause"), ("Tab", "page"), ("/", "find"))
FOOT_OF_A_LOG: Final = (
    *FOOT[:3],
    ("← →", "1 s"),
    ("Tab", "page"),
    ("n N", "state"),
    ("g", "second"),
    ("/", "find"),
)
_BLINK_S: Final = 0.5
_WIDE: Final = 60
_BESIDE: Final = 110  # columns from which on bars and trends stand beside the overview …
_LEFT: Final = 72  # … which takes so many at least


class MonitorApp(App[None]):
    """`moment` is what was shown last; `printed` what was written to standard error meanwhile."""

    CSS = """
    Static { height: auto; }
    #head, #foot, Input { height: 1; }
    #foot { text-wrap: nowrap; }
    #both { height: 1fr; }
    #side { padding-left: 1; }
    #scroll, OptionList { scrollbar-size-vertical: 1; overflow-x: hidden; }
    OptionList { border: none; padding: 0; height: 1fr; text-wrap: nowrap; text-overflow: clip; }
    """
    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(keys, action, priority=True)  # on every page; while something is typed, Esc and Ctrl-C alone
        for keys, action in (
            ("q", "end"),
            ("question_mark", "page('help')"),
            ("p,space", "pause"),
            ("tab", "next_page"),
            ("slash", "ask('signals')"),
            ("left", "step(-1)"),
            ("right", "step(1)"),
            ("comma", "step(-10)"),
            ("full_stop", "step(10)"),
            ("n", "change(1)"),
            ("N", "change(-1)"),
            ("g", "ask('second')"),
            ("escape", "leave"),
            ("ctrl+c", "quit"),
            *((str(number), f"page('{page}')") for number, page in enumerate(PAGES, 1)),
        )
    ]

    def __init__(self, source: Source, every_s: float, patterns: Sequence[str] = ()) -> None:
        """Prepare to show `source` every `every_s`; with patterns the page of signals comes first."""
        super().__init__(ansi_color=True)  # the terminal's own colours, dark or light
        self.theme = "ansi-dark"
        self.moment = source.look()
        self.printed: list[str] = []
        self._source = source
        self._replayed = source if isinstance(source, PlayedLog) else None
        self._every_s = every_s
        self._patterns = tuple(patterns) or ("*",)
        self._page = "signals" if patterns else "overview"
        self._asked = ""  # what is typed at the moment
        self._key = 0  # of the message that is looked at
        self._height = 0  # lines of the text: arranging the page again costs as much as drawing it
        self._rows: list[tuple[Text, Any]] = []
        self._events: tuple[float, list[TimelineEntry]] | None = None
        self._head, self._text = Static(id="head"), Static()
        self._scroll = VerticalScroll(self._text, id="scroll")
        self._side = Static(id="side")
        self._both = Horizontal(self._scroll, self._side, id="both")
        self._list = OptionList(markup=False)
        self._input = Input(compact=True)
        self._foot = Static(id="foot", markup=False)

    def compose(self) -> ComposeResult:
        yield from (self._head, self._both, self._list, self._input, self._foot)

    def on_mount(self) -> None:
        for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            asyncio.get_running_loop().add_signal_handler(each, self.exit)
        asyncio.get_running_loop().add_signal_handler(signal.SIGTSTP, self._stop_process)
        # Not textual's own either, which takes a terminal that is drawn on already for the one to be left behind.
        asyncio.get_running_loop().add_signal_handler(signal.SIGCONT, self._draw_anew)
        self.begin_capture_print(self, stdout=False)
        self.set_interval(self._every_s, self._tick)
        self._input.display = False
        self.action_page(self._page)

    def _stop_process(self) -> None:
        # By the event loop: textual's own handler waits for a lock that the code it interrupts may hold.
        with self.suspend():
            os.kill(os.getpid(), signal.SIGSTOP)

    def _draw_anew(self) -> None:
        self.refresh(layout=True)

    def on_print(self, event: events.Print) -> None:
        self.printed.append(event.text)

    def on_resize(self) -> None:
        self._show()

    def _tick(self) -> None:
        if self._source.ended and not self._replayed:
            self.exit()
        playing = self._source.playing
        self._source.advance(self._every_s)
        if playing:
            self._show()

    # ------------------------------------------------------------ pictures

    def _show(self) -> None:
        """Take a look at the source and draw the page in hand."""
        self.moment = self._source.look()
        width, height = self.size
        page = self._page if width >= _WIDE else ""
        self._foot.update(drawing.badges(FOOT_OF_A_LOG if self._replayed else FOOT, width), layout=False)
        self._head.update(drawing.head(self.moment.picture, self._position(), width, page), layout=False)
        if self._page == "help":
            self._side.display = False
            self._text.update(HELP)
            self._height = 0
        elif self._page == "overview":
            side = min(self.size.width - _LEFT, 60) if self.size.width >= _BESIDE else 0
            self._side.display = bool(side)
            if side:
                self._side.styles.width = side
                view, picture = self.moment.view, self.moment.picture
                self._side.update(drawing.instruments(picture, view.trends(picture.t_ns), side - 2), layout=False)
            dark = self._source.playing and time.monotonic() % (2 * _BLINK_S) > _BLINK_S
            text = drawing.overview(self.moment.picture, width - 1 - side, height, dark_phase=dark)
            self._text.update(text, layout=text.plain.count("\n") != self._height)
            self._height = text.plain.count("\n")
        else:
            self._show_rows(list(self._rows_of_page(width - 1)))

    def _position(self) -> str:
        log = self._replayed
        if not log:
            return self.moment.words if self.size.width < _WIDE else f"listening only   {self.moment.words}"
        position_s, end_s = ((t_ns - log.begin_ns) / S for t_ns in (log.position_ns, log.end_ns))
        return f"{'▶' if log.playing else '■'} {position_s:.1f} of {end_s:.1f} s"

    def _rows_of_page(self, width: int) -> Iterator[tuple[Text, Any]]:
        """The rows of a list, and what each stands for: a message's key, an event's time."""
        view, picture = self.moment.view, self.moment.picture
        if self._page == "messages":
            yield from ((drawing.message_row(one, width), one.key) for one in picture.messages)
        elif self._page == "message":
            shown = [one for one in picture.messages if one.key == self._key]
            yield from ((drawing.message_row(one, width), None) for one in shown)
            patterns = [f"{one.name}.*" for one in shown if one.name]
            histories = view.bytes(self._key, picture.t_ns) + view.signals(patterns, picture.t_ns)
            yield from ((drawing.history_row(one, width), None) for one in histories)
        elif self._page == "signals":
            found = view.signals(self._patterns, picture.t_ns)
            yield from ((drawing.history_row(one, width, full=True), None) for one in found)
            if not found:
                yield drawing.line(f"no signal received fits {', '.join(self._patterns)}"), None
        else:
            for event in self._history():
                later = event.t_ns > picture.t_ns
                yield drawing.event_row(event, self._source.clock(event.t_ns), later=later), event.t_ns

    def _show_rows(self, rows: list[tuple[Text, Any]]) -> None:
        """Replace those rows of the list that have changed, and follow the newest event where the last was chosen."""
        shown, old = self._list, self._rows
        follows = shown.highlighted == len(old) - 1 and self._page == "events" and not self._replayed
        if len(rows) < len(old):
            shown.clear_options()
            old = []
        for place, ((row, _), (before, _)) in enumerate(zip(rows, old, strict=False)):
            if row.markup != before.markup:
                shown.replace_option_prompt_at_index(place, row)
        shown.add_options(row for row, _ in rows[len(old) :])
        if rows and (shown.highlighted is None or follows):
            now_ns = self.moment.picture.t_ns
            past = sum(t_ns <= now_ns for _, t_ns in rows) if self._page == "events" else 1
            shown.highlighted = max(0, past - 1)
        self._rows = rows

    def _history(self) -> list[TimelineEntry]:
        """The events: of a log all of them, of a bus those until now, looked for once a second."""
        if self._events is None or (not self._replayed and time.monotonic() - self._events[0] > 1.0):
            self._events = time.monotonic(), self._source.events()
        return self._events[1]

    # ------------------------------------------------------------ keys

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Return whether an action is possible: keys are letters while something is typed, and a bus cannot be moved
        in.
        """
        if self._input.display:
            return action not in ("end", "page", "pause", "next_page", "ask", "step", "change")
        return self._replayed is not None or not (action in ("step", "change") or parameters == ("second",))

    def action_end(self) -> None:
        self.exit()

    def action_page(self, page: str) -> None:
        self._page = page
        is_text = page in ("overview", "help")
        self._both.display, self._list.display = is_text, not is_text
        self._list.styles.text_wrap = "wrap" if page == "events" else "nowrap"
        self._list.clear_options()
        self._rows = []
        self._type_into(self._scroll if is_text else self._list)
        self._scroll.scroll_home(animate=False)
        self._show()

    def _type_into(self, widget: Widget) -> None:
        """Set the focus at once, not behind the keys typed since: a busy machine may have let them wait together."""
        self.screen.set_focus(widget)

    def action_next_page(self) -> None:
        place = PAGES.index(self._page) if self._page in PAGES else 0
        self.action_page(PAGES[(place + 1) % len(PAGES)])

    def action_leave(self) -> None:
        if self._input.display:
            self._input.display = False
        else:
            self._page = "messages" if self._page == "message" else "overview"
        self.action_page(self._page)

    def action_pause(self) -> None:
        self._source.pause()
        self._show()

    def action_step(self, seconds: int) -> None:
        if self._replayed:
            self._replayed.seek(self._replayed.position_ns + seconds * S)
            self._show()

    def action_change(self, direction: int) -> None:
        if self._replayed:
            now_ns = self._replayed.position_ns
            times = [one.t_ns for one in self._history() if one.topic == "AS state"]
            beyond = [t_ns for t_ns in times[::direction] if (t_ns - now_ns) * direction > 0]
            self._replayed.seek(beyond[0] if beyond else now_ns)
            self._show()

    def action_ask(self, what: str) -> None:
        self._asked = what
        self._input.placeholder = "seconds after the start" if what == "second" else "signals: NAME or a part of it, …"
        self._input.value = ""
        self._input.display = True
        self._type_into(self._input)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        parts = [part.strip() for part in event.value.split(",") if part.strip()]
        self._input.display = False
        if self._asked == "signals":
            self._patterns = tuple(part if "*" in part or "?" in part else f"*{part}*" for part in parts) or ("*",)
            self._page = "signals"
        elif self._replayed:
            try:
                self._replayed.seek(self._replayed.begin_ns + round(float(event.value) * S))
            except (ValueError, OverflowError):
                self.notify(f"{event.value} is no number of seconds", severity="error")
        self.action_page(self._page)

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        key = self._rows[event.option_index][1]
        if self._page == "messages":
            self._key = key
            self.action_page("message")
        elif self._page == "events" and self._replayed:
            self._replayed.seek(key)
            self.action_page("overview")
