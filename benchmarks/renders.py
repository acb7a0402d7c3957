"""What pictures cost, beside an older version: the first of a table, further ones, and the 200 of the study.

python benchmarks/renders.py TABLE.binary TABLE.binary [...] [--before CHECKOUT] [--pictures 200] [--rounds 3]

400 x 400 pixels, bundled light; tables under 2048 lights, the study's under 1024. Each is measured by a process of its
own, and with --before the older version's follows at once, so that both have the same machine. Seconds on the clock and
of the processors, the median of the rounds. The older version's 200 pictures may be fewer (--pictures), as its cost is
that of one picture times their number; what is printed is for 200.
"""

import argparse
import inspect
import json
import os
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

WHOLE = 200
MODELS = ("ward", "cook_torrance", "ashikhmin_shirley")
SHOWN = (
    ("first", "the first picture of a table, scene included"),
    ("again", "the same table again"),
    ("further", "a further table, reading included"),
    ("lobe", "Lambert + 2 Ward, alone"),
    ("study", "the 200 pictures of fores2012, scenes included"),
)


def parse(arguments):
    """The options."""
    parser = argparse.ArgumentParser()
    parser.add_argument("files", nargs="+", help="MERL tables, at least two for further ones")
    parser.add_argument("--before", help="a checkout of an older version")
    parser.add_argument("--pictures", type=int, default=WHOLE, help="of the study, that the older version draws")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--measure", choices=["tables", "study"], help="what the process itself measures")
    return parser.parse_args(arguments)


def make_scene(lights, turn=0.0):
    """A scene of the version that is imported: names of settings have changed."""
    from torchbrdf import render

    camera = getattr(render, "Camera", None) or render.View
    known = inspect.signature(render.Scene.__init__).parameters
    name = "light_samples" if "light_samples" in known else "lights"
    return render.Scene(render.blob(), camera(turn), render.Environment.default(), size=400, **{name: lights})


def timed(work):
    """What some work makes, and its seconds on the clock and of the processors."""
    clock, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF)
    made = work()
    after = resource.getrusage(resource.RUSAGE_SELF)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return made, (time.perf_counter() - clock, cpu)


def tables(files):
    """Seconds of single pictures."""
    from torchbrdf.lobes import make_model
    from torchbrdf.measured import load
    from torchbrdf.render import render

    first, *others = map(load, files)
    scene = make_scene(4)  # what is loaded at first use is loaded
    render(make_model("ward", 2), scene)

    def work():
        scene = make_scene(2048)
        render(first, scene)
        return scene

    scene, seconds = timed(work)
    further = [timed(lambda table=table: render(table, scene))[1] for table in others]
    return {
        "first": seconds,
        "again": timed(lambda: render(first, scene))[1],
        "further": [statistics.median(column) for column in zip(*further, strict=True)],
        "lobe": timed(lambda: render(make_model("ward", 2), make_scene(2048)))[1],
    }


def study(pictures):
    """Seconds of the study's pictures: ten materials and 180 fits in one scene, the materials in another view."""
    import torch

    from torchbrdf.lobes import make_model
    from torchbrdf.measured import load, standins
    from torchbrdf.render import render

    render(make_model("ward", 2), make_scene(4))
    share = pictures / WHOLE
    materials = load(standins()).batch(range(round(10 * share)))
    generator = torch.Generator().manual_seed(0)
    fits = []
    for name in MODELS * 2:
        model = make_model(name, 2).batched(round(30 * share))
        with torch.no_grad():
            for key, value in model.named_parameters():
                if "roughness" in key or "exponent" in key:
                    value.mul_(torch.rand(value.shape, generator=generator) * 4 + 1)
        fits.append(model)
    (straight, turned), scenes = timed(lambda: (make_scene(1024), make_scene(1024, 15.0)))
    _, drawn = timed(lambda: (render([materials, *fits], straight), render(materials, turned)))
    return {"study": [one + other / share for one, other in zip(scenes, drawn, strict=True)]}


def measured(options, what, checkout, pictures):
    """What a process of a version finds."""
    command = [sys.executable, __file__, *options.files, "--measure", what, "--pictures", str(pictures)]
    root = Path(checkout) if checkout else Path(__file__).parents[1]
    done = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": str(root)}, check=True, capture_output=True, text=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def main(options):
    """Print the table."""
    if options.measure:
        import torchbrdf

        # Older versions have assets and recipes at the top level of the repository, without links to them.
        torchbrdf.__path__.append(str(Path(torchbrdf.__file__).parents[1]))
        found = tables(options.files) if options.measure == "tables" else study(options.pictures)
        print(json.dumps(found))
        return
    versions = {"now": (None, WHOLE), **({"before": (options.before, options.pictures)} if options.before else {})}
    rounds = {name: {} for name in versions}
    for _ in range(options.rounds):
        for what in ("tables", "study"):
            for name, (checkout, pictures) in versions.items():
                for label, seconds in measured(options, what, checkout, pictures).items():
                    rounds[name].setdefault(label, []).append(seconds)
    for label, said in SHOWN:
        own = {
            name: [statistics.median(column) for column in zip(*found[label], strict=True)]
            for name, found in rounds.items()
            if label in found
        }
        line = "".join(f"{name}: {clock:8.2f} s, {cpu:8.2f} CPU s   " for name, (clock, cpu) in own.items())
        if len(own) > 1:
            line += "  ".join(f"{before / now:5.1f}" for before, now in zip(own["before"], own["now"], strict=True))
        print(f"{said:50s}{line}")


if __name__ == "__main__":
    main(parse(sys.argv[1:]))
