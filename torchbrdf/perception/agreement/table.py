"""The benchmark's table: losses by statistics, with intervals, ceilings and paired differences."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from torchbrdf.bootstrap import percentile_interval, resample_counts
from torchbrdf.perception.agreement import statistics
from torchbrdf.perception.agreement.statistics import DistanceComparisons
from torchbrdf.perception.datasets.factors import FACTORS
from torchbrdf.perception.datasets.opinions import Opinions
from torchbrdf.perception.datasets.triplets import Triplets

ODD_METHOD = "ABC"
"""A method whose published parameters look otherwise than what people saw."""
LEFT_OUT = (FACTORS, ODD_METHOD)
"""Methods that the main columns leave out; others have each of them back, one at a time."""

LABELS = {
    "majority": "triplets: majority",
    "votes": "triplets: single votes",
    "pairs": "approximations: pairs of one material",
    "apart": "pairs apart by more than two standard errors",
    "across": "one method, across materials",
}


@dataclass(frozen=True)
class Statistic:
    """Statistic of the benchmark, one column of its table.

    rows: which of the distances of its data set it is about, all if None. ceiling: `(1, C)`, what disagreement between
    people lets anything reach of each comparison, or None if it is about no single answers. added: the method that it
    has beside those of the main columns.
    """

    key: str
    label: str
    data: Literal["triplets", "opinions"]
    comparisons: DistanceComparisons
    ceiling: Tensor | None
    materials: int
    rows: Tensor | None = None
    added: str = ""

    @property
    def count(self) -> int:
        """How many questions, votes or pairs it is about."""
        return round(float(self.comparisons.weight.sum()))


@dataclass(frozen=True)
class Distances:
    """Distances of one loss: `triplets` (K, K) at [reference, candidate], `opinions` (R,); None where it has none."""

    triplets: Tensor | None
    opinions: Tensor | None


@dataclass(frozen=True)
class Table:
    """Table of the benchmark: agreement of L losses with people by S statistics.

    value `(L, S)`, low and high `(L, S)`: 95 % intervals over materials; nan where a loss has no distances.
    ceiling, ceiling_low, ceiling_high `(S,)`, nan where there is none. replicates: `(S, B, L)`.
    """

    losses: list[str]
    statistics: list[Statistic]
    value: Tensor
    low: Tensor
    high: Tensor
    ceiling: Tensor
    ceiling_low: Tensor
    ceiling_high: Tensor
    replicates: Tensor

    def difference(self, loss: str, other: str) -> tuple[Tensor, Tensor, Tensor]:
        """How much more often a loss agrees with people than another, `(S,)`, and the ends of its 95 % interval.

        It is paired: both losses see the same drawn materials.
        """
        one, two = self.losses.index(loss), self.losses.index(other)
        ends = percentile_interval((self.replicates[:, :, one] - self.replicates[:, :, two]).T)
        return self.value[one] - self.value[two], ends[:, 0], ends[:, 1]

    def records(self) -> list[dict[str, Any]]:
        """One record for each loss and statistic."""
        return [
            {
                "loss": loss,
                "statistic": one.key,
                "comparisons": one.count,
                "agreement": float(self.value[k, s]),
                "low": float(self.low[k, s]),
                "high": float(self.high[k, s]),
                "ceiling": None if one.ceiling is None else float(self.ceiling[s]),
            }
            for k, loss in enumerate(self.losses)
            for s, one in enumerate(self.statistics)
            if bool(self.value[k, s].isfinite())
        ]


def statistics_of(triplets: Triplets, opinions: Opinions, without: Iterable[str] = LEFT_OUT) -> list[Statistic]:
    """Statistics of the benchmark: of the triplets, of the opinions without some methods, then with each of these.

    A statistic without any comparison is left out.
    """
    count = len(triplets.materials)
    found = [
        Statistic("majority", LABELS["majority"], "triplets", statistics.majorities(triplets), None, count),
        Statistic(
            "votes",
            LABELS["votes"],
            "triplets",
            statistics.single_votes(triplets),
            statistics.majority_of_votes(triplets),
            count,
        ),
    ]
    own_tables = [method for method in without if method in opinions.methods]
    for added in ("", *own_tables):
        rows = [row for row, method in enumerate(opinions.methods) if method == added or method not in own_tables]
        found += _of_opinions(opinions.select(rows), torch.tensor(rows, dtype=torch.long, device="cpu"), added)
    return [one for one in found if len(one.comparisons)]


def _of_opinions(opinions: Opinions, rows: Tensor, added: str) -> list[Statistic]:
    suffix, said = (f"_with_{added.lower()}", f", with {added}") if added else ("", "")
    made = {
        "pairs": statistics.same_material(opinions),
        "apart": statistics.same_material(opinions, well_separated=True),
        "across": statistics.across_materials(opinions),
    }
    materials = len(set(opinions.materials))
    return [
        Statistic(
            key + suffix,
            LABELS[key] + said,
            "opinions",
            comparisons,
            statistics.expected_order(comparisons, opinions),
            materials,
            rows,
            added,
        )
        for key, comparisons in made.items()
    ]


def tabulate(
    columns: list[Statistic], distances: Mapping[str, Distances], replicates: int = 1000, seed: int = 0
) -> Table:
    """Tabulate how well losses agree with people, with intervals over materials; the same are drawn for all losses.

    Args:
        columns: Statistics, as `statistics_of` gives them.
        distances: By loss.
        replicates: Of the bootstrap.
        seed: Of the bootstrap.
    """
    losses = list(distances)
    shape = (len(columns), len(losses))
    value, ceiling = (
        torch.full(shape, torch.nan, dtype=torch.float64, device="cpu"),
        torch.full((len(columns), 3), torch.nan, dtype=torch.float64, device="cpu"),
    )
    drawn = torch.full((len(columns), replicates, len(losses)), torch.nan, dtype=torch.float64, device="cpu")
    for s, one in enumerate(columns):
        resamples = resample_counts(one.materials, replicates, seed)
        known = [k for k, loss in enumerate(losses) if getattr(distances[loss], one.data) is not None]
        rights = []
        for k in known:
            own: Tensor = getattr(distances[losses[k]], one.data).flatten()
            rights.append(one.comparisons.concordant((own if one.rows is None else own[one.rows])[None]))
        if known:
            right = torch.cat(rights)
            value[s, known] = one.comparisons.agreement_rate(right)
            drawn[s][:, known] = one.comparisons.agreement_rate(right, resamples)
        if one.ceiling is not None:
            ends = percentile_interval(one.comparisons.agreement_rate(one.ceiling, resamples))[0]
            ceiling[s] = torch.cat([one.comparisons.agreement_rate(one.ceiling), ends])
    ends = torch.stack([percentile_interval(part) for part in drawn]) if losses else drawn.new_empty(*shape, 2)
    return Table(
        losses,
        columns,
        value=value.T,
        low=ends[..., 0].T,
        high=ends[..., 1].T,
        ceiling=ceiling[:, 0],
        ceiling_low=ceiling[:, 1],
        ceiling_high=ceiling[:, 2],
        replicates=drawn,
    )
