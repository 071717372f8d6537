"""Pool of workers on a Ray cluster. A lost worker costs the parts that it had in hand."""

import hashlib
import logging
import os
import socket
import statistics
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from mjx_fit.jobs.pool import USER_MODULES, Done, Piece, Tell, as_it_is
from mjx_fit.jobs.worker import Order, Report
from mjx_fit.utils import provenance
from mjx_fit.utils.errors import RequestError, WorkError, one_line, shortened

# Ray reports its use to its makers unless it is told not to.
os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")

try:
    import ray
    from ray import cloudpickle
    from ray.exceptions import RayError
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy
except ImportError:
    raise ImportError("--cluster needs Ray, which is not installed: pip install 'mjx-fit[ray]'") from None

MOST_FAILURES = 3
"""A part that failed, or lost its worker, this many times ends the command."""
SLOW, SLOW_FROM_S = 4.0, 10.0
"""A part that takes so many times the median, and so many seconds more, is also started elsewhere."""
_TICK_S, _CONNECT_S = 0.5, 10.0


def connect(address: str) -> None:
    """Connect this process to a cluster.

    Args:
        address: ``auto``, the cluster of this machine or of ``RAY_ADDRESS``, or HOST:PORT.

    Raises:
        RequestError: No cluster answers.
    """
    if ray.is_initialized():
        return
    hint = "start one with ray start --head"
    try:
        if address != "auto":  # before Ray, which takes longer and writes lines of its own
            host, _, port = address.rpartition(":")
            hint = "expected auto or HOST:PORT of a cluster's head"
            socket.create_connection((host, int(port)), _CONNECT_S).close()
        ray.init(address=address, log_to_driver=False, logging_level=logging.CRITICAL)
    except (RuntimeError, ValueError, OverflowError, OSError) as error:
        why = shortened(one_line(str(error)), 120)
        raise RequestError(
            f"--cluster: {address} cannot be used: no cluster answers there ({why}): {hint}"
        ) from None


@dataclass(frozen=True)
class _Flight:
    """A part in the hands of a worker, or a result on its way to storage."""

    name: str
    began_s: float
    result: Any
    saving: bool = False


class RayPool:
    """Performs parts on a cluster.

    Args:
        address: Address of the cluster (``connect``).
        cpus: CPUs of each worker.
        shared: Whether workers store results themselves, on storage that they share with the driver. If not,
            results travel to a process beside the driver, which stores them.

    Attributes:
        perform: Remote function of a piece (``worker.perform``).
        save: Remote function of a result, which runs beside the driver (``worker.save``).

    Raises:
        RequestError: No cluster answers.
    """

    alone = False

    def __init__(self, address: str, cpus: int = 1, *, shared: bool = False):
        connect(address)
        self._cpus, self.shared = cpus, shared
        here: Any = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        self.perform: Any = ray.remote(num_cpus=cpus, num_returns=2, max_retries=0)(_perform())
        self.save: Any = ray.remote(num_cpus=0, max_retries=0, scheduling_strategy=here)(_save())

    def run(
        self,
        work: Callable[[Piece, Tell], Any],
        pieces: Mapping[str, Piece],
        tell: Tell,
        store: Callable[[Any], Done] = as_it_is,
    ) -> Iterator[tuple[str, Done]]:
        """See ``Pool.run``."""
        yield from _Run(self, work, pieces, tell, store)

    def order(self, payload: bytes) -> Order:
        """Return what workers are asked for with this work."""
        return Order(hashlib.sha256(payload).hexdigest(), provenance.versions(), self._cpus)

    def room(self) -> int:
        """Return how many parts may be in flight: one for each worker, and as many that wait."""
        return 2 * max(1, int(ray.cluster_resources().get("CPU", 0)) // self._cpus)


class _Run:
    """One job on its way."""

    def __init__(self, pool: RayPool, work, pieces: Mapping[str, Any], tell: Tell, store):
        self._pool, self._pieces, self._tell = pool, pieces, tell
        self._saves = not pool.shared and store is not as_it_is
        at_worker = as_it_is if self._saves else store
        for module in [name for name in sys.modules if name.startswith(USER_MODULES)]:
            cloudpickle.register_pickle_by_value(sys.modules[module])
        payload, saving = (cloudpickle.dumps(one) for one in ((work, at_worker), (None, store)))
        self._order = pool.order(payload)
        self._payload, self._saving = ray.put(payload), ray.put(saving)
        self._waiting, self._flying = deque(pieces), dict[Any, _Flight]()
        self._seconds, self._failures, self._doubled, self._done = list[float](), Counter[str](), set(), set()

    def __iter__(self) -> Iterator[tuple[str, Any]]:
        while len(self._done) < len(self._pieces):
            while self._waiting and len(self._flying) < self._pool.room():
                self._submit(self._waiting.popleft())
            ready, _ = ray.wait(list(self._flying), timeout=_TICK_S)
            for ref in ready:
                flight = self._flying.pop(ref)
                landed = [] if flight.name in self._done else self._landed(ref, flight)
                for result in landed:
                    self._done.add(flight.name)
                    yield flight.name, result
            self._tell(0, "")
            self._double_stragglers()

    def _submit(self, name: str) -> None:
        pool = self._pool
        report, result = pool.perform.remote(self._payload, self._pieces[name], tuple(self._order))
        self._flying[report] = _Flight(name, time.monotonic(), result)

    def _landed(self, ref: Any, flight: _Flight) -> list[Any]:
        """Return the result of a part that is done, or nothing: then it goes on, or is done again."""
        try:
            if flight.saving:
                return [ray.get(ref)]
            report = Report(*ray.get(ref))
            result = [] if self._saves else [ray.get(flight.result)]
        except OSError as error:  # also a RayError, with this cause
            raise WorkError(f"{flight.name} cannot be stored: {one_line(str(error))}") from None
        except RayError as error:
            self._again(flight.name, f"its worker was lost ({type(error).__name__})")
            return []
        if report.refused is not None:
            raise RequestError(report.refused)
        if report.unfit is not None:
            raise WorkError(f"--cluster: the worker on {report.host} cannot be used: {report.unfit}")
        if report.failed is not None:
            self._again(flight.name, f"it failed on {report.host}: {report.failed}")
            return []
        self._seconds.append(report.seconds)
        if not self._saves:
            return result
        ref = self._pool.save.remote(self._saving, flight.result, tuple(self._order))
        self._flying[ref] = _Flight(flight.name, time.monotonic(), ref, saving=True)
        return []

    def _again(self, name: str, why: str) -> None:
        self._failures[name] += 1
        if self._failures[name] >= MOST_FAILURES:
            raise WorkError(f"{name} failed {MOST_FAILURES} times; the last time {why}")
        print(f"mjx-fit: {name} is done again: {why}", file=sys.stderr)
        self._waiting.append(name)

    def _double_stragglers(self) -> None:
        """Start what takes far longer than the rest once more, when nothing else is left to start."""
        if self._waiting or not self._seconds:
            return
        usual = statistics.median(self._seconds)
        for flight in list(self._flying.values()):
            spent = time.monotonic() - flight.began_s
            slow = spent > SLOW * usual and spent > usual + SLOW_FROM_S
            if slow and flight.name not in self._doubled and not flight.saving:
                self._doubled.add(flight.name)
                print(
                    f"mjx-fit: {flight.name} takes {spent:.0f} s, others {usual:.0f} s: it is started on "
                    "another worker, too",
                    file=sys.stderr,
                )
                self._submit(flight.name)


def _perform() -> Callable[..., Any]:
    """Return a function that travels by value, so that it can say that the package is missing."""

    def perform(payload: bytes, piece: Any, order: tuple) -> Any:
        try:
            from mjx_fit.jobs import worker
        except ImportError as error:
            import socket

            return (socket.gethostname(), 0.0, None, None, f"{error}: install mjx-fit there"), None
        return worker.perform(payload, piece, worker.Order(*order))

    return perform


def _save() -> Callable[..., Any]:
    def save(payload: bytes, result: Any, order: tuple) -> Any:
        from mjx_fit.jobs import worker

        return worker.save(payload, result, worker.Order(*order))

    return save
