"""What many small fits take: by `torchbrdf fit`, side by side in processes and on Dask.

    python benchmarks/shards.py [fit] [dask] [--materials 20000] [--pairs 200]

fit: so many files of so many pairs, two cores; shares of the time that files are listed, read, fitted and written; the
parent's memory. dask: the same on four Dask workers against processes, CPU seconds beside.
What one process takes that does the same for long: endurance.py.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

COMMAND = [sys.executable, "-m", "torchbrdf", "fit"]
SETTINGS = ["--model", "ward", "--lobes", "1"]
# In a process of its own: one core does everything, a clock around each kind of work.
STAGES = """if True:
    import sys, time, json
    from pathlib import Path
    import torch
    torch.set_num_threads(1)
    from torchbrdf.fitting import Batches, blocks
    from torchbrdf.fitting.tables import write_tables
    from torchbrdf.lobes import make_model, parts
    from torchbrdf.losses import LearnedLoss
    from torchbrdf.measured import load_later
    from torchbrdf.measured import unopened

    spent = {}
    def clocked(owner, name, kind):
        inner = getattr(owner, name)
        def call(*args, **keywords):
            began = time.process_time()
            try:
                return inner(*args, **keywords)
            finally:
                spent[kind] = spent.get(kind, 0) + time.process_time() - began
        setattr(owner, name, call)

    clocked(unopened.Unopened, "opened", "reading")
    clocked(blocks, "fit", "fitting")
    clocked(parts.FitFolder, "add", "writing")
    clocked(parts.FitFolder, "register", "writing")
    clocked(parts.FitFolder, "note", "writing")
    began = time.process_time()
    groups = load_later([sys.argv[1]])
    spent["listing"] = time.process_time() - began
    batches = Batches(make_model("ward", 1), LearnedLoss(), out=Path(sys.argv[2]))
    for _ in batches.fits(groups, executor="threads", bad=[]):
        pass
    middle = time.process_time()
    batches.write_tables()
    spent["writing"] += time.process_time() - middle
    spent["all"] = time.process_time() - began
    print(json.dumps(spent))
"""


def make(folder: Path, count: int, pairs: int) -> Path:
    """So many files of materials."""
    from helpers.tiny_materials import write_tiny

    write_tiny(folder, count, pairs)
    return folder


def fit(folder: Path, out: Path, *options: str) -> dict[str, float]:
    """Seconds of a command and of its processes, and the most memory that the parent took."""
    before, began, most = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter(), 0
    command = [*COMMAND, str(folder), *SETTINGS, "--out", str(out), *options]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=os.environ | {"OMP_NUM_THREADS": "2"})
    while process.poll() is None:
        try:
            most = max(most, psutil.Process(process.pid).memory_info().rss)
        except psutil.NoSuchProcess:
            break
        time.sleep(0.2)
    if process.wait():
        raise SystemExit(f"exit status {process.returncode}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = sum(getattr(after, name) - getattr(before, name) for name in ("ru_utime", "ru_stime"))
    return {"seconds": time.perf_counter() - began, "cpu": cpu, "parent": most / 2**20}


def size(folder: Path) -> float:
    """Bytes of a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def fits(folder: Path, work: Path, count: int) -> None:
    """Shares of the time, and the parent's memory."""
    done = subprocess.run(
        [sys.executable, "-c", STAGES, str(folder), str(work / "one")], check=True, capture_output=True, text=True
    )
    spent = json.loads(done.stdout.splitlines()[-1])
    whole = spent.pop("all")
    rest = whole - sum(spent.values())
    shares = ", ".join(f"{name} {100 * value / whole:.1f} %" for name, value in (*spent.items(), ("the rest", rest)))
    print(f"{count} materials on one core: {1000 * whole / count:.2f} CPU ms each: {shares}", flush=True)
    print(f"    {size(work / 'one' / 'fits') / count:.0f} bytes of parts each", flush=True)
    found = fit(folder, work / "default")
    print("    as a command, two cores: {seconds:.1f} s, {cpu:.1f} CPU s, parent {parent:.0f} MiB".format(**found))


def dask(folder: Path, work: Path) -> None:
    """Four workers against processes."""
    from helpers.dask_cluster import dask_cluster

    here = fit(folder, work / "processes", "--executor", "processes")
    print("processes: {seconds:.1f} s, {cpu:.1f} CPU s".format(**here), flush=True)
    with dask_cluster(work, 4) as cluster:
        workers = [psutil.Process(worker.pid) for worker in cluster.workers]
        from distributed import Client

        with Client(cluster.address) as client:
            client.wait_for_workers(4)
        before = sum(sum(worker.cpu_times()[:2]) for worker in workers)
        there = fit(folder, work / "dask", "--executor", "dask", "--scheduler", cluster.address)
        there["cpu"] += sum(sum(worker.cpu_times()[:2]) for worker in workers) - before
    print("four Dask workers: {seconds:.1f} s, {cpu:.1f} CPU s, parent {parent:.0f} MiB".format(**there))
    print(f"speed {here['seconds'] / there['seconds']:.2f} of the processes', by CPU {here['cpu'] / there['cpu']:.2f}")


def main(work: list[str], materials: int, pairs: int) -> None:
    """Print a line each."""
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        if {"fit", "dask"} & set(work):
            folder = make(root / "files", materials, pairs)
        if "fit" in work:
            fits(folder, root, materials)
        if "dask" in work:
            dask(folder, root)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", nargs="*", choices=[[], "fit", "dask"], help="which; by default all")
    parser.add_argument("--materials", type=int, default=20_000)
    parser.add_argument("--pairs", type=int, default=200)
    options = parser.parse_args()
    main(options.work or ["fit", "dask"], options.materials, options.pairs)
