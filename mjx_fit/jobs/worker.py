"""What a worker of a cluster does: set up its process once, and perform pieces of jobs."""

# JAX is imported after the limits are set that it reads when it starts.

import functools
import pickle
import socket
import sys
import time
import traceback
from collections.abc import Callable
from typing import Any, NamedTuple

from mjx_fit.utils.errors import RequestError, WorkError, one_line


class Order(NamedTuple):
    """What a driver asks of its workers.

    Attributes:
        digest: Digest of the pickled work.
        versions: Versions at the driver (``provenance.versions``), which the workers' must equal.
        cpus: CPUs of one worker.
    """

    digest: str
    versions: dict[str, str]
    cpus: int


class Report(NamedTuple):
    """What came of a piece.

    Attributes:
        host: Name of the machine.
        seconds: Time it took, s.
        refused: Why the request is wrong; None: it is not.
        failed: Why the piece failed; None: it did not.
        unfit: Why this worker can perform no piece; None: it can.
    """

    host: str
    seconds: float
    refused: str | None = None
    failed: str | None = None
    unfit: str | None = None


def perform(payload: bytes, piece: Any, order: Order) -> tuple[Report, Any]:
    """Perform a piece, and return what came of it with its result; None if there is none.

    Args:
        payload: Pickled work, and the function that stores its result (``Pool.run``).
        piece: The piece.
        order: What the driver asks.
    """
    host, began = socket.gethostname(), time.monotonic()
    try:
        other = _set_up(order.cpus, tuple(order.versions.items()))
        if other:
            return Report(host, 0.0, unfit=other), None
        work, store = _unpickled(order.digest, payload)
        result = store(work(piece, _nobody_listens))
    except RequestError as error:
        return Report(host, time.monotonic() - began, refused=str(error)), None
    except Exception as error:
        return Report(host, time.monotonic() - began, failed=_reason(error)), None
    return Report(host, time.monotonic() - began), result


def save(payload: bytes, result: Any, order: Order) -> Any:
    """Store a result that came from elsewhere, beside the driver."""
    _set_up(order.cpus, tuple(order.versions.items()))
    _, store = pickle.loads(payload)
    return store(result)


@functools.cache
def _set_up(cpus: int, versions: tuple[tuple[str, str], ...]) -> str:
    """Set up this process, and say which version differs from the driver's; nothing if none does."""
    from mjx_fit.utils import environment, granted_cpus

    environment.draw_nothing()
    granted_cpus.limit_to(cpus)
    from mjx_fit.utils import process_setup, provenance

    process_setup.pin()
    process_setup.configure()
    for name, there, here in provenance.differing(dict(versions), provenance.versions()):
        return f"it has {name} {here}, and the driver has {there}"
    return ""


@functools.lru_cache(maxsize=1)
def _unpickled(digest: str, payload: bytes) -> tuple[Callable[..., Any], Callable[[Any], Any]]:
    """Return work and storing; kept, since it holds what was compiled."""
    return pickle.loads(payload)


def _nobody_listens(done: int, text: str) -> None:
    """Progress within a part stays with its worker."""


def _reason(error: Exception) -> str:
    """Return one line: what happened, and where."""
    if isinstance(error, WorkError | OSError):
        return one_line(str(error))
    frame = traceback.extract_tb(sys.exc_info()[2])[-1]
    place = f"{frame.filename.rpartition('/')[2]}:{frame.lineno}"
    return one_line(f"{type(error).__name__}: {error} ({place})")
