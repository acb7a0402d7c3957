"""What one step on a full table costs, beside the least that is possible: one exp a pair and one pass over the data.

python benchmarks/step.py NICKEL.binary
"""

import sys
from functools import partial

import torch
from common import MODELS, lobes_of, seconds

from torchbrdf.fitting.objective import make_objective
from torchbrdf.losses import CompressedLoss, CosineRMSLoss, CubeRootLoss, LogLoss, Problem, RMSLoss
from torchbrdf.measured import load


def main(path):
    """Print the table."""
    measured = load(path).within(80.0)
    pairs, target = measured.pairs, measured.values
    tan2 = pairs.tan2_h.contiguous()
    floor = seconds(lambda: (torch.exp(-tan2).sum(), target.sum()))
    print(f"{len(pairs)} pairs, one thread; floor {1e3 * floor:.2f} ms: one exp a pair, one pass over the data")
    for count in (1, 2):
        for name in MODELS:
            for loss in (RMSLoss(), CosineRMSLoss(), CompressedLoss(), LogLoss(), CubeRootLoss()):
                model, values, free = lobes_of(name, measured, count)
                objective, one = make_objective(model, Problem(pairs, target), loss), torch.tensor([0])
                bound = objective.bind(free, values, one, 0.01 * objective.target_scale)
                step = seconds(partial(bound.quadratic_model, free.encode(values), one))
                print(
                    f"{name:18s} {count} lobes {type(loss).__name__:15s}{1e3 * step:8.2f} ms{step / floor:7.1f} floors"
                )


if __name__ == "__main__":
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    torch.set_flush_denormal(True)
    main(sys.argv[1])
