"""`torchbrdf fit`."""

from typing import TYPE_CHECKING

from torchbrdf.bounds import SEEDS
from torchbrdf.cli.common import (
    Commands,
    Options,
    add_bands,
    add_memory,
    add_reading,
    check_files,
    described,
    number,
    read_settings,
    short,
    whole,
)
from torchbrdf.cli.many import MOST_LINES, add_working, check_working, fit_all, load_files_later, say_summary
from torchbrdf.cli.progress import progress_bar
from torchbrdf.errors import UsageError
from torchbrdf.kinds import DIFFERENCES, DIFFUSE_MODES, INTERVALS, LOSSES, STRATEGIES, check_model, check_word

if TYPE_CHECKING:
    from torchbrdf.lobes import FitRecord
    from torchbrdf.losses import Loss

FITS, TABLE = "fits.json", "fits.csv"
RENDERED, COMBINED = "rendered", "combined"
# The options that only losses of pictures have, and what they are if they are not given.
OF_RENDERED = {"difference": "delta_e76", "environment": "grove", "shape": "blob", "size": 128, "lights": 1024}
OF_PICTURES = {RENDERED: OF_RENDERED, COMBINED: OF_RENDERED | {"size": 24}}
# Of lobes with a grain, whose pictures are of every pixel's own pairs; they are known by their names, before torch is.
GRAIN, OF_GRAIN = "_anisotropic", {"size": 24, "lights": 256}

DESCRIPTION = """\
Fit a model to measured BRDFs: files of eighteen formats (MERL, RGL, ASTM E1392, CSV and others, told by their content),
fits.json, or folders.

  torchbrdf fit nickel.binary --model ward --lobes 2
  torchbrdf fit MERL/ --model cook_torrance --loss cosine_rms --out fits/
  torchbrdf fit nickel.binary --model ward --loss rendered --difference delta_e76
  torchbrdf fit nickel.binary --model ward --loss rendered --strategy image_driven
  torchbrdf fit nickel.binary --model ward --loss combined

The last three compare pictures: in every step; of fits under several metrics, of which the nearest is kept; and small
ones beside the learned metric. A folder is fitted in blocks, and each is written as it is done: run the command again,
and it goes on from there. On several machines:

  torchbrdf fit MERL/ --out fits/ --executor dask --scheduler tcp://login:8786
  torchbrdf fit MERL/ --out fits-3/ --shard 3/8      one of eight jobs; torchbrdf collect puts them together
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(commands.add_parser("fit", help="fit a model to measured BRDFs"), DESCRIPTION, "files")
    parser.add_argument("files", nargs="+", help="measured BRDFs, or folders of them")
    parser.add_argument(
        "--model", default="ward", help="ward (default), ggx, ..., or all components, such as oren_nayar+ggx+ggx"
    )
    parser.add_argument(
        "--lobes", type=whole(1, 8), help="specular lobes beside the diffuse term, 1 to 8 (default 2, or those named)"
    )
    parser.add_argument(
        "--loss",
        default="learned",
        help="learned (default), rms, cosine_rms, cube_root, compressed, log, ..., rendered, combined",
    )
    of = "of losses of pictures:"
    parser.add_argument("--difference", help=f"{of} delta_e76 (default), log_hdr, psnr, ssim, flip, ...")
    parser.add_argument("--environment", help=f"{of} grove (default), studio, or a file")
    parser.add_argument("--shape", help=f"{of} blob (default), sphere, or a mesh file")
    parser.add_argument("--size", type=whole(8, 1024), help=f"{of} pixels of a side, 8 to 1024 (128; combined 24)")
    parser.add_argument("--lights", type=whole(1, 16384), help=f"{of} lights in the scene, 1 to 16384 (default 1024)")
    parser.add_argument(
        "--strategy",
        default="global",
        help="global (default): the best fit; staged: the paper's way; image_driven: of fits under several metrics the "
        "nearest; tabulated_monotone, tabulated_smooth: of distribution_based models",
    )
    parser.add_argument(
        "--diffuse",
        help="the diffuse albedo: 45:0, measured and held; fit, with the rest; by default what looks best under the "
        "loss, fit for learned and pictures, 45:0 for others",
    )
    parser.add_argument(
        "--max-theta", type=number(1, 90), default=80.0, help="largest angle from the normal, 1 to 90 (default 80)"
    )
    parser.add_argument(
        "--samples",
        type=samples,
        default=20_000,
        help="pairs of the search, up to 10 million; 0 or all: all (default 20000)",
    )
    parser.add_argument("--seed", type=whole(*SEEDS), default=0, help="seed of the subset (default 0)")
    parser.add_argument(
        "--intervals",
        default="gauss_newton",
        help="95 %% intervals of parameters, in fits.json: gauss_newton (default; of losses of squares), bootstrap "
        "(of 100 refits, too), none",
    )
    parser.add_argument("--out", help="folder for the fits; those that it holds already are not made again")
    add_working(parser)
    add_memory(parser)
    add_reading(parser)
    add_bands(parser)
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf fit`."""
    _check_names(options)
    check_working(options)
    check_files(options.files)

    from torchbrdf.experiment.labels import difference_label, diffuse_label
    from torchbrdf.files import destination, writable
    from torchbrdf.fitting import Batches
    from torchbrdf.lobes import make_model
    from torchbrdf.perception.discrimination.words import INTERVAL, MEANING, scale

    STRATEGIES[options.strategy]
    model = make_model(options.model, options.lobes)
    DIFFERENCES[options.difference]()  # which says if it needs an extra that is not installed
    out = writable(options.out) if options.out else None
    # All files first: what is wrong with one is said before there is any work.
    if out is not None:
        for name in (FITS, TABLE):
            destination(out / name)
    batches = Batches(
        model,
        _loss(options),
        out=out,
        reading=read_settings(options),
        strategy=options.strategy,
        diffuse=options.diffuse,
        max_theta=options.max_theta,
        samples=options.samples,
        seed=options.seed,
        intervals=options.intervals,
    )
    groups, complete = load_files_later(options)
    if not groups:
        return 1
    found, all_fitted = fit_all(batches, groups, options, progress_bar("fits"))
    if batches.loss.scene_summary:
        print(f"pictures of {batches.loss.scene_summary}")
    if found.count > MOST_LINES:
        say_summary(found)
    else:
        diffuse = diffuse_label(batches.settings["diffuse"])
        print(f"{'material':32s} {'error':>10s}  {'told apart by':22s} {'status':14s} parameters, {diffuse}")
        shares = found.shares(groups)
        for record in found.records:
            rest = [f"{key} {short(value)}" for key, value in record.parameters.items()]
            rest += [f"({note})" for note in _notes(record)]
            told = "" if (share := shares.get(record.material)) is None else share.brief
            print(f"{record.material:32s} {short(record.error):>10s}  {told:22s} {record.status:14s} {'  '.join(rest)}")
        if any(shares.values()):
            print(f"{MEANING} {INTERVAL}")
    if (
        line := scale(options.difference, f"{difference_label(options.difference)} of pictures")
        if options.loss == RENDERED
        else ""
    ):
        print(line)
    if out is not None:
        print(out / FITS if (out / FITS).exists() and options.shard is None else out)
    return 0 if complete and all_fitted else 1


def samples(text: str) -> int | None:
    """The type of an option that is a number of pairs; None for all, which was 0 before.

    Example:
        >>> samples("500"), samples("all")
        (500, None)
    """
    return None if text.lower() in ("all", "none", "0") else whole(1, 10_000_000)(text)


def _check_names(options: Options) -> None:
    """A UsageError for an unknown name, and for options that another loss has, before torch is imported."""
    STRATEGIES.check(options.strategy)
    if options.diffuse is not None:
        check_word("--diffuse", options.diffuse, DIFFUSE_MODES)
    check_word("--intervals", options.intervals, INTERVALS)
    check_model(options.model)
    LOSSES.check(options.loss, *OF_PICTURES)
    defaults = OF_PICTURES.get(options.loss, OF_RENDERED) | (OF_GRAIN if GRAIN in options.model else {})
    for key, default in defaults.items():
        if getattr(options, key) is None:
            setattr(options, key, default)
        elif options.loss not in OF_PICTURES:
            expected = f"expected only with --loss {' or '.join(OF_PICTURES)}"
            raise UsageError(f"--{key}: {expected}, found --loss {options.loss}")
    DIFFERENCES.check(options.difference)


def _loss(options: Options) -> "Loss":
    """A loss by name, or pictures of the scene that the options describe."""
    from torchbrdf.losses import CombinedLoss, LearnedLoss, make_loss

    if options.loss not in OF_PICTURES:
        return make_loss(options.loss)
    from torchbrdf.lobes import make_model
    from torchbrdf.render import Environment, RenderedLoss, Scene, cache_folder, find_mesh, small_scene

    difference = DIFFERENCES[options.difference]()
    light = Environment.find(options.environment)
    mesh = find_mesh(options.shape)
    has_grain = make_model(options.model, options.lobes).is_anisotropic
    settings = {"size": options.size, "light_samples": options.lights, "cache": cache_folder(), "oriented": has_grain}
    if options.loss == COMBINED:
        return CombinedLoss(LearnedLoss(), RenderedLoss(small_scene(mesh, light, **settings), difference))
    return RenderedLoss(Scene(mesh, None, light, **settings), difference)


def _notes(record: "FitRecord") -> list[str]:
    """What else there is to say of a fit."""
    notes = [record.reason] if record.reason else []
    black = record.error == 0 and not any(record.parameters.get("diffuse", [1.0]))
    notes += ["no value is above 0, which every model fits"] if black else []
    notes += [f"under {record.chosen}"] if record.chosen else []
    notes += [f"an error as of the noise alone, {short(record.noise['error'])}"] if record.has_reached_noise else []
    notes += [f"{record.ties} other minim{'um' if record.ties == 1 else 'a'} within 1 %"] if record.ties else []
    notes += [f"at a bound: {', '.join(record.at_bounds)}"] if record.at_bounds else []
    return notes + ([f"not determined: {', '.join(record.undetermined)}"] if record.undetermined else [])
