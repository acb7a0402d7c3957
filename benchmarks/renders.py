"""What a picture costs: a scene's set-up, and then each BRDF, beside a plain Lambert sphere of the same pairs.

python benchmarks/renders.py [TABLE.binary]
"""

import sys
import time

from torchbrdf.lobes import Lambert, make_model
from torchbrdf.measured import load, standins
from torchbrdf.render import Camera, Environment, Scene, blob, render


def timed(label, work, unit=None):
    """Run, print seconds and the ratio to `unit`, and give the seconds."""
    began = time.perf_counter()
    work()
    seconds = time.perf_counter() - began
    ratio = f"{seconds / unit:8.2f}" if unit else ""
    print(f"{label:44s}{seconds:8.2f} s{ratio}")
    return seconds


def main(files):
    """Print the table."""
    environment = Environment.default()
    made = {}
    timed("scene, 400 x 400", lambda: made.update(scene=Scene(blob(), Camera(), environment, size=400)))
    scene = made["scene"]
    unit = timed("Lambert (the unit of the ratios)", lambda: render(Lambert(), scene))
    timed("Lambert + 2 Ward", lambda: render(make_model("ward", 2), scene), unit)
    timed("30 times Lambert + 2 Ward, one call", lambda: render([make_model("ward", 2)] * 30, scene), unit)
    timed("a bundled stand-in", lambda: render(load(standins()).batch([0]), scene), unit)
    timed("200 times, one call", lambda: render([make_model("ward", 2)] * 200, scene), unit)
    for name in files:
        table = load(name)
        timed(f"{name}, first time", lambda table=table: render(table, scene), unit)
        timed(f"{name}, again", lambda table=table: render(table, scene), unit)


if __name__ == "__main__":
    main(sys.argv[1:])
