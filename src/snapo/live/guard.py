"""Who may speak to the page's server: this machine, with the token, from the page itself.

Every address begins with the token. The name of the host is checked, so that no name of an
attacker's can be pointed at this machine; the origin too, where a browser tells it. The page may
load nothing from anywhere else, and no other page may show it in a frame.
"""

import hmac
import secrets
from collections.abc import Awaitable, Callable

from aiohttp import web

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self' {socket}; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def new_token() -> str:
    """256 random bits, as they stand in an address."""
    return secrets.token_urlsafe(32)


def guard(token: str, port: Callable[[], int]):
    """The middleware that refuses everybody else, and tells the browser what the page may do."""

    @web.middleware
    async def checked(request: web.Request, handler: Handler) -> web.StreamResponse:
        names = [f"{name}:{port()}" for name in NAMES]
        if request.headers.get("Host") not in names:
            raise web.HTTPForbidden(text="This server is for this machine alone.")
        first = request.path.lstrip("/").partition("/")[0]
        if not hmac.compare_digest(first.encode(), token.encode()):
            raise web.HTTPForbidden(text="The address has no token, or a wrong one.")
        origin = request.headers.get("Origin")
        if origin is not None and origin not in [f"http://{name}" for name in names]:
            raise web.HTTPForbidden(text="Another page asks for this one.")
        if request.headers.get("Upgrade") and origin is None:
            raise web.HTTPForbidden(text="The page itself must ask.")
        return await handler(request)

    async def harden(request: web.Request, response: web.StreamResponse) -> None:
        sockets = " ".join(f"ws://{name}:{port()}" for name in NAMES)
        response.headers["Content-Security-Policy"] = POLICY.format(socket=sockets)
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Referrer-Policy"] = "no-referrer"
        response.headers["Cache-Control"] = "no-store"
        response.headers["Cross-Origin-Resource-Policy"] = "same-origin"
        response.headers["Cross-Origin-Opener-Policy"] = "same-origin"
        response.headers.pop("Server", None)

    return checked, harden
