"""Kill commands at random times, and see that what they leave is taken up and ends as if nothing had been.

    python benchmarks/kills.py [fit share collect run train render match texels] [--kills 30] [--seed 0]

Each kill: the command runs in a new folder and gets SIGKILL, SIGTERM or SIGHUP at a random moment, or one of its worker
processes gets SIGKILL; no process of it may be left after three seconds. Then the same command runs to its end. Every
file is held, byte for byte, against that of a run that nobody disturbed, without what tells the time (log.txt, and
seconds in JSON, CSV and pages); there may be no other file, in the folder, the cache or the folder of temporary files.
"""

import argparse
import atexit
import csv
import io
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import psutil

STANDINS = Path(__file__).resolve().parents[1] / "assets" / "standins.json"
FIT = ["fit", str(STANDINS), "--lobes", "1", "--samples", "2000", "--max-theta", "60"]
SHARES = Path(tempfile.gettempdir()) / f"shares-{os.getpid()}"
WORK = {
    "fit": FIT,
    "share": [*FIT, "--shard", "1/2"],
    "collect": ["collect", str(SHARES / "1"), str(SHARES / "2")],
    "run": ["run", "fores2012", "quick=true", "size=32"],
    "train": ["run", "train_metric", "quick=true"],
    "render": ["render", str(STANDINS), "--size", "48"],
    "match": ["match", "zoo:nickel", "--for", "brdf", "--budget", "quick"],
    "texels": ["run", "texels", "quick=true"],
}
ENDS = {"SIGKILL": signal.SIGKILL, "SIGTERM": signal.SIGTERM, "SIGHUP": signal.SIGHUP, "a worker": None}
# Seconds that processes have to be gone after a signal: two, and some for a busy machine to look.
GRACE = 3.0


@dataclass
class Place:
    """A folder for what a command writes: its results, a cache, temporary files."""

    root: Path

    def start(self, arguments: list[str], processes: str) -> subprocess.Popen:
        """The command, in a session of its own."""
        for name in ("cache", "tmp"):
            (self.root / name).mkdir(parents=True, exist_ok=True)
        own = {"TORCHBRDF_CACHE": self.root / "cache", "TMPDIR": self.root / "tmp", "TORCHBRDF_PROCESSES": processes}
        environment = os.environ | {"OMP_NUM_THREADS": "2"} | {key: str(value) for key, value in own.items()}
        command = [sys.executable, "-m", "torchbrdf", *arguments, "--out", str(self.root / "out")]
        with (self.root / "said.txt").open("ab") as said:
            return subprocess.Popen(command, stdout=said, stderr=said, env=environment, start_new_session=True)

    def files(self) -> dict[str, bytes]:
        """Every file, without what tells the time."""
        found = [path for path in self.root.rglob("*") if path.is_file() and path.name not in ("said.txt", "log.txt")]
        return {str(path.relative_to(self.root)): timeless(path) for path in sorted(found)}


def timeless(path: Path) -> bytes:
    """A file's bytes without seconds."""
    data = path.read_bytes()
    if path.suffix == ".json":
        return json.dumps(_without_seconds(json.loads(data))).encode()
    if path.suffix == ".jsonl":
        head, *lines = [json.loads(line) for line in data.splitlines()]
        return json.dumps([{**head, "sha256": ""}, *_without_seconds(lines)]).encode()
    if path.suffix == ".csv":
        rows = csv.DictReader(io.StringIO(data.decode()))
        return json.dumps([{key: value for key, value in row.items() if key != "seconds"} for row in rows]).encode()
    if path.suffix == ".html":
        return re.sub(rb"[\d.]+ (s|seconds|minutes)\b", b"", data)
    return data


def _without_seconds(value: object) -> object:
    if isinstance(value, dict):
        return {key: _without_seconds(item) for key, item in value.items() if key != "seconds"}
    return [_without_seconds(item) for item in value] if isinstance(value, list) else value


def session(leader: int) -> list[psutil.Process]:
    """The processes of a session, without those that have ended and only wait to be counted."""
    found = []
    for process in psutil.process_iter():
        try:
            if os.getsid(process.pid) == leader and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
        except (OSError, psutil.NoSuchProcess):
            pass
    return found


def left_after(leader: int, seconds: float) -> list[psutil.Process]:
    """What is left of a session after so many seconds, which is killed."""
    until = time.monotonic() + seconds
    while (left := session(leader)) and time.monotonic() < until:
        time.sleep(0.05)
    for process in left:
        process.kill()
    return left


def kill(process: subprocess.Popen, end: str) -> None:
    """End a command, or one of its workers, if it has any."""
    if ENDS[end] is not None:
        process.send_signal(ENDS[end])
        return
    workers = [one for one in session(process.pid) if "popen_loky" in " ".join(one.cmdline())]
    if workers:
        random.choice(workers).kill()


def differences(found: dict[str, bytes], expected: dict[str, bytes]) -> list[str]:
    """What is wrong with files, a line each."""
    lines = [f"{name}: left over" for name in found.keys() - expected.keys()]
    lines += [f"{name}: missing" for name in expected.keys() - found.keys()]
    return lines + [f"{name}: differs" for name in found.keys() & expected.keys() if found[name] != expected[name]]


def try_one(arguments: list[str], folder: Path, expected: dict[str, bytes], after: float, end: str) -> list[str]:
    """Disturb one command, run it again, and say what is wrong then."""
    wrong = []
    place = Place(folder)
    process = place.start(arguments, "always" if end == "a worker" else random.choice(["", "always"]))
    try:
        process.wait(after)
    except subprocess.TimeoutExpired:
        kill(process, end)
    if end == "a worker":
        status = process.wait()
        wrong += [f"exit status {status} after the death of a worker"] if status else []
    left = left_after(process.pid, GRACE)
    process.wait()
    wrong += [f"process left: {' '.join(map(str, left))}"] if left else []
    again = place.start(arguments, "")
    if again.wait():
        wrong.append(f"exit status {again.returncode} of the second run")
    wrong += [f"semaphore left: {path}" for path in Path("/dev/shm").glob(f"sem.loky-{process.pid}-*")]
    wrong += differences(place.files(), expected)
    if wrong:
        print((folder / "said.txt").read_text(errors="replace")[-2000:], file=sys.stderr)
    return wrong


def make_shares() -> None:
    """The two folders that are collected."""
    for k in ("1", "2"):
        command = [sys.executable, "-m", "torchbrdf", *FIT, "--shard", f"{k}/2", "--out", str(SHARES / k)]
        subprocess.run(command, check=True, capture_output=True)


def main(names: list[str], kills: int, seed: int) -> int:
    """Print a line for each command; the exit status is 1 if anything was wrong."""
    random.seed(seed)
    if not names or "collect" in names:
        make_shares()
        atexit.register(shutil.rmtree, SHARES)
    failed = 0
    for name in names or list(WORK):
        with tempfile.TemporaryDirectory() as folder:
            undisturbed = Place(Path(folder) / "undisturbed")
            began = time.monotonic()
            if undisturbed.start(WORK[name], "").wait():
                raise SystemExit((undisturbed.root / "said.txt").read_text())
            seconds, expected = time.monotonic() - began, undisturbed.files()
            ended: Counter[str] = Counter()
            wrong: list[str] = []
            for k in range(kills):
                end = random.choice(list(ENDS) if name in ("fit", "share", "run") else [e for e in ENDS if ENDS[e]])
                after = random.uniform(0, seconds)
                found = try_one(WORK[name], Path(folder) / str(k), expected, after, end)
                wrong += [f"{name}, {end} after {after:.2f} s: {line}" for line in found]
                ended[end] += 1
                shutil.rmtree(Path(folder) / str(k))
        kinds = ", ".join(f"{count} {end}" for end, count in sorted(ended.items()))
        print(f"{name:8s} {seconds:6.1f} s undisturbed, {len(expected)} files; {kills} kills ({kinds}): "
              f"{len(wrong)} wrong", *wrong, sep="\n  ", flush=True)  # fmt: skip
        failed += len(wrong)
    return int(failed > 0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", nargs="*", choices=[[], *WORK], help="which commands; by default all")
    parser.add_argument("--kills", type=int, default=30, help="of each (default 30)")
    parser.add_argument("--seed", type=int, default=0, help="of moments and kinds of ends (default 0)")
    options = parser.parse_args()
    sys.exit(main(options.work, options.kills, options.seed))
