"""Checks of requests to a page that is served on 127.0.0.1: only the browser that was given its address gets it.

Other pages in the browser can send requests to 127.0.0.1 as well. Host excludes names of other sites that resolve to
127.0.0.1, Origin excludes their scripts, and the token in the address, which they do not know, excludes the rest and
other users of the machine.
"""

from __future__ import annotations

import hmac
import os
import secrets
import socket
import sys
import webbrowser
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from websockets.http11 import Request

HOST = "127.0.0.1"
_COOKIE = "cell-token"


def open_socket() -> tuple[socket.socket, int]:
    """Return a socket on a free port of 127.0.0.1, and the port."""
    server_socket = socket.create_server((HOST, 0))
    return server_socket, server_socket.getsockname()[1]


def make_token() -> str:
    """Return a new random token."""
    return secrets.token_urlsafe(24)


def refusal(request: Request, port: int, token: str) -> str:
    """Return the reason to refuse a request, "" to accept it.

    The token is the beginning of the path, `?token=` of the address, or the cookie that `cookie` sets.

    Args:
        request: of a page or of a WebSocket.
        port: of the server.
        token: of the server.
    """
    names = {f"{HOST}:{port}", f"localhost:{port}"}
    hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
    if len(hosts) != 1 or hosts[0] not in names:
        return "the header Host is not this server"
    if any(origin not in {f"http://{name}" for name in names} for origin in origins):
        return "the header Origin is another site"
    if "Upgrade" in request.headers and not origins:
        return "a WebSocket needs the header Origin"
    path, _, query = request.path.partition("?")
    cookies = [each.strip() for text in request.headers.get_all("Cookie") for each in text.split(";")]
    credentials = [path.removeprefix("/").partition("/")[0], *query.split("&"), *cookies]
    expected = (token, f"token={token}", f"{_COOKIE}-{port}={token}")
    is_known = any(hmac.compare_digest(each.encode(), other.encode()) for each in credentials for other in expected)
    return "" if is_known else "the address has no token, or that of another server"


def cookie(port: int, token: str) -> str:
    """Return the header Set-Cookie with which later requests of a page need no token in their address."""
    return f"{_COOKIE}-{port}={token}; Path=/; HttpOnly; SameSite=Strict"


def open_browser(address: str) -> bool:
    """Open an address in the user's browser; return False without a browser or a screen."""
    has_screen = sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    try:
        return has_screen and webbrowser.open(address)
    except webbrowser.Error:
        return False
