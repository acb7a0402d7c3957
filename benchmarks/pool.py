"""How long fits take in threads, in processes that start anew, and in processes that are there already.

    python benchmarks/pool.py FOLDER [--before CHECKOUT] [--materials 2,10] [--rounds 3]

FOLDER holds MERL-format tables. CHECKOUT is a checkout of an earlier version, which takes turns with this one in the
same run. Seconds are the medians of some rounds; each round is a process of its own that fits one model under one loss
twice, so that the second time finds the processes of the first. Beside them are CPU seconds, and a worker's memory.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path

ROUND = """if True:
    import json, os, resource, sys, time
    import torch
    torch.set_num_threads(2)
    from pathlib import Path
    from torchbrdf import fit
    from torchbrdf.lobes import make_model
    from torchbrdf.losses import CubeRootLoss
    from torchbrdf.measured import load

    paths = sorted(Path(sys.argv[1]).glob("*.binary"))[: int(sys.argv[2])]
    measured = load([str(path) for path in paths])
    seconds, errors = [], []
    for _ in range(int(sys.argv[3])):
        began = time.perf_counter()
        result = fit(make_model("ward", 2), measured, CubeRootLoss())
        seconds.append(time.perf_counter() - began)
        errors.append(result.error.tolist())
    try:
        from torchbrdf.workers import WORKERS
        WORKERS.kill()
    except ImportError:
        pass
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    cpu = sum(use.ru_utime + use.ru_stime for use in both)
    print(json.dumps({"seconds": seconds, "errors": errors, "cpu": cpu, "memory": both[1].ru_maxrss / 1024}))
"""


def one(checkout: Path, folder: str, materials: int, rule: str, times: int) -> dict:
    """What one process found."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "TORCHBRDF_PROCESSES": rule, "GOMP_SPINCOUNT": "3000"}
    command = [sys.executable, "-c", ROUND, folder, str(materials), str(times)]
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True, cwd=checkout)
    return json.loads(done.stdout)


def main(folder: str, before: str | None, materials: list[int], rounds: int, times: int) -> None:
    """Print a table."""
    here = Path(__file__).resolve().parents[1]
    kinds = [("threads", here, "never"), ("processes", here, "always"), ("as by default", here, "")]
    kinds += [("before", Path(before), "")] if before else []
    for count in materials:
        found: dict[str, list[dict]] = {label: [] for label, _, _ in kinds}
        for _ in range(rounds):
            for label, checkout, rule in kinds:
                found[label].append(one(checkout, folder, count, rule, times))
        errors = {json.dumps(errors) for each in found.values() for run in each for errors in run["errors"]}
        equal = "equal" if len(errors) == 1 else "NOT equal"
        print(f"{count} materials, {times} times, {rounds} rounds; results are {equal}")
        for label, each in found.items():
            first, last, total, cpu, memory = (
                statistics.median(values)
                for values in zip(
                    *(
                        (run["seconds"][0], run["seconds"][-1], sum(run["seconds"]), run["cpu"], run["memory"])
                        for run in each
                    ),
                    strict=True,
                )
            )
            print(f"  {label:14s} first {first:6.2f} s, last {last:6.2f} s, all {total:6.2f} s, {cpu:6.1f} CPU s, "
                  f"a child {memory:4.0f} MB", flush=True)  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--before", help="a checkout of an earlier version")
    parser.add_argument("--materials", default="2,10", help="numbers of tables (default 2,10)")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--times", type=int, default=2, help="fits in each process (default 2)")
    options = parser.parse_args()
    main(options.folder, options.before, list(map(int, options.materials.split(","))), options.rounds, options.times)
