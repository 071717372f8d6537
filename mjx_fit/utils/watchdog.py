"""Ends a process that stands still, so that a job which nobody looks at does not wait for ever."""

import os
import sys
import threading
import time

PATIENCE_S = 300
_IDLE_SHARE = 0.01


class Watchdog:
    """Watches work that says ``beat`` whenever it gets on.

    Work stands still when, for ``patience_s`` seconds on end, it says nothing and the process uses no
    processor time either. Long compilations use it; a deadlock does not. Seconds in which the process is
    suspended do not count, since nobody counts them.

    Args:
        name: What the work is called.
        patience_s: Seconds.
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
        """The work got on."""
        self._idle_s = 0

    def _watch(self) -> None:
        used = time.process_time()
        while not self._over.wait(1):
            before, used = used, time.process_time()
            self._idle_s = self._idle_s + 1 if used - before < _IDLE_SHARE else 0
            if self._idle_s >= self._patience_s:
                print(
                    f"mjx-fit: {self._name} stands still: no progress and no work for {self._patience_s} s; "
                    "what was complete is saved: give the same command again",
                    file=sys.stderr,
                    flush=True,
                )
                os._exit(1)  # an orderly exit would wait for what stands still
