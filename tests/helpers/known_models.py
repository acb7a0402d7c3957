"""Materials that a model makes itself, so that a fit of it is known."""

import math

import torch

from torchbrdf.fitting.initialization import from_unit
from torchbrdf.lobes import LOBES, make_model
from torchbrdf.measured import Lookup, Measured, Samples
from torchbrdf.pairs import Pairs

# Every registered lobe whose value is a colour times a scalar function.
COLORED = [name for name, lobe in LOBES.items() if lobe.albedo_spec() is not None and not lobe.is_diffuse]
ISOTROPIC = [name for name in COLORED if not LOBES[name].is_anisotropic]
# Shapes of a sharp and a broad lobe; of other lobes a place within their bounds.
SHAPES = {
    "ward": ("roughness", 0.03, 0.3),
    "cook_torrance": ("roughness", 0.05, 0.4),
    "ashikhmin_shirley": ("exponent", 800.0, 12.0),
}
PLACES = (0.4, 0.7)


def two_lobes(name, materials=1):
    """A sharp and a broad lobe of different colours, somewhat different in each material."""
    model = make_model(name, 2, torch.float64).batched(materials)
    step = torch.linspace(1, 1.3, materials, dtype=torch.float64)[:, None]
    model.components()[0].albedo.data[:] = torch.tensor([0.2, 0.15, 0.1])
    for k, (part, color) in enumerate(zip(model.components()[1:], ([0.3, 0.25, 0.2], [0.2, 0.3, 0.4]), strict=True)):
        for spec in part.scalars():
            shape = from_unit(spec, torch.tensor(PLACES[k], dtype=torch.float64))
            if name in SHAPES and spec.name == SHAPES[name][0]:
                shape = SHAPES[name][1 + k]
            getattr(part, spec.name).data = torch.full_like(step, 0.3) if spec.affine else shape * step
        albedo = part.albedo_spec()
        getattr(part, albedo.name).data[:] = 2 * albedo.start * torch.tensor(color, dtype=torch.float64)
    return model


def some_pairs(count=3000, seed=0):
    generator = torch.Generator().manual_seed(seed)
    uniform = torch.rand(3, 1, count, generator=generator, dtype=torch.float64)
    phi_h = 2 * math.pi * torch.rand(1, count, generator=generator, dtype=torch.float64)
    pairs = Pairs.from_half_diff(uniform[0] ** 2 * 1.3, uniform[1] * 1.3, uniform[2] * math.pi, phi_h)
    return pairs.select(samples=pairs.above_horizon[0].nonzero()[:, 0])


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
    for part in model.components():
        for name, spec in part.parameter_specs.items():
            value = getattr(part, name)
            assert ((value >= spec.lower - 1e-12) & (value <= spec.upper * (1 + 1e-9))).all(), name
