"""Materials that a model makes itself, so that a fit of it is known."""

import math

import torch

from torchbrdf.measured import Lookup, Measured, Samples
from torchbrdf.pairs import Pairs


def some_pairs(count=3000, seed=0):
    generator = torch.Generator().manual_seed(seed)
    uniform = torch.rand(3, 1, count, generator=generator, dtype=torch.float64)
    pairs = Pairs.from_half_diff(uniform[0] ** 2 * 1.3, uniform[1] * 1.3, uniform[2] * math.pi)
    return pairs.select(samples=pairs.above[0].nonzero()[:, 0])


class Made(Samples):
    """Samples of a batched model, which also knows its values elsewhere."""

    def __init__(self, model, pairs):
        self.model = model
        super().__init__(pairs, model(pairs).detach(), None, None)

    def at(self, pairs, materials, interpolation):
        values = self.model(pairs).detach()[materials]
        return Lookup(values, torch.zeros(len(materials), dtype=torch.int64))


def measured_from(model, pairs=None, materials=1):
    """Materials that the model itself makes, whose 45:0 reading is the model's."""
    made = Made(model.batched(materials), pairs or some_pairs())
    return Measured(made, dtype=made.values.dtype)


def assert_within_bounds(model):
    """Every parameter of a model, but for rounding."""
    for part in model.parts():
        for name, bounded in part.declared.items():
            value = getattr(part, name)
            assert ((value >= bounded.lower - 1e-12) & (value <= bounded.upper * (1 + 1e-9))).all(), name
