"""Fit one material and look at the fits.

Nickel, one of the bundled stand-ins, is fitted with two Ward lobes under the three metrics of the paper. Each fit is
the best there is under its metric, and yet they look different: RMS spends all it has on the highlight's peak, the
cube root minds its flanks. The upper picture shows them in the bundled light, the lower one a cut through the lobes:
light and viewer mirrored about a half vector that tilts away from the normal.
"""

import math

import matplotlib.pyplot as plt
import torch

from torchbrdf import Pairs, Scene, fit, load
from torchbrdf.images import DIFFERENCES, ToneMap
from torchbrdf.lobes import make_model
from torchbrdf.losses import CosineRMSLoss, CubeRootLoss, RMSLoss
from torchbrdf.measured import standins
from torchbrdf.render import blob, render

measured = load(standins())
nickel = measured.batch([measured.names.index("nickel")])
losses = {"RMS": RMSLoss(), "cosine RMS": CosineRMSLoss(), "cube root": CubeRootLoss()}
fits = {name: fit(make_model("ward", lobes=2), nickel, loss, samples=4000) for name, loss in losses.items()}
for name, result in fits.items():
    first, second = (lobe.roughness.item() for lobe in list(result.model.lobes)[1:])
    print(f"{name:12s} error {result.error.item():.3f}, {result.status[0]}, roughness {first:.3f} and {second:.3f}")

# One tone map, measured on the reference, so that the pictures can be compared.
scene = Scene(blob(), size=160)
pictures = render([nickel, *(result.model for result in fits.values())], scene)
shown = torch.where(scene.mask[..., None], ToneMap.from_images(pictures[:1], scene.mask)(pictures), 0.5)
delta_e = DIFFERENCES["delta_e76"]()(shown[1:], shown[:1].expand(3, -1, -1, -1), scene.mask)

figure, axes = plt.subplots(1, 4, figsize=(12, 3.4), layout="constrained")
titles = ["nickel (stand-in)", *(f"{name}: Delta E {value:.1f}" for name, value in zip(fits, delta_e, strict=True))]
for axis, picture, title in zip(axes, shown, titles, strict=True):
    axis.imshow(picture.numpy())
    axis.set_title(title, fontsize=10)
    axis.axis("off")
figure.savefig("fit-pictures.png", dpi=100)

theta_h = torch.linspace(0, math.radians(25), 200)[None]
pairs = Pairs.from_half_diff(theta_h, torch.full_like(theta_h, math.radians(10)), torch.full_like(theta_h, math.pi / 2))
degrees = theta_h[0].rad2deg().numpy()
figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
axis.semilogy(degrees, nickel.at(pairs)[0, :, 1].numpy(), "k", linewidth=3, alpha=0.4, label="nickel (stand-in)")
for name, result in fits.items():
    axis.semilogy(degrees, result.model(pairs)[0, :, 1].detach().numpy(), label=name)
axis.set(xlabel="half angle in degrees", ylabel="BRDF, green, in 1/sr")
axis.legend()
figure.savefig("fit-slices.png", dpi=100)
