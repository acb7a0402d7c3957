"""Materials with known parameters and 1 % noise: how often a fit is as good as the truth.

    python benchmarks/synthetic.py [--materials 1000]

A third of them for each model: Lambert and two lobes with random parameters, on 4,000 pairs, every value off by a
factor of normal noise with a standard deviation of 1 %; `diffuse="fit"`. A fit is good when its error is at most 1.01
times that of the true parameters. Of those that are not it counts how many say so in their status.
"""

import argparse

import torch
from common import MODELS, Timer, losses

from torchbrdf.fitting import Status, fit, score, stratified
from torchbrdf.lobes import make_model
from torchbrdf.measured import Measured
from torchbrdf.measured.merl import bin_centers

PAIRS, NOISE = 4_000, 0.01


def truth(name, materials, generator):
    """Batched models with random parameters: shapes uniform on the solver's scale, albedos that add up to below 1."""
    model = make_model(name, 2).batched(materials)
    for k, part in enumerate(model.components()):
        for key, spec in part.parameter_specs.items():
            low, high = torch.tensor([spec.lower, spec.upper]).double()
            u = torch.rand(materials, spec.size, generator=generator, dtype=torch.float64)
            if spec.linear:
                value = u * (0.5 if k == 0 else 0.3) + 0.02
            elif spec.log:
                value = ((low.log() * 0.7 + high.log() * 0.3) * (1 - u) + high.log() * u).exp()
            else:
                value = low + (high - low) * u
            getattr(part, key).data = value.float()
    return model


def main(materials):
    """Print the table."""
    every = bin_centers().to(dtype=torch.float32)
    low = (every.cos_i >= 0.1736) & (every.cos_o >= 0.1736)
    inside = low[0].nonzero()[:, 0]
    pairs = every.select(samples=inside[stratified(len(inside), PAIRS, 0)])
    materials = -(-materials // len(MODELS))
    for name in MODELS:
        for metric, loss in losses().items():
            generator = torch.Generator().manual_seed(0)
            model = truth(name, materials, generator)
            with torch.no_grad():
                values = model(pairs)
            noise = 1 + NOISE * torch.randn(values.shape, generator=generator)
            measured = Measured.from_samples(pairs, values * noise)
            at_truth = score(model, measured, [loss])[0]
            start = make_model(name, 2)
            with Timer() as timer:
                result = fit(start, measured, loss, diffuse="fit", samples=None)
            bad = (result.error > 1.01 * at_truth).nonzero()[:, 0].tolist()
            said = sum(result.status[k] != Status.CONVERGED for k in bad)
            ratio = (result.error / at_truth).max().item()
            print(
                f"{name:18s} {metric:9s} good {100 * (1 - len(bad) / materials):6.2f} %; of {len(bad)} others {said}"
                f" say so; largest {ratio:.3f}; {timer.clock:.1f} s",
                flush=True,
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--materials", type=int, default=1000)
    main(parser.parse_args().materials)
