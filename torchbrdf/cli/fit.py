"""`torchbrdf fit`."""

from pathlib import Path
from typing import TYPE_CHECKING

from torchbrdf.cli.common import Commands, Options, described, load_files, progress_bar, short, whole
from torchbrdf.registry import unknown

if TYPE_CHECKING:
    from torchbrdf.lobes import FitRecord
    from torchbrdf.losses import Loss

RENDERED = "rendered"

DESCRIPTION = """\
Fit a model to measured BRDFs: files (MERL .binary, RGL .bsdf, fits.json) or folders of them.

  torchbrdf fit nickel.binary --model ward --lobes 2 --loss cube_root
  torchbrdf fit MERL/ --model cook_torrance --loss cosine_rms --out fits/
  torchbrdf fit nickel.binary --model ward --loss rendered --difference delta_e76 --diffuse fit

The last compares pictures. A folder is fitted in batches, and each is written as it is done: run the command again,
and it goes on from there.
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(commands.add_parser("fit", help="fit a model to measured BRDFs"), DESCRIPTION, "files")
    parser.add_argument("files", nargs="+", help="measured BRDFs, or folders of them")
    parser.add_argument("--model", default="ward", help="ward (default), cook_torrance, ashikhmin_shirley, ...")
    parser.add_argument(
        "--lobes", type=whole(1, 8), default=2, help="specular lobes beside the diffuse one (default 2)"
    )
    parser.add_argument(
        "--loss", default="cube_root", help="rms, cosine_rms, cube_root (default), compressed, log, ..., rendered"
    )
    parser.add_argument(
        "--difference",
        default="delta_e76",
        help="of a rendered loss: delta_e76 (default), log_hdr, psnr, ssim, flip, ...",
    )
    parser.add_argument("--environment", default="grove", help="of a rendered loss: grove (default), studio, or a file")
    parser.add_argument("--shape", default="blob", help="of a rendered loss: blob (default), sphere, or a mesh file")
    parser.add_argument("--size", type=int, default=128, help="of a rendered loss: pixels of a side (default 128)")
    parser.add_argument(
        "--lights", type=int, default=1024, help="of a rendered loss: lights in the scene (default 1024)"
    )
    parser.add_argument("--strategy", default="global", help="global (default): the best fit; staged: the paper's way")
    parser.add_argument("--diffuse", default="45:0", help="45:0 (default): measured and held; fit: fitted")
    parser.add_argument("--max-theta", type=float, default=80.0, help="largest angle from the normal (default 80)")
    parser.add_argument("--samples", type=int, default=20_000, help="pairs of the search; 0: all (default 20000)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the subset (default 0)")
    parser.add_argument(
        "--out", help="folder for fits.json and fits.csv; fits that it holds already are not made again"
    )
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf fit`."""
    from torchbrdf.files import writable
    from torchbrdf.fitting import STRATEGIES, Batches
    from torchbrdf.lobes import make_model
    from torchbrdf.pairs import check_max_theta

    STRATEGIES[options.strategy]
    check_max_theta(options.max_theta)
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
    groups, complete = load_files(options.files)
    records = batches.run(groups, progress_bar("fits"))
    if batches.loss.scene_summary:
        print(f"pictures of {batches.loss.scene_summary}")
    print(f"{'material':32s} {'error':>10s}  {'status':14s} parameters")
    for record in records:
        rest = [f"{key} {short(value)}" for key, value in record.parameters.items()]
        rest += [f"({note})" for note in _notes(record)]
        print(f"{record.material:32s} {short(record.error):>10s}  {record.status:14s} {'  '.join(rest)}")
    if options.out:
        print(Path(options.out) / "fits.json")
    return 0 if complete else 1


def _loss(options: Options) -> "Loss":
    """A loss by name, or pictures of the scene that the options describe."""
    from torchbrdf.losses import LOSSES, make_loss

    if options.loss != RENDERED:
        if options.loss not in LOSSES:
            raise unknown("loss", options.loss, [*LOSSES, RENDERED])
        return make_loss(options.loss)
    from torchbrdf.images import DIFFERENCES
    from torchbrdf.render import Environment, RenderedLoss, Scene, cache_folder, find_mesh

    difference = DIFFERENCES[options.difference]()
    light = Environment.find(options.environment)
    mesh = find_mesh(options.shape)
    scene = Scene(mesh, None, light, size=options.size, light_samples=options.lights, cache=cache_folder())
    return RenderedLoss(scene, difference)


def _notes(record: "FitRecord") -> list[str]:
    """What else there is to say of a fit."""
    notes = [record.reason] if record.reason else []
    notes += [f"{record.ties} other minima within 1 %"] if record.ties else []
    return notes + ([f"at a bound: {', '.join(record.at_bounds)}"] if record.at_bounds else [])
