"""The web server of a study: a page for observers, their own links, and nothing about what they look at."""

import json
import logging
import re
import socket
import sqlite3
import struct
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flask import Flask, Response, abort, jsonify, make_response, render_template, request
from waitress.server import create_server
from werkzeug.exceptions import HTTPException

from torchbrdf.errors import DataError, TorchbrdfError, UsageError
from torchbrdf.registry import unknown
from torchbrdf.study.plan import PLAN, TEXTS, Plan, inside
from torchbrdf.study.store import SIDES, STORE, IneligibleError, NotNowError, State, Store, UnknownObserverError

PAGES = Path(__file__).parent / "pages"
CONTENT_TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
PORT = 8000
# So many trials after the current one may be loaded ahead; so few that nobody can look through the study.
AHEAD = 2
LARGEST_BODY = 16 * 1024
# Seconds; a page that is left open for longer says this.
LONGEST_RESPONSE = 86_400.0

# Self-reports and their answers; None: free text.
REPORTS: dict[str, tuple[str, ...] | None] = {
    "colour_vision": ("normal", "deficient", "not sure"),
    "acuity": ("yes", "no"),
    "room": ("dark", "dim", "bright"),
    "display": None,
}
LONGEST_TEXT = 100
STEPS = 8
# The screen check, and what is possible. card: the width of a bank card in device pixels, None if not measured; window
# and screen in CSS pixels.
SCREEN: dict[str, tuple[float, float]] = {
    "dark_steps": (0, STEPS),
    "bright_steps": (0, STEPS),
    "card": (1, 100_000),
    "pixel_ratio": (0.01, 100),
    "window_width": (1, 100_000),
    "window_height": (1, 100_000),
    "screen_width": (1, 100_000),
    "screen_height": (1, 100_000),
    "colour_depth": (1, 256),
}

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
# The link is a secret, so it must not reach another site; nor may one show the page in a frame.
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "X-Robots-Tag": "noindex",
}

# The chunks of a PNG that say how it looks; all others, such as texts, could say what it is.
LOOKS = (b"IHDR", b"PLTE", b"tRNS", b"gAMA", b"cHRM", b"sRGB", b"iCCP", b"sBIT", b"cICP", b"IDAT", b"IEND")
SIGNATURE = b"\x89PNG\r\n\x1a\n"


def serve(folder: Path | str, experiment: str, host: str = "127.0.0.1", port: int = PORT) -> None:
    """Serve a study until Ctrl-C: the plan in a folder, answers into a database beside it. Port 0: one that is free.

    A UsageError or DataError says in one line why that cannot be.
    """
    folder = Path(folder)
    plan = Plan.load(folder)
    with listening(host, port) as listener:
        store = Store(folder / STORE, plan)
        interval = sys.getswitchinterval()
        try:
            app = make_app(folder, experiment, store)
            # Waiting for a thread is usual when pages load pictures ahead, and nothing to warn of.
            logging.getLogger("waitress.queue").setLevel(logging.ERROR)
            # With the usual 5 ms that threads wait for each other, answers wait for 100 ms where many come at once.
            sys.setswitchinterval(1e-4)
            server = create_server(
                app,
                sockets=[listener],
                threads=4,
                connection_limit=500,  # a browser has up to six
                asyncore_use_poll=True,
                max_request_body_size=2 * LARGEST_BODY,
                max_request_header_size=16 * 1024,
                ident="torchbrdf",
            )
            print(f"{address(host, listener.getsockname()[1])} asks observers; Ctrl-C stops", flush=True)
            server.run()
            observers, answers = store.counts(experiment)
            print(f"stopped: {observers} observers, {answers} answers in {store.path}", flush=True)
        finally:
            sys.setswitchinterval(interval)
            store.close()


def listening(host: str, port: int) -> socket.socket:
    """Open a socket that listens; a UsageError if the port is taken, or the host is not this machine."""
    if not 0 <= port <= 65535:
        raise UsageError(f"port: expected 0 to 65535, found {port}")
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        raise UsageError(f"cannot listen at {host}, port {port} ({error.strerror}); try another port") from None


def address(host: str, port: int) -> str:
    """Address to open in a browser."""
    name = socket.gethostname() if host in ("", "0.0.0.0", "::") else host
    return f"http://{f'[{name}]' if ':' in name else name}:{port}/"


def make_app(folder: Path | str, experiment: str, store: Store) -> Flask:
    """Make the server as a WSGI application; the store has the plan."""
    plan = store.plan
    plan.experiment(experiment)
    pictures = find_pictures(plan, Path(folder))
    for key, allowed in plan.screening.items():
        choices = REPORTS.get(key)
        if choices is None:
            raise unknown("self-report to screen by", key, [key for key, choices in REPORTS.items() if choices])
        for choice in allowed:
            if choice not in choices:
                raise unknown(f"answer to {key}", choice, choices)

    app = Flask(__name__, template_folder=str(PAGES), static_folder=None)
    app.config["MAX_CONTENT_LENGTH"] = LARGEST_BODY
    app.url_map.merge_slashes = False  # a climbing path is not put right, but refused
    parts = {path.name: path for path in PAGES.iterdir() if path.suffix in CONTENT_TYPES}
    texts = {key: re.split(r"\n\s*\n", plan.text(key).strip()) for key in TEXTS}
    largest = [max(sizes) for sizes in zip(*(size for _, size in pictures.values()), strict=True)]

    def page(own: bool) -> str:
        return render_template(
            "study.html", own=own, texts=texts, steps=range(1, STEPS + 1), ahead=AHEAD, largest=largest
        )

    @app.get("/")
    def landing() -> str:
        return page(own=False)

    @app.get("/page/<name>")
    def part(name: str) -> Response:
        if name not in parts:
            abort(404)
        return Response(parts[name].read_bytes(), content_type=f"{CONTENT_TYPES[parts[name].suffix]}; charset=utf-8")

    @app.post("/begin")
    def begin() -> tuple[Response, int]:
        if json_body("agreed")["agreed"] is not True:
            abort(400, "agreed: expected true")
        return jsonify(link=f"/o/{store.begin(experiment)}"), 201

    @app.get("/o/<token>")
    def own(token: str) -> str:
        store.state(token)
        return page(own=True)

    @app.get("/o/<token>/state")
    def state(token: str) -> Response:
        return jsonify(state=state_json(store.state(token)))

    @app.post("/o/<token>/profile")
    def profile(token: str) -> Response:
        reports = json_body(*REPORTS)
        for key, choices in REPORTS.items():
            if not isinstance(reports[key], str):
                abort(400, f"{key}: expected text")
            if choices is not None and reports[key] not in choices:
                abort(400, f"{key}: expected one of {', '.join(choices)}")
            if len(reports[key]) > LONGEST_TEXT or not reports[key].isprintable():
                abort(400, f"{key}: expected a line of at most {LONGEST_TEXT} characters")
        eligible = all(reports[key] in allowed for key, allowed in plan.screening.items())
        return jsonify(state=state_json(store.report(token, reports, eligible)))

    @app.post("/o/<token>/screen")
    def screen(token: str) -> Response:
        found = json_body(*SCREEN)
        for key, (low, high) in SCREEN.items():
            if key != "card" or found[key] is not None:
                number(found, key, low, high)
        return jsonify(state=state_json(store.record_screen(token, found)))

    @app.post("/o/<token>/answer")
    def answer(token: str) -> Response:
        record = json_body("trial", "side", "response_time")
        if type(record["trial"]) is not int:
            abort(400, "trial: expected a whole number")
        if record["side"] not in SIDES:
            abort(400, "side: expected left or right")
        time = number(record, "response_time", 0, LONGEST_RESPONSE)
        return jsonify(state=state_json(store.answer(token, record["trial"], record["side"], time)))

    @app.get("/o/<token>/<int:trial>/<any(reference, left, right):what>.png")
    def picture(token: str, trial: int, what: str) -> Response:
        now = store.state(token)
        if now.stage != "trials" or not now.position <= trial <= min(now.position + AHEAD, now.trials - 1):
            abort(403, "this picture is not to be seen now")
        shown = store.trial(now, trial)
        path, _ = pictures[shown.material, None if what == "reference" else getattr(shown, what)]
        found = Response(plain_png(path.read_bytes(), path), content_type="image/png")
        found.headers["Cache-Control"] = "private, max-age=3600"
        return found

    app.before_request(same_origin)
    app.after_request(security_headers)
    app.register_error_handler(HTTPException, lambda error: problem(error.code or 500, error.description or error.name))
    app.register_error_handler(UnknownObserverError, lambda error: problem(404, str(error)))
    app.register_error_handler(IneligibleError, lambda error: problem(403, str(error)))

    @app.errorhandler(NotNowError)
    def not_now(error: NotNowError) -> Response:
        # So that a page whose acknowledgment got lost goes on.
        assert request.view_args is not None
        return problem(409, str(error), state=state_json(store.state(request.view_args["token"])))

    @app.errorhandler(sqlite3.Error)
    @app.errorhandler(OSError)
    @app.errorhandler(TorchbrdfError)
    def broken(error: Exception) -> Response:
        app.logger.error("%s", error)
        return problem(503, "this does not work just now")  # the page tries again

    return app


def find_pictures(plan: Plan, folder: Path) -> dict[tuple[str, str | None], tuple[Path, tuple[int, int]]]:
    """The file and the size of each material's reference, under None, and of its stimuli."""
    found = {}
    for material in plan.materials:
        names = {None: material.reference} | {name: one.picture for name, one in material.stimuli.items()}
        for name, picture in names.items():
            path = inside(folder, picture, folder / PLAN)
            with path.open("rb") as file:
                head = file.read(24)
            if len(head) < 24 or not head.startswith(SIGNATURE):
                raise DataError(f"{path}: expected a PNG, found something else")
            found[material.name, name] = (path, struct.unpack(">II", head[16:]))
    return found


def plain_png(data: bytes, path: Path) -> bytes:
    """Strip a PNG of all that is not needed to show it."""
    kept, at = [data[:8]], 8
    while at + 12 <= len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] in LOOKS:
            kept.append(data[at:end])
        at = end
    if not data.startswith(SIGNATURE) or at != len(data) or kept[-1][4:8] != b"IEND":
        raise DataError(f"{path}: expected a whole PNG, found something else")
    return b"".join(kept)


def state_json(state: State) -> dict[str, Any]:
    """State of an observer as a page hears it."""
    return {"stage": state.stage, "trial": state.position, "of": state.trials}


def json_body(*fields: str) -> dict[str, Any]:
    """The JSON object that a page sent, with exactly these fields."""
    if request.mimetype != "application/json":
        abort(415, "expected application/json")
    try:
        record = json.loads(request.get_data().decode("utf-8"))
    except (ValueError, RecursionError):
        abort(400, "expected JSON")
    if not isinstance(record, dict) or set(record) != set(fields):
        abort(400, f"expected an object with {', '.join(fields)}")
    return record


def number(record: Mapping[str, Any], key: str, low: float, high: float) -> float:
    """A field that is a number in a range, which NaN never is."""
    value = record[key]
    if type(value) not in (int, float) or not low <= value <= high:
        abort(400, f"{key}: expected a number from {low:g} to {high:g}")
    return float(value)


def same_origin() -> None:
    """Refuse what a page of another site sends."""
    origin = request.headers.get("Origin")
    if request.method not in ("GET", "HEAD") and origin is not None and origin.partition("://")[2] != request.host:
        abort(403, "expected a request from this page")


def security_headers(response: Response) -> Response:
    """Add the headers that keep the link secret and the page out of frames."""
    response.headers.update(HEADERS)
    response.headers.setdefault("Cache-Control", "no-store")
    return response


def problem(status: int, text: str, **more: Any) -> Response:
    """Response that says what is wrong, for the page; in plain words where a person opens it."""
    person = request.method == "GET" and not request.path.endswith("/state")
    body = Response(f"{text}\n", content_type="text/plain; charset=utf-8") if person else jsonify(error=text, **more)
    return make_response(body, status)
