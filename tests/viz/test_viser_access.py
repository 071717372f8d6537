"""The browser's page is for this machine alone, and whoever sees it can look and no more."""

import http.client
import itertools
import socket
import time

import numpy as np
import pytest
from fakes import TWO_HOLES as CONFIG
from fakes import PathEngine

from mjx_fit.evaluation import playback
from mjx_fit.utils.errors import RequestError
from mjx_fit.viz import viewer
from mjx_fit.viz.panel import Panel
from mjx_fit.viz.scene_model import Puppet
from mjx_fit.viz.timeline import moments

viser = pytest.importorskip("viser")
msgpack = pytest.importorskip("msgspec").msgpack
zstandard = pytest.importorskip("zstandard")
sync = pytest.importorskip("websockets.sync.client")
closed = pytest.importorskip("websockets.exceptions")
browser_ = pytest.importorskip("mjx_fit.viz.viser_page")
door_ = pytest.importorskip("mjx_fit.viz.viser_access")

EVIL = "http://evil.example"


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def own_address() -> str:
    """An address of this machine that others reach."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as route:
        try:
            route.connect(("192.0.2.1", 9))  # sends nothing
        except OSError:
            pytest.skip("this machine has no other address than the loop-back")
        return route.getsockname()[0]


@pytest.fixture(scope="module")
def shown():
    """A puppet, and a way to let a screen show something that it did not show before."""
    *_, played = playback.record(CONFIG, playback.Pick("failure_only", 1), 5, PathEngine())
    puppet, moment = Puppet(played), moments(played, 4, 1.0)[0]
    panel, counter = Panel(played, 460, 720).draw(moment), itertools.count()

    def show_on(browser):
        browser._panel_at = 0.0
        browser.show(lambda: None, moment, [], panel ^ np.uint8(next(counter)))

    return puppet, show_on


@pytest.fixture(scope="module")
def served(shown):
    """A page that is served, and its port."""
    port = free_port()
    browser = browser_.Browser(shown[0], door_.Door("127.0.0.1", port))
    yield browser, port
    browser._server.stop()


@pytest.fixture(scope="module")
def served_to_all(shown):
    port = free_port()
    browser = browser_.Browser(shown[0], door_.Door("0.0.0.0", port))
    yield browser, port
    browser._server.stop()


def look(port: int, host: str = "127.0.0.1", origin: str | None = "same"):
    """A client like viser's own."""
    return sync.connect(
        f"ws://{host}:{port}",
        origin=f"http://{host}:{port}" if origin == "same" else origin,
        subprotocols=[f"viser-v{viser.__version__}"],
        compression=None,
        max_size=None,
    )


def seen_by(client, seconds: float = 0.4) -> list[dict]:
    """What reaches a client until nothing comes for a while."""
    messages = []
    while True:
        try:
            raw = client.recv(timeout=seconds)
        except TimeoutError:
            return messages
        size = int.from_bytes(raw[8:16], "little")
        messages += msgpack.decode(zstandard.ZstdDecompressor().decompress(raw[16 : 16 + size]))["messages"]


def status_of(port: int, **headers: str) -> int:
    """The answer to a request for the page (or, with an Upgrade, for its websocket)."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.putrequest("GET", "/", skip_host=True)
    for name, value in headers.items():
        connection.putheader(name.replace("_", "-"), value)
    connection.endheaders()
    try:
        return connection.getresponse().status
    finally:
        connection.close()


def test_it_listens_on_the_loop_back_alone(served):
    _, port = served
    assert status_of(port, Host=f"localhost:{port}") == 200
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((own_address(), port), timeout=5)


def test_who_looks_sees_the_scene(served, shown):
    browser, port = served
    with look(port) as client:
        names = {message.get("name") for message in seen_by(client)}
        assert {f"/geoms/{i}" for i in browser._geoms} <= names
        shown[1](browser)
        assert any(str(message.get("name")).startswith("/marks/") for message in seen_by(client))


@pytest.mark.parametrize(
    "origin", [EVIL, "null", "http://localhost", "https://127.0.0.1:{port}", "http://[::1]:1"]
)
def test_a_page_from_elsewhere_is_kept_out(served, origin):
    _, port = served
    with pytest.raises(closed.InvalidStatus) as caught:
        look(port, origin=origin.format(port=port))
    assert caught.value.response.status_code == 403


@pytest.mark.parametrize(
    "name", ["localhost:{port}", "127.0.0.1:{port}", "LOCALHOST:9000", "[::1]:{port}", "127.0.0.1"]
)
def test_the_loop_backs_own_page_is_let_in(served, name):
    """At any port: the user's own tunnel may end at another one."""
    _, port = served
    host = name.format(port=port)
    asks = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec_WebSocket_Version": "13"}
    asks |= {"Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==", "Host": host}
    assert status_of(port, **asks, Origin=f"http://{host}") == 101
    assert status_of(port, **asks, Origin=EVIL) == 403
    assert status_of(port, **asks) == 101  # a program on this machine


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "localhost.evil.example", "192.0.2.7", "[::1", ""]
)
def test_a_name_that_somebody_points_here_is_kept_out(served, host):
    """DNS rebinding: the page's origin is then the server's own, by a name that is not."""
    _, port = served
    host = host.format(port=port)
    assert status_of(port, Host=host) == 403
    assert status_of(port, Host=host, Origin=f"http://{host}", Upgrade="websocket") == 403


def test_no_client_can_ask_for_a_tunnel(served, monkeypatch):
    asked = []
    monkeypatch.setattr(viser.ViserServer, "request_share_url", lambda self: asked.append("opened"))
    monkeypatch.setattr(viser.ViserServer, "disconnect_share_url", lambda self: asked.append("closed"))
    with look(served[1]) as client:
        for name in ("ShareUrlRequest", "ShareUrlDisconnect"):
            client.send(msgpack.encode({"type": name}))
        seen_by(client)
    assert not asked


def test_what_a_client_sends_changes_nothing_for_anybody(served, shown, capfd):
    browser, port = served
    with look(port) as one, look(port) as other:
        seen_by(one)
        seen_by(other)
        before = len(browser._server._websock_server.get_message_buffer().message_from_id)
        for kind in viser._messages.Message.get_subclasses():
            one.send(msgpack.encode({"type": kind.__name__}))
        for number in range(20):
            one.send(msgpack.encode({"type": "GuiFormDirtyMessage", "uuid": f"mine {number}"}))
            one.send(msgpack.encode({"type": "GuiFormSubmitMessage", "uuid": f"mine {number}"}))
        one.send(b"\xc1 no msgpack")
        one.send("text")
        assert not seen_by(other)
        assert len(browser._server._websock_server.get_message_buffer().message_from_id) == before
        shown[1](browser)
        assert seen_by(one)
        assert seen_by(other)
    assert capfd.readouterr() == ("", "")


def test_a_large_message_ends_its_connection_alone(served):
    with look(served[1]) as one, look(served[1]) as other:
        one.send(b"x" * (door_.LARGEST_MESSAGE + 1))
        with pytest.raises(closed.ConnectionClosed) as caught:
            seen_by(one)
        assert caught.value.rcvd is not None
        assert caught.value.rcvd.code == 1009
        assert seen_by(other)


def test_only_so_many_look_at_once(served):
    clients = []
    try:
        for _ in range(door_.MOST_CLIENTS):
            clients.append(look(served[1]))
        with pytest.raises(closed.InvalidStatus) as caught:
            look(served[1])
        assert caught.value.response.status_code == 503
    finally:
        for client in clients:
            client.close()


def test_half_a_handshake_prints_nothing(served, capfd):
    for sent in (b"", b"GET / HTTP/1.1\r\n", b"\xff" * 100, b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n"):
        with socket.create_connection(("127.0.0.1", served[1]), timeout=5) as client:
            client.sendall(sent)
    time.sleep(0.3)
    assert capfd.readouterr() == ("", "")


def test_others_look_when_they_are_asked_in(served_to_all):
    _, port = served_to_all
    address = own_address()
    with look(port, address) as client:
        assert seen_by(client)
    for origin in (EVIL, f"http://localhost:{port}", None):  # from there, a missing one is no browser's
        with pytest.raises(closed.InvalidStatus) as caught:
            look(port, address, origin)
        assert caught.value.response.status_code == 403
    assert status_of(port, Host=socket.gethostname()) == 200
    assert status_of(port, Host="evil.example") == 403


@pytest.mark.parametrize(
    "host",
    [
        "",
        " ",
        "no-such-host.invalid",
        "256.1.1.1",
        "127.0.0.1:80",
        "http://localhost",
        "a" * 70,
        "\0",
        "ü" * 99,
    ],
)
def test_a_host_that_is_none_is_one_line(host):
    with pytest.raises(RequestError, match=r"^--host: '.*' is invalid: expected an IP address") as caught:
        door_.Door(host, free_port())
    assert "\n" not in str(caught.value)


def test_an_address_of_another_machine_is_one_line():
    with pytest.raises(RequestError, match=r"--host: '198.51.100.7' .* expected an address of this machine"):
        door_.Door("198.51.100.7", free_port())


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_a_port_in_use_is_one_line_before_anything_is_played(host, capfd):
    def playing():
        raise AssertionError
        yield

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(
            RequestError, match=rf"^--port: {port} cannot be used: it is in use; choose another$"
        ):
            viewer.view(playing(), None, 1.0, True, port, host)


def test_letting_others_look_is_said(monkeypatch, capfd):
    def playing():
        raise KeyboardInterrupt
        yield

    for host, said in (("127.0.0.1", False), ("0.0.0.0", True), ("::1", False)):
        if host == "::1" and not socket.has_ipv6:
            continue
        viewer.view(playing(), None, 1.0, True, free_port(), host)
        assert ("anybody who reaches port" in capfd.readouterr().err) == said


def test_a_viser_that_listens_in_another_way_is_not_used():
    door = door_.Door("127.0.0.1", free_port())
    with pytest.raises(Exception, match="cannot be guarded"), door.guarding():
        pass
    door.close()
