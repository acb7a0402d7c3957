"""What one step on a full table costs, beside the least that is possible: one exp a pair and one pass over the data.

python benchmarks/step.py NICKEL.binary

Beside the step as fits take it, which evaluates lobes at probes only, the same with lobes evaluated on every pair.
"""

import statistics
import sys
import time
from functools import partial

import torch
from common import MODELS, lobes_of

from torchbrdf.fitting import Gathered
from torchbrdf.fitting.objective import QuadraticObjective, make_objective
from torchbrdf.losses import CompressedLoss, CosineRMSLoss, CubeRootLoss, LearnedLoss, LogLoss, Problem, RMSLoss
from torchbrdf.measured import load

LOSSES = (RMSLoss, CosineRMSLoss, CubeRootLoss, CompressedLoss, LogLoss, LearnedLoss)


def main(path):
    """Print the table."""
    measured = load(path).within(80.0)
    pairs, target = measured.pairs, measured.values
    tan2 = pairs.tan2_h.contiguous()
    floor = seconds(lambda: (torch.exp(-tan2).sum(), target.sum()))
    print(f"{len(pairs)} pairs, one thread; floor {1e3 * floor:.2f} ms: one exp a pair, one pass over the data")
    for count in (1, 2):
        for name in MODELS:
            for loss in (kind() for kind in LOSSES):
                model, values, free = lobes_of(name, measured, count)
                if loss.is_quadratic:
                    own = Gathered(measured, [model], [loss]).find(model, loss)
                    objective, what = QuadraticObjective(own, loss), "by sums"
                else:
                    objective, what = make_objective(model, Problem(pairs, target), loss), "by factors"
                step = step_of(objective, free, values)
                plain = make_objective(model, Problem(pairs, target), loss)
                plain.factored = None
                every = step_of(plain, free, values)
                label = f"{name:18s} {count} lobes {type(loss).__name__:15s} {what:10s}"
                print(
                    f"{label}{1e3 * step:8.2f} ms{step / floor:7.2f} floors; lobes on every pair "
                    f"{1e3 * every:8.2f} ms{every / floor:7.1f} floors",
                    flush=True,
                )


def seconds(work, times=9):
    """The median CPU time of some runs, after one that warms up: a busy neighbour matters less than on the clock."""
    found = []
    for _ in range(times + 1):
        began = time.thread_time()
        work()
        found.append(time.thread_time() - began)
    return statistics.median(found[1:])


def step_of(objective, free, values):
    """Seconds for value, gradient and matrix."""
    one = torch.tensor([0])
    bound = objective.bind(free, values, one, 0.01 * objective.target_scale)
    return seconds(partial(bound.quadratic_model, free.encode(values), one))


if __name__ == "__main__":
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    torch.set_flush_denormal(True)
    main(sys.argv[1])
