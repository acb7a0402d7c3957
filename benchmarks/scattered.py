"""Values between scattered samples: which interpolation predicts best what was left out.

    python benchmarks/scattered.py PAINTS --rgl RGL [--every 1] [--asked 500] [--fits]
    python benchmarks/scattered.py PAINTS --speed

PAINTS are files of scattered samples (ASTM), RGL a folder of RGL measurements, which are sampled as a goniophotometer
does: light at 0, 20, 40 and 60 degrees, viewer every degree of polar angle and 10 of azimuth. Every fourth sample is
left out, or all of one incidence; of these `--asked` are predicted. Printed is the root mean square error of the log of
values (below 0.001 / sr they count as that), mean over materials, and the CPU seconds of one prediction.

With --speed: CPU seconds of one thread until the first of 100,000 positions are known, and of the next 100,000; of each
of PAINTS, and of made-up samples with a grain.

nearest, inverse distance, linear (Delaunay) and RBF (thin plates through the 24 nearest) work on the same coordinates
and compressed values as the package's own interpolation. With --fits also a fitted model (two GGX lobes) times the
package's own interpolation of the ratio to it.
"""

import argparse
import math
import time
import warnings

import numpy as np
import torch
from scipy.interpolate import LinearNDInterpolator, RBFInterpolator
from scipy.spatial import KDTree

from torchbrdf.fitting import fit
from torchbrdf.lobes import GGXAnisotropic, Lambert, Sum, make_model
from torchbrdf.losses import make_loss
from torchbrdf.measured import Measured, load
from torchbrdf.measured.scattered import Angles, Places, Surface
from torchbrdf.pairs import Pairs

FLOOR = 1e-3
LIMIT = math.cos(math.radians(81))


def goniometer():
    """Pairs as a goniophotometer takes them, `(1, N)`, and each one's incidence in degrees."""
    rows = [
        (light, polar, azimuth)
        for light in (0, 20, 40, 60)
        for polar in range(81)
        for azimuth in (range(0, 181, 10) if polar else [0])
    ]
    light, polar, azimuth = torch.deg2rad(torch.tensor(rows, dtype=torch.float64)).T
    wi = torch.stack([light.sin(), 0 * light, light.cos()], -1)
    wo = torch.stack([polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos()], -1)
    return Pairs.from_directions(wi[None], wo[None])


def materials(options):
    """Kind, pairs and values `(N, 3)` of each material."""
    paints = load(sorted(options.paints), dtype=torch.float64)
    for k in range(0, len(paints), options.every):
        one = paints.batch([k])
        good = (one.weight[0, :, 0] > 0) & (torch.minimum(one.pairs.cos_i, one.pairs.cos_o)[0] > LIMIT)
        yield "paints", one.pairs.select([0], good.nonzero()[:, 0]), one.values[0, good]
    if options.rgl:
        pairs, found = goniometer(), load(options.rgl, dtype=torch.float64)
        for k in range(0, len(found), options.every):
            yield "RGL", pairs, found.batch([k]).at(pairs)[0]


def splits(pairs, asked):
    """Name, the samples that are kept, and some of those that are left out."""
    incidence = torch.rad2deg(torch.arccos(pairs.cos_i[0].clamp(-1, 1))).round()
    every = torch.arange(len(pairs))
    out = {"every fourth": every % 4 == 0} | {f"all at {angle:g}": incidence == angle for angle in incidence.unique()}
    for name, mask in out.items():
        gone = every[mask]
        yield name, every[~mask], gone[:: max(1, len(gone) // asked)]


def compressed(pairs, values):
    """Coordinates, compressed values and their scale, repetitions once."""
    angles = Angles.of(pairs, 0)
    places = Places(angles)
    mean = np.stack([places.mean(channel) for channel in values.numpy().T], -1)
    scale = max(np.quantile(np.abs(mean), 0.02), 1e-3 * np.abs(mean).mean())
    points = np.stack([places.mean(axis) for axis in angles.places().T], -1)
    return points, np.arcsinh(mean / (2 * scale)), scale


def plain(make):
    """A method on coordinates and compressed values."""

    def predict(pairs, values, asked):
        points, known, scale = compressed(pairs, values)
        return 2 * scale * np.sinh(make(points, known, Angles.of(asked, 0).places()))

    return predict


def nearest(points, known, asked):
    return known[KDTree(points).query(asked)[1]]


def inverse_distance(points, known, asked):
    distance, index = KDTree(points).query(asked, 12)
    weight = 1 / np.maximum(distance, 1e-9) ** 2
    return (known[index] * weight[..., None]).sum(1) / weight.sum(1, keepdims=True)


def linear(points, known, asked):
    found = LinearNDInterpolator(points, known)(asked)
    missing = np.isnan(found).any(1)
    found[missing] = nearest(points, known, asked[missing])
    return found


def rbf(points, known, asked):
    return RBFInterpolator(points, known, neighbors=24, kernel="thin_plate_spline", degree=1)(asked)


def own(pairs, values, asked):
    places = Places(Angles.of(pairs, 0))
    return Surface(places, values.numpy()).at(places.near(Angles.of(asked, 0)))


def fitted(model):
    """A fitted model times the ratio to it."""

    def predict(pairs, values, asked):
        result = fit(
            make_model(model, 2), Measured.from_samples(pairs, values[None]), make_loss("cube_root"), diffuse="fit"
        )
        with torch.no_grad():
            base, there = (result.model(one)[0].clamp_min(FLOOR / 10) for one in (pairs, asked))
        return own(pairs, values / base, asked) * there.numpy()

    return predict


def anywhere(seed):
    """100,000 pairs all over the hemisphere."""
    draw = np.random.default_rng(seed).uniform(0.01, 1, (100_000, 2, 2))
    z, turn = draw[..., 0], 2 * math.pi * draw[..., 1]
    flat = np.sqrt(1 - z**2)
    directions = torch.from_numpy(np.stack([flat * np.cos(turn), flat * np.sin(turn), z], -1))
    return Pairs.from_directions(*directions.transpose(0, 1)[:, None])


def brushed():
    """Made-up samples with a grain, taken at four turns of the surface."""
    lobe = Sum(Lambert(albedo=0.2), GGXAnisotropic(specular=0.3, roughness_x=0.1, roughness_y=0.4)).double()
    turn = torch.arange(4, dtype=torch.float64)[:, None] * math.pi / 4
    wi, wo = (
        torch.stack([x * turn.cos() - y * turn.sin(), x * turn.sin() + y * turn.cos(), z.expand(4, -1)], -1)
        for x, y, z in (one[0].T for one in (goniometer().wi, goniometer().wo))
    )
    pairs = Pairs.from_directions(wi.reshape(1, -1, 3), wo.reshape(1, -1, 3))
    with torch.no_grad():
        return Measured.from_samples(pairs, lobe(pairs), names=["made up, with a grain"])


def speed(paints):
    """How long questions take."""
    torch.set_num_threads(1)
    print("| samples of | how many | preparation, CPU s | 100,000 positions, CPU s |\n|---|---|---|---|")
    for measured in [*(load(path, dtype=torch.float64) for path in paints), brushed()]:
        times = []
        for k in range(5):
            asked = anywhere(k)
            began = time.process_time()
            measured.at(asked)
            times.append(time.process_time() - began)
        least = min(times[1:])
        print(f"| {measured.names[0]} | {len(measured.pairs)} | {times[0] - least:.2f} | {least:.2f} |")


METHODS = {
    "nearest": plain(nearest),
    "inverse distance": plain(inverse_distance),
    "linear (Delaunay)": plain(linear),
    "RBF": plain(rbf),
    "lobes and inverse distance": own,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paints", nargs="+")
    parser.add_argument("--rgl")
    parser.add_argument("--every", type=int, default=1, help="one in so many materials")
    parser.add_argument("--asked", type=int, default=500)
    parser.add_argument("--fits", action="store_true")
    parser.add_argument("--speed", action="store_true")
    options = parser.parse_args()
    if options.speed:
        speed(sorted(options.paints))
        return
    warnings.simplefilter("ignore")
    methods = METHODS | ({"GGX and ratio": fitted("ggx")} if options.fits else {})
    errors, seconds = {}, {}
    for kind, pairs, values in materials(options):
        for split, kept, out in splits(pairs, options.asked):
            known, asked = pairs.select(samples=kept), pairs.select(samples=out)
            expected = values[out].clamp_min(FLOOR).log().numpy()
            for name, predict in methods.items():
                began = time.process_time()
                found = np.log(np.maximum(predict(known, values[kept], asked), FLOOR))
                seconds.setdefault(name, []).append(time.process_time() - began)
                errors.setdefault((kind, split), {}).setdefault(name, []).append(
                    np.sqrt(np.mean((found - expected) ** 2))
                )
    columns = list(errors)
    print("| method |", " | ".join(f"{kind}: {split}" for kind, split in columns), "| CPU s |")
    print("|---|" + "---|" * (len(columns) + 1))
    for name in methods:
        cells = [f"{np.mean(errors[column][name]):.3f}" for column in columns]
        print(f"| {name} |", " | ".join(cells), f"| {np.median(seconds[name]):.2f} |")


if __name__ == "__main__":
    main()
