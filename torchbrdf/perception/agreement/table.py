"""The benchmark's table: losses by statistics, with intervals, ceilings and paired differences."""

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, SupportsFloat

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
CLOSE_METHOD = FACTORS
"""A method so close to its materials that how it does on one and on another says little; more so on stand-ins."""

LABELS = {
    "majority": "triplets: majority",
    "votes": "triplets: single votes",
    "pairs": "approximations: pairs of one material",
    "apart": "pairs apart by more than two standard errors",
    "across": "one method, across materials",
}
HEADS = {"majority": "triplets", "votes": "votes", "pairs": "pairs", "apart": "apart", "across": "across"}
"""Labels of a word."""


@dataclass(frozen=True)
class Statistic:
    """Statistic of the benchmark, one column of its table.

    rows: which of the distances of its data set it is about, all if None. ceiling: `(1, C)`, what disagreement between
    people lets anything reach of each comparison, or None where that is not known. variant: how its methods differ
    from those of the main columns, such as "without WARD"; main: the column that it varies.
    """

    key: str
    label: str
    data: Literal["triplets", "opinions"]
    comparisons: DistanceComparisons
    ceiling: Tensor | None
    materials: int
    rows: Tensor | None = None
    variant: str = ""
    main: str = ""

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

    @property
    def ranked(self) -> list[int]:
        """Places of the losses, the best first by the first statistic that they have."""
        return sorted(range(len(self.losses)), key=lambda k: self.value[k].nan_to_num(-1).tolist(), reverse=True)

    def text(self) -> str:
        """The main columns as lines to print, the best first: agreement with its interval, and the ceilings below."""
        shown = [s for s, one in enumerate(self.statistics) if not one.variant]
        rows = [["", *(f"{HEADS[self.statistics[s].key]} ({self.statistics[s].count:,})" for s in shown)]]
        rows += [
            [self.losses[k], *(span(self.value[k, s], self.low[k, s], self.high[k, s]) for s in shown)]
            for k in self.ranked
        ]
        ends = (self.ceiling, self.ceiling_low, self.ceiling_high)
        rows.append(["ceiling: people", *(span(*(part[s] for part in ends)) for s in shown)])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)

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


def span(value: SupportsFloat, low: SupportsFloat, high: SupportsFloat, *, sign: str = "") -> str:
    """A share and its interval in words, "none" where there is no share.

    Example:
        >>> span(0.8, 0.75, 0.84)
        '0.800 (0.750 to 0.840)'
    """
    if not math.isfinite(float(value)):
        return "none"
    return f"{float(value):{sign}.3f} ({float(low):{sign}.3f} to {float(high):{sign}.3f})"


def statistics_of(
    triplets: Triplets,
    opinions: Opinions,
    odd: Collection[str] = (ODD_METHOD,),
    close: Collection[str] = (CLOSE_METHOD,),
) -> list[Statistic]:
    """Statistics of the benchmark: of the triplets, of the opinions, and of these with other methods.

    The main columns are about all methods but those that are odd, and, across materials, those that are close. Others
    leave out one method more, or have one that is odd or close back. A statistic without any comparison is left out.

    Args:
        triplets: Questions about materials.
        opinions: Of approximations.
        odd: Methods that no main column is about.
        close: Methods that the main columns of pairs of one material are about, and that across materials is not.
    """
    count = len(triplets.materials)
    found = [
        Statistic(
            "majority",
            LABELS["majority"],
            "triplets",
            statistics.majorities(triplets),
            statistics.majority_of_people(triplets),
            count,
        ),
        Statistic(
            "votes",
            LABELS["votes"],
            "triplets",
            statistics.single_votes(triplets),
            statistics.majority_of_votes(triplets),
            count,
        ),
    ]
    for variant, methods in _variants(list(dict.fromkeys(opinions.methods)), odd, close):
        found += [_of_opinions(opinions, key, variant, chosen) for key, chosen in methods.items()]
    return [one for one in found if len(one.comparisons)]


def _variants(
    methods: list[str], odd: Collection[str], close: Collection[str]
) -> Iterator[tuple[str, dict[str, list[str]]]]:
    """Which methods each column of opinions is about: the main columns, then each variant's that differ from them."""
    main = [method for method in methods if method not in odd]
    apart = [method for method in main if method not in close]
    yield "", {"pairs": main, "apart": main, "across": apart}
    for out in main:
        fewer = {key: [method for method in own if method != out] for key, own in (("pairs", main), ("across", apart))}
        varied = {"pairs": fewer["pairs"], "apart": fewer["pairs"], "across": fewer["across"]}
        yield f"without {out}", varied if out in apart else {key: varied[key] for key in ("pairs", "apart")}
    for back in methods:
        if back not in apart:
            more = {"across": [*apart, back]}
            yield f"with {back}", {"pairs": [*main, back], "apart": [*main, back], **more} if back in odd else more


def _of_opinions(opinions: Opinions, key: str, variant: str, methods: Collection[str]) -> Statistic:
    rows = [row for row, method in enumerate(opinions.methods) if method in methods]
    own = opinions.select(rows)
    if key == "across":
        comparisons = statistics.across_materials(own)
    else:
        comparisons = statistics.same_material(own, well_separated=key == "apart")
    return Statistic(
        f"{key}_{variant.lower().replace(' ', '_')}" if variant else key,
        f"{LABELS[key]}, {variant}" if variant else LABELS[key],
        "opinions",
        comparisons,
        statistics.expected_order(comparisons, own),
        len(set(own.materials)),
        torch.tensor(rows, dtype=torch.long, device="cpu"),
        variant,
        key,
    )


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
