"""`torchbrdf score`: metrics of BRDFs against what people answered."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from torchbrdf.bounds import SEEDS
from torchbrdf.cli.common import Commands, Options, add_memory, described, say, whole
from torchbrdf.cli.progress import progress_bar
from torchbrdf.errors import UsageError
from torchbrdf.kinds import DIFFERENCES, check_metric

if TYPE_CHECKING:
    from torchbrdf.losses import Loss
    from torchbrdf.perception import BenchmarkData

DESCRIPTION = """\
Say how often metrics order materials, and approximations of them, as people do: the open table of BRDF metrics.

  torchbrdf score --materials MERL/ --human HUMAN/ --fits published_fits.json
  torchbrdf score --materials MERL/ --human HUMAN/ --fits published_fits.json --metric my_metrics:distance
  torchbrdf score --quick --metric my_metrics.py:distance          made-up answers, to see that it works

A metric is the name of a registered loss, or a function or a module of your own, module:name or file.py:name: it is
called with (prediction, target, pairs), values (B, N, 3) in 1/sr, and returns distances (B,). Its module runs as the
program that it is, with all that you may do: give only what you trust.

Columns: triplets (which of two materials is more like a third: what most voted), their single votes, pairs of
approximations of one material, those clearly apart, and two materials under one method. Beside each share its 95 %
interval over materials; last what people's own disagreement lets anything reach. `torchbrdf run human_benchmark` makes
a page of it, with methods left out.
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(commands.add_parser("score", help="score metrics by what people answered"), DESCRIPTION)
    parser.add_argument(
        "--metric",
        action="append",
        default=[],
        metavar="NAME",
        help="a registered loss, module:name or file.py:name, which runs; may be given again (default: all losses)",
    )
    parser.add_argument("--difference", action="append", default=[], metavar="NAME",
                        help="an image difference of pictures of a sphere; may be given again")  # fmt: skip
    parser.add_argument("--size", type=whole(16, 512), default=64, help="pixels of a side of the pictures")
    parser.add_argument("--materials", default="", help="a folder with the 100 MERL tables")
    parser.add_argument("--human", default="", help="a folder with the published answers")
    parser.add_argument("--quick", action="store_true", help="made-up answers about the bundled stand-ins")
    for name, said in (
        ("fits", "published parameters of approximations"),
        ("factors", "non-parametric factors of approximations"),
        ("triplets", "the file of triplets in HUMAN"),
        ("opinions", "the file of opinions in HUMAN"),
    ):
        parser.add_argument(f"--{name}", help=said)
    parser.add_argument("--samples", type=whole(2, 200_000), help="pairs, uniform in three angles (default: 6000)")
    parser.add_argument("--replicates", type=whole(2, 100_000), default=1000, help="of the bootstrap")
    parser.add_argument("--seed", type=whole(*SEEDS), default=0, help="of pairs and bootstrap")
    parser.add_argument("--out", help="a folder for scores.csv and scores.json, with methods left out")
    add_memory(parser)
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf score`."""
    for name in options.metric:
        check_metric(name)
    for name in options.difference:
        DIFFERENCES.check(name)
    for key in ("materials", "human"):
        if not (options.quick or getattr(options, key)):
            raise UsageError(f"score: --{key}: expected a folder; --quick runs on made-up answers")

    from torchbrdf.experiment.benchmark import write_scores
    from torchbrdf.perception import score, uniform_pairs
    from torchbrdf.perception.datasets.synthetic import SYNTHETIC, synthetic_benchmark

    # One that was asked for has to work; of all that there are, those that fail are left out.
    left_out: dict[str, str] = {}
    metrics = _metrics(options, left_out)
    data = synthetic_benchmark(seed=options.seed) if options.quick else _read(options)
    samples = options.samples or (500 if options.quick else 6000)
    table = score(
        metrics,
        data,
        pairs=uniform_pairs(samples, seed=options.seed),
        replicates=options.replicates,
        seed=options.seed,
        progress=progress_bar("metrics"),
        left_out=None if options.metric else left_out,
    )
    for name, why in left_out.items():
        say(f"torchbrdf: {name} is left out: {why}", to=sys.stderr)
    if not table.losses:
        raise UsageError("score: no metric could be scored")
    if options.out:
        write_scores(Path(options.out), table)
    if options.quick:
        say(SYNTHETIC)
    elif data.stand_in:
        say("stand-ins: not all tables are MERL's own, while people saw the measured materials")
    if data.left_out:
        say(f"left out, as nothing gives their values: {', '.join(data.left_out)}")
    for line in table.text().splitlines():
        say(line)
    return 0


def _metrics(options: Options, left_out: dict[str, str]) -> "dict[str, Loss]":
    """The metrics that are asked for, by their names in the table."""
    from torchbrdf.losses import LOSSES
    from torchbrdf.perception import FORMULAS, find_metric, metric_label
    from torchbrdf.render import Camera, Environment, RenderedLoss, Scene, sphere

    found: dict[str, Loss] = {}
    for text in options.metric or ([] if options.difference else (*LOSSES, *FORMULAS)):
        if metric_label(text) in found:
            raise UsageError(f"score: --metric: expected {metric_label(text)} once, found twice")
        try:
            found[metric_label(text)] = find_metric(text)
        except UsageError as error:
            if options.metric:
                raise
            left_out[text] = str(error)
    if options.difference:
        scene = Scene(sphere(), Camera(), Environment.default(), size=options.size)
        for name in options.difference:
            loss = RenderedLoss(scene, name, reduction="none")
            found[loss.registered_name] = loss
    return found


def _read(options: Options) -> "BenchmarkData":
    """What the recipe human_benchmark would read, with its defaults."""
    from dataclasses import fields

    from torchbrdf.experiment import HumanAnswersRecipe
    from torchbrdf.perception import read_benchmark_data

    defaults = {one.name: one.default for one in fields(HumanAnswersRecipe)}
    keys = ("materials", "human", "fits", "factors", "triplets", "opinions")
    return read_benchmark_data(*(str(getattr(options, key) or defaults[key]) for key in keys))
