"""The pictures of a grid of fits in one or several scenes, and how far each is from its reference."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path

import matplotlib
import torch
from torch import Tensor

from torchbrdf.experiment.grid import FitGrid, picture_name
from torchbrdf.files import write_json
from torchbrdf.images import DIFFERENCES, ToneMap, composite, read_image, write_exr, write_png
from torchbrdf.images.differences.delta_e76 import lab
from torchbrdf.lobes import FitRecord, make_model, model_of
from torchbrdf.lobes.model import lobe_count
from torchbrdf.names import file_stem
from torchbrdf.parallel import thread_map
from torchbrdf.progress import Progress, part_of
from torchbrdf.render import Scene
from torchbrdf.render.draw import Brdf, render_by_transport, render_directly, worth_a_transport

# Image differences that reports speak of, by their registered names, and the one that they sort by.
SHOWN_DIFFERENCES = ("psnr", "ssim", "delta_e76")
DIFFERENCE = "delta_e76"
# Pictures that are drawn at a time.
TOGETHER = 256
# A colour difference that maps show as the brightest colour.
BRIGHTEST = 20.0
# Green, which is none of its colours, where there is no difference to tell.
COLOR_MAP = matplotlib.colormaps["magma"].with_extremes(bad="lime")
# The name of a scene that is the only one: its pictures lie in `renders/` itself.
ONLY = ""


class Pictures:
    """Every material and every fit of a grid in every scene, in `renders/SCENE/`, with one tone map a scene.

    Linear pictures are kept as EXR, and what is there is not drawn again. A tone map is measured over a composite of
    pictures, kept in `tonemap.json`, and used for every PNG of its scene.

    Args:
        grid: The fits.
        scenes: By name; `ONLY`, if there is just one.
        differences: Names of image differences, former ones too, each taken between a fit and its reference.
        maps: Also write `map-*.png`, the colour difference of each pixel.
    """

    def __init__(
        self, grid: FitGrid, scenes: Mapping[str, Scene], differences: Sequence[str], *, maps: bool = False
    ) -> None:
        self.grid, self.scenes, self.maps = grid, scenes, maps
        # Made here, so that one whose extra is not installed fails before anything is worked out.
        self._measures = {name: DIFFERENCES[name]() for name in map(DIFFERENCES.canonical, differences)}
        self.differences = list(self._measures)
        self.tones: dict[str, ToneMap] = {}

    def path(self, name: str, scene: str = ONLY, suffix: str = ".png") -> Path:
        """Where a picture is."""
        return self.grid.folder.path / "renders" / scene / f"{file_stem(name)}{suffix}"

    def records_in(self, scene: str) -> list[FitRecord]:
        """The records that reports show, with the image differences in one scene as their `differences`."""
        if scene == ONLY:
            return self.grid.shown
        return [replace(record, differences=record.pictures[scene]) for record in self.grid.shown]

    def draw(self, *, materials: bool = True, fits: bool = True) -> None:
        """Draw what is not there yet of the materials, the fits, or both, in every scene."""
        jobs = self._references() if materials else []
        for strategy in self.grid.strategies if fits else ():
            for model in self.grid.models:
                chosen = [record for record in self.grid.by_strategy(strategy) if record.model == model]
                jobs.append((model_of(chosen, torch.float32), [self.grid.picture(record) for record in chosen]))
        for name, scene in self.scenes.items():
            self._draw(name, scene, jobs)

    def measure_tones(self, *, fits: bool) -> None:
        """Measure the tone map of every scene over its materials, or over the fits as well, and show the materials."""
        for name, scene in self.scenes.items():
            names = [picture_name(material) for material in self.grid.materials]
            fitted = [self.grid.picture(record) for record in self.grid.drawn] if fits else []
            linears = self._read(name, names + fitted)
            self.tones[name] = ToneMap.from_images(linears, scene.mask.expand(linears.shape[:-1]))
            self._show(name, scene, dict(zip(names, linears, strict=False)))
        record = {name: tone.to_dict() for name, tone in self.tones.items()}
        write_json(self.grid.folder.path / "tonemap.json", record.get(ONLY, record))

    def draw_turned(self, scene: Scene, part: str, like: str = ONLY) -> None:
        """Draw the materials in another view, named with `part` behind, under the tone map of the scene `like`."""
        jobs = self._references(part)
        self._draw(like, scene, jobs)
        names = [name for _, names in jobs for name in names]
        self._show(like, scene, dict(zip(names, self._read(like, names), strict=True)))

    def compare(self) -> None:
        """Show the fits, and put their image differences into the records: `pictures[scene]`, or `differences`."""
        drawn = self.grid.drawn
        total, progress = len(self.scenes) * len(drawn), self.grid.folder.progress("comparisons")
        for k, (name, scene) in enumerate(self.scenes.items()):
            materials = self.grid.materials
            pictures = self._read(name, [picture_name(material) for material in materials])
            compare = partial(self._compare, name, scene, dict(zip(materials, pictures, strict=True)))
            advance = part_of(progress, k * len(drawn), total)
            for done, (record, found) in enumerate(zip(drawn, thread_map(compare, drawn), strict=True), 1):
                if name == ONLY:
                    record.differences = found
                else:
                    record.pictures[name] = found
                advance(done, len(drawn))
        self.grid.save()

    @cached_property
    def _render(self) -> Callable[..., Tensor]:
        """How all pictures are drawn: alike, as they are compared."""
        models = [make_model(name, lobe_count(name, self.grid.lobes[0])) for name in self.grid.models]
        pictures = len(self.grid.materials) * (1 + len(models) * len(self.grid.losses))
        together = worth_a_transport([*self.grid.groups, *models], pictures)
        return render_by_transport if together else render_directly

    def _references(self, *parts: str) -> list[tuple[Brdf, list[str]]]:
        return [(group, [picture_name(name, *parts) for name in group.names]) for group in self.grid.groups]

    def _draw(self, name: str, scene: Scene, jobs: Sequence[tuple[Brdf, list[str]]]) -> None:
        """Draw what is not there yet: BRDFs, and the names of their pictures."""
        jobs = [job for job in jobs if not all(self.path(one, name, ".exr").exists() for one in job[1])]
        folder, done, total = self.grid.folder, 0, sum(len(names) for _, names in jobs)
        progress = folder.progress(f"renders, {name}" if name else "renders")
        for some in _parts(jobs):
            names = [one for _, own in some for one in own]
            pictures = self._render([brdf for brdf, _ in some], scene, _share_of(progress, done, len(names), total))
            paths = [self.path(one, name, ".exr") for one in names]
            for _ in thread_map(lambda job: write_exr(*job), list(zip(paths, pictures, strict=True))):
                pass
            done += len(names)
            progress(done, total)
            folder.log(f"{f'{name}: ' if name else ''}{len(names)} renders: {names[0]} to {names[-1]}")

    def _show(self, name: str, scene: Scene, linears: Mapping[str, Tensor]) -> None:
        """Write PNGs of linear pictures."""

        def write(one: str) -> None:
            write_png(self.path(one, name), composite(self.tones[name](linears[one]), scene.coverage))

        for _ in thread_map(write, linears):
            pass

    def _compare(
        self, name: str, scene: Scene, references: Mapping[str, Tensor], record: FitRecord
    ) -> dict[str, float]:
        """Write the PNG of a fit; its image differences by name."""
        fit = self.grid.picture(record)
        linear = torch.stack([read_image(self.path(fit, name, ".exr")), references[record.material]])
        shown = self.tones[name](linear)
        write_png(self.path(fit, name), composite(shown[0], scene.coverage))
        if self.maps:
            colors = COLOR_MAP((color_difference(*shown) / BRIGHTEST).clamp(0, 1).numpy())[..., :3]
            write_png(self.path(f"map-{fit}", name), composite(torch.from_numpy(colors).to(linear), scene.coverage))
        found = {}
        for key, difference in self._measures.items():
            pair = linear if difference.linear else shown
            found[key] = difference(pair[:1], pair[1:], scene.mask).item()
        return found

    def _read(self, scene: str, names: Sequence[str]) -> Tensor:
        return torch.stack(list(thread_map(read_image, [self.path(name, scene, ".exr") for name in names])))


def _parts(jobs: Sequence[tuple[Brdf, list[str]]]) -> Iterator[list[tuple[Brdf, list[str]]]]:
    """Jobs that are drawn together, about so many pictures that they fit the memory."""
    part: list[tuple[Brdf, list[str]]] = []
    for job in jobs:
        part.append(job)
        if sum(len(names) for _, names in part) >= TOGETHER:
            yield part
            part = []
    if part:
        yield part


def _share_of(progress: Progress, before: int, count: int, whole: int) -> Progress:
    """What `render` calls with its own numbers, for `count` of all pictures."""
    return lambda done, total: progress(before + count * done // total, whole)


def color_difference(display: Tensor, reference: Tensor) -> Tensor:
    """CIELAB Delta E 76 of every pixel of display values `(..., H, W, 3)`: `(..., H, W)`."""
    return (lab(display) - lab(reference)).square().sum(-1).sqrt()
