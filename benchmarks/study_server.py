"""What a hundred observers at once feel: from an answer to the next trial, against a server in a process of its own.

    python benchmarks/study_server.py [--observers 100]

Every observer answers 20 of 60 trials and, as a page does, loads after each answer the three pictures of the last trial
that may be loaded ahead. They think before they answer: as long as people do, or for a moment, which is faster than any
person; or not at all, which shows what the server can do. The same is asked of a bare Flask application with the same
settings, which records nothing and checks nothing: what is left for the study to make faster.
"""

import argparse
import http.client
import json
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from common import Timer
from PIL import Image

from torchbrdf.study import Experiment, Material, Plan, Stimulus
from torchbrdf.study.server import AHEAD
from torchbrdf.study.store import STORE

TRIALS = 20  # of 60
STIMULI = ("a", "b", "c", "d")
REPORTS = {"colour_vision": "normal", "acuity": "yes", "room": "dim", "display": ""}
SCREEN = dict.fromkeys(("card", "pixel_ratio", "window_width", "window_height", "screen_width", "screen_height"), 1)
SCREEN |= {"dark_steps": 8, "bright_steps": 8, "colour_depth": 24}
STUDY = "import sys; from torchbrdf.study.server import serve; serve(sys.argv[1], 'two', port=0)"
BARE = """
import sys
from pathlib import Path
from flask import Flask, Response, jsonify, request
from torchbrdf.study.connections import listening, make_server
from torchbrdf.study.server import THREADS
app, data = Flask("bare"), (Path(sys.argv[1]) / "0-reference.png").read_bytes()
said = lambda trial: jsonify(state={"stage": "done" if trial == 60 else "trials", "trial": trial, "of": 60})
routes = {
    "/begin": lambda: jsonify(link="/o/token"),
    "/o/<token>/profile": lambda token: said(0),
    "/o/<token>/screen": lambda token: said(0),
    "/o/<token>/answer": lambda token: said(request.json["trial"] + 1),
    "/o/<token>/<int:trial>/<what>.png": lambda token, trial, what: Response(data, content_type="image/png"),
}
for path, view in routes.items():
    app.add_url_rule(path, path.replace(".", "-"), view, methods=["GET", "POST"])
listener = listening("127.0.0.1", 0)
sys.setswitchinterval(1e-4)
print(f"http://127.0.0.1:{listener.getsockname()[1]}/", flush=True)
make_server(app, listener, threads=THREADS).run()
"""
THINKING = {"as people, 1-4 s": (1.0, 4.0), "for 50-200 ms": (0.05, 0.2), "not at all": None}


def make_study(folder):
    """Ten materials with four stimuli, 400 x 400 pixels; gives the mean size of a file."""
    noise = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(-1, 1, 400), np.linspace(-1, 1, 400))
    materials = []
    for k in range(10):
        for name in ("reference", *STIMULI):
            shade = (
                110 + 70 * np.cos(3 * x + k)[..., None] * np.sin(2 * y)[..., None] + noise.normal(0, 1.2, (400, 400, 3))
            )
            Image.fromarray(shade.clip(0, 255).astype(np.uint8)).save(folder / f"{k}-{name}.png")
        stimuli = {name: Stimulus(f"{k}-{name}.png") for name in STIMULI}
        materials.append(Material(str(k), f"{k}-reference.png", stimuli))
    Plan(tuple(materials), (Experiment("two", "Two", STIMULI),)).save(folder)
    sizes = [path.stat().st_size for path in folder.glob("*.png")]
    return sum(sizes) / len(sizes)


class Observer(threading.Thread):
    """Answers all trials; `answers` and `pictures` are the seconds that each took."""

    def __init__(self, port, seed, think, together):
        super().__init__()
        self.source, self.think, self.together = random.Random(seed), think, together
        self.connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        self.answers, self.pictures = [], []

    def ask(self, path, record=None):
        method, body = ("GET", None) if record is None else ("POST", json.dumps(record))
        self.connection.request(method, path, body, {"Content-Type": "application/json"} if body else {})
        response = self.connection.getresponse()
        data = response.read()
        if response.status >= 300:
            raise RuntimeError(f"{method} {path}: {response.status}, {data[:200]!r}")
        return data

    def load(self, link, trial):
        began = time.perf_counter()
        for what in ("reference", "left", "right"):
            self.ask(f"{link}/{trial}/{what}.png")
        self.pictures.append(time.perf_counter() - began)

    def run(self):
        link = json.loads(self.ask("/begin", {"agreed": True}))["link"]
        self.ask(f"{link}/profile", REPORTS)
        state = json.loads(self.ask(f"{link}/screen", SCREEN))["state"]
        for trial in range(AHEAD):
            self.load(link, trial)
        self.together.wait()
        while len(self.answers) < TRIALS:
            trial = state["trial"]
            if trial + AHEAD < state["of"]:
                self.load(link, trial + AHEAD)
            if self.think:
                time.sleep(self.source.uniform(*self.think))
            answer = {"trial": trial, "side": self.source.choice(["left", "right"]), "response_time": 1.0}
            began = time.perf_counter()
            state = json.loads(self.ask(f"{link}/answer", answer))["state"]
            self.answers.append(time.perf_counter() - began)
        self.connection.close()


def measure(code, folder, count, think):
    """Let them all answer; gives 50 and 95 % of the seconds for answers and for pictures, and the server's a trial."""
    used = cpu_of_children()
    server = subprocess.Popen([sys.executable, "-c", code, folder], stdout=subprocess.PIPE, text=True)
    try:
        port = int(server.stdout.readline().split("/")[2].split(":")[1])
        together = threading.Barrier(count + 1)
        observers = [Observer(port, seed, think, together) for seed in range(count)]
        for observer in observers:
            observer.start()
        together.wait()
        with Timer() as timer:
            for observer in observers:
                observer.join()
    finally:
        server.kill()
        server.wait()
    found = []
    for what in ("answers", "pictures"):
        times = np.array([seconds for observer in observers for seconds in getattr(observer, what)])
        if what == "answers" and len(times) != TRIALS * count:
            raise RuntimeError(f"expected {TRIALS * count} answers, found {len(times)}")
        found += [*np.percentile(times, (50, 95))]
    return found, TRIALS * count / timer.clock, (cpu_of_children() - used) / (TRIALS * count)


def cpu_of_children():
    """Seconds of a core that processes took which this one started and waited for."""
    times = os.times()
    return times.children_user + times.children_system


def main(count, rounds):
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        size = make_study(Path(folder))
        print(f"{count} observers at once, {TRIALS} trials each, PNGs of 400 x 400 pixels, {size / 1e3:.0f} kB, in ms")
        print(f"{'they think':18s} {'server':6s}  answers p50    p95  pictures p50    p95  answers/s  CPU a trial")
        for name, think in THINKING.items():
            for _ in range(rounds):
                tails = {}
                for server, code in (("bare", BARE), ("study", STUDY)):
                    (Path(folder) / STORE).unlink(missing_ok=True)
                    (a50, a95, p50, p95), rate, cpu = measure(code, folder, count, think)
                    tails[server] = a95
                    print(
                        f"{name:18s} {server:6s} {1e3 * a50:12.1f} {1e3 * a95:6.1f} {1e3 * p50:13.1f} {1e3 * p95:6.1f} "
                        f"{rate:10.0f} {1e3 * cpu:12.2f}",
                        flush=True,
                    )
                print(f"{'':18s} p95 of answers: {tails['study'] / tails['bare']:.2f} of the bare server's")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--observers", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=1, help="each row so often (default 1)")
    options = parser.parse_args()
    main(options.observers, options.rounds)
