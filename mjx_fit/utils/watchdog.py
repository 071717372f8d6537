"""Watchdog that ends a stalled process, so that an unattended job does not hang forever."""

import os
import sys
import threading
import time

PATIENCE_S = 300
_IDLE_SHARE = 0.01


class Watchdog:
    """Watchdog of work that calls ``beat`` on every progress.

    Work has stalled if, for ``patience_s`` consecutive seconds, it does not call ``beat`` and the process
    uses no CPU time. Long compilations use CPU time; a deadlock does not. Time while the process is suspended
    does not count.

    Args:
        name: Name of the work.
        patience_s: Time without progress after which work has stalled, s.
    """

    def __init__(self, name: str, patience_s: int = PATIENCE_S):
        self._name, self._patience_s = name, patience_s
        self._idle_s = 0
        self._over = threading.Event()

    def __enter__(self) -> "Watchdog":
        threading.Thread(target=self._watch, name="watchdog", daemon=True).start()
        return self

    def __exit__(self, *error) -> None:
        self._over.set()

    def beat(self) -> None:
        """Record progress."""
        self._idle_s = 0

    def _watch(self) -> None:
        used = time.process_time()
        while not self._over.wait(1):
            before, used = used, time.process_time()
            self._idle_s = self._idle_s + 1 if used - before < _IDLE_SHARE else 0
            if self._idle_s >= self._patience_s:
                print(
                    f"mjx-fit: {self._name} has stalled: no progress and no CPU time for {self._patience_s} "
                    "s; completed work is saved: rerun the command to resume",
                    file=sys.stderr,
                    flush=True,
                )
                os._exit(1)  # a regular exit would wait for the stalled work
