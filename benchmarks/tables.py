"""Any BRDF as a table, there and back: how far pictures and values are off.

    python benchmarks/tables.py FILE_OR_FOLDER ... [--size 96] [--mitsuba SAMPLES]

For each measured material: the seconds of its RGL table; its relative error at random pairs up to 75 degrees from the
normal, half of them near the mirror direction (the median, and the mean error over the mean value, both of f cos); the
Delta E 76 and the dB of our pictures (blob, default scene) beside the original's, of its RGL table, of its MERL table,
and of the table that is back in its own format: MERL to RGL to MERL, RGL to MERL to RGL. With --mitsuba (a square
number of paths a pixel) the dB of Mitsuba's picture of a sphere with the RGL table to ours of the original, and the
ratio of the means.
"""

import argparse
import math
import sys
import tempfile
import time
from pathlib import Path

import torch

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from helpers.directions import hemisphere
from helpers.mitsuba_pictures import Studio, likeness, obstacle

from torchbrdf.export import picture_differences
from torchbrdf.measured import load, load_all, merl_values, write_merl, write_rgl
from torchbrdf.pairs import Pairs
from torchbrdf.render import Camera, Environment, Scene, blob, render, sphere

MEASURES = ("delta_e76", "psnr")


def random_pairs(count=20_000):
    """Pairs up to 75 degrees, every other one near the mirror direction."""
    wi, wo = hemisphere(2 * count, seed=1), hemisphere(2 * count, seed=2)
    near = torch.arange(2 * count) % 2 == 0
    wo[near] = wi[near] * torch.tensor([-1.0, -1, 1]) + 0.1 * wo[near]
    wo = wo / wo.norm(dim=-1, keepdim=True)
    low = torch.minimum(wi[:, 2], wo[:, 2]) > math.cos(math.radians(75))
    return Pairs.from_directions(wi[None, low][:, :count], wo[None, low][:, :count])


def as_rgl(brdf, path):
    """Its RGL table."""
    write_rgl(path, brdf)
    return load(path)


def as_merl(brdf, path):
    """Its MERL table."""
    write_merl(path, merl_values(brdf).clamp_(0))
    return load(path)


def errors(brdf, table, pairs):
    """The median relative error, and the mean error over the mean value, of f cos."""
    expected, found = (one.at(pairs)[0] * pairs.cos_o[0, :, None] for one in (brdf, table))
    off = (found - expected).abs().mean(-1)
    size = expected.abs().mean(-1)
    return (off / size.clamp_min(1e-12)).median().item(), (off.mean() / size.mean()).item()


class Drawn:
    """Mitsuba beside us: a sphere in the default environment, without shadows."""

    def __init__(self, samples):
        self.samples, light, camera = samples, Environment.default(), Camera(20.0)
        self.scene = Scene(sphere(6), camera, light, size=64)
        self.studio = Studio(self.scene.mesh, camera, light, self.scene.coverage == 1)

    def compare(self, brdf, path):
        """How alike the pictures are."""
        bsdf = {"type": "measured", "filename": str(path)}
        theirs = [self.studio.picture(bsdf, self.samples, seed) for seed in (0, 1)]
        return likeness(render(brdf, self.scene)[0], theirs, self.studio.where)


def main(files, size, samples):
    """Print the table."""
    scene, pairs = Scene(blob(), size=size), random_pairs()
    drawn = Drawn(samples) if samples and not obstacle() else None
    heads = ("RGL s", "median", "mean", "E", "dB", "MERL E", "dB", "back E", "dB", "Mitsuba", "ratio")
    print(f"{'':24s}" + "".join(f"{one:>9s}" for one in heads))
    with tempfile.TemporaryDirectory() as folder:
        rgl, merl, back = (Path(folder) / name for name in ("a.bsdf", "a.binary", "b.bin"))
        for measured in load_all(files):
            for k, name in enumerate(measured.names):
                brdf = measured.batch([k])
                began = time.perf_counter()
                tables = [as_rgl(brdf, rgl)]
                row = [time.perf_counter() - began, *errors(brdf, tables[0], pairs)]
                tables.append(as_merl(brdf, merl))
                tables.append(as_merl(tables[0], back) if measured.on_merl_bins else as_rgl(tables[1], back))
                for table in tables:
                    found = picture_differences(brdf, table, scene, MEASURES)
                    row += [found[name] for name in MEASURES]
                if drawn is not None:
                    alike = drawn.compare(brdf, rgl)
                    row += [alike.psnr, alike.ratio]
                print(f"{name:24.24s}" + "".join(f"{one:9.4g}" for one in row), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("files", nargs="+")
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--mitsuba", type=int, default=0)
    options = parser.parse_args()
    main(options.files, options.size, options.mitsuba)
