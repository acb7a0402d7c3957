"""Fits under losses of squares of a whole database, read and scored: seconds and errors, to compare versions.

    python benchmarks/squares.py FOLDER

Three models with two lobes under RMS and cosine RMS, cross-scored. Runs in an earlier version, too: install that in an
environment of its own, and start the two in turns.
"""

import argparse
import resource

from common import MODELS, Timer

from torchbrdf.fitting import cross_score, fit, local_minima
from torchbrdf.lobes import make_model
from torchbrdf.losses import LOSSES
from torchbrdf.measured import load

try:
    from torchbrdf.fitting import Gathered
except ImportError:  # a version without
    Gathered = None


def main(folder):
    """Print the table."""
    losses = [LOSSES["rms"](), LOSSES["cosine_rms"]()]
    models = [make_model(name, 2) for name in MODELS]
    with Timer() as total:
        measured = load(folder)
        every = measured.within(80.0)
        shared = () if Gathered is None else (Gathered(every, models, losses),)
        for name, model in zip(MODELS, models, strict=True):
            with Timer() as timer:
                fits = [fit(model, measured, loss, **({"gathered": shared[0]} if shared else {})) for loss in losses]
                cross = cross_score([one.model for one in fits], every, losses, *shared)
            outliers = int(local_minima(cross, 1e-4).sum())
            sums = [f"{one.error.sum().item():.6f}" for one in fits]
            print(f"{name:18s}{timer.clock:7.1f} s, {outliers} outliers, sums of errors {sums}", flush=True)
    peaks = [resource.getrusage(who).ru_maxrss / 2**20 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    fits = 6 * len(measured)
    print(
        f"{fits} fits: {total.clock:.1f} s, {total.clock / fits:.4f} s each; peak {peaks[0]:.2f} and {peaks[1]:.2f} GiB"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("folder")
    main(parser.parse_args().folder)
