"""Two or more materials or fits beside each other: metrics, pictures, and where they differ most."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.color import luminance
from torchbrdf.errors import DataError, TorchbrdfError, UsageError, shown
from torchbrdf.experiment.extrapolation import is_extrapolated
from torchbrdf.experiment.items import list_items
from torchbrdf.experiment.labels import model_label
from torchbrdf.experiment.matching.judge import Brdf, Figures, Judge, values_of
from torchbrdf.lobes import FitRecord, Lobe
from torchbrdf.losses import LOSSES
from torchbrdf.measured import FORMATS, Measured
from torchbrdf.measured.find import by_format, find_files
from torchbrdf.measured.load import check_settings, load_groups
from torchbrdf.measured.standin import all_round
from torchbrdf.pairs import Pairs
from torchbrdf.perception import FORMULAS, Share, find_metric, told_apart, uniform_pairs
from torchbrdf.render import Scene, blob, unseen_scenes

# Degrees: what is near the highlight, and what is grazing.
HIGHLIGHT, GRAZING = 10.0, 65.0
# Pairs of directions that metrics need at least.
LEAST = 100
SAME = 1e-5
"""Relative differences that are rounding, in single precision."""
MOST = 128
"""Materials on a page."""

Source = Brdf | str | os.PathLike[str]


@dataclass(frozen=True)
class Subject:
    """What is compared.

    Args:
        label: What it is, for people.
        brdf: One material, a fit or a model.
    """

    label: str
    brdf: Brdf


@dataclass(frozen=True)
class Place:
    """A pair of directions at which two materials differ, as far as any in its part.

    Args:
        part: Near the highlight, at grazing angles, or elsewhere.
        light: Of the light, degrees from the normal.
        viewer: The same of the viewer.
        around: Azimuth between them, degrees; 180 is the mirror's side.
        reference: Values there, linear RGB in 1/sr.
        other: The same of what is compared.
    """

    part: str
    light: float
    viewer: float
    around: float
    reference: tuple[float, float, float]
    other: tuple[float, float, float]

    @property
    def words(self) -> str:
        """All of it in a sentence."""
        both = torch.tensor([self.reference, self.other], dtype=torch.float32, device="cpu")
        one, two = luminance(both).tolist()
        ratio = f", {100 * two / one:.0f} % of it" if one > 0 else ""
        return (
            f"{self.part}: light at {self.light:.0f}\u00b0, viewer at {self.viewer:.0f}\u00b0, "
            f"{self.around:.0f}\u00b0 around: {one:.3g} of the reference, {two:.3g} here{ratio} (luminance, 1/sr)"
        )


@dataclass(frozen=True)
class Compared:
    """A material beside the reference.

    Args:
        subject: The material.
        metrics: Distances from the reference, by the name of a metric; nan where too little was measured of both.
        pairs: How many pairs of directions those are over, of how many.
        figures: Of pictures, by scene.
        places: Where it differs most; nowhere, where it is the same.
        is_same: Whether values are the same at all of these pairs, of which there are enough, but for rounding.
    """

    subject: Subject
    metrics: Mapping[str, float]
    pairs: tuple[int, int]
    figures: Mapping[str, Figures]
    places: Sequence[Place] = field(default_factory=list)
    is_same: bool = False

    @property
    def where(self) -> list[str]:
        """Where it differs most, in words."""
        same = ["Nowhere: the same values at all of these directions."] if self.is_same else []
        return same or [place.words for place in self.places]

    def told(self, metric: str) -> Share | None:
        """The share of observers who would tell it from the reference, by a metric; None where that is not known."""
        return told_apart(metric, self.metrics[metric]) if self.metrics[metric] >= 0 else None


def scenes_of(size: int = 128, cache: Path | None = None) -> dict[str, Scene]:
    """The two scenes of pictures: the blob in the grove, and a sphere in the studio.

    Args:
        size: Pixels of a side.
        cache: A folder where transports are kept.
    """
    name, studio = next(iter(unseen_scenes(size, cache).items()))
    return {"blob, grove": Scene(blob(), size=size, cache=cache), name: studio}


def find_subjects(
    sources: Sequence[Source], bad: list[TorchbrdfError], settings: Mapping[str, str] | None = None
) -> list[Subject]:
    """What files hold, and what is given, in that order, each under a label of its own.

    Args:
        sources: Files, folders, measured materials, fits and lobes.
        bad: Takes the errors of files that cannot be read.
        settings: What files do not say, as of `torchbrdf.load`.

    Raises:
        UsageError: Something is none of these.
    """
    groups: list[Measured] = []
    others: dict[int, list[Subject]] = {}
    unread: list[DataError] = []
    kinds = [
        by_format(find_files(one, unread), unread) if isinstance(one, str | os.PathLike) else {} for one in sources
    ]
    check_settings([name for own in kinds for name in own], settings if any(kinds) else None)
    for source, own in zip(sources, kinds, strict=True):
        if isinstance(source, Measured):
            groups.append(source)
        elif isinstance(source, FitRecord):
            others.setdefault(len(groups), []).append(
                Subject(f"{source.material}: {model_label(source.model)}", source)
            )
        elif isinstance(source, Lobe):
            others.setdefault(len(groups), []).append(Subject("a model", source))
        elif isinstance(source, str | os.PathLike):
            groups += load_groups(own, unread, settings=_told(own, settings))
        else:
            raise UsageError(f"compare: expected files, materials, fits or lobes, found {shown(source)}")
    bad += unread
    items = iter(list_items(groups))
    found: list[Subject] = []
    for k, group in enumerate([*groups, None]):
        found += others.get(k, [])
        if group is not None:
            found += [Subject(next(items).label, group.batch([row])) for row in range(len(group))]
    return found


def _told(kinds: Iterable[str], settings: Mapping[str, str] | None) -> dict[str, str]:
    """The settings that files of some formats take."""
    return {
        key: value for key, value in (settings or {}).items() if any(key in FORMATS[name].settings for name in kinds)
    }


def compared(reference: Judge, name: str, subject: Subject, pairs: Pairs | None = None) -> Compared:
    """A material beside the reference.

    Args:
        reference: The reference in its scenes.
        name: What errors call the reference.
        subject: The material.
        pairs: Where metrics are taken, `(N,)`; by default `uniform_pairs()`, as where people's answers were.

    Raises:
        DataError: A material has no values.
    """
    pairs = all_round((uniform_pairs() if pairs is None else pairs).unsqueeze()).to(dtype=torch.float32)
    target, values = values_of(reference.measured, pairs), values_of(subject.brdf, pairs)
    if not values.isfinite().all() or not target.isfinite().all():
        raise DataError(f"{subject.label}, beside {name}: expected finite values, found others")
    known = ~(is_extrapolated(reference.measured, pairs) | is_extrapolated(subject.brdf, pairs))
    rows = known.nonzero()[:, 0]
    own = pairs.select(samples=rows), target[:, rows], values[:, rows]
    is_same = len(rows) >= LEAST and torch.allclose(own[1], own[2], rtol=SAME, atol=0)
    return Compared(
        subject,
        _metrics(*own),
        (len(rows), len(pairs)),
        reference.figures(subject.brdf),
        _places(*own) if len(rows) and not is_same else [],
        is_same,
    )


@torch.no_grad()
def _metrics(pairs: Pairs, target: Tensor, values: Tensor) -> dict[str, float]:
    """Every registered metric."""
    found = {}
    for name in (*LOSSES, *FORMULAS):
        found[name] = float(find_metric(name)(values, target, pairs)) if len(pairs) >= LEAST else float("nan")
    return found


def _places(pairs: Pairs, target: Tensor, values: Tensor) -> list[Place]:
    """Where values times the cosines differ most, by their cube roots, in three parts of all directions."""
    cosines = (pairs.cos_i * pairs.cos_o)[0]
    roots = [(luminance(one[0]) * cosines).clamp_min(0) ** (1 / 3) for one in (target, values)]
    off = (roots[0] - roots[1]).abs()
    half = torch.rad2deg(pairs.theta_h[0])
    light, viewer = (torch.rad2deg(torch.acos(cosine[0].clamp(-1, 1))) for cosine in (pairs.cos_i, pairs.cos_o))
    low = torch.maximum(light, viewer) > GRAZING
    parts = {
        f"Near the highlight (half angles below {HIGHLIGHT:g}\u00b0)": half < HIGHLIGHT,
        f"At grazing angles (beyond {GRAZING:g}\u00b0)": low & (half >= HIGHLIGHT),
        "Elsewhere": ~low & (half >= HIGHLIGHT),
    }
    found = []
    for part, inside in parts.items():
        if not inside.any():
            continue
        k = int(torch.where(inside, off, -1).argmax())
        wi, wo = pairs.wi[0, k], pairs.wo[0, k]
        turn = torch.atan2(wi[0] * wo[1] - wi[1] * wo[0], (wi[:2] * wo[:2]).sum()).abs()
        red = tuple(target[0, k].tolist()), tuple(values[0, k].tolist())
        if float(off[k]) > SAME * float(roots[0].max()):
            found.append((float(off[k]), Place(part, float(light[k]), float(viewer[k]), float(turn.rad2deg()), *red)))
    return [place for _, place in sorted(found, key=lambda one: -one[0])]
