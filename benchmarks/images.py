"""What pictures cost as a loss, and what fits under them look like.

python benchmarks/images.py MERL/        a folder of MERL tables: the first is used for single figures, all for fits
"""

import sys
import time

import torch
from common import seconds

from torchbrdf.fitting import fit
from torchbrdf.images import DIFFERENCES, ToneMap
from torchbrdf.lobes import make_model
from torchbrdf.losses import LOSSES, CombinedLoss, CosineRMSLoss, LearnedLoss
from torchbrdf.measured import load_all
from torchbrdf.render import Camera, Environment, RenderedLoss, Scene, blob, render, small_scene, sphere
from torchbrdf.render.raster.raster import rasterize

ANALYTIC = ("rms", "cosine_rms", "cube_root", "compressed", "log", "learned")


def step(loss, problem):
    """Forward and backward through a two-lobe Ward model, as in a user's own training loop."""
    model = make_model("ward", 2)

    def work():
        model.zero_grad()
        loss(model(problem.pairs).expand_as(problem.target), problem.target, problem.pairs, problem.weight).backward()

    return seconds(work)


def steps(measured, scene):
    """A step of rendered-image loss beside one of CosineRMSLoss on all valid bins."""
    whole = measured.within(90)
    valid = (whole.weight[0, :, 0] > 0).nonzero()[:, 0]
    analytic = CosineRMSLoss()
    problem = analytic.problem(whole, valid)
    problem = type(problem)(problem.pairs, problem.target)
    unit = step(analytic, problem)
    print(f"step, CosineRMSLoss, {len(valid)} bins{'':26s}{1e3 * unit:9.1f} ms    1.00")
    for name in ("log_hdr", "psnr", "delta_e76", "delta_e_itp", "delta_e2000", "ssim", "flip"):
        loss = RenderedLoss(scene, name)
        took = step(loss, loss.problem(measured))
        print(f"step, rendered {name:12s} {scene.size} x {scene.size}, {scene.light_samples} lights"
              f"{1e3 * took:18.1f} ms {took / unit:7.2f}")  # fmt: skip


def products(scene):
    """The transport's size and products."""
    began = time.perf_counter()
    transport = scene.transport
    made = time.perf_counter() - began
    values = torch.rand(1, transport.count, 3)
    print(
        f"transport: {transport.count} pairs, {transport.entries / 1e6:.1f} M entries, "
        f"{16 * transport.entries / 2**20:.0f} MiB, made in {made:.2f} s"
    )
    print(f"a product {1e3 * seconds(lambda: transport.pixels(values)):.1f} ms, "
          f"of 8 columns {1e3 * seconds(lambda: transport.columns(values[0, :, 0].expand(8, -1))):.1f} ms")  # fmt: skip


def fits(materials, scene):
    """Two-lobe Ward fits under every loss, judged by the colour difference in scenes seen and unseen."""
    studio = Scene(sphere(), Camera(140, elevation=20), Environment.find("studio"), size=128)
    places = {"unseen": studio, "training": Scene(blob(), Camera(), Environment.default(), size=128)}
    measure, judges, best = DIFFERENCES["delta_e76"](), {}, {}
    for where, place in places.items():
        references = render(materials, place)
        tone = ToneMap.from_images(references, place.mask.expand(references.shape[:-1]))
        judges[where] = tone, tone(references)
    runs = [(name, LOSSES[name](), diffuse, "global") for name in ANALYTIC for diffuse in ("45:0", "fit")]
    runs += [(name, RenderedLoss(scene, name), "fit", "global") for name in ("log_hdr", "delta_e76", "delta_e_itp")]
    runs += [("combined", CombinedLoss(LearnedLoss(), RenderedLoss(small_scene())), "fit", "global")]
    runs += [(name, RenderedLoss(scene), "fit", name) for name in ("image_driven", "image_driven_polished")]
    for name, loss, diffuse, strategy in runs:
        began = time.perf_counter()
        result = fit(make_model("ward", 2), materials, loss, strategy=strategy, diffuse=diffuse)
        label = strategy if strategy != "global" else loss.registered_name
        line = f"{label:26s} diffuse {diffuse:5s} {time.perf_counter() - began:6.1f} s   mean Delta E"
        for where, place in places.items():
            tone, shown = judges[where]
            found = measure(tone(render(result.model, place)), shown, place.mask)
            line += f"   {where} {found.mean():6.2f}"
            if name in ANALYTIC:
                for key in ((where, diffuse), (where, "either")):
                    best[key] = torch.minimum(best.get(key, found), found)
            else:
                said = [f"{int((found <= best[where, key]).sum())} ({key})" for key in ("fit", "either")]
                line += f", no worse than the best analytic metric in {', '.join(said)} of {len(found)}"
        print(line)
    for name in ("log_hdr", "delta_e76", "delta_e_itp"):
        loss = RenderedLoss(scene, name)
        began = time.perf_counter()
        fit(make_model("ward", 2), materials.batch([0]), loss, diffuse="fit")
        print(f"one two-lobe Ward fit under rendered {name}: {time.perf_counter() - began:.2f} s")


def pictures(measured):
    """A G-buffer and a final picture."""
    mesh = blob()
    print(f"G-buffer, 400 x 400, software: {seconds(lambda: rasterize(mesh, Camera(), 400)):.3f} s")
    began = time.perf_counter()
    scene = Scene(mesh, Camera(), size=400, light_samples=2048)
    made = time.perf_counter() - began
    took = seconds(lambda: render(measured, scene), 3)
    print(f"a table, 400 x 400, 2048 lights: scene {made:.2f} s, picture {took:.2f} s")


def main(folder):
    """Print all figures."""
    (materials,) = load_all(folder)
    first = materials.batch([0])
    scene = Scene(blob(), Camera(), Environment.default(), size=128, light_samples=2048)
    products(scene)
    steps(first, scene)
    pictures(first)
    fits(materials, scene)


if __name__ == "__main__":
    main(sys.argv[1])
