"""The pictures of a study's fits in several scenes, and how far each is from its reference in every way."""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import matplotlib
import torch
from torch import Tensor

from torchbrdf.files import write_text
from torchbrdf.images import DIFFERENCES, ToneMap, composite, read_image, write_exr, write_png
from torchbrdf.images.differences.delta_e76 import lab
from torchbrdf.lobes import model_of
from torchbrdf.parallel import thread_map
from torchbrdf.render import Scene, render
from torchbrdf.report.study import Study, picture

# A colour difference that the maps show as the brightest colour.
BRIGHTEST = 20.0


class Gallery:
    """Every material and every fit in every scene, in `renders/SCENE/`, with one tone map a scene.

    The tone map is measured over the scene's references and frozen: `tones`, kept in `tonemap.json`. Differences go
    into the records, `pictures[scene][difference]`, and maps of the colour difference beside the pictures.
    """

    def __init__(self, study: Study, scenes: Mapping[str, Scene], differences: Sequence[str]) -> None:
        self.study, self.scenes, self.differences = study, scenes, differences
        self.tones: dict[str, ToneMap] = {}

    def path(self, scene: str, name: str, suffix: str = ".png") -> Any:
        """Where a picture is."""
        return self.study.folder.path / "renders" / scene / f"{name}{suffix}"

    def draw_references(self) -> None:
        """Draw the materials, and measure the tone maps."""
        for name, scene in self.scenes.items():
            jobs = [(group, [picture(one) for one in group.names]) for group in self.study.groups]
            self._draw(name, jobs)
            pictures = self._read(name, [picture(one) for one in self.study.materials])
            tone = ToneMap.from_images(pictures, scene.mask.expand(pictures.shape[:-1]))
            self.tones[name] = tone
            for one, linear in zip(self.study.materials, pictures, strict=True):
                write_png(self.path(name, picture(one)), composite(tone(linear), scene.coverage))
        record = {name: tone.to_dict() for name, tone in self.tones.items()}
        write_text(self.study.folder.path / "tonemap.json", json.dumps(record, indent=1) + "\n")

    def draw_fits(self) -> None:
        """Draw the fits, and compare them with the references."""
        study = self.study
        for name in self.scenes:
            jobs = []
            for model in study.models:
                chosen = [record for record in study.shown if record["model"] == model]
                jobs.append((model_of(chosen), [study.picture(record) for record in chosen]))
            self._draw(name, jobs)
        advance = study.folder.progress("comparisons", len(self.scenes) * len(study.shown))
        for name, scene in self.scenes.items():
            references = dict(
                zip(study.materials, self._read(name, [picture(one) for one in study.materials]), strict=True)
            )
            compare = partial(self._compare, name, scene, references)
            for record, found in zip(study.shown, thread_map(compare, study.shown), strict=True):
                record.setdefault("pictures", {})[name] = found
                advance(1)
        study.save()

    def seen(self, scene: str) -> list[dict[str, Any]]:
        """The records, with the image differences in one scene as their `differences`."""
        return [{**record, "differences": record["pictures"][scene]} for record in self.study.shown]

    def _draw(self, name: str, jobs: list[tuple[Any, list[str]]]) -> None:
        jobs = [job for job in jobs if not all(self.path(name, one, ".exr").exists() for one in job[1])]
        advance = self.study.folder.progress(f"renders, {name}", sum(len(names) for _, names in jobs))
        for brdf, names in jobs:
            for one, linear in zip(names, render(brdf, self.scenes[name]), strict=True):
                write_exr(self.path(name, one, ".exr"), linear)
                advance(1)
            self.study.folder.log(f"{name}: {len(names)} renders: {names[0]} to {names[-1]}")

    def _compare(
        self, name: str, scene: Scene, references: Mapping[str, Tensor], record: dict[str, Any]
    ) -> dict[str, float]:
        fit = self.study.picture(record)
        linear = torch.cat([self._read(name, [fit]), references[record["material"]][None]])
        shown = self.tones[name](linear)
        write_png(self.path(name, fit), composite(shown[0], scene.coverage))
        first, second = lab(shown)
        away = (first - second).square().sum(-1).sqrt() / BRIGHTEST
        colors = torch.from_numpy(matplotlib.colormaps["magma"](away.clamp(0, 1).numpy())[..., :3]).to(linear)
        write_png(self.path(name, f"map-{fit}"), composite(colors, scene.coverage))
        found = {}
        for key in self.differences:
            difference = DIFFERENCES[key]()
            pair = linear if difference.linear else shown
            found[key] = difference(pair[:1], pair[1:], scene.mask).item()
        return found

    def _read(self, scene: str, names: list[str]) -> Tensor:
        return torch.stack([read_image(self.path(scene, name, ".exr")) for name in names])
