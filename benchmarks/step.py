"""What one step on a full table costs, beside the least that is possible: one exp a pair and one pass over the data.

python benchmarks/step.py NICKEL.binary
"""

import sys
from functools import partial

import torch
from common import MODELS, lobes_of, seconds

from torchbrdf.fitting.objective import QuadraticObjective, make_objective
from torchbrdf.fitting.sufficient_statistics import Gathered
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
                label = f"{name:18s} {count} lobes {type(loss).__name__:15s}"
                print(f"{label}{1e3 * step:8.2f} ms{step / floor:7.1f} floors")
                if loss.is_quadratic:
                    by_sums(measured, model, values, free, loss, floor, label)


def by_sums(measured, model, values, free, loss, floor, label):
    """The same step from sufficient statistics, and what their pass takes."""
    gathering = seconds(lambda: Gathered(measured, [model], [loss]).find(model, loss), times=3)
    objective, one = QuadraticObjective(Gathered(measured, [model], [loss]).find(model, loss), loss), torch.tensor([0])
    bound = objective.bind(free, values, one)
    step = seconds(partial(bound.quadratic_model, free.encode(values), one))
    print(f"{label}{1e3 * step:8.2f} ms{step / floor:7.2f} floors by sums, gathered in {1e3 * gathering:.0f} ms")


if __name__ == "__main__":
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    torch.set_flush_denormal(True)
    main(sys.argv[1])
