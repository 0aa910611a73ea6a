"""Requests to the server: from its own page only, bounded, and answered in one line."""

import http.client
import socket
import struct
import threading

import pytest

from anystyle.errors import UserError
from anystyle_viewer.server import PageServer


@pytest.fixture
def posted():
    return []


@pytest.fixture
def server(posted):
    def on_post(query, body):
        if body == b"bad":
            raise UserError("no, for a reason")
        posted.append((query, body))

    def answer_as_viser():
        while True:
            connection, _ = behind.accept()
            request = connection.recv(4096)
            connection.sendall(b"HTTP/1.1 200 OK\r\n\r\nviser: " + request.partition(b"\r\n")[0])
            connection.close()

    with socket.create_server(("127.0.0.1", 0)) as behind:
        threading.Thread(target=answer_as_viser, daemon=True).start()
        options = {"page": b"the page", "on_post": {"/picture": on_post}, "max_body": 10}
        server = PageServer(port=0, viser_port=behind.getsockname()[1], **options)
        yield server
        server.close()


def ask(server, method, path="/", body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=20)
    connection.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
    response = connection.getresponse()
    return response.status, response.read().decode()


@pytest.mark.parametrize(
    ("method", "headers", "status"),
    [
        ("GET", {}, 200),
        ("GET", {"Host": "localhost:8080", "Origin": "http://localhost:8080"}, 200),  # through a tunnel
        ("GET", {"Host": "evil.example:8080"}, 421),  # DNS rebinding
        ("GET", {"Host": "127.0.0.1:8080", "Origin": "http://evil.example"}, 403),
        ("GET", {"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:9999"}, 403),
        ("GET", {"Upgrade": "websocket", "Origin": "http://evil.example"}, 403),
        ("PUT", {"Host": "localhost"}, 501),
        ("POST", {"Host": "localhost"}, 403),  # browsers always name the origin of a post
        ("POST", {"Host": "localhost", "Origin": "http://evil.example"}, 403),
    ],
)
def test_only_the_own_page_may_ask(server, method, headers, status):
    assert ask(server, method, **headers)[0] == status


def test_all_but_the_page_is_answered_by_viser(server):
    assert ask(server, "GET") == (200, "the page")
    assert ask(server, "GET", "/assets/x.js") == (200, "viser: GET /assets/x.js HTTP/1.1")
    assert ask(server, "GET", Upgrade="websocket") == (200, "viser: GET / HTTP/1.1")


def test_posts_are_bounded_and_errors_are_one_line(server, posted):
    origin = {"Origin": f"http://127.0.0.1:{server.server_port}"}
    assert ask(server, "POST", "/picture?name=a%20b.png", b"0123456789", **origin) == (200, "")
    assert posted == [({"name": "a b.png"}, b"0123456789")]
    assert ask(server, "POST", "/picture", b"bad", **origin) == (400, "no, for a reason")
    assert ask(server, "POST", "/picture", b"", Content_Length="11", **origin)[0] == 413
    assert ask(server, "POST", "/picture", b"", Content_Length="-1", **origin)[0] == 413
    assert ask(server, "POST", "/elsewhere", b"1", **origin)[0] == 404 and len(posted) == 1


@pytest.mark.parametrize("reset", [False, True])
def test_a_browser_that_goes_posts_nothing_and_is_no_error(server, posted, capsys, reset):
    with socket.create_connection(server.server_address) as browser:
        lines = "POST /picture HTTP/1.1", "Host: localhost", "Origin: http://localhost", "Content-Length: 9", "", "half"
        browser.sendall("\r\n".join(lines).encode())
        browser.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", reset, 0))
        browser.shutdown(socket.SHUT_WR)
        assert reset or browser.recv(9) == b""
    assert ask(server, "GET")[0] == 200 and posted == [] and "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("port", [None, 99999, -1])
def test_a_port_that_cannot_be_used_is_refused_in_one_line(server, port):
    port = port or server.server_port
    with pytest.raises(UserError, match=f"port {port} cannot be used"):
        PageServer(port=port, viser_port=1, page=b"", on_post={}, max_body=1)
