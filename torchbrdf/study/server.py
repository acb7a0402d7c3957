"""The web server of a study: a page for observers, their own links, and nothing about what they look at."""

import json
import logging
import math
import re
import sqlite3
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from functools import lru_cache
from pathlib import Path
from typing import Any

from flask import Flask, Response, abort, jsonify, make_response, redirect, render_template, request
from werkzeug.exceptions import HTTPException

from torchbrdf.errors import DataError, TorchbrdfError, UsageError, shown
from torchbrdf.reading import read_bytes, reading
from torchbrdf.registry import unknown
from torchbrdf.study.connections import address, listening, make_server, say, stopping
from torchbrdf.study.design import trials
from torchbrdf.study.guard import Begins, Site
from torchbrdf.study.pictures import find_pictures, plain_png
from torchbrdf.study.plan import PLAN, TEXTS, Plan
from torchbrdf.study.store import (
    SIDES,
    STORE,
    FullError,
    IneligibleError,
    NotNowError,
    State,
    Store,
    UnknownObserverError,
)

PAGES = Path(__file__).parent / "pages"
CONTENT_TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
PORT = 8000
# Most of them wait for the disk, which writes for all of them at once.
THREADS = 12
# So many may begin, if nothing else is said; so a flood does not fill the disk.
OBSERVERS = 1000
# Seconds after which a page tries again where the database does not work.
AGAIN = 1.0
MINUTE = 60.0
# So many trials after the current one may be loaded ahead; so few that nobody can look through the study.
AHEAD = 2
LARGEST_BODY = 16 * 1024
# Bytes of pictures that are kept in memory.
PICTURES_KEPT = 2**26
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


def serve(
    folder: Path | str,
    experiment: str,
    host: str = "127.0.0.1",
    port: int = PORT,
    *,
    url: str | None = None,
    observers: int = OBSERVERS,
) -> None:
    """Serve a study until Ctrl-C, SIGTERM or SIGHUP: the plan in a folder, answers into a database beside it.

    Port 0: one that is free. `url`: of the page for observers, where they come to it through a proxy. `observers`: so
    many may begin. A UsageError or DataError says in one line why that cannot be.
    """
    folder = Path(folder)
    site = Site.of(host, url)
    if observers < 1:
        raise UsageError(f"--observers: expected 1 or more, found {observers}")
    plan = Plan.load(folder)
    with ExitStack() as stack:
        stack.enter_context(stopping())
        listener = stack.enter_context(listening(host, port))
        store = Store(folder / STORE, plan)
        stack.callback(store.close)
        begins = Begins() if url is None else Begins(one=None)
        app = make_app(folder, experiment, store, site, observers=observers, begins=begins)
        # With the usual 5 ms that threads wait for each other, answers wait for 100 ms where many come at once.
        stack.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(1e-4)
        server = make_server(
            app,
            listener,
            threads=THREADS,
            url_prefix=site.prefix,
            max_request_body_size=2 * LARGEST_BODY,
            max_request_header_size=16 * 1024,
            ident="torchbrdf",
        )
        here = address(host, listener.getsockname()[1])
        with store.checkpoints():
            say(f"{here} asks observers{f', who open {site.url}' if site.url else ''}; Ctrl-C stops")
            server.run()
        store.check_place()
        count, answers = store.counts(experiment)
        store.close()
        say(f"stopped: {count} observers, {answers} answers in {store.path}")


def make_app(
    folder: Path | str,
    experiment: str,
    store: Store,
    site: Site | None = None,
    *,
    observers: int | None = None,
    begins: Begins | None = None,
) -> Flask:
    """Make the server as a WSGI application; the store has the plan. How many may begin is not limited by itself."""
    plan = store.plan
    asked = plan.experiment(experiment)
    with reading(Path(folder) / PLAN, f"an experiment {experiment!r} that can be asked"):
        trials(plan, asked, 0)
    site = Site() if site is None else site
    check_screening(plan, Path(folder) / PLAN)
    texts = {key: paragraphs(plan, key, Path(folder) / PLAN) for key in TEXTS}
    pictures = find_pictures(plan, Path(folder))

    # Many observers see the same pictures.
    @lru_cache(maxsize=max(1, PICTURES_KEPT // max(path.stat().st_size for path, _ in pictures.values())))
    def plain(path: Path) -> bytes:
        return plain_png(read_bytes(path, "a PNG"), path)

    app = Flask(__name__, template_folder=str(PAGES), static_folder=None)
    app.config["MAX_CONTENT_LENGTH"] = LARGEST_BODY
    app.url_map.merge_slashes = False  # a climbing path is not put right, but refused
    parts = {path.name: path for path in PAGES.iterdir() if path.suffix in CONTENT_TYPES}
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
        wait = 0.0 if begins is None else begins.wait(request.remote_addr or "")
        if wait:
            app.logger.warning("more people begin than may at once; some are asked to wait")
            return later(429, "too many begin just now; please try again soon", wait), 429
        return jsonify(link=f"/o/{store.begin(experiment, observers)}"), 201

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
        pair = store.trial(now, trial)
        path, _ = pictures[pair.material, None if what == "reference" else getattr(pair, what)]
        found = Response(plain(path), content_type="image/png")
        found.headers["Cache-Control"] = "private, max-age=3600"
        return found

    @app.before_request
    def check_page() -> Response | None:
        host = request.headers.get("Host")  # None: no browser
        if host is not None and not site.knows(host):
            app.logger.warning(
                "refused a request for %s, which is no name of this server; if it is one, say so: --url", shown(host)
            )
            abort(400, "this server does not go by that name")
        if request.method not in ("GET", "HEAD"):
            origin = request.headers.get("Origin")
            if not site.sent(host or "", origin, request.headers.get("Sec-Fetch-Site")):
                app.logger.warning(
                    "refused what a page at %s sends; if observers come through a proxy, say so: --url", shown(origin)
                )
                abort(403, "expected a request from this page")
        if request.environ["PATH_INFO"] == "":  # so that relative links are right
            return make_response(redirect(f"{site.prefix}/", 308))
        return None

    app.after_request(security_headers)
    app.register_error_handler(HTTPException, lambda error: problem(error.code or 500, error.description or error.name))
    app.register_error_handler(UnknownObserverError, lambda error: problem(404, str(error)))
    app.register_error_handler(IneligibleError, lambda error: problem(403, str(error)))
    app.logger.addFilter(Seldom())

    @app.errorhandler(NotNowError)
    def not_now(error: NotNowError) -> Response:
        # So that a page whose acknowledgment got lost goes on.
        assert request.view_args is not None
        return problem(409, str(error), state=state_json(store.state(request.view_args["token"])))

    @app.errorhandler(sqlite3.Error)
    @app.errorhandler(OSError)
    @app.errorhandler(TorchbrdfError)
    def broken(error: Exception) -> Response:
        app.logger.error(str(error).replace("%", "%%"))
        return later(503, "this does not work just now", AGAIN)  # the page tries again

    @app.errorhandler(FullError)
    def full(error: FullError) -> Response:
        app.logger.error("nobody else can begin: %s; --observers raises that", error)
        return problem(403, "This study has all the observers that it needs. Thank you for your interest.")

    return app


def check_screening(plan: Plan, path: Path) -> None:
    """A DataError if a plan screens by what nobody is asked, or by an answer that nobody can give."""
    for key, allowed in plan.screening.items():
        choices = REPORTS.get(key)
        if choices is None:
            known = [name for name, choices in REPORTS.items() if choices]
            raise DataError(f"{path}: {unknown('self-report to screen by', key, known)}")
        for choice in allowed:
            if choice not in choices:
                raise DataError(f"{path}: {unknown(f'answer to {key}', str(choice), choices)}")


def paragraphs(plan: Plan, key: str, path: Path) -> list[str]:
    """A text that is shown to observers; an empty line parts paragraphs."""
    text = plan.text(key)
    if not isinstance(text, str):
        raise DataError(f"{path}: texts: {key}: expected text, found {shown(text)}")
    return re.split(r"\n\s*\n", text.strip())


class Seldom(logging.Filter):
    """Lets what is said the same way through once a minute: pages try again and again."""

    def __init__(self) -> None:
        super().__init__()
        self._said: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to say it."""
        said = self._said.get(record.msg, -MINUTE)
        if record.created - said < MINUTE:
            return False
        if len(self._said) > 100:
            self._said.clear()
        self._said[record.msg] = record.created
        return True


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


def later(status: int, text: str, seconds: float) -> Response:
    """Response that says what is wrong, and when to try again."""
    response = problem(status, text)
    response.headers["Retry-After"] = str(math.ceil(seconds))
    return response
