"""How often fits find the grain of made-up materials: random widths and rotations, scattered samples with noise.

python benchmarks/grain.py [MATERIALS]

A fit is right whose error is at most 2 % above that of the truth, which the noise gives, and whose grain lies within 2
degrees of the true one, where the widths differ by a quarter or more.
"""

import math
import sys
import time

import torch

from torchbrdf import Measured, fit
from torchbrdf.lobes import LOBES, Lambert, Sum, make_model
from torchbrdf.losses import make_loss
from torchbrdf.pairs import Pairs

NAMES = ("ggx_anisotropic", "ward_anisotropic", "ashikhmin_shirley_anisotropic")
NOISE = 0.05


def scattered(count, seed=0):
    """Pairs within 80 degrees of the normal, half of them near the mirror direction."""
    generator = torch.Generator().manual_seed(seed)

    def drawn(number):
        cos = 0.174 + (1 - 0.174) * torch.rand(number, generator=generator, dtype=torch.float64)
        phi = 2 * math.pi * torch.rand(number, generator=generator, dtype=torch.float64)
        sin = (1 - cos.square()).sqrt()
        return torch.stack([sin * phi.cos(), sin * phi.sin(), cos], -1)

    wi, wo = drawn(count), drawn(count)
    mirror = wi * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
    width = 10 ** (-2 + 2 * torch.rand(count, 1, generator=generator, dtype=torch.float64))
    near = mirror + width * torch.randn(count, 3, generator=generator, dtype=torch.float64)
    near = near / near.norm(dim=-1, keepdim=True)
    use = (torch.arange(count) % 2 == 0)[:, None] & (near[:, 2:] > 0.174)
    return Pairs.from_directions(wi, torch.where(use, near, wo))


def truths(name, materials, seed=1):
    """Models with random parameters, batched."""
    generator = torch.Generator().manual_seed(seed)

    def drawn(low, high, size=1):
        return low + (high - low) * torch.rand(materials, size, generator=generator, dtype=torch.float64)

    kind = LOBES[name]
    values = {"specular": drawn(0.1, 0.9, 3), "rotation": drawn(-math.pi / 2, math.pi / 2)}
    narrow = 10 ** drawn(-1.7, -0.6)
    wide = narrow * 10 ** drawn(0.1, 0.7)
    widths = (narrow, wide) if kind.rises_with_width else (2 / narrow.square(), 2 / wide.square())
    values |= dict(zip(kind.axes, widths, strict=True))
    if "f0" in kind.parameter_specs:
        values["f0"] = drawn(0.05, 0.9)
    return Sum(Lambert(albedo=drawn(0.02, 0.3, 3)), kind(**values))


def main(materials):
    """Print the table."""
    pairs = scattered(4000)
    for name in NAMES:
        kind, truth = LOBES[name], truths(name, materials)
        exact = truth(pairs).detach()
        noise = torch.randn(exact.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
        values = exact * (1 + NOISE * noise)
        measured = Measured.from_samples(pairs, values)
        for loss in ("cube_root", "compressed", "cosine_rms"):
            least = make_loss(loss).error(exact, values, pairs)
            for strategy in ("global", "staged"):
                began = time.process_time()
                found = fit(make_model(name, 1), measured, make_loss(loss), strategy=strategy, diffuse="fit")
                seconds = time.process_time() - began
                good = found.error <= 1.02 * least
                own = get(found.model, "rotation")
                apart = (own - get(truth, "rotation") + math.pi / 2) % math.pi - math.pi / 2
                first, second = (get(truth, axis) for axis in kind.axes)
                seen = (first / second).log().abs() > math.log(1.25) * (1 if kind.rises_with_width else 2)
                lies = (apart.abs() < math.radians(2)) | ~seen
                print(
                    f"{name:30s} {loss:11s} {strategy:7s} right {int((good & lies).sum()):3d} of {materials}, "
                    f"error {int(good.sum()):3d}, grain {int(lies.sum()):3d}; "
                    f"worst {float((found.error / least).max()):.3f}; {seconds / materials:.2f} s each",
                    flush=True,
                )


def get(model, name):
    """A parameter of the only lobe, `(M,)`."""
    return getattr(model.components()[1], name).detach()[:, 0]


if __name__ == "__main__":
    torch.set_num_threads(1)
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
