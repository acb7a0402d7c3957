"""What fits look like: tables x models x losses x diffuse treatments, judged by pictures of scenes that no fit saw.

python benchmarks/looks.py [--tables MERL/ --materials nickel,brass,...] [--models ward,cook_torrance] [--out looks/]

Without --tables the bundled stand-ins are fitted. Fits are kept in --out and not made again (delete a loss's folders
there when its code has changed); pictures are drawn anew. Prints tables; writes sheet-MODEL-SCENE.png, a figure of a
few materials for each model (every loss with its default diffuse treatment), and looks.json.
"""

import argparse
import json
from pathlib import Path

import torch

from torchbrdf import load
from torchbrdf.experiment.items import Item
from torchbrdf.experiment.labels import diffuse_label, loss_label, model_label
from torchbrdf.experiment.pictures import color_difference
from torchbrdf.fitting import Batches
from torchbrdf.fitting.api import DIFFUSE_MODES
from torchbrdf.images import DIFFERENCES, ToneMap, composite, write_png
from torchbrdf.lobes import make_model, model_of
from torchbrdf.losses import LOSSES, make_loss
from torchbrdf.measured import PAPER_TEN, is_merl, standins
from torchbrdf.render import RenderedLoss, Scene, blob, unseen_scenes
from torchbrdf.report.figures import grid_figure
from torchbrdf.report.sheet import write_sheet

FORMULAS = ("cube_root", "compressed", "log")
RENDERED = "rendered"
PLACES = ("sphere, studio", "torus, evening")
EIGHT = (
    "brass", "black-obsidian", "green-metallic-paint2", "pink-fabric2", "red-plastic", "specular-violet-phenolic",
    "two-layer-gold", "white-marble",
)  # fmt: skip
# A highlight: how much brighter this share of the object, the reference's brightest pixels, is than the median pixel.
# Not at the rim, this share of the picture's side; and not where there is none, in display values.
HIGHLIGHT, RIM, NO_HIGHLIGHT = 0.01, 0.04, 0.1


def scenes(size):
    """Other lights on other shapes than the grove on the blob, which rendered losses see."""
    return {name: scene for name, scene in unseen_scenes(size).items() if name in PLACES}


def loss_of(name):
    """A registered loss, or the colour difference of a small picture of the blob in the grove."""
    return make_loss(name) if name != RENDERED else RenderedLoss(Scene(blob(), size=96), "delta_e76")


def fits_of(measured, options):
    """Records of all materials by (model, loss, diffuse)."""
    found = {}
    for model in options.models:
        for name in options.losses:
            loss = loss_of(name)
            for diffuse in options.diffuse:
                out = options.out / f"{model}-{name}-{diffuse.replace(':', '-')}"
                batches = Batches(
                    make_model(model, 2), loss, out=out, diffuse=diffuse, strategy="global", max_theta=80.0,
                    samples=options.samples, seed=0,
                )  # fmt: skip
                found[model, name, diffuse] = records = batches.run([measured])
                odd = [f"{r.material} ({r.status})" for r in records if r.status != "converged"]
                took = sum(r.seconds for r in records) / len(records)
                print(f"{model} {name} {diffuse}: {took:.2f} s a fit{', ' * bool(odd)}{', '.join(odd)}", flush=True)
    return found


class Judge:
    """Pictures of the references in a scene, and how far those of fits are from them."""

    def __init__(self, scene, measured):
        linear = scene.transport @ measured.at(scene.pairs)
        self.scene, self.tone = scene, ToneMap.from_images(linear, scene.mask.expand(linear.shape[:-1]))
        self.shown = self.tone(linear)
        width = 2 * round(RIM * scene.size) + 1
        outside = 1 - scene.mask[None].to(torch.float32)
        self.inside = torch.nn.functional.max_pool2d(outside, width, 1, width // 2)[0] == 0

    def __call__(self, records):
        """Display values, mean Delta E of each, and how much of the reference's highlight there is."""
        with torch.no_grad():
            values = torch.cat([model_of([record], torch.float32)(self.scene.pairs) for record in records])
        shown = self.tone(self.scene.transport @ values)
        apart = DIFFERENCES["delta_e76"]()(shown, self.shown, self.scene.mask)
        mine, theirs = (picture.mean(-1)[:, self.inside] for picture in (shown, self.shown))
        brightest = theirs.topk(max(int(HIGHLIGHT * theirs.shape[1]), 1)).indices
        mine, theirs = (x.gather(1, brightest).mean(1) - x.median(1).values for x in (mine, theirs))
        return shown, apart, torch.where(theirs > NO_HIGHLIGHT, mine / theirs, 1)


def summary(names, judged, options):
    """Mean Delta E of each kind of fit, over that of the best formula with the same and with either diffuse."""
    places = list(next(iter(judged.values())))
    print(f"\n| model | diffuse | fits under | {' | '.join(places)} | mean | over best formula, same diffuse | "
          "over best, either | worst material | least highlight |\n|" + "---|" * (8 + len(places)))  # fmt: skip
    for model in options.models:
        mean = {key[1:]: torch.stack([x[1] for x in judged[key].values()]).mean() for key in judged if key[0] == model}
        for (loss, diffuse), own in mean.items():
            each = torch.stack([x[1] for x in judged[model, loss, diffuse].values()])
            same, either = (
                min((mean[k] for k in mean if k[0] in FORMULAS and k[1] in kinds), default=torch.nan)
                for kinds in ((diffuse,), DIFFUSE_MODES)
            )
            worst = each.mean(0).argmax()
            light = torch.stack([x[2] for x in judged[model, loss, diffuse].values()]).amin(0)
            cells = [
                model_label(model), diffuse_label(diffuse), loss_label(loss), *(f"{x:.2f}" for x in each.mean(1)),
                f"{own:.2f}", f"{own / same:.2f}", f"{own / either:.2f}", f"{names[worst]} {each.mean(0)[worst]:.1f}",
                f"{names[light.argmin()]} {light.min():.2f}",
            ]  # fmt: skip
            print(f"| {' | '.join(cells)} |")


def by_material(names, judged):
    """Mean Delta E over the scenes of every material."""
    print(f"\n| fits | {' | '.join(names)} |\n|" + "---|" * (1 + len(names)))
    for (model, loss, diffuse), places in judged.items():
        each = torch.stack([apart for _, apart, _ in places.values()]).mean(0)
        said = f"{model_label(model)}, {loss_label(loss)}, {diffuse_label(diffuse)}"
        print(f"| {said} | {' | '.join(f'{x:.1f}' for x in each.tolist())} |")


def sheets(names, judges, judged, options):
    """A sheet for each model and scene: references, their fits, and where those differ."""
    for model in options.models:
        keys = [key for key in judged if key[0] == model]
        for place, judge in judges.items():
            items = [Item(name, name, "measured") for name in names]
            display, apart, maps = [judge.shown], [torch.zeros(len(names))], [torch.zeros(judge.shown.shape[:-1])]
            for key in keys:
                said = f"{loss_label(key[1])}, {diffuse_label(key[2])}"
                items += [Item(f"{name}: {said}", name, "fit", k) for k, name in enumerate(names)]
                shown, distance, _ = judged[key][place]
                display, apart = [*display, shown], [*apart, distance]
                maps.append(color_difference(shown, judge.shown))
            path = options.out / f"sheet-{model}-{place.replace(', ', '-')}.png"
            parts = (torch.cat(part) for part in (display, maps))
            write_sheet(path, items, *parts, torch.cat(apart).tolist(), judge.scene.coverage)
            print(path)


def figures(measured, judges, judged, options, stand_in):
    """A small figure for each model: references, and fits under each loss with its default treatment."""
    names = [name for name in options.figure if name in measured.names]
    place, judge = next(iter(judges.items()))
    for model in options.models if names else ():
        rows = {"reference": judge.shown}
        for name in options.losses:
            diffuse = loss_of(name).default_diffuse
            if (model, name, diffuse) in judged:
                rows[f"{loss_label(name)},\n{diffuse_label(diffuse)}"] = judged[model, name, diffuse][place][0]
        paths = {}
        for k, (label, shown) in enumerate(rows.items()):
            paths[label] = [options.out / "pictures" / f"{model}-{k}-{name}.png" for name in names]
            for name, path in zip(names, paths[label], strict=True):
                write_png(path, composite(shown[measured.names.index(name)], judge.scene.coverage))
        path = options.out / f"figure-{model}.png"
        grid_figure(path, names, paths, stand_in)
        print(path)


def options_of(arguments):
    """What to fit and how."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", type=Path, help="a folder of MERL tables; the bundled stand-ins without it")
    parser.add_argument("--materials", help="of those, split by commas; or ten (the paper's, default), eight")
    parser.add_argument("--models", default="ward,cook_torrance")
    parser.add_argument("--losses", default="cube_root,compressed,log,learned,rendered")
    parser.add_argument("--diffuse", default="fit,45:0")
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument("--size", type=int, default=128, help="pixels of a side of the pictures that are compared")
    parser.add_argument("--figure", default="gold-metallic-paint2,blue-acrylic,alum-bronze,silver-metallic-paint,nylon")
    parser.add_argument("--out", type=Path, default=Path("looks"))
    options = parser.parse_args(arguments)
    for key in ("models", "losses", "diffuse", "figure"):
        setattr(options, key, getattr(options, key).split(","))
    options.losses = [x if x == RENDERED else LOSSES.canonical(x) for x in options.losses]
    names = {None: PAPER_TEN, "ten": PAPER_TEN, "eight": EIGHT}.get(options.materials)
    options.materials = names or options.materials.split(",")
    return options


def main(arguments=None):
    """Fit, draw, print."""
    options = options_of(arguments)
    if options.tables is None:
        measured = load(standins())
        measured, stand_in = measured.batch([measured.names.index(name) for name in options.materials]), True
    else:
        paths = [options.tables / f"{name}.binary" for name in options.materials]
        measured, stand_in = load(paths), not all(map(is_merl, paths))
    names = measured.names
    fits = fits_of(measured, options)
    judges = {place: Judge(scene, measured) for place, scene in scenes(options.size).items()}
    judged = {key: {place: judge(records) for place, judge in judges.items()} for key, records in fits.items()}
    summary(names, judged, options)
    by_material(names, judged)
    sheets(names, judges, judged, options)
    figures(measured, judges, judged, options, stand_in)
    kept = [
        {"model": m, "loss": x, "diffuse": d, "scene": place, "delta_e76": dict(zip(names, v[1].tolist(), strict=True))}
        for (m, x, d), places in judged.items()
        for place, v in places.items()
    ]
    (options.out / "looks.json").write_text(json.dumps(kept, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
