"""A loss in a training loop.

A small network sees 64 values of an unknown material and predicts the albedo and roughness of a Ward lobe. It never
sees the true parameters: the loss compares BRDF values on pairs of directions, so that every measured material could
serve as training data. The left picture shows the loss, the right one how well the roughness of materials that the
network never saw is recovered.
"""

import matplotlib.pyplot as plt
import torch
from torch import nn

from torchbrdf import Pairs
from torchbrdf.lobes import Ward, ward
from torchbrdf.losses import CompressedLoss

generator = torch.Generator().manual_seed(0)
torch.manual_seed(0)


def directions(count: int) -> torch.Tensor:
    """Unit vectors above the horizon, uniform in solid angle, `(1, count, 3)`."""
    z, phi = torch.rand(2, 1, count, generator=generator)
    radius = (1 - z.square()).sqrt()
    return torch.stack([radius * (6.2832 * phi).cos(), radius * (6.2832 * phi).sin(), z], -1)


def mirrored(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Pairs of directions around the mirror direction, where lobes are."""
    wi = directions(count)
    mirror = wi * torch.tensor([-1.0, -1.0, 1.0])
    wo = mirror + 0.15 * torch.randn(wi.shape, generator=generator)
    return wi, nn.functional.normalize(wo, dim=-1)


def materials(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Albedos `(count, 3)` and roughnesses `(count, 1)`, on a logarithmic scale."""
    albedo = 0.05 + 0.9 * torch.rand(count, 3, generator=generator)
    return albedo, 10 ** (-1.5 + 1.2 * torch.rand(count, 1, generator=generator))


pairs = Pairs.from_directions(*mirrored(64))
network = nn.Sequential(nn.Linear(64 * 3, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, 4))
limits = Ward.roughness
loss = CompressedLoss()
optimizer = torch.optim.Adam(network.parameters(), 2e-3)


def predict(values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Albedo and roughness, inside Ward's bounds, from values `(M, 64, 3)`."""
    raw = network(values.clamp_min(0).pow(1 / 3).flatten(1))
    low, high = torch.tensor([limits.lower, limits.upper]).log()
    return raw[:, :3].sigmoid(), (low + (high - low) * raw[:, 3:].sigmoid()).exp()


history = []
for _ in range(600):
    target = ward(pairs, *materials(64))
    value = loss(ward(pairs, *predict(target)), target, pairs)
    optimizer.zero_grad()
    value.backward()
    optimizer.step()
    history.append(value.item())
print(f"compressed error: {history[0]:.3f} at first, {sum(history[-20:]) / 20:.3f} at last")

albedo, roughness = materials(200)
with torch.no_grad():
    _, found = predict(ward(pairs, albedo, roughness))
print(f"roughness of 200 new materials: median error {((found / roughness).log().abs().median().exp() - 1):.1%}")

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
left.semilogy(history)
left.set(xlabel="step", ylabel="compressed error")
right.loglog(roughness.numpy(), found.numpy(), ".")
right.loglog([0.03, 0.5], [0.03, 0.5], "k", linewidth=0.5)
ticks = [0.03, 0.1, 0.3]
right.set(xlabel="true roughness", ylabel="predicted roughness")
right.set_xticks(ticks, ticks)
right.set_yticks(ticks, ticks)
right.minorticks_off()
figure.savefig("training-loop.png", dpi=100)
