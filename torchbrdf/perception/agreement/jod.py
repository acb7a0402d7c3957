"""JOD scores beside distances: of the pictures that their authors compared, and of tables where there are any.

The scores are of approximations whose tables, or parameters, do not come with them, so that a metric of BRDFs cannot be
asked about them. A fit of the same model by other hands is another approximation, and looks otherwise: where this study
and that of the opinions have a model and a material in common (nine materials, under Ward and GGX), people order the
materials no more alike than by chance, as far as so few can tell; and what they think of two fits of one model by
different hands (`WARD` and `WARD-OURS` of the opinions) orders materials the same way in 69 to 84 of 100 pairs.
Stand-ins of MERL's tables are neural fits, as `nbrdf` is: what lies between two of them says nothing of either's
distance from the material. What is left without tables is the colour difference of pictures that comes with the scores;
`score_jod` scores any metric for those who have the tables.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.losses import ImageLoss
from torchbrdf.measured import Measured
from torchbrdf.pairs import Pairs
from torchbrdf.perception.agreement import statistics
from torchbrdf.perception.agreement.metrics import Metric, named_metrics
from torchbrdf.perception.agreement.scores import distances
from torchbrdf.perception.agreement.table import Distances, Statistic, Table, tabulate
from torchbrdf.perception.datasets.jod import JodScores
from torchbrdf.perception.directions import uniform_pairs

LABELS = {
    "pairs": "JOD: pairs of one material",
    "apart": "JOD: pairs more than 1 JOD apart",
    "across": "JOD: one method, across materials",
    "any": "JOD: any two approximations",
}
PICTURES = "delta_e_of_the_study"
"""The row of the colour difference that comes with the scores."""


@dataclass(frozen=True)
class JodTable:
    """Agreement with JOD scores, and what it is about.

    Args:
        scores: The rows that all of it is about.
        table: Of what was scored, the study's own pictures first.
    """

    scores: JodScores
    table: Table


def jod_statistics(scores: JodScores) -> list[Statistic]:
    """Statistics of JOD scores; without a ceiling, as how sure each is is not published."""
    pairs = statistics.same_material(scores)
    found = {
        "pairs": pairs,
        "apart": pairs.apart(scores.distance, 1.0),
        "across": statistics.across_materials(scores),
        "any": statistics.any_two(scores),
    }
    count = len(set(scores.materials))
    return [Statistic(key, LABELS[key], "opinions", own, None, count) for key, own in found.items() if len(own)]


def score_jod(
    scores: JodScores,
    metric: Metric | Mapping[str, Metric] | None = None,
    tables: Measured | None = None,
    references: Measured | None = None,
    *,
    pairs: Pairs | None = None,
    replicates: int = 1000,
    seed: int = 0,
) -> JodTable:
    """Score metrics by JOD: how often they order two approximations as people do.

    Args:
        scores: Of approximations.
        metric: As `score` takes it, but for losses of pictures; None: only the pictures of the study.
        tables: The approximations, by the names that the scores have. Rows without one are left out.
        references: The materials, by name.
        pairs: Where BRDFs are compared; None: `uniform_pairs(seed=seed)`.
        replicates: Of the bootstrap over materials.
        seed: Of the pairs and the bootstrap.

    Raises:
        UsageError: As `score` says.
        DataError: A distance is not finite; or tables of two approximations at least, or a material, are missing.

    Example:
        >>> jod = torch.tensor([9.0, 7.0, 5.0], dtype=torch.float64)
        >>> scores = JodScores(["nickel_1", "nickel_2", "nickel_3"], ["nickel"] * 3, ["a", "b", "c"], jod, 20 - 2 * jod)
        >>> score_jod(scores, replicates=2).table.value[0].tolist()  # pairs, those apart, any two
        [1.0, 1.0, 1.0]
    """
    if metric is None:
        return _tabulated(scores, {}, replicates, seed)
    if tables is None or references is None:
        raise DataError("JOD: expected the tables of approximations and materials, found none")
    known = set(tables.names)
    scores = scores.select([row for row, name in enumerate(scores.names) if name in known])
    if len(scores) < 2:
        raise DataError(f"JOD: expected tables of approximations, such as aluminium_1, found {len(scores)} of them")
    missing = sorted(set(scores.materials) - set(references.names))
    if missing:
        raise DataError(f"JOD: expected tables of the materials, found none of {', '.join(missing)}")
    pairs = uniform_pairs(seed=seed) if pairs is None else pairs
    values, materials = (
        _values(measured, names, pairs)
        for measured, names in ((tables, scores.names), (references, list(dict.fromkeys(scores.materials))))
    )
    place = {name: k for k, name in enumerate(dict.fromkeys(scores.materials))}
    target = torch.tensor([place[name] for name in scores.materials], dtype=torch.long, device="cpu")
    rows = torch.arange(len(scores), dtype=torch.long, device="cpu")
    found = {}
    for name, loss in named_metrics(metric).items():
        if isinstance(loss, ImageLoss):
            raise DataError(f"JOD: {name}: compares pictures, not values on pairs")
        found[name] = distances(loss, values, materials, pairs, rows, target)
    return _tabulated(scores, found, replicates, seed)


def _tabulated(scores: JodScores, found: Mapping[str, Tensor], replicates: int, seed: int) -> JodTable:
    rows = {PICTURES: scores.delta_e, **found}
    table = tabulate(
        jod_statistics(scores), {name: Distances(None, own) for name, own in rows.items()}, replicates, seed
    )
    return JodTable(scores, table)


def _values(measured: Measured, names: list[str], pairs: Pairs) -> Tensor:
    place = {name: k for k, name in enumerate(measured.names)}
    return measured.batch([place[name] for name in names]).at(pairs)
