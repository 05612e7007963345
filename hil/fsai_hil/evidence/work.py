"""Long work of the evidence: spread over processes, followed by one line, and kept in a record that it goes on from.

A record holds results as JSON lines, one for each, after a header that says what they are results of. Lines are
appended whole and flushed, so that work that is killed goes on where it was; a line cut short by the kill is left out
when the record is read, and written over.
"""

from __future__ import annotations

import ctypes
import fcntl
import hashlib
import json
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import AbstractContextManager
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any, Final, TextIO, TypeVar

import fsai_hil
import fsai_vcu
from fsai_vcu.interface.revisions import dbc_dir

AHEAD: Final = 3  # tasks waiting per worker
NICENESS: Final = 5  # evidence gives way to what else there is to do on the machine
PROGRESS_EVERY_S: Final = 5.0
MANY: Final = 20  # that are wrong: further ones are not told

PR_SET_PDEATHSIG: Final = 1  # linux/prctl.h

T = TypeVar("T")
R = TypeVar("R")

DRIVEN: Final = {
    fsai_vcu: ("core/**/*", "interface/**/*", "runtime/**/*", "diagnostics/log/*", "diagnostics/statistics/quantiles"),
    fsai_hil: ("rules/**/*", "simulator/**/*", "evidence/campaign/**/*"),
}
"""The places of the code that decides a run: what is driven, the rules, and what these import of the diagnostics. The
command line, the nodes and the rest of the evidence change none."""

Header = Mapping[str, Any]
"""The facts that decide every result: records with equal headers hold the same. The first key is the record's kind."""


class RecordError(ValueError):
    """A record that cannot be used; the message is one clear line."""


def digest_of(files: Mapping[str, Path]) -> str:
    """One short word for these files, by names that are the same wherever they are installed."""
    found = hashlib.sha256()
    for name, path in sorted(files.items()):
        found.update(f"{name}\0".encode() + path.read_bytes() + b"\0")
    return found.hexdigest()[:12]


def driven_files() -> dict[str, Path]:
    """Return the files that decide a run, by names that are the same on every machine: code and signal databases."""
    found = {path.name: path for path in dbc_dir().glob("*.dbc")}
    for package, parts in DRIVEN.items():
        root = Path(str(package.__file__)).parent
        found |= {str(path.relative_to(root.parent)): path for part in parts for path in root.glob(f"{part}.py")}
    return found


@cache
def digest() -> str:
    """One short word for the code of this installation: runs of different code must not be mixed in one record."""
    return digest_of(driven_files())


def read(path: Path, kind: str) -> tuple[Header, list[Any]]:
    """Header and results of a record. Raises RecordError, OSError."""
    found = []
    for number, line in enumerate(path.read_text().splitlines(keepends=True), 1):
        if line.endswith("\n"):
            try:
                found.append(json.loads(line))
            except json.JSONDecodeError:
                raise RecordError(f"{path}:{number}: not a line of a record") from None
    if not found or not isinstance(found[0], dict) or kind not in found[0]:
        raise RecordError(f"{path} is not a record of the kind {kind!r}")
    return found[0], found[1:]


class RecordFile(AbstractContextManager["RecordFile"]):
    """A record that is appended to, or begun. `results`: what it holds; `kept_as`: what its place held before."""

    def __init__(self, path: Path, header: Header, *, resume: bool = True) -> None:
        """One with another header is kept by another name, and without `resume` any is.

        Raises RecordError where the file is no record of this kind, or is written to by another process, OSError.
        """
        self.path, self.results, self.kept_as = path, list[Any](), None
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a")
        try:
            self._lock()
            whole_bytes = path.read_bytes().rfind(b"\n") + 1
            if whole_bytes:
                before, results = read(path, next(iter(header)))
                if resume and before == header:
                    self.results = results
                    self._file.truncate(whole_bytes)
                    return
                self.kept_as = _put_aside(path)
                self._file.close()
                self._file = path.open("a")
                self._lock()
            else:
                self._file.truncate(0)
        except BaseException:
            self._file.close()
            raise
        self._put(header)

    def _lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RecordError(f"{self.path} is being written by another process") from None

    def add(self, result: Any) -> None:
        self.results.append(result)
        self._put(result)

    def _put(self, line: Any) -> None:
        print(json.dumps(line, ensure_ascii=False), file=self._file, flush=True)

    def __exit__(self, *_: object) -> None:
        self._file.close()


def _put_aside(path: Path) -> Path:
    number = 1
    while (kept := path.with_name(f"{path.stem}-before-{number}{path.suffix}")).exists():
        number += 1
    return path.rename(kept)


# ---------------------------------------------------------------- work spread over processes


def _begin_worker(parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who spreads the work
    # A worker waits for work on a pipe of which it holds both ends: it would outlive a parent that is killed.
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        os._exit(1)
    os.nice(NICENESS)


def handed_over(pool: Executor, work: Callable[[T], R], tasks: Iterable[T], at_once: int) -> Iterator[R]:
    """The result of each task as it comes; tasks are taken when a worker has room for them."""
    waiting = iter(tasks)
    under_way: set[Future[R]] = set()
    while True:
        under_way |= {pool.submit(work, task) for task in islice(waiting, at_once - len(under_way))}
        if not under_way:
            return
        done, under_way = wait(under_way, return_when=FIRST_COMPLETED)
        for future in done:
            yield future.result()


def spread(work: Callable[[T], R], tasks: Iterable[T], jobs: int) -> Iterator[R]:
    """`work` done to each task in `jobs` processes of this machine; results as they come."""
    if jobs == 1:
        yield from map(work, tasks)
        return
    # Forked workers share what is imported already, and a test's seeded defects.
    context = multiprocessing.get_context("fork")
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin_worker, initargs=(os.getpid(),))
    try:
        yield from handed_over(pool, work, tasks, jobs * AHEAD)
    except BaseException:
        workers = list((pool._processes or {}).values())
        pool.shutdown(wait=False, cancel_futures=True)
        for process in workers:
            process.terminate()
        raise
    pool.shutdown()


def followed(
    results: Iterable[R],
    what: str,
    total: int | None,
    wrong: Callable[[R], str],
    counted: str,
    *,
    record: RecordFile | None = None,
    to: TextIO | None = None,
) -> Iterator[R]:
    """The results as they come, kept in the `record`; one line on stderr says how the work goes on.

    `what` is counted up to `total` (None where the end is not known), and so is what is `wrong`, in words ("": nothing
    is), under the name `counted`; the words go to standard output, or `to` another place. The line is written over on a
    terminal, and comes every few seconds elsewhere.
    """
    began_s = next_s = time.monotonic()
    terminal = sys.stderr.isatty()
    clear = "\r\033[K" if terminal else ""
    failed = 0
    try:
        for done, one in enumerate(results, 1):
            if record is not None:
                record.add(one)
            if words := wrong(one):
                failed += 1
                print(clear, end="", file=sys.stderr, flush=True)
                if failed <= MANY:
                    print(words if failed < MANY else f"{words}\n… further ones are counted only", file=to, flush=True)
            now_s = time.monotonic()
            if now_s >= next_s or done == total:
                next_s = now_s + (0.2 if terminal else PROGRESS_EVERY_S)
                rate = done / max(1e-9, now_s - began_s)
                left = ""
                if total is not None:
                    minutes, seconds = divmod(round((total - done) / rate), 60)
                    left = f" of {total}, {minutes // 60}:{minutes % 60:02d}:{seconds:02d} left"
                line = f"{clear}{done} {what}{left}, {rate:.2f} {what}/s, {failed} {counted}"
                print(line, end="" if terminal else "\n", file=sys.stderr, flush=True)
            yield one
    finally:
        print(clear, end="", file=sys.stderr, flush=True)
