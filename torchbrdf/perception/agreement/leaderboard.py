"""The leaderboard: any metric of BRDFs against what people answered."""

from collections.abc import Callable, Mapping

import torch

from torchbrdf.errors import TorchbrdfError, UsageError
from torchbrdf.losses import ImageLoss, Loss
from torchbrdf.pairs import Pairs
from torchbrdf.perception.agreement.metrics import Metric, named_metrics
from torchbrdf.perception.agreement.scores import (
    BenchmarkData,
    EvaluatedBrdfs,
    evaluate_brdfs,
    score_opinions,
    score_triplets,
)
from torchbrdf.perception.agreement.table import Distances, Table, statistics_of, tabulate
from torchbrdf.perception.directions import uniform_pairs


def score(
    metric: Metric | Mapping[str, Metric],
    data: BenchmarkData,
    *,
    pairs: Pairs | None = None,
    replicates: int = 1000,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    left_out: dict[str, str] | None = None,
) -> Table:
    """Score a metric by what people answered: how often it orders two distances as they do.

    The metric is asked for the distance of each candidate from its reference, and of each approximation from its
    material: the first is the prediction, the second the target. It sees values `(B, N, 3)` in 1/sr of B of them at
    once, and returns `(B,)`; only the order of its distances matters. A loss of pictures, such as
    `torchbrdf.render.RenderedLoss(scene, reduction="none")`, sees its own scene's pictures instead.

    Args:
        metric: The name of a registered loss, `module:name`, a Loss, a function or module of (prediction, target,
            pairs) or of (prediction, target); or several of them by the names that they shall have.
        data: What people were asked about, and their answers: `read_benchmark_data`.
        pairs: Where BRDFs are compared, `(N,)`; None: `uniform_pairs(seed=seed)`, which are 6,000 uniform in (theta_i,
            theta_o, phi) below 80 degrees.
        replicates: Of the bootstrap over materials.
        seed: Of the pairs and the bootstrap.
        progress: Called with (metrics done, of how many).
        left_out: Gets those metrics that fail, with why, which are then left out; None: the first that fails raises.

    Returns:
        A table with a row for each metric and a column for each statistic: `majority` and `votes` of the triplets,
        `pairs` of approximations of one material, those well `apart`, and one method `across` materials; then the last
        three with methods left out or added. Each has a 95 % interval over materials, and what people's own
        disagreement lets anything reach.

    Raises:
        UsageError: There is no such metric; or it raises, or gives something else than a distance of each two.
        DataError: A distance is not finite.

    Example:
        >>> from torchbrdf.perception.datasets.synthetic import synthetic_benchmark
        >>> data = synthetic_benchmark(questions=20)  # made-up answers: nobody was asked
        >>> def largest(prediction, target, pairs):
        ...     return ((prediction - target).abs() * pairs.cos_i[:, None]).amax((-2, -1))
        >>> table = score({"largest": largest, "cube root": "cube_root"}, data, replicates=10)
        >>> table.losses, [one.key for one in table.statistics[:3]], table.value.shape[0]
        (['largest', 'cube root'], ['majority', 'votes', 'pairs'], 2)
    """
    if not isinstance(data, BenchmarkData):
        raise UsageError(f"score: expected BenchmarkData, as read_benchmark_data gives it, found {type(data).__name__}")
    losses = named_metrics(metric)
    if replicates < 1:
        raise UsageError(f"score: replicates: expected at least 1, found {replicates}")
    pairs = uniform_pairs(seed=seed) if pairs is None else pairs
    brdfs: EvaluatedBrdfs | None = None
    found: dict[str, Distances] = {}
    for done, (name, loss) in enumerate(losses.items(), 1):
        try:
            if isinstance(loss, ImageLoss):
                own = evaluate_brdfs(data, loss.pairs.to(dtype=torch.float32), loss)
            else:
                own = brdfs = brdfs or evaluate_brdfs(data, pairs)
            found[name] = distances_of(loss, data, own)
        except TorchbrdfError as error:
            if left_out is None:
                raise
            left_out[name] = str(error)
        if progress is not None:
            progress(done, len(losses))
    return tabulate(statistics_of(data.triplets, data.opinions), found, replicates, seed)


def distances_of(loss: Loss, data: BenchmarkData, brdfs: EvaluatedBrdfs) -> Distances:
    """Distances of a loss wherever people were asked for one."""
    return Distances(score_triplets(loss, brdfs, data.triplets), score_opinions(loss, brdfs))
