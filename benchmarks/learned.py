"""What the learned metric costs beside cosine RMS, on the same pairs: an evaluation, one with weights, a gradient; and
a fit beside the compressed loss. Seconds are of the processor, on one thread, so that what else runs matters little.

python benchmarks/learned.py [MERL/]
"""

import statistics
import sys
import time

import torch

from torchbrdf import fit, load
from torchbrdf.lobes import make_model
from torchbrdf.losses import CompressedLoss, CosineRMSLoss, LearnedLoss
from torchbrdf.measured import standins
from torchbrdf.perception import uniform_pairs


def seconds(work, calls):
    """Processor seconds of a call, the median of seven rounds."""
    for _ in range(3):
        work()
    found = []
    for _ in range(7):
        began = time.process_time()
        for _ in range(calls):
            work()
        found.append((time.process_time() - began) / calls)
    return statistics.median(found)


def slope(loss, prediction, *rest):
    """The gradient by the prediction."""
    point = prediction.clone().requires_grad_()
    loss(point, *rest).sum().backward()


def costs(kind, count, materials):
    """Seconds of an evaluation, of a first one on new pairs, of one with weights, and of a gradient."""
    pairs = uniform_pairs(count).to(dtype=torch.float32)
    generator = torch.Generator().manual_seed(0)
    one, other = (torch.rand(materials, count, 3, generator=generator) + 0.01 for _ in range(2))
    loss, weight = kind(reduction="none"), torch.ones(materials, count, 1)
    calls = max(5, 600_000 // (count * materials))
    return (
        seconds(lambda: loss(one, other, pairs), calls),
        seconds(lambda: loss(one, other, pairs.select()), calls // 5 + 1),
        seconds(lambda: loss(one, other, pairs, weight), calls),
        seconds(lambda: slope(loss, one, other, pairs), calls),
    )


def fits(name, measured):
    """Processor seconds of a fit under either loss, in turns, and how many of the first converged."""
    found = {}
    for _ in range(2):
        for loss in (LearnedLoss(), CompressedLoss()):
            began = time.process_time()
            results = [fit(make_model(name, lobes=2), measured.batch([k]), loss) for k in range(len(measured))]
            taken = (time.process_time() - began) / len(measured)
            found.setdefault(type(loss), []).append(taken)
            if isinstance(loss, LearnedLoss):
                good = sum(str(result.status[0]) == "converged" for result in results)
    return *(min(found[kind]) for kind in (LearnedLoss, CompressedLoss)), good


def main(folder=None):
    """Print the tables."""
    torch.set_num_threads(1)
    print("| pairs | materials | evaluation | on new pairs | with weights | gradient |\n|---|---|---|---|---|---|")
    for count, materials in ((6000, 1), (6000, 10), (6000, 100), (100_000, 1)):
        rows = [costs(kind, count, materials) for kind in (CosineRMSLoss, LearnedLoss)]
        cells = [f"{mine / theirs:.2f} ({mine * 1e3:.2f} ms)" for theirs, mine in zip(*rows, strict=True)]
        print(f"| {count:,} | {materials} | {' | '.join(cells)} |", flush=True)
    measured = load(standins() if folder is None else folder)
    measured = measured.batch([k for k in range(len(measured)) if len(measured) <= 10 or k % 10 == 0])
    print("\n| two lobes | learned, s a fit | compressed, s a fit | ratio | converged |\n|---|---|---|---|---|")
    for name in ("ward", "cook_torrance"):
        mine, theirs, good = fits(name, measured)
        print(f"| {name} | {mine:.2f} | {theirs:.2f} | {mine / theirs:.1f} | {good} of {len(measured)} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
