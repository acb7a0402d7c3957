"""Which metric gives the fits that look closest?

Four stand-ins are fitted with one Cook-Torrance lobe under four metrics, the diffuse albedo held at its 45:0 reading
under all of them, and every fit is drawn and compared with its reference in CIELAB. The table has the mean Delta E of
the pictures: read it by rows. `torchbrdf run image_vs_analytic` does the same with more models, more materials and a
second scene, and `torchbrdf run fores2012` asks observers.
"""

import matplotlib.pyplot as plt
import torch

from torchbrdf import Scene, fit, load
from torchbrdf.images import DIFFERENCES, ToneMap
from torchbrdf.lobes import make_model
from torchbrdf.losses import CompressedLoss, CosineRMSLoss, CubeRootLoss, RMSLoss
from torchbrdf.measured import standins
from torchbrdf.render import render, sphere

NAMES = ("aluminium", "blue-acrylic", "gold-metallic-paint2", "nickel")
LOSSES = (RMSLoss(), CosineRMSLoss(), CubeRootLoss(), CompressedLoss())

everything = load(standins())
measured = everything.batch([everything.names.index(name) for name in NAMES])
model = make_model("cook_torrance", lobes=1)
fits = [fit(model, measured, loss, diffuse="45:0", samples=3000) for loss in LOSSES]

scene = Scene(sphere(), size=112)
pictures = render([measured, *(result.model for result in fits)], scene).unflatten(0, (-1, len(NAMES)))
# A tone map for each material, measured on its reference.
shown = torch.stack([ToneMap.from_images(column[:1], scene.mask)(column) for column in pictures.unbind(1)], 1)
shown = torch.where(scene.mask[..., None], shown, 0.5)
difference = DIFFERENCES["delta_e76"]()
delta_e = torch.stack([difference(row, shown[0], scene.mask) for row in shown[1:]], 1)

labels = [type(loss).__name__.removesuffix("Loss") for loss in LOSSES]
print(f"{'Delta E':22s}" + "".join(f"{label:>12s}" for label in labels))
for name, row in zip(NAMES, delta_e.tolist(), strict=True):
    print(f"{name:22s}" + "".join(f"{value:12.1f}" for value in row))
print(f"{'mean':22s}" + "".join(f"{value:12.1f}" for value in delta_e.mean(0).tolist()))

figure, axes = plt.subplots(len(NAMES), len(LOSSES) + 1, figsize=(10, 8.5), layout="constrained")
for column, label in enumerate(["reference", *labels]):
    axes[0, column].set_title(label)
    for row in range(len(NAMES)):
        axes[row, column].imshow(shown[column, row].numpy())
        axes[row, column].set(xticks=[], yticks=[])
        if column:
            axes[row, column].set_xlabel(f"{delta_e[row, column - 1]:.1f}", fontsize=9)
for row, name in enumerate(NAMES):
    axes[row, 0].set_ylabel(name, fontsize=9)
figure.savefig("metrics.png", dpi=90)
