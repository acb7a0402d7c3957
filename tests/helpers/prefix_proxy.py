"""A proxy such as nginx, small: asks another server for what is under a prefix, and changes Host as nginx does."""

import http.client
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@contextmanager
def proxy(port: int, prefix: str, strips: bool = True) -> Iterator[int]:
    """A proxy for a server at a port, until the block ends; gives its own port. `strips`: takes the prefix off."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        disable_nagle_algorithm = True

        def pass_on(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            if not self.path.startswith(f"{prefix}/"):
                self.reply(404, [], b"not under the prefix")
                return
            path = self.path.removeprefix(prefix) if strips else self.path
            headers = {key: value for key, value in self.headers.items() if key.lower() not in ("host", "connection")}
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)  # Host is 127.0.0.1
            try:
                connection.request(self.command, path, body, headers)
                response = connection.getresponse()
                self.reply(response.status, response.getheaders(), response.read())
            finally:
                connection.close()

        do_GET = do_POST = pass_on  # noqa: N815 (http.server's names)

        def reply(self, status: int, headers: list[tuple[str, str]], body: bytes) -> None:
            self.send_response_only(status)
            for key, value in headers:
                if key.lower() not in ("content-length", "connection", "transfer-encoding"):
                    self.send_header(key, value)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
