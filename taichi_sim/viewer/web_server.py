"""A server of web pages on one port, which answers nobody who does not know its token."""

import errno
import hmac
import logging
import queue
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ipaddress import ip_address
from typing import Any

from taichi_sim.common.errors import BackendError
from taichi_sim.viewer.web_waiting import PAGE, WAITING

__all__ = ["HOST", "PORT", "WebServer"]

HOST, PORT, MOST_PORT = "127.0.0.1", 8080, 65535
EVERYWHERE = ("0.0.0.0", "::")  # what must be said for all addresses
ALONE = threading.Lock()  # held while functions and a console that all of the process shares are others for a server
SILENT = logging.getLogger(f"{__name__}.requests")  # of what strangers send, which is no error of this program
SILENT.addHandler(logging.NullHandler())
SILENT.propagate = False
# s for a request to be read and for a page to answer: the compiler may stop all other threads for half of it
PATIENCE = 60.0
REFUSED = "taichi_sim: open the address that the program printed, with all that follows the port.\n"


class WebServer:
    """Serves the page of a viser server, and its websocket, to those who have its address `url`, which holds a random token.

    host: of this machine's addresses the one to listen on; port: 0 for any that is free. It works in threads of its own: what
    they want done to a simulation, they put into `later`, and the thread of the simulation calls `work`. Raises BackendError
    where viser is missing, OSError where the address cannot be had, ValueError for a port that there is not, and for a host that
    means all addresses without saying it by one of EVERYWHERE.
    """

    def __init__(self, host: str = HOST, port: int = PORT) -> None:
        viser = _viser()
        self.token = secrets.token_urlsafe(16)
        listening = _listening(host, port)
        self.port = int(listening.getsockname()[1])
        name = socket.gethostname() if host in EVERYWHERE else host
        self.url = f"http://{f'[{name}]' if ':' in name else name}:{self.port}/{self.token}/"
        with ALONE, _without_words(), _guarded(listening, self.token):
            self.viser = viser.ViserServer(host=host, port=self.port, verbose=False)
        # a page may ask for a tunnel through which anybody on the internet could come
        self.viser.request_share_url = lambda *_: None
        self.viser.gui.configure_theme(show_share_button=False)
        self.framing: Any = None  # where pages look from, once a stage has said it
        self._later: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

    @property
    def watched(self) -> bool:
        """True if a page is open anywhere."""
        return bool(self.viser.get_clients())

    def later(self, act: Callable[[], None]) -> None:
        """Have something done by the thread of the simulation."""
        self._later.put(act)

    def work(self) -> None:
        """Do what pages have asked for."""
        while not self._later.empty():
            self._later.get()()

    def notify(self, title: str, words: str) -> None:
        """Show a message on all pages."""
        for client in self.viser.get_clients().values():
            client.add_notification(title=title, body=words, auto_close_seconds=None)

    def close(self) -> None:
        """Stop to serve. Pages stay as they are."""
        with ALONE, _without_words():
            self.viser.stop()

    def __enter__(self) -> "WebServer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _viser() -> Any:
    try:
        import viser
    except ImportError:
        raise BackendError('a view in a browser needs one more package: pip install "taichi-sim[web]"') from None
    return viser


def _listening(host: str, port: int) -> socket.socket:
    """A socket that listens there and nowhere else. Raises OSError and ValueError in a sentence."""
    if not 0 <= port <= MOST_PORT:
        raise ValueError(f"port: {port} is not allowed; it must be from 0 to {MOST_PORT}")
    try:
        family, *_, place = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        address: Any = ip_address(place[0])
        if (getattr(address, "ipv4_mapped", None) or address).is_unspecified and host not in EVERYWHERE:
            raise ValueError(
                f"host: {host!r} is not allowed; it must be an address of this machine, or 0.0.0.0 or :: for all of its addresses"
            )
        return socket.create_server(place[:2], family=family)
    except (OSError, UnicodeError) as error:
        number = getattr(error, "errno", None)
        if number == errno.EADDRINUSE:
            says = f"port {port} is in use; choose another one with --port, or 0 for any that is free"
        elif number == errno.EACCES:
            says = f"port {port} is for the administrator alone; choose one above 1023 with --port"
        else:
            says = f"{host!r} is no address of this machine; leave --host out, or give 0.0.0.0 for all of them"
        raise OSError(says) from None


@contextmanager
def _guarded(listening: socket.socket, token: str) -> Iterator[None]:
    """Let a server that is started in the block listen on this socket, and refuse requests without the token, for pages and for
    websockets alike. viser has no hook for that, so it is put into the function of websockets that viser serves by."""
    from websockets.asyncio import server

    plain, used = server.serve, []

    def serve(handler: Any, host: Any, port: Any, *, process_request: Any, **options: Any) -> Any:
        def admit(connection: Any, request: Any) -> Any:
            place, _, query = request.path.partition("?")
            given, _, rest = place.removeprefix("/").partition("/")
            if not hmac.compare_digest(given.encode(errors="surrogateescape"), token.encode()):
                return connection.respond(403, REFUSED)
            request.path = f"/{rest}"
            if not rest and f"?{query}" != PAGE and "Upgrade" not in request.headers:
                answer = connection.respond(200, WAITING)
                del answer.headers["Content-Type"]
                answer.headers["Content-Type"] = "text/html; charset=utf-8"
            else:
                answer = process_request(connection, request)
            if answer is not None:
                answer.headers["Referrer-Policy"] = "no-referrer"
            return answer

        used.append(True)
        options |= {"open_timeout": PATIENCE, "ping_timeout": PATIENCE, "logger": SILENT}
        return plain(handler, sock=listening, process_request=admit, **options)

    server.serve = serve  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        server.serve = plain  # type: ignore[misc]
    if not used:
        listening.close()
        raise BackendError("this version of viser cannot be guarded by a token; install viser 1.1")


@contextmanager
def _without_words() -> Iterator[None]:
    """Keep viser from printing an address that nobody is admitted to."""
    import rich

    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
