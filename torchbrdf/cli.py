"""The command line: `torchbrdf run | fit | render | view | info`."""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchbrdf import __version__
from torchbrdf.errors import DataError, TorchbrdfError, UsageError
from torchbrdf.registry import unknown

if TYPE_CHECKING:
    from torchbrdf.losses import Loss
    from torchbrdf.measured import Measured

RENDERED = "rendered"

DESCRIPTION = """\
Fit BRDF models to measured materials, and measure which error metric gives the fit that looks right.

  torchbrdf run fores2012                       the study of Fores, Ferwerda and Gu (2012), to a report
  torchbrdf fit nickel.binary --model ward      one fit, printed
  torchbrdf render nickel.binary                a picture of a measured material, or of fits
  torchbrdf view nickel.binary fits.json        a page to turn them and to wipe between them
  torchbrdf info nickel.binary                  what a file holds
"""

RUN = """\
Run a recipe: a short Python file that says what to do and which settings it has.

  torchbrdf run fores2012
  torchbrdf run fores2012 quick=true
  torchbrdf run fores2012 materials=MERL/ environment=rnl_probe.hdr models=ward,cook_torrance
  torchbrdf run my_recipe.py --out results

Run it again with the same settings and folder, and it takes up what is finished.
"""

FIT = """\
Fit a model to measured BRDFs: files (MERL .binary, RGL .bsdf, fits.json) or folders of them.

  torchbrdf fit nickel.binary --model ward --lobes 2 --loss cuberoot
  torchbrdf fit MERL/ --model cook_torrance --loss cosine --out fits/
  torchbrdf fit nickel.binary --model ward --loss rendered --difference delta_e --diffuse fit

The last compares pictures. A folder is fitted in batches, and each is written as it is done: run the command again,
and it goes on from there.
"""

RENDER = """\
Draw measured BRDFs, or the fits of a fits.json, under a light probe, to PNG (and linear EXR) files.

  torchbrdf render nickel.binary --out pictures/
  torchbrdf render fits/fits.json --environment rnl_probe.hdr --shape sphere --rotate 15
"""

VIEW = """\
Draw measured BRDFs and fits from all around, and write one page to look at them: turn the object, wipe between a
material and its fit, see their difference. The page needs no network, and nothing beside it.

  torchbrdf view nickel.binary fits/fits.json
  torchbrdf view MERL/ --environment grove rnl_probe.hdr --steps 24 --out nickel.html --open
"""

INFO = """\
Say what measured BRDF files hold: format, size, invalid entries, whether a file is MERL's own, diffuse and gloss.

  torchbrdf info nickel.binary
  torchbrdf info --system
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; the exit status is 0, 1 (data or a run failed) or 2 (usage)."""
    # Before torch is imported: threads that spin for long while they wait make a busy machine crawl.
    os.environ.setdefault("GOMP_SPINCOUNT", "3000")
    options = build_parser().parse_args(arguments)
    try:
        return int(options.command(options))
    except UsageError as error:
        print(f"torchbrdf: {error}", file=sys.stderr)
        return 2
    except (TorchbrdfError, OSError) as error:
        print(f"torchbrdf: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("torchbrdf: stopped", file=sys.stderr)
        return 1


def build_parser() -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    parser = _parser(argparse.ArgumentParser(prog="torchbrdf"), DESCRIPTION)
    parser.add_argument("--version", action="version", version=f"torchbrdf {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    run = _parser(commands.add_parser("run", help="run a recipe, such as fores2012"), RUN)
    run.add_argument("recipe", help="a recipe's name, or a Python file that holds one; `list` shows them")
    run.add_argument("settings", nargs="*", metavar="key=value", help="settings; `torchbrdf run NAME help=` shows them")
    run.add_argument("--out", help="folder of the run (default: runs/NAME)")
    run.set_defaults(command=run_command)

    fit = _parser(commands.add_parser("fit", help="fit a model to measured BRDFs"), FIT)
    fit.add_argument("files", nargs="+", help="measured BRDFs, or folders of them")
    fit.add_argument("--model", default="ward", help="ward (default), cook_torrance, ashikhmin_shirley, ...")
    fit.add_argument("--lobes", type=int, default=2, help="specular lobes beside the diffuse one (default 2)")
    fit.add_argument(
        "--loss", default="cuberoot", help="rms, cosine, cuberoot (default), compressed, log, ..., rendered"
    )
    fit.add_argument(
        "--difference", default="delta_e", help="of a rendered loss: delta_e (default), log_hdr, psnr, ssim, flip, ..."
    )
    fit.add_argument("--environment", default="grove", help="of a rendered loss: grove (default), studio, or a file")
    fit.add_argument("--shape", default="blob", help="of a rendered loss: blob (default), sphere, or a mesh file")
    fit.add_argument("--size", type=int, default=128, help="of a rendered loss: pixels of a side (default 128)")
    fit.add_argument("--lights", type=int, default=1024, help="of a rendered loss: lights in the scene (default 1024)")
    fit.add_argument("--strategy", default="global", help="global (default): the best fit; staged: the paper's way")
    fit.add_argument("--diffuse", default="45:0", help="45:0 (default): measured and held; fit: fitted")
    fit.add_argument("--max-theta", type=float, default=80.0, help="largest angle from the normal (default 80)")
    fit.add_argument("--samples", type=int, default=20_000, help="pairs of the search; 0: all (default 20000)")
    fit.add_argument("--seed", type=int, default=0, help="seed of the subset (default 0)")
    fit.add_argument("--out", help="folder for fits.json and fits.csv; fits that it holds already are not made again")
    fit.set_defaults(command=fit_command)

    render = _parser(commands.add_parser("render", help="draw measured BRDFs or fits"), RENDER)
    render.add_argument("files", nargs="+", help="measured BRDFs, or a fits.json")
    render.add_argument(
        "--environment", default="grove", help="grove (default), studio, none, or .exr or .hdr: lat-long or angular map"
    )
    render.add_argument("--shape", default="blob", help="blob (default), sphere, or a mesh file")
    render.add_argument("--rotate", type=float, default=0.0, help="turn the view by so many degrees (default 0)")
    render.add_argument("--elevation", type=float, default=0.0, help="degrees to look down from (default 0)")
    render.add_argument("--size", type=int, default=400, help="pixels of a side (default 400)")
    render.add_argument(
        "--lamp", action="append", default=[], help="directional:X,Y,Z:COLOR or point:X,Y,Z:COLOR; may come again"
    )
    render.add_argument("--shadows", action="store_true", help="the object casts shadows on itself (needs embreex)")
    render.add_argument(
        "--backend", default="auto", help="pyrender (OpenGL), software, or auto (default): OpenGL where it works"
    )
    render.add_argument("--out", default=".", help="folder for the pictures (default: here)")
    render.set_defaults(command=render_command)

    view = _parser(commands.add_parser("view", help="write a page to compare measured BRDFs and fits"), VIEW)
    view.add_argument("files", nargs="+", help="measured BRDFs, fits.json, or folders of them")
    view.add_argument(
        "--environment", nargs="+", default=["grove"], help="grove (default), studio, or .exr or .hdr light probes"
    )
    view.add_argument("--shape", default="blob", help="blob (default), sphere, or a mesh file")
    view.add_argument("--size", type=int, default=320, help="pixels of a side (default 320)")
    view.add_argument("--steps", type=int, default=12, help="sides that it is seen from, all around (default 12)")
    view.add_argument("--out", default="view.html", help="the page (default: view.html)")
    view.add_argument("--open", action="store_true", help="open it in the browser")
    view.set_defaults(command=view_command)

    info = _parser(commands.add_parser("info", help="say what a file holds"), INFO)
    info.add_argument("files", nargs="*", help="measured BRDFs")
    info.add_argument("--system", action="store_true", help="say what this machine offers: torch, CUDA, OpenGL, ...")
    info.set_defaults(command=info_command)
    return parser


def run_command(options: argparse.Namespace) -> int:
    """`torchbrdf run`."""
    from torchbrdf.recipe import RECIPES, configure, describe, find_recipe, run

    if options.recipe == "list":
        for name, kind in RECIPES.items():
            print(f"{name:20s} {(kind.__doc__ or '').splitlines()[0]}")
        return 0
    kind = find_recipe(options.recipe)
    settings = {}
    for text in options.settings:
        key, separator, value = text.partition("=")
        if not separator:
            raise UsageError(f"{kind.name}: expected key=value, found {text!r}")
        settings[key] = value
    if "help" in settings:
        print(describe(kind))
        return 0
    recipe = configure(kind, settings)
    print(run(recipe, options.out or Path("runs") / kind.name, bars))
    return 0


def fit_command(options: argparse.Namespace) -> int:
    """`torchbrdf fit`."""
    from torchbrdf.files import writable
    from torchbrdf.fitting import STRATEGIES, Batches
    from torchbrdf.lobes import make_model, number

    STRATEGIES[options.strategy]
    model = make_model(options.model, options.lobes)
    batches = Batches(
        model,
        _loss(options),
        out=writable(options.out) if options.out else None,
        strategy=options.strategy,
        diffuse=options.diffuse,
        max_theta=options.max_theta,
        samples=options.samples or None,
        seed=options.seed,
    )
    groups, complete = _load(options.files)
    records = batches.run(groups, bars("fits", sum(map(len, groups))))
    if batches.loss.scene:
        print(f"pictures of {batches.loss.scene}")
    print(f"{'material':32s} {'error':>10s}  {'status':14s} parameters")
    for record in records:
        rest = [f"{key} {_short(value)}" for key, value in record["parameters"].items()]
        rest += [f"({note})" for note in _notes(record)]
        print(
            f"{record['material']:32s} {_short(number(record['error'])):>10s}  {record['status']:14s} {'  '.join(rest)}"
        )
    if options.out:
        print(Path(options.out) / "fits.json")
    return 0 if complete else 1


def _loss(options: argparse.Namespace) -> "Loss":
    """A loss by name, or pictures of the scene that the options describe."""
    from torchbrdf.losses import LOSSES

    if options.loss != RENDERED:
        if options.loss not in LOSSES:
            raise unknown("loss", options.loss, [*LOSSES, RENDERED])
        return LOSSES[options.loss]()
    from torchbrdf.images import DIFFERENCES
    from torchbrdf.render import Environment, RenderedLoss, Scene, cache_folder, find_mesh

    difference = DIFFERENCES[options.difference]()
    light = Environment.find(options.environment)
    mesh = find_mesh(options.shape)
    scene = Scene(mesh, None, light, size=options.size, lights=options.lights, cache=cache_folder())
    return RenderedLoss(scene, difference)


def _notes(record: dict[str, Any]) -> list[str]:
    """What else there is to say of a fit."""
    notes = [record["reason"]] if record["reason"] else []
    notes += [f"{record['ties']} other minima within 1 %"] if record["ties"] else []
    return notes + ([f"at a bound: {', '.join(record['at_bounds'])}"] if record["at_bounds"] else [])


def render_command(options: argparse.Namespace) -> int:
    """`torchbrdf render`."""
    from torchbrdf.files import writable
    from torchbrdf.images import ToneMap, over, write_exr, write_png
    from torchbrdf.render import Environment, Scene, View, find_mesh, parse_lamp, render

    out = writable(options.out)
    if options.environment == "none" and not options.lamp:
        raise UsageError("render: expected an environment or a lamp, found neither")
    light = None if options.environment == "none" else Environment.find(options.environment)
    scene = Scene(
        find_mesh(options.shape),
        View(options.rotate, elevation=options.elevation),
        light,
        size=options.size,
        lamps=[parse_lamp(text) for text in options.lamp],
        shadows=options.shadows,
        backend=options.backend,
    )
    groups, complete = _load(options.files)
    for group in groups:
        pictures = render(group, scene)
        tone = ToneMap.from_images(pictures, scene.mask.expand(pictures.shape[:-1]))
        for name, picture in zip(group.names, pictures, strict=True):
            path = out / f"{name}.png"
            write_png(path, over(tone(picture), scene.coverage))
            write_exr(path.with_suffix(".exr"), picture)
            print(path)
    return 0 if complete else 1


def view_command(options: argparse.Namespace) -> int:
    """`torchbrdf view`."""
    from torchbrdf.files import writable
    from torchbrdf.render import Environment, find_mesh
    from torchbrdf.report.view import distinct, write_view

    out = Path(options.out)
    writable(out.parent)
    mesh = find_mesh(options.shape)
    lights = [Environment.find(name) for name in options.environment]
    names = distinct([Path(name).stem for name in options.environment])
    groups, complete = _load(options.files)
    if not groups:
        return 1
    write_view(
        out,
        groups,
        dict(zip(names, lights, strict=True)),
        mesh,
        size=options.size,
        steps=options.steps,
        advance=bars("sides", len(lights) * max(options.steps, 0)),
    )
    pictures = sum(map(len, groups)) * len(lights) * options.steps
    print(f"{pictures} pictures, {out.stat().st_size / 1e6:.1f} MB")
    print(out)
    if options.open:
        import webbrowser

        webbrowser.open(out.resolve().as_uri())
    return 0 if complete else 1


def info_command(options: argparse.Namespace) -> int:
    """`torchbrdf info`."""
    from torchbrdf.measured import describe

    if not options.files and not options.system:
        raise UsageError("info: expected files, or --system")
    if options.system:
        from torchbrdf.render.system import system_facts  # late, because most of the package comes with it

        _print_facts(system_facts(), "")
    failed = 0
    for k, name in enumerate(options.files):
        try:
            facts = describe(name)
        except TorchbrdfError as error:
            print(f"torchbrdf: {error}", file=sys.stderr)
            failed = 1
            continue
        if k or options.system:
            print()
        print(name)
        _print_facts(facts, "  ")
    return failed


def bars(label: str, total: int) -> Callable[[int], None]:
    """A progress bar on a terminal; nothing where there is none, or nothing to do."""
    from tqdm import tqdm

    bar = tqdm(total=total, desc=label, unit="", disable=None if total else True, leave=True)

    def advance(done: int) -> None:
        bar.update(done)
        if bar.n >= total:
            bar.close()

    return advance


def _load(files: Sequence[str]) -> tuple[list["Measured"], bool]:
    """What could be loaded, and whether that is all; the rest is said."""
    from torchbrdf.measured import load_all

    bad: list[DataError] = []
    groups = load_all(files, bad=bad)
    for error in bad:
        print(f"torchbrdf: left out: {error}", file=sys.stderr)
    return groups, not bad


def _print_facts(facts: dict[str, object], indent: str) -> None:
    for key, value in facts.items():
        if isinstance(value, dict):
            print(f"{indent}{key}")
            _print_facts(value, indent + "  ")
        else:
            print(f"{indent}{key:42s} {_short(value)}")


def _short(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        shown = [_short(item) for item in value[:6]]
        return "(" + ", ".join(shown) + (", ..." if len(value) > 6 else "") + ")"
    return str(value)


def _parser(parser: argparse.ArgumentParser, description: str) -> argparse.ArgumentParser:
    parser.description = description
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    return parser
