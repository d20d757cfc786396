"""The server: what it serves, from where, to whom; and how the command begins and ends it."""

from __future__ import annotations

import os
import re
import signal
import socket
import urllib.error
import urllib.request
from functools import partial
from pathlib import Path

import pytest
from tornado.ioloop import IOLoop
from typer.testing import CliRunner

from workbench.cli import app
from workbench.errors import InvalidValue
from workbench.ui.server import start

EVIL = """\
title: "<script>alert(1)</script>"
loop:
  plant: {type: fopdt, gain: 1, time_constant: 5 s}
  valve: {type: ideal}
  sample_time: 1 s
experiment: {duration: 60 s}
cases: [{name: "<script>alert(2)</script>", Kc: 1, Ti: 9 s, note: "<img src=x onerror=alert(3)>"}]
"""


@pytest.fixture(scope="module")
def served(serve, tmp_path_factory):
    path = tmp_path_factory.mktemp("evil") / "evil.yaml"
    path.write_text(EVIL)
    return serve(str(path))


def get(url: str) -> tuple[int, str, str]:
    with urllib.request.urlopen(url, timeout=30) as answer:
        return answer.status, answer.headers.get_content_type(), answer.read().decode()


def test_the_page_holds_no_text_of_the_scenario_and_names_no_other_place(served):
    status, kind, html = get(served.url)
    assert (status, kind) == (200, "text/html")
    assert "alert(" not in html
    assert 'http-equiv="Content-Security-Policy" content="default-src \'self\'' in html
    assert re.findall(r"(?:src|href)=\"([^\"]*)\"", html) == [
        "data:,",
        "/assets/ui.css",
        "/static/js/bokeh.min.js",
        "/assets/ui.js",
    ]
    assert not re.search(r"https?://", html)


def test_its_own_files_are_served_and_nothing_beside_them(served):
    assert get(f"{served.url}assets/ui.css")[1] == "text/css"
    assert get(f"{served.url}assets/ui.js")[1] in ("text/javascript", "application/javascript")
    for path in ("assets/../server.py", "assets/%2e%2e/server.py", "assets//etc/passwd", "assets/"):
        with pytest.raises(urllib.error.HTTPError) as caught:
            get(served.url + path)
        with caught.value as error:
            assert error.code in (403, 404)


def socket_from(url: str, token: str, origin: str) -> int:
    """Return the HTTP code of a websocket asked for by a page of `origin`: 101 where it is opened."""
    host, _, port = url.removeprefix("http://").rstrip("/").partition(":")
    lines = [
        "GET /ws HTTP/1.1",
        f"Host: {host}:{port}",
        f"Origin: {origin}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version: 13",
        f"Sec-WebSocket-Protocol: bokeh, {token}",
    ]
    with socket.create_connection((host, int(port)), timeout=30) as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode())
        return int(connection.recv(12).split()[1])


def test_websockets_are_for_the_pages_own_address_alone(served):
    port = served.url.rsplit(":", 1)[1].rstrip("/")
    found = re.search(r'"token":"([^"]+)"', get(served.url)[2])
    assert found is not None
    asked = partial(socket_from, served.url, found[1])
    assert asked(f"http://127.0.0.1:{port}") == 101
    assert asked(f"http://localhost:{port}") == 101
    assert asked("http://evil.example") == 403
    assert asked(f"http://evil.example:{port}") == 403
    assert asked("http://127.0.0.1:1") == 403


def test_it_listens_on_this_machine_alone(served):
    port = int(served.url.rsplit(":", 1)[1].rstrip("/"))
    assert served.url == f"http://127.0.0.1:{port}/"
    listening = Path("/proc/net/tcp")
    if not listening.exists():
        pytest.skip("no /proc/net/tcp on this system")
    rows = [line.split()[1] for line in listening.read_text().splitlines()[1:] if line.split()[3] == "0A"]
    addresses = {address for address, _, its in (row.partition(":") for row in rows) if int(its, 16) == port}
    assert addresses == {"0100007F"}


@pytest.mark.skipif(os.name != "posix", reason="ends a process by a signal")
def test_ctrl_c_ends_it_and_leaves_no_uploaded_records(serve, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    served = serve()
    get(served.url)  # a session
    assert [path.name for path in tmp_path.glob("workbench-ui-*")]
    code, said = served.end()
    assert code == 0
    assert said.endswith("Workbench: ended\n")
    assert "Traceback" not in said
    assert not list(tmp_path.glob("workbench-ui-*"))


@pytest.mark.skipif(os.name != "posix", reason="is sent a signal")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_kill_or_a_closed_terminal_ends_it_as_ctrl_c_does(name):
    ending = getattr(signal, name)
    before = {one: signal.getsignal(one) for one in (signal.SIGTERM, signal.SIGHUP)}
    loop = IOLoop()  # the command's, as it is this thread's
    loop.call_later(0.0, os.kill, os.getpid(), ending)
    try:
        signal.signal(ending, lambda *_: loop.stop())  # where the command does not take it
        result = CliRunner().invoke(app, ["ui", "--address", "localhost", "--no-browser", "--port", "0"])
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)
        loop.close(all_fds=True)
    assert result.exit_code == 0
    assert result.output.startswith("Workbench: http://localhost:")
    assert result.output.endswith("Workbench: ended\n")


def test_an_address_or_port_that_cannot_be_had_is_refused_in_one_line():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InvalidValue, match=r"cannot be served here \(Address already in use\)$"):
            start(port=port)
    for address in ("", " "):  # every address of this machine, for a socket
        with pytest.raises(InvalidValue, match=r"--address: '.?' given; must be an address or a name of this machine"):
            start(address=address, port=0)
    for address in ("203.0.113.7", "no such host", "::1"):
        with pytest.raises(InvalidValue, match="--address and --port"):
            start(address=address, port=0)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("gone.yaml", "gone.yaml: no such file"),
        ("gone.csv", "gone.csv: no such file"),
        (".", "is a directory"),
        ("bad.yaml", "bad.yaml:1:1: titel: unknown key (did you mean title?)"),
    ],
)
def test_a_bad_source_is_refused_before_anything_is_served(tmp_path, monkeypatch, source, words):
    monkeypatch.chdir(tmp_path)
    Path("bad.yaml").write_text("titel: x\n")
    result = CliRunner().invoke(app, ["ui", source, "--no-browser", "--port", "0"])
    assert result.exit_code == 2
    assert words in result.stderr
    assert "Traceback" not in result.stderr
