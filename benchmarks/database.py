"""A whole database: every material, three models, three metrics, two lobes, scored on every bin.

    python benchmarks/database.py FOLDER [--strategy staged]

Prints seconds, statuses, outliers by the paper's test, peak memory, and, for materials in reference.json, how many
errors are above 1.002 times the best that is known.
"""

import argparse
import json
import resource
from collections import Counter
from pathlib import Path

import torch
from common import MODELS, Timer, losses

from torchbrdf.fitting import Gathered, cross_score, fit, local_minima
from torchbrdf.lobes import make_model
from torchbrdf.measured import load

REFERENCE = Path(__file__).parent / "reference.json"


def main(folder, strategy):
    """Print the table."""
    known = json.loads(REFERENCE.read_text())["errors"] if REFERENCE.exists() else {}
    measured = load(folder)
    metrics = losses()
    every = measured.within(80.0)
    gathered = Gathered(every, [make_model(name, 2) for name in MODELS], list(metrics.values()))
    outliers, above, compared, worst = 0, [], 0, 0.0
    with Timer() as total:
        for name in MODELS:
            results = {}
            for metric, loss in metrics.items():
                with Timer() as timer:
                    results[metric] = fit(make_model(name, 2), measured, loss, strategy=strategy, gathered=gathered)
                status = dict(Counter(map(str, results[metric].status)))
                print(f"{name:18s} {metric:9s} {timer.clock:6.1f} s, {timer.cpu:6.1f} CPU s  {status}", flush=True)
            cross = cross_score([result.model for result in results.values()], every, list(metrics.values()), gathered)
            outliers += int(local_minima(cross, 1e-4).sum())
            for metric, result in results.items():
                for material, error in zip(result.names, result.error.tolist(), strict=True):
                    best = known.get(f"{material}/{name}/{metric}")
                    if best is not None:
                        compared += 1
                        ratio = error / min(best.values())
                        worst = max(worst, ratio)
                        above += [(material, name, metric, round(ratio, 4))] if ratio > 1.002 else []
    fits = 9 * len(measured)
    print(f"{fits} fits and their scores: {total.clock:.1f} s, {total.cpu:.1f} CPU s, {outliers} outliers")
    if compared:
        print(f"above 1.002 times the best known: {len(above)} of {compared}; largest ratio {worst:.5f} {above[:9]}")
    peaks = [resource.getrusage(who).ru_maxrss / 2**20 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    print(f"peak memory: {peaks[0]:.2f} GiB, and {peaks[1]:.2f} GiB in each of {torch.get_num_threads()} workers")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("folder")
    parser.add_argument("--strategy", default="global")
    options = parser.parse_args()
    main(options.folder, options.strategy)
