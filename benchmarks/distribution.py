"""Distribution-based models by the solver for tables: errors, seconds a fit, Delta E in scenes that no fit saw.

python benchmarks/distribution.py --tables MERL/ [--rgl RGL/] [--losses compressed,log,learned,rendered] [--lobes 1,2]
    [--resampled] [--before]

Without --tables the bundled stand-ins are fitted. --rgl judges that folder's files in the place of tables; --resampled
fits what these say at MERL's bins, and not at their own samples. --before fits one lobe under the first loss by
autograd and L-BFGS as well, and prints how many times as long that takes.
"""

import argparse
import time
from pathlib import Path

import torch
from looks import Judge, loss_of, scenes

from torchbrdf import fit, load
from torchbrdf.fitting import TabulatedFit, stratified
from torchbrdf.lobes import make_model
from torchbrdf.measured import PAPER_TEN, Measured, standins
from torchbrdf.measured.merl import bin_centers


def resampled(measured, samples):
    """What measurements say at some of MERL's bins."""
    pairs = bin_centers().to(dtype=torch.float32)
    low = torch.minimum(pairs.cos_i, pairs.cos_o)[0] > torch.cos(torch.deg2rad(torch.tensor(80.0)))
    pairs = pairs.select(samples=low.nonzero()[:, 0])
    pairs = pairs.select(samples=stratified(len(pairs), samples, 0))
    return Measured.from_samples(pairs, measured.at(pairs), names=measured.names)


def row(label, measured, judges, loss, lobes, strategy, samples):
    """Fit, judge, print; seconds a fit."""
    began = time.perf_counter()
    result = fit(
        make_model("distribution_based", lobes), measured, loss_of(loss), strategy=strategy, samples=samples,
        diffuse="fit",
    )  # fmt: skip
    seconds = (time.perf_counter() - began) / len(measured)
    records = result.records()
    each = torch.stack([judge(records)[1] for judge in judges.values()])
    mean, worst = each.mean(0), each.mean(0).argmax()
    converged = sum(status == "converged" for status in result.status)
    cells = [
        label, str(lobes), loss, f"{result.error.mean():.4g}", f"{seconds:.2f}", f"{converged}/{len(measured)}",
        *(f"{x:.2f}" for x in each.mean(1)), f"{each.mean():.2f}", f"{measured.names[worst]} {mean[worst]:.1f}",
    ]  # fmt: skip
    print(f"| {' | '.join(cells)} |", flush=True)
    return seconds


def main(arguments=None):
    """Fit, draw, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", type=Path)
    parser.add_argument("--rgl", type=Path)
    parser.add_argument("--resampled", action="store_true")
    parser.add_argument("--losses", default="compressed")
    parser.add_argument("--lobes", default="1,2")
    parser.add_argument("--strategies", default="global,tabulated_monotone,tabulated_smooth")
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--polish", type=int, help="steps under losses of pictures")
    parser.add_argument("--before", action="store_true")
    options = parser.parse_args(arguments)
    if options.rgl:
        measured = load(sorted(options.rgl.glob("*.bsdf")))
    elif options.tables:
        measured = load([options.tables / f"{name}.binary" for name in PAPER_TEN])
    else:
        measured = load(standins())
    judges = {place: Judge(scene, measured) for place, scene in scenes(options.size).items()}
    seen = resampled(measured, options.samples) if options.resampled else measured
    heads = "strategy | lobes | fits under | mean error | seconds a fit | converged"
    print(f"| {heads} | {' | '.join(judges)} | mean | worst |\n|" + "---|" * (8 + len(judges)))
    losses, counts = options.losses.split(","), [int(x) for x in options.lobes.split(",")]
    took = {}
    for strategy in options.strategies.split(","):
        used = TabulatedFit(polish=options.polish) if options.polish is not None and strategy == "global" else strategy
        for loss in losses:
            for lobes in counts:
                took[strategy, loss, lobes] = row(strategy, seen, judges, loss, lobes, used, options.samples)
    if options.before:
        slow = row("by autograd", seen, judges, losses[0], 1, "staged", options.samples)
        print(f"by autograd and L-BFGS it takes {slow / took['global', losses[0], 1]:.1f} times as long")


if __name__ == "__main__":
    main()
