"""What thirty observers at once feel: from an answer to the next trial, against a server in a process of its own.

    python benchmarks/study_server.py [--observers 30]

Every observer answers all 60 trials and, as a page does, loads the three pictures of the last trial that may be loaded
ahead after each answer. Once they think before they answer, once they do not, which is faster than any person.
"""

import argparse
import http.client
import json
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

STIMULI = ("a", "b", "c", "d")
REPORTS = {"colour_vision": "normal", "acuity": "yes", "room": "dim", "display": ""}
SCREEN = dict.fromkeys(("card", "pixel_ratio", "window_width", "window_height", "screen_width", "screen_height"), 1)
SCREEN |= {"dark_steps": 8, "bright_steps": 8, "colour_depth": 24}
SERVE = "import sys; from torchbrdf.study.server import serve; serve(sys.argv[1], 'two', port=0)"


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
        while state["stage"] != "done":
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


def measure(name, port, count, think):
    """Let them all answer, and print the row."""
    together = threading.Barrier(count + 1)
    observers = [Observer(port, seed, think, together) for seed in range(count)]
    for observer in observers:
        observer.start()
    together.wait()
    with Timer() as timer:
        for observer in observers:
            observer.join()
    for what in ("answers", "pictures"):
        times = np.array([seconds for observer in observers for seconds in getattr(observer, what)])
        if what == "answers" and len(times) != 60 * count:
            raise RuntimeError(f"expected {60 * count} answers, found {len(times)}")
        p50, p95 = np.percentile(times, (50, 95))
        rate = f"{len(times) / timer.clock:7.0f} a second"
        print(
            f"{name:20s} {what:9s} p50 {1e3 * p50:6.1f}  p95 {1e3 * p95:6.1f}  max {1e3 * times.max():6.1f} ms {rate}"
        )


def main(count):
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        size = make_study(Path(folder))
        server = subprocess.Popen([sys.executable, "-c", SERVE, folder], stdout=subprocess.PIPE, text=True)
        try:
            port = int(server.stdout.readline().split("/")[2].split(":")[1])
            print(f"{count} observers at once, 60 trials each, PNGs of 400 x 400 pixels, {size / 1e3:.0f} kB")
            measure("thinking 50-200 ms", port, count, (0.05, 0.2))
            measure("not thinking", port, count, None)
        finally:
            server.kill()
            server.wait()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--observers", type=int, default=30)
    main(parser.parse_args().observers)
