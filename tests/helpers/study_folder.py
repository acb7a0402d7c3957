"""A small study to test with: pictures in one colour with a little noise, farther from the reference one by one."""

import http.client
import io
import json
import signal
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image, PngImagePlugin

from torchbrdf.study import MEASURED, Experiment, Material, Plan, Stimulus

# From the best to the worst. No text of a page has these names in it.
BIRDS = ("kestrel", "osprey", "wren", "heron")
METALS = ("cobalt", "gallium", "hafnium", "indium", "niobium", "osmium", "rhenium", "tantalum", "vanadium", "yttrium")
EXPERIMENT = "quartet"
SECRETS = (*BIRDS, *METALS, EXPERIMENT, MEASURED, "secretmodel", "secretloss")


def make_study(folder: Path, materials: int = 3, size: int = 24, **experiment) -> Plan:
    """Write pictures and `study.json` into a folder. Their metadata holds names, as those of careless tools do."""
    noise = np.random.default_rng(0)
    found = []
    for k, metal in enumerate(METALS[:materials]):
        colour = np.array([60 + 12 * k, 120, 180 - 9 * k])
        stimuli = {}
        for far, bird in enumerate((MEASURED, *BIRDS)):
            shade = colour + far * np.array([9, -9, -9])
            pixels = shade + noise.integers(-3, 4, (size, size, 3))
            write_named(folder / "renders" / f"{metal}-{bird}.png", pixels.clip(0, 255).astype(np.uint8))
            stimuli[bird] = Stimulus(f"renders/{metal}-{bird}.png", "secretmodel", "secretloss", difference=float(far))
        reference = colour + noise.integers(-3, 4, (size, size, 3))
        write_named(folder / "renders" / f"{metal}.png", reference.astype(np.uint8))
        found.append(Material(metal, f"renders/{metal}.png", stimuli, order=float(k)))
    asked = Experiment(EXPERIMENT, "All four", BIRDS, **experiment)
    plan = Plan(tuple(found), (asked,), seed=5, screening={"colour_vision": ("normal",)})
    plan.save(folder)
    return plan


def write_named(path: Path, pixels: np.ndarray) -> None:
    """A PNG whose text says what it is."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = PngImagePlugin.PngInfo()
    text.add_text("Title", path.stem)
    text.add_text("Comment", f"{path.stem} by secretmodel", zip=True)
    Image.fromarray(pixels).save(path, pnginfo=text, dpi=(300, 300))


def pixels_of(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


def chunks_of(data: bytes) -> list[bytes]:
    """The kinds of chunks of a PNG, in order."""
    kinds, at = [], 8
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        kinds.append(data[at + 4 : at + 8])
        at += 12 + length
    return kinds


REPORTS = {"colour_vision": "normal", "acuity": "yes", "room": "dim", "display": "laptop"}
SCREEN = {
    "dark_steps": 6,
    "bright_steps": 7,
    "card": 323.5,
    "pixel_ratio": 1.25,
    "window_width": 1280,
    "window_height": 900,
    "screen_width": 1920,
    "screen_height": 1080,
    "colour_depth": 24,
}

GOOD = {"trial": 0, "side": "left", "response_time": 1.5}
BAD_ANSWERS = [
    *({key: value for key, value in GOOD.items() if key != left} for left in GOOD),
    {**GOOD, "observer": 1},
    *({**GOOD, "trial": bad} for bad in (None, "0", 0.0, True, False, [0], {})),
    *({**GOOD, "side": bad} for bad in (None, "up", "Left", "", 0, ["left"], {"left": 1})),
    *({**GOOD, "response_time": bad} for bad in (None, "1", True, -0.001, 86_401, 10**400, [1], float("nan"))),
    *({**GOOD, "response_time": bad} for bad in (float("inf"), -float("inf"), -1)),
    [],
    [GOOD],
    "left",
    None,
    1,
]
_TEXTS = ["", "{", "{'trial': 0}", "[" * 10_000, '{"trial": ' + "9" * 9000 + ', "side": "left", "response_time": 1}']
_TEXTS += [
    '{"trial": 0, "side": "left", "response_time": 1e999}',
    json.dumps(GOOD) + "x",
    "\ufeff" + json.dumps(GOOD),
]
_BYTES = [b"\xff\xfe" + json.dumps(GOOD).encode("utf-16-le"), json.dumps(GOOD).encode("utf-32"), b"\x80", b"\0"]
BAD_BODIES = [text.encode() for text in _TEXTS] + _BYTES
BAD_REPORTS = [
    *({**REPORTS, "colour_vision": bad} for bad in ("fine", "", "Normal", None, 1, ["normal"])),
    *({**REPORTS, "display": bad} for bad in (None, 5, "x" * 101, "two\nlines", "\ud800", "nul\0", ["x"])),
    {**REPORTS, "name": "me"},
    {key: REPORTS[key] for key in list(REPORTS)[1:]},
]
BAD_SCREENS = [
    *({**SCREEN, "dark_steps": bad} for bad in (-1, 9, "3", None, True)),
    *({**SCREEN, "card": bad} for bad in (0, -5, "wide", 10**9, True)),
    *({**SCREEN, key: None} for key in SCREEN if key != "card"),
    *({**SCREEN, "pixel_ratio": bad} for bad in (0, float("nan"), 1e9)),
    {**SCREEN, "more": 1},
    {key: SCREEN[key] for key in list(SCREEN)[1:]},
]


def start_server(folder: Path, port: int = 0, **settings: object) -> tuple[subprocess.Popen, int]:
    """`serve` in a process of its own, and the port that it listens at."""
    # Where this runs in the background of a shell, Ctrl-C would be ignored.
    code = (
        "import json, signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from torchbrdf.study.server import serve; serve(sys.argv[1], **json.loads(sys.argv[2]))"
    )
    given = json.dumps({"experiment": EXPERIMENT, "port": port, **settings})
    process = subprocess.Popen([sys.executable, "-c", code, str(folder), given], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line.startswith("http://127.0.0.1:"), f"the server did not start: {line!r}, status {process.poll()}"
    return process, int(line.split("/")[2].split(":")[1])


@contextmanager
def serving(folder: Path, **settings: object) -> Iterator[tuple[subprocess.Popen, int]]:
    """A server, and its port, until the block ends."""
    process, port = start_server(folder, **settings)
    try:
        yield process, port
    finally:
        if process.poll() is None:
            stop_server(process)


def stop_server(process: subprocess.Popen, number: int = signal.SIGINT) -> str:
    """Stop it as Ctrl-C does, or by another signal; gives what it says at the end."""
    process.send_signal(number)
    said, _ = process.communicate(timeout=20)
    return said


class Client:
    """A browser without a screen: asks the server over one connection that is kept, and again when that breaks."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.headers: dict[str, str] = {}  # sent with every request
        self._connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)

    def ask(self, path: str, record: object = None) -> tuple[int, bytes]:
        """Get, or post a record as JSON; gives status and body. An OSError or HTTPException if it breaks."""
        response, said = self._ask(path, record)
        return response.status, said

    def location(self, path: str) -> tuple[int, str | None]:
        """Get; gives the status and where it leads."""
        response, _ = self._ask(path)
        return response.status, response.headers["Location"]

    def _ask(self, path: str, record: object = None) -> tuple[http.client.HTTPResponse, bytes]:
        body = None if record is None else json.dumps(record)
        headers = self.headers | ({"Content-Type": "application/json"} if body else {})
        try:
            self._connection.request("GET" if body is None else "POST", path, body, headers)
            response = self._connection.getresponse()
            return response, response.read()
        except (OSError, http.client.HTTPException):
            self._connection.close()  # the next request opens it again
            raise

    def tell(self, path: str, record: object = None) -> tuple[int, dict]:
        """The same, for JSON."""
        status, said = self.ask(path, record)
        return status, json.loads(said)

    def ready(self) -> str:
        """The link of a new observer who may answer."""
        link = self.tell("/begin", {"agreed": True})[1]["link"]
        assert self.tell(f"{link}/profile", REPORTS)[0] == self.tell(f"{link}/screen", SCREEN)[0] == 200
        return link

    def close(self) -> None:
        self._connection.close()


def give_answers(client, link, first, count):
    """Give some answers; all are acknowledged."""
    for trial in range(first, first + count):
        assert client.tell(f"{link}/answer", {"trial": trial, "side": "left", "response_time": 1.5})[0] == 200


def begin(client) -> str:
    """The link of a new observer, by Flask's own client."""
    return client.post("/begin", json={"agreed": True}).json["link"]


def ready(client) -> str:
    """The link of an observer who may answer."""
    link = begin(client)
    assert client.post(f"{link}/profile", json=REPORTS).status_code == 200
    assert client.post(f"{link}/screen", json=SCREEN).status_code == 200
    return link


def admitted(store):
    """An observer who may answer."""
    token = store.begin(EXPERIMENT)
    store.report(token, REPORTS, True)
    store.record_screen(token, SCREEN)
    return token


def answer(client, link: str, trial: int, side: str = "left", seconds: float = 1.0):
    return client.post(f"{link}/answer", json={"trial": trial, "side": side, "response_time": seconds})


# The mean colours of what is on the screen, once an answer is awaited to this trial.
LOOK = """count => {
  if (document.getElementById("count").textContent !== count) return null;
  if (document.getElementById("trials").dataset.phase !== "shown") return null;
  return ["reference", "left", "right"].map(name => {
    const picture = document.querySelector(`#${name} img`);
    const canvas = Object.assign(document.createElement("canvas"), { width: 24, height: 24 });
    const paint = canvas.getContext("2d");
    paint.drawImage(picture, 0, 0);
    const { data } = paint.getImageData(0, 0, 24, 24);
    return [0, 1, 2].map(k => data.filter((_, n) => n % 4 === k).reduce((a, b) => a + b) / 576);
  });
}"""


class Ears:
    """Every response that a page gets."""

    def __init__(self):
        self.heard, self._waiting = [], []

    def listen(self, page):
        page.on("response", lambda response: self._waiting.append(response))

    def catch_up(self):
        """Read bodies now, before the browser forgets them."""
        while self._waiting:
            response = self._waiting.pop()
            # What brought the page here is gone with the page before.
            body = b"" if response.url.endswith("/begin") else response.body()
            self.heard.append(f"{response.url} {response.all_headers()} {body.decode('latin-1')}".lower())
