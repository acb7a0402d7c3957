"""How time grows with the work: log-log slopes, of materials, lobes, samples, and pixels of a picture's side squared.

    python benchmarks/growth.py FOLDER [--out assets/growth.png]

FOLDER holds MERL-format tables; materials are taken from it in turn, so 100 ask for 100. Every point is the least of
some runs in this process, in CPU seconds of one thread, after one that warms up. At most 1.1 is wanted, 1.5 of lobes;
fixed costs make slopes smaller at the left of a curve, so the slope of the last two points is printed beside that of
all.
"""

import argparse
import math
import time
from itertools import pairwise

import torch

from torchbrdf.fitting import fit, stratified
from torchbrdf.lobes import Lobe, make_model
from torchbrdf.losses import LOSSES
from torchbrdf.measured import Measured, load
from torchbrdf.render import Camera, Environment, Scene, blob, render


def least(work, times: int) -> float:
    """The least CPU seconds of some runs: others on the machine matter less than on the clock."""
    found = []
    for _ in range(times):
        began = time.process_time()
        work()
        found.append(time.process_time() - began)
    return min(found)


def fitted(measured: Measured, lobes: int, loss: str, samples: int | None = 20_000):
    """A fit, to be run."""
    return lambda: fit(make_model("cook_torrance", lobes), measured, LOSSES[loss](), samples=samples)


def step(measured: Measured):
    """Error and gradient of a two-lobe model on all pairs, as a user's loop has them."""
    model = make_model("cook_torrance", 2).batched(len(measured))
    loss, target = LOSSES["cube_root"](), measured.values

    def work() -> None:
        with torch.enable_grad():
            loss(model(measured.pairs), target, measured.pairs).backward()

    return work


def picture(brdf: Lobe | Measured, size: int):
    """A scene and one picture."""
    environment = Environment.default()
    return lambda: render(brdf, Scene(blob(), Camera(), environment, size=size))


def subset(measured: Measured, count: int) -> Measured:
    """So many of the samples."""
    return measured.batch(samples=stratified(len(measured.pairs), min(count, len(measured.pairs)), 0))


def curves(folder: str):
    """Names of curves, the largest slope that is wanted, and their points: amounts and what to run."""
    every = load(folder)
    count = len(every)
    nickel = every.batch([0]).within(80.0)
    amounts = [n for n in (1, 10, 100) if n <= count]
    yield (
        "materials, fits of two lobes",
        1.1,
        [(n, fitted(every.batch(list(range(n))), 2, "cube_root"), 1 + (n < 100)) for n in amounts],
    )
    yield (
        "materials, as sums (RMS)",
        1.1,
        [(n, fitted(every.batch(list(range(n))), 2, "rms"), 1 + (n < 100)) for n in amounts],
    )
    yield "lobes, a fit under cube root", 1.5, [(n, fitted(nickel, n, "cube_root"), 3) for n in (1, 2, 3, 4)]
    sizes = [5_000, 20_000, 100_000, 300_000, 900_000]
    yield "samples, value and gradient", 1.1, [(n, step(subset(nickel, n)), 3) for n in sizes]
    yield "samples, a fit of all of them", 1.1, [(n, fitted(subset(nickel, n), 2, "cube_root", None), 2) for n in sizes]
    widths = (64, 128, 256, 512, 1024)
    yield "pixels, a lobe's picture", 1.1, [(n * n, picture(make_model("ggx", 2), n), 2 - (n > 500)) for n in widths]
    yield "pixels, a table's picture", 1.1, [(n * n, picture(every.batch([0]), n), 2 - (n > 500)) for n in widths]


def slope(points: list[tuple[int, float]]) -> float:
    """Of a line through points on logarithmic scales, by least squares."""
    x, y = (torch.tensor([math.log(one) for one in part], dtype=torch.float64) for part in zip(*points, strict=True))
    return float(((x - x.mean()) * (y - y.mean())).sum() / (x - x.mean()).square().sum())


def draw(found: dict[str, list[tuple[int, float]]], out: str) -> None:
    """The figure."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    kinds = list(dict.fromkeys(name.split(",")[0] for name in found))
    figure, axes = plt.subplots(1, len(kinds), figsize=(3.2 * len(kinds), 3.2), layout="constrained")
    for axis, kind in zip(axes, kinds, strict=True):
        for name, points in found.items():
            if name.split(",")[0] == kind:
                axis.loglog(*zip(*points, strict=True), "o-", label=f"{name.split(', ')[1]}: {slope(points):.2f}")
        axis.set_xlabel(kind)
        amounts = sorted(
            {amount for name, points in found.items() if name.split(",")[0] == kind for amount, _ in points}
        )
        if amounts[-1] < 10:
            axis.xaxis.set_minor_formatter("")
            axis.set_xticks(amounts, map(str, amounts))
        axis.legend(fontsize=7)
        axis.grid(True, which="both", alpha=0.25)
    axes[0].set_ylabel("CPU seconds")
    figure.savefig(out, dpi=110)


def main(folder: str, out: str | None) -> None:
    """Print slopes, and draw them."""
    found: dict[str, list[tuple[int, float]]] = {}
    for name, wanted, points in curves(folder):
        measured_points = []
        for amount, work, times in points:
            if times > 1:
                work()
            measured_points.append((amount, least(work, times)))
        found[name] = measured_points
        last = [slope([*pair]) for pair in pairwise(measured_points)][-1]
        seconds = ", ".join(f"{amount}: {one:.3g} s" for amount, one in measured_points)
        verdict = "" if slope(measured_points) <= wanted else f"  ABOVE {wanted}"
        print(f"{name:32s} slope {slope(measured_points):.2f}, at the end {last:.2f} ({seconds}){verdict}", flush=True)
    if out:
        draw(found, out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder")
    parser.add_argument("--out")
    torch.set_flush_denormal(True)
    torch.set_num_threads(1)
    main(**vars(parser.parse_args()))
