"""Access control of the browser's page: who may watch, and that clients can only watch.

viser chooses its own address, accepts connections from any web page, obeys client messages (including one
that opens a public tunnel), and stores or forwards messages that it does not know. This module therefore
opens the socket itself, accepts connections by their Host and Origin headers, and reads and drops client
messages; the page works without them.
"""

import errno
import http
import ipaddress
import logging
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from mjx_fit.utils.errors import RequestError, WorkError

LOOPBACK = "127.0.0.1"
LARGEST_MESSAGE = 64 * 1024
"""Largest client message, in bytes; a camera update, the largest one needed, has some 300."""
MOST_CLIENTS = 32


class Door:
    """Open port, and the rule that accepts connections.

    Attributes:
        host: Requested host.
        port: Port number.
        is_loopback: True if only this machine can connect.
    """

    def __init__(self, host: str, port: int):
        """Open the port.

        Raises:
            RequestError: The host is not an address of this machine, or the port is in use.
        """
        family, address = _resolved(host, port)
        self.host, self.port = host, port
        self._ip = ipaddress.ip_address(address[0].partition("%")[0])
        self.is_loopback = self._ip.is_loopback
        self._socket = _listening(family, address, host)
        self._is_guarding = False

    def close(self) -> None:
        """Close the port, unless a server uses it."""
        if not self._is_guarding:
            self._socket.close()

    @property
    def address(self) -> str:
        """Return the URL to open in a browser on this machine."""
        if self._ip.is_unspecified or str(self._ip) in (LOOPBACK, "::1"):
            return f"http://localhost:{self.port}"
        return (
            f"http://[{self._ip}]:{self.port}" if self._ip.version == 6 else f"http://{self._ip}:{self.port}"
        )

    @contextmanager
    def guarding(self) -> Iterator[None]:
        """Make a viser server created inside this context listen on this port.

        Raises:
            WorkError: The server did not use it: this version of viser listens differently.
        """
        serve = websockets.asyncio.server.serve

        def serve_guarded(handler: Callable[[ServerConnection], Any], *_: Any, **options: Any) -> Any:
            self._is_guarding = True
            wanted = options.pop("process_request", None)
            guarded: dict[str, Any] = {
                "sock": self._socket,
                "create_connection": _Spectator,
                "max_size": LARGEST_MESSAGE,
                "logger": _quiet_logger(),
                "process_request": lambda *asked: self._refusal(*asked) or (wanted and wanted(*asked)),
            }
            return serve(handler, **options | guarded)

        # viser has no argument for any of this, and looks up the function when it starts.
        websockets.asyncio.server.serve = serve_guarded
        try:
            yield
        finally:
            websockets.asyncio.server.serve = serve
        if not self._is_guarding:
            raise WorkError("view: this version of viser cannot be guarded: pip install 'mjx-fit[view]'")

    def _refusal(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the response to a rejected request; None accepts it."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_ours(hosts[0]):
            return connection.respond(http.HTTPStatus.FORBIDDEN, "Host: not a name of this server\n")
        # Any port is accepted: a tunnel of the user (ssh -L) may end at another one.
        if origins and [origin.lower() for origin in origins] != [f"http://{hosts[0].lower()}"]:
            return connection.respond(http.HTTPStatus.FORBIDDEN, "Origin: only this server's own page\n")
        # Browsers always send Origin, so this is a program, which may watch from this machine only.
        if not origins and "Upgrade" in request.headers and not _is_loopback(connection.remote_address[0]):
            return connection.respond(http.HTTPStatus.FORBIDDEN, "Origin: missing\n")
        if len(connection.server.connections) >= MOST_CLIENTS:
            return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, "too many clients\n")
        return None

    def _is_ours(self, host_header: str) -> bool:
        """Return whether a Host header names this server; other names may be DNS rebinding."""
        try:
            name = (urlsplit(f"//{host_header}").hostname or "").rstrip(".")
        except ValueError:
            return False
        if name == "localhost":
            return True
        try:
            ip = ipaddress.ip_address(name.partition("%")[0])
        except ValueError:
            own = () if self.is_loopback else (socket.gethostname(), socket.getfqdn())
            return name in (one.lower() for one in (self.host, *own))
        return ip.is_loopback if self.is_loopback else True  # an address cannot be rebound


class _Spectator(ServerConnection):
    """Connection that drops all client messages."""

    async def recv(self, decode: bool | None = None) -> Any:
        """Read and drop messages until ``ConnectionClosed`` is raised."""
        while True:
            await super().recv(decode)


class _Handshakes(logging.Filter):
    def filter(self, record: logging.LogRecord) -> bool:
        """Return False for tracebacks of incomplete handshakes, which port scans cause."""
        return record.getMessage() != "opening handshake failed"


def _quiet_logger() -> logging.Logger:
    logger = logging.getLogger(__name__)
    logger.addFilter(_Handshakes())
    return logger


def _resolved(host: str, port: int) -> tuple[int, Any]:
    wrong = RequestError(
        f"--host: {host!r} is invalid: expected an IP address or a host name that resolves to one"
    )
    if not host.strip():
        raise wrong
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, ValueError):  # unknown or malformed name
        raise wrong from None
    family, *_, address = next((one for one in found if one[0] == socket.AF_INET), found[0])
    return family, address


def _listening(family: int, address: Any, host: str) -> socket.socket:
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        if family == socket.AF_INET6:
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        if hasattr(socket, "SO_EXCLUSIVEADDRUSE"):  # Windows, where REUSEADDR would share the port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
        else:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        # Listen now, before there is something to show, to reserve the port.
        listener.listen()
    except OSError as error:
        listener.close()
        raise _why_not(error, host, address[1]) from None
    return listener


def _why_not(error: OSError, host: str, port: int) -> RequestError:
    if error.errno == errno.EADDRINUSE:
        return RequestError(f"--port: {port} cannot be used: it is in use; choose another")
    if error.errno in (errno.EACCES, errno.EPERM):
        return RequestError(f"--port: {port} cannot be used: the system refuses it; choose 1024 or higher")
    return RequestError(f"--host: {host!r} is invalid: expected an address of this machine")


def _is_loopback(address: str) -> bool:
    return ipaddress.ip_address(address.partition("%")[0]).is_loopback
