"""Work spread over processes: results as they are done, the first failure ends all of it, no process outlives the command."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import traceback
from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import TypeVar, cast

from vantage.cores import available_cores
from vantage.errors import UserError, explain
from vantage.stopping import follow_parent, stop_deferred, stop_requested

Task = TypeVar("Task")
Result = TypeVar("Result")

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class WorkerFailed(UserError):
    """A worker process could not do its task; the text is that of the worker."""


@dataclass(frozen=True)
class _Failure:
    """An exception of a worker, in a form that any process can unpickle."""

    line: str | None
    """For people; None for a bug."""
    system: tuple[int, str, str | None] | None
    """Number, reason and file name of an error of the operating system."""
    trace: str

    @classmethod
    def of(cls, error: BaseException) -> _Failure:
        system = None
        if isinstance(error, OSError) and error.errno is not None:
            system = error.errno, error.strerror or "", None if error.filename is None else str(error.filename)
        return cls(explain(error), system, "".join(traceback.format_exception(error)))

    def as_exception(self) -> Exception:
        if self.system is not None:
            return OSError(*self.system)
        return RuntimeError(f"a worker failed:\n{self.trace}") if self.line is None else WorkerFailed(self.line)


def worker_count(wanted: int, tasks: int) -> int:
    """Return the number of processes for some tasks: as wanted, 0 = one for each core, and no more than tasks."""
    return max(1, min(wanted or available_cores(), tasks))


def results_of(
    function: Callable[[Task], Result], tasks: Sequence[Task], workers: int
) -> Generator[tuple[int, Result], None, None]:
    """Yield (index of the task, result) as the tasks are done. With one worker they run in this process, in order.

    Close the iterator (`contextlib.closing`), so that an error or Ctrl-C between two results ends the workers at once.

    Args:
        function: a function of a module, or a `functools.partial` of one: it is pickled, once for each worker.

    Raises:
        OSError: an error of the operating system, in a worker.
        WorkerFailed: another error for people in a worker, or a worker that was killed.
        RuntimeError: a bug in a worker, with its traceback.
    """
    if workers <= 1:
        for index, task in enumerate(tasks):
            yield index, function(task)
        return
    waiting = deque(enumerate(tasks))
    processes: list[BaseProcess] = []
    busy: dict[Connection, tuple[BaseProcess, int]] = {}
    try:
        for _ in range(workers):
            connection = _start(function, processes)
            index, task = waiting.popleft()
            busy[connection] = processes[-1], index
            _send(connection, task, processes[-1])
        while busy:
            for connection in cast(list[Connection], wait(list(busy))):
                process, index = busy.pop(connection)
                try:
                    result = connection.recv()
                except (EOFError, OSError):
                    raise WorkerFailed(_end_of(process)) from None
                if isinstance(result, _Failure):
                    raise result.as_exception()
                if waiting:
                    following, task = waiting.popleft()
                    busy[connection] = process, following
                    _send(connection, task, process)
                else:
                    connection.close()
                yield index, result
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.join()


def _send(connection: Connection, task: object, process: BaseProcess) -> None:
    try:
        connection.send(task)
    except OSError:
        raise WorkerFailed(_end_of(process)) from None


def _start(function: Callable[[Task], Result], processes: list[BaseProcess]) -> Connection:
    """Start a worker, which takes its tasks from the connection that is returned.

    It inherits blocked signals, so that Ctrl-C while it imports what it needs leaves no traceback (see `follow_parent`).
    """
    context = multiprocessing.get_context("spawn")
    resource_tracker.ensure_running()  # else `start` does so, and that unblocks signals
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(function, theirs), daemon=True)
    with stop_deferred():
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
        try:
            process.start()
            processes.append(process)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    theirs.close()
    if stop_requested():
        raise KeyboardInterrupt
    return ours


def _work(function: Callable[[Task], Result], connection: Connection) -> None:
    """Do the tasks that the parent sends, until it closes the connection or ends."""
    follow_parent()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    with contextlib.suppress(EOFError, OSError):  # the parent is gone
        while True:
            task = connection.recv()
            try:
                result: Result | _Failure = function(task)
            except BaseException as error:
                result = _Failure.of(error)
            connection.send(result)


def _end_of(process: BaseProcess) -> str:
    """Return how a process ended that did not end by itself."""
    process.join()
    code = process.exitcode or 0
    if code >= 0:
        return f"a worker process ended with exit code {code}: see above"
    name = signal.Signals(-code).name
    remedy = "; perhaps memory ran out: take fewer --workers, and run it again" if name == "SIGKILL" else ": run it again"
    return f"a worker process was killed by {name}{remedy}"
