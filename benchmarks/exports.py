"""Exported materials in Mitsuba beside our pictures: how alike they are, and a figure of some.

python benchmarks/exports.py [PIXELS [SAMPLES [FIGURE]]]     (192 pixels of a side, 256 paths a pixel, no figure)

The blob with its own shadows, in the default light. Exact ones are three models that Mitsuba has, the others MERL
tables of stand-ins. Alike: PSNR after tone mapping to the mean of two pictures by Mitsuba, beside the PSNR that its
noise alone would leave, the ratio of the means, and CIELAB's Delta E 76.
"""

import sys
import tempfile
from pathlib import Path

import torch

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from helpers.measured_files import BINS, merl_centres
from helpers.mitsuba_pictures import Studio, likeness, mitsuba, obstacle

from torchbrdf.export import export
from torchbrdf.images import DIFFERENCES, ToneMap, composite, write_png
from torchbrdf.lobes import Lambert, Principled, RoughConductor, Sum
from torchbrdf.measured import load, standins, write_merl
from torchbrdf.pairs import Pairs
from torchbrdf.render import Camera, Environment, Scene, blob, render

EXACT = {
    "diffuse": Lambert(albedo=[0.8, 0.5, 0.2]),
    "copper": Sum(
        Lambert(albedo=[0.1, 0.04, 0.02]), RoughConductor(specular=[0.95, 0.64, 0.54], roughness=0.2, eta=0.2, k=3.9)
    ),
    "principled": Principled(base_color=[0.1, 0.2, 0.5], metallic=0.0, roughness=0.4, specular=0.6, clearcoat=0.8),
}
MEASURED = ("nickel", "nylon", "alum-bronze", "light-red-paint", "blue-acrylic")
SHOWN = ("copper", "principled", "nickel")


def tables(folder):
    """MERL tables of stand-ins, loaded, by name."""
    stand_in = load(standins(), dtype=torch.float64)
    centres = Pairs.from_half_diff(*(torch.from_numpy(one.reshape(1, -1)) for one in merl_centres()))
    for name in MEASURED:
        values = stand_in.batch([stand_in.names.index(name)]).at(centres)
        write_merl(folder / f"{name}.binary", values.reshape(*BINS, 3))
        yield name, load(folder / f"{name}.binary")


def main(size=192, samples=256, figure=""):
    """Print the table, and write the figure."""
    if obstacle():
        sys.exit(obstacle())
    light, view = Environment.default(), Camera(20.0)
    scene = Scene(blob(), view, light, size=size, shadows=True)
    where = scene.coverage == 1
    studio = Studio(scene.mesh, view, light, where)
    rows = []
    print(f"{'':18s}{'':12s}{'dB':>7s}{'noise':>8s}{'ratio':>8s}{'dE 76':>8s}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for material, brdf in [*EXACT.items(), *tables(folder)]:
            done = export(brdf, "mitsuba", folder / "out", name=material)
            bsdf = mitsuba().load_file(str(done.files[0]))
            ours, pair = render(brdf, scene)[0], [studio.picture(bsdf, samples, seed) for seed in (0, 1)]
            found, theirs = likeness(ours, pair, where), sum(pair) / 2
            tone = ToneMap.from_images(ours, where)
            difference = DIFFERENCES["delta_e76"]()(tone(ours)[None], tone(theirs)[None], where).item()
            kind = "exact" if done.exact else "table"
            print(
                f"{material:18s}{kind:12s}{found.psnr:7.1f}{found.noise:8.1f}{found.ratio:8.4f}{difference:8.2f}",
                flush=True,
            )
            if material in SHOWN:
                rows.append(torch.cat([composite(tone(one * where[..., None]), where) for one in (ours, theirs)], 0))
    if figure:
        write_png(figure, torch.cat(rows, 1))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]), *sys.argv[3:4])
