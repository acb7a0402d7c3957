"""How the memory of one process grows while it does the same thing for long: fits, renders, answers of a study server.

    python benchmarks/endurance.py [fits] [renders] [answers] [--fits 2000] [--renders 1000] [--answers 50000]

Each in a process of its own. Fits: of materials of 200 pairs, one at a time, a Ward lobe under the cube root. Renders:
of Ward and GGX lobes with other parameters each time, 64 x 64 pixels, a new scene for every tenth. Answers: 20
observers at once, who answer 20 trials each, after which others come. The memory is what is resident: the most within
the first tenth, and how much more it ever is later.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np
import psutil

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

DEFAULTS = {"fits": 2000, "renders": 1000, "answers": 50_000}
WORK = {
    "fits": """if True:
        import sys
        import torch
        torch.set_num_threads(1)
        from torchbrdf import fit
        from torchbrdf.lobes import make_model
        from torchbrdf.losses import make_loss
        from torchbrdf.measured import load_all

        (measured,) = load_all([sys.argv[1]])
        loss = make_loss("cube_root")

        def work(k):
            some = measured.batch([k % len(measured)]).batch()
            fit(make_model("ward", 1), some, loss, samples=None, diffuse="fit")
    """,
    "renders": """if True:
        import torch
        torch.set_num_threads(1)
        from torchbrdf.lobes import make_model
        from torchbrdf.render import Scene, render, sphere
        scene = None

        def work(k):
            global scene
            if k % 10 == 0:
                scene = Scene(sphere(3), size=64, light_samples=64)
            model = make_model(("ward", "ggx")[k % 2], 1)
            with torch.no_grad():
                model.components()[1].roughness.fill_(0.05 + 0.001 * (k % 300))
            render(model, scene)
    """,
}
# What a process does after its own kind of work is defined: says its memory, about a hundred times.
LOOP = """
import json, sys
import psutil
count, own, sizes = int(sys.argv[2]), psutil.Process(), []
for k in range(count):
    work(k)
    if (k + 1) % max(count // 100, 1) == 0:
        sizes.append(own.memory_info().rss)
print(json.dumps(sizes))
"""
OBSERVERS = 20


def say(what: str, count: int, sizes: list[int]) -> None:
    """Print what a process took."""
    tenth = max(len(sizes) // 10, 1)
    first, later = max(sizes[:tenth]), max(sizes[tenth:])
    grown = 100 * (later / first - 1)
    print(
        f"{count} {what} in one process: {first / 2**20:.0f} MiB after a tenth, at most {grown:+.1f} % later",
        flush=True,
    )


def by_process(what: str, folder: Path, count: int) -> None:
    """Fits or renders."""
    import textwrap

    code = textwrap.dedent(WORK[what].partition("\n")[2]) + LOOP
    command = [sys.executable, "-c", code, str(folder), str(count)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    say(what, count, json.loads(done.stdout.splitlines()[-1]))


def answers(folder: Path, count: int) -> None:
    """Answers to a server; its memory after each round of observers."""
    from study_server import STUDY, TRIALS, Observer, make_study

    class Answering(Observer):
        """Answers, and loads no pictures."""

        def load(self, link, trial):
            pass

    make_study(folder)
    # All begin at one address, and there are more of them than a study has unless it is told.
    many = "from torchbrdf.study.guard import Begins; Begins.wait = lambda self, address: 0.0\n"
    many += STUDY.replace("port=0", f"port=0, observers={count // TRIALS + OBSERVERS}")
    server = subprocess.Popen([sys.executable, "-c", many, str(folder)], stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        port = int(server.stdout.readline().split("/")[2].split(":")[1])
        sizes, done = [], 0
        while done < count:
            together = threading.Barrier(OBSERVERS)
            observers = [Answering(port, done + seed, None, together) for seed in range(OBSERVERS)]
            for observer in observers:
                observer.start()
            for observer in observers:
                observer.join()
            done += sum(len(observer.answers) for observer in observers)
            sizes.append(psutil.Process(server.pid).memory_info().rss)
            if done != TRIALS * OBSERVERS * len(sizes):
                raise SystemExit(f"expected {TRIALS * OBSERVERS * len(sizes)} answers, found {done}")
    finally:
        server.kill()
        server.wait()
    say("answers", done, [int(size) for size in np.repeat(sizes, max(1, -(-10 // len(sizes))))])


def main(work: list[str], counts: dict[str, int]) -> None:
    """Print a line each."""
    from helpers.tiny_materials import write_tiny

    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        if "fits" in work:
            write_tiny(root / "few", 50, 200)
        for what in work:
            if what == "answers":
                (root / "study").mkdir()
                answers(root / "study", counts[what])
            else:
                by_process(what, root / "few", counts[what])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", nargs="*", choices=[[], *DEFAULTS], help="which; by default all")
    for what, count in DEFAULTS.items():
        parser.add_argument(f"--{what}", type=int, default=count, metavar="N", help=f"how many (default {count:,})")
    options = parser.parse_args()
    main(options.work or list(DEFAULTS), {what: getattr(options, what) for what in DEFAULTS})
