"""What the learned metric costs beside cosine RMS, on the same pairs: an evaluation, one with weights, a gradient; and
a fit beside the compressed loss.

python benchmarks/learned.py [MERL/]
"""

import sys

import torch
from common import seconds

from torchbrdf import fit, load
from torchbrdf.lobes import make_model
from torchbrdf.losses import CompressedLoss, CosineRMSLoss, LearnedLoss
from torchbrdf.perception import uniform_pairs


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
    return (
        seconds(lambda: loss(one, other, pairs), 61, 5),
        seconds(lambda: loss(one, other, pairs.select()), 15, 5),
        seconds(lambda: loss(one, other, pairs, weight), 61, 5),
        seconds(lambda: slope(loss, one, other, pairs), 61, 5),
    )


def main(folder=None):
    """Print the tables."""
    print("| pairs | materials | evaluation | on new pairs | with weights | gradient |\n|---|---|---|---|---|---|")
    for count, materials in ((6000, 1), (6000, 10), (6000, 100), (100_000, 1)):
        rows = [costs(kind, count, materials) for kind in (CosineRMSLoss, LearnedLoss)]
        cells = [f"{mine / theirs:.2f} ({mine * 1e3:.2f} ms)" for theirs, mine in zip(*rows, strict=True)]
        print(f"| {count:,} | {materials} | {' | '.join(cells)} |")
    if folder is None:
        return
    measured = load(folder)
    print("\n| two lobes | learned, s a fit | compressed, s a fit | ratio | converged |\n|---|---|---|---|---|")
    for name in ("ward", "cook_torrance", "ashikhmin_shirley"):
        found = [fit(make_model(name, lobes=2), measured, loss) for loss in (LearnedLoss(), CompressedLoss())]
        each = [result.seconds / len(measured) for result in found]
        good = sum(str(status) == "converged" for status in found[0].status)
        print(f"| {name} | {each[0]:.2f} | {each[1]:.2f} | {each[0] / each[1]:.1f} | {good} of {len(measured)} |")


if __name__ == "__main__":
    main(*sys.argv[1:])
