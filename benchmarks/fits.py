"""Staged fits beside what a user would write: scipy's L-BFGS-B in a loop, on the same pairs and starts.

    python benchmarks/fits.py [FILES...]        the bundled stand-ins by default

Both fit Lambert (held at 45:0) plus one lobe with a scalar albedo, from Table 1's start, to the same stratified subset
under the same loss; scipy gets exact gradients from torch, one material after the other.
"""

import sys
import time

import numpy as np
import torch
from scipy.optimize import minimize

from torchbrdf.fitting import fit, stratified
from torchbrdf.lobes import make_model
from torchbrdf.losses import CosineRMSLoss, CubeRootLoss, RMSLoss
from torchbrdf.measured import load, standins

SAMPLES = 20_000


def scipy_error(measured, name, loss):
    """The errors of one-lobe fits with a scalar albedo, a material at a time."""
    low = measured.within(80.0)
    subset = low.batch(samples=stratified(len(low.pairs), SAMPLES, 0))
    errors = []
    for k in range(len(measured)):
        part = subset.batch([k])
        model = make_model(name, 1).batched(1)
        diffuse, lobe = model.parts()
        diffuse.albedo.data = measured.batch([k]).diffuse_45_0()
        shape = [bounded for key, bounded in lobe.declared.items() if key != "specular"]
        bounds = [(0.0, 1.0)] + [tuple(np.log([b.lower, b.upper])) if b.log else (b.lower, b.upper) for b in shape]
        start = [0.5] + [np.log(b.start) if b.log else b.start for b in shape]

        def objective(x, part=part, diffuse=diffuse, lobe=lobe, shape=shape):
            point = torch.tensor(x, requires_grad=True)
            values = [(v.exp() if b.log else v).float().reshape(1, 1) for b, v in zip(shape, point[1:], strict=True)]
            albedo = point[:1].float().expand(1, 3)
            prediction = diffuse(part.pairs).detach() + type(lobe).function(part.pairs, albedo, *values)
            error = loss.error(prediction, part.values, part.pairs).square().sum()
            (gradient,) = torch.autograd.grad(error, point)
            return error.item(), gradient.numpy()

        errors.append(minimize(objective, start, jac=True, bounds=bounds, method="L-BFGS-B").fun ** 0.5)
    return np.array(errors)


def main(files):
    """Print the table."""
    measured = load(files or standins())
    print(f"{len(measured)} materials, {SAMPLES} pairs, {torch.get_num_threads()} threads")
    print(f"{'model':20s}{'loss':10s}{'scipy s':>9s}{'torchbrdf s':>13s}{'ratio':>7s}  error, torchbrdf / scipy")
    for name in ("ward", "cook_torrance", "ashikhmin_shirley"):
        for label, loss in (("rms", RMSLoss()), ("cosine", CosineRMSLoss()), ("cuberoot", CubeRootLoss())):
            began = time.perf_counter()
            theirs = scipy_error(measured, name, loss)
            theirs_s = time.perf_counter() - began
            result = fit(make_model(name, 1), measured, loss, samples=SAMPLES)
            ours_s = result.seconds
            ours = np.array(result.history[0].error)
            ratio = ours / theirs
            print(
                f"{name:20s}{label:10s}{theirs_s:9.1f}{ours_s:13.1f}{theirs_s / ours_s:7.2f}"
                f"  median {np.median(ratio):.4f}, from {ratio.min():.3f} to {ratio.max():.3f}"
            )


if __name__ == "__main__":
    main(sys.argv[1:])
