"""Our pictures beside Mitsuba's: how alike they are, and what both take, for each of four materials.

python benchmarks/against_mitsuba.py [PIXELS [SAMPLES]]     (256 pixels of a side, 576 paths a pixel: a square number)

Alike: PSNR after tone mapping over the pixels that the object fills, to the mean of two pictures by Mitsuba, beside the
PSNR that its noise alone would leave; and the ratio of the means. Mitsuba's seconds are those of one picture, without
compiling.
"""

import sys
import tempfile
import time
from pathlib import Path

import torch

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from helpers.measured_files import BINS, merl_centres
from helpers.mitsuba_pictures import Beckmann, Studio, conductor, diffuse, likeness, obstacle, table

from torchbrdf.lobes import CookTorrance, Lambert, Sum
from torchbrdf.measured import load
from torchbrdf.measured.merl import write_merl
from torchbrdf.pairs import Pairs
from torchbrdf.render import Camera, Environment, Scene, blob, render, sphere


def write_plastic(path):
    """A MERL table."""
    plastic = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), CookTorrance(specular=0.3, roughness=0.15, f0=0.3)).double()
    with torch.no_grad():
        values = plastic(Pairs.from_half_diff(*(torch.from_numpy(one.reshape(1, -1)) for one in merl_centres())))
    write_merl(path, values.reshape(*BINS, 3))


def timed(work, *given, **named):
    """What it gives, and seconds."""
    began = time.perf_counter()
    return work(*given, **named), time.perf_counter() - began


def main(size=256, samples=576):
    """Print the table."""
    if obstacle():
        sys.exit(obstacle())
    environment, view = Environment.default(), Camera(20.0)
    print(f"{'':24s}{'dB':>8s}{'noise':>8s}{'ratio':>8s}{'ours':>10s}{'Mitsuba':>10s}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plastic.binary"
        write_plastic(path)
        materials = {
            "diffuse": (diffuse(0.5), Lambert(albedo=0.5)),
            "conductor, alpha 0.3": (conductor(0.3), Beckmann(0.3)),
            "conductor, alpha 0.1": (conductor(0.1), Beckmann(0.1)),
            "MERL table": (table(path, 0.15), load(path)),
        }
        for shape, mesh, shadows in (("sphere", sphere(6), False), ("blob with shadows", blob(), True)):
            scene, seconds = timed(Scene, mesh, view, environment, size=size, shadows=shadows)
            print(f"{shape}, {size} x {size}{'':32s}{seconds:8.2f} s")
            where = scene.coverage == 1
            studio = Studio(mesh, view, environment, where)
            for name, (bsdf, brdf) in materials.items():
                studio.picture(bsdf, 16)
                first, theirs = timed(studio.picture, bsdf, samples, 0)
                found, ours = timed(render, brdf, scene)
                like = likeness(found[0], (first, studio.picture(bsdf, samples, 1)), where)
                numbers = f"{like.psnr:8.1f}{like.noise:8.1f}{like.ratio:8.4f}"
                print(f"  {name:22s}{numbers}{ours:8.2f} s{theirs:8.2f} s", flush=True)


if __name__ == "__main__":
    main(*(int(number) for number in sys.argv[1:]))
