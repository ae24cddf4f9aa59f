"""A thread that waits for the disk, so that writing does not."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor


class SyncThread:
    """Does one thing after the other; it starts with the first."""

    def __init__(self) -> None:
        self._executor: ThreadPoolExecutor | None = None
        self._futures: deque[Future[None]] = deque()

    @property
    def idle(self) -> bool:
        """Whether nothing waits to be done."""
        return all(future.done() for future in self._futures)

    def submit(self, action: Callable[[], None]) -> None:
        """Do something after everything that waits."""
        if self._executor is None:
            self._executor = ThreadPoolExecutor(1, thread_name_prefix="log-sync")
        self._futures.append(self._executor.submit(action))

    def after(self, action: Callable[[], None]) -> None:
        """Do something as soon as nothing waits that came before: at once when nothing ever did."""
        if self._executor is None:
            action()
        else:
            self.submit(action)

    def finish(self) -> list[OSError]:
        """Wait until everything is done, and return the errors since the last call."""
        errors = []
        while self._futures:
            error = self._futures.popleft().exception()
            if isinstance(error, OSError):
                errors.append(error)
            elif error is not None:
                raise error
        return errors

    def end(self) -> None:
        """End the thread when everything is done."""
        if self._executor is not None:
            self._executor.shutdown()
