"""match.html: each match beside its measurement, the runners-up, and where the match is bad."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchbrdf.experiment.extrapolation import MOST, NOTE, extrapolated_share, hatched
from torchbrdf.experiment.labels import difference_label, loss_label
from torchbrdf.experiment.matching import Figures, Match, Tried
from torchbrdf.experiment.matching.candidates import so_many
from torchbrdf.experiment.matching.judge import Brdf, Means
from torchbrdf.experiment.matching.shortfall import Angles, Part
from torchbrdf.experiment.pictures import BRIGHTEST, COLOR_MAP, color_difference
from torchbrdf.files import write_text
from torchbrdf.images import composite
from torchbrdf.perception.discrimination.words import BEYOND, MEANING, scale
from torchbrdf.report.embed import embed_display, template

# Fits of a material whose pictures are on the page, the match among them.
PICTURED = 4
# Delta E of the brightest colour of maps: matches are nearer than most fits that people compare.
MAP_TOP = BRIGHTEST / 2
QUALITY = 90


@dataclass
class Finished:
    """A match, what was written of it, and what there is to say of it.

    Args:
        match: The match.
        chosen: The fit that was written.
        shown: What the target shows: the fit, or what it was refitted or tabulated to.
        figures: Of what is shown, by scene.
        files: That were written; none where the target could not show it.
        exact: Whether the target shows the fit itself.
        notes: Of the export.
        warnings: What no surface does, of the measurement and of the match, and what was not measured.
        parts: Where the match differs in pictures.
        angles: Where it differs by angle.
        words: Both in sentences.
    """

    match: Match
    chosen: Tried
    shown: Brdf
    figures: Mapping[str, Figures]
    files: list[Path] = field(default_factory=list)
    exact: bool = True
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)
    angles: list[Angles] = field(default_factory=list)
    words: list[str] = field(default_factory=list)

    @property
    def means(self) -> Means:
        """Figures of all scenes as one."""
        return Means.of(self.figures)

    @property
    def sentence(self) -> str:
        """The match in one line; who would pick it out knows which is the fit, as wherever a share is printed."""
        means, scenes = self.means, so_many(len(self.figures), "scene")
        beside = f"about {means.told.percent} of observers would pick it out beside the original"
        return (
            f"{self.match.material} as {self.chosen.candidate.label}: Delta E {means.mean:.1f} "
            f"({means.low:.1f} to {means.high:.1f} over {scenes}); {beside}"
        )


@dataclass(frozen=True)
class Row:
    """A fit in the table of those that were tried, in words."""

    label: str
    loss: str
    delta: list[str]
    mean: str
    seconds: str
    chosen: bool
    told: str = ""  # which pages of an earlier version had in other terms


@dataclass(frozen=True)
class Pictures:
    """Pictures of a scene as data URIs: the reference, and each fit with its map."""

    reference: str
    fits: list[str]
    maps: list[str]


@dataclass(frozen=True)
class Block:
    """What the page shows of one material: it is kept beside the fits, for a page that later matches add to."""

    name: str
    target: str
    sentence: str
    scenes: list[str]
    labels: list[str]
    rows: list[Row]
    files: list[str]
    notes: list[str]
    warnings: list[str]
    words: list[str]
    parts: list[Part]
    angles: list[Angles]
    parameters: list[tuple[str, str]]
    figures: list[tuple[str, list[str]]]
    pictures: list[Pictures]


def write_match_page(path: Path, blocks: Sequence[Block], problems: Sequence[str]) -> None:
    """Write the page, whole or not at all.

    Args:
        path: Where.
        blocks: Of the matches.
        problems: What could not be matched.
    """
    names = list(dict.fromkeys(block.name for block in blocks))
    targets = ", ".join(dict.fromkeys(block.target for block in blocks))
    title = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    page = template("match.html").render(
        title=f"Matches for {targets}: {title}",
        blocks=blocks,
        several_targets="," in targets,
        data=[{"scenes": [vars(scene) for scene in block.pictures]} for block in blocks],
        problems=list(problems),
        top=f"{MAP_TOP:g}",
        meaning=f"{MEANING} {BEYOND}",
        extrapolated=NOTE,
        scale=scale("delta_e76", difference_label("delta_e76")),
    )
    write_text(path, page)


def block_of(one: Finished, target: str) -> Block:
    """What the page shows of one material."""
    match, scenes = one.match, list(one.figures)
    pictured = [(one.chosen, one.shown), *((other, other.record) for other in _others(one)[: PICTURED - 1])]
    return Block(
        name=match.material,
        target=target,
        sentence=one.sentence,
        scenes=scenes,
        labels=[_label(tried) for tried, _ in pictured],
        rows=[_row(tried, tried is one.chosen, scenes) for tried in (one.chosen, *_others(one))],
        files=[path.name for path in one.files],
        notes=one.notes,
        warnings=one.warnings,
        words=one.words,
        parts=one.parts,
        angles=one.angles,
        parameters=_parameters(one.chosen.record.parameters),
        figures=[
            (difference_label(key), [f"{own.differences[key]:.2f}" for own in one.figures.values()])
            for key in next(iter(one.figures.values())).differences
        ],
        pictures=[_pictures(one, [brdf for _, brdf in pictured], scene) for scene in scenes],
    )


def _others(one: Finished) -> list[Tried]:
    return [tried for tried in one.match.ranked if tried is not one.chosen]


def _label(tried: Tried) -> str:
    return f"{tried.candidate.label}, {loss_label(tried.record.loss)}"


def _row(tried: Tried, chosen: bool, scenes: Sequence[str]) -> Row:
    means = tried.means
    return Row(
        label=tried.candidate.label,
        loss=loss_label(tried.record.loss),
        delta=[f"{tried.figures[name].delta_e76:.2f}" for name in scenes],
        mean=f"{means.mean:.2f}",
        seconds=f"{tried.record.seconds:.1f} s",
        chosen=chosen,
        told=means.told.percent + ("" if means.told.asked else "*"),
    )


def _pictures(one: Finished, brdfs: Sequence[Brdf], scene: str) -> Pictures:
    judge, coverage = one.match.judge, one.match.judge.scenes[scene].coverage
    reference = judge.reference(scene)
    shown = [judge.picture(brdf, scene) for brdf in brdfs]
    far = (extrapolated_share(judge.measured, judge.scenes[scene]) > MOST) & judge.scenes[scene].mask
    return Pictures(
        reference=_webp(hatched(composite(reference, coverage), far)),
        fits=[_webp(composite(picture, coverage)) for picture in shown],
        maps=[_webp(hatched(composite(_map(picture, reference), coverage), far)) for picture in shown],
    )


def _map(picture: Tensor, reference: Tensor) -> Tensor:
    colors = COLOR_MAP((color_difference(picture, reference) / MAP_TOP).clamp(0, 1).numpy())[..., :3]
    return torch.from_numpy(colors).to(picture)


def _webp(display: Tensor) -> str:
    return embed_display(display, "webp", quality=QUALITY)


def _parameters(values: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [(name, _short(value)) for name, value in values.items()]


def _short(value: Any) -> str:
    if isinstance(value, list):
        return "; ".join(map(_short, value)) if any(isinstance(one, list) for one in value) else _flat(value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _flat(value: Sequence[Any]) -> str:
    shown = [_short(one) for one in value[:6]]
    return " ".join([*shown, *(["..."] if len(value) > 6 else [])])
