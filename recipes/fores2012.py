"""The study of Fores, Ferwerda and Gu (2012): three models, three metrics, ten materials."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from torchbrdf.errors import UsageError
from torchbrdf.experiment.settings import LOBE_COUNTS, PICTURE_SIDES, FitGridRecipe, load_materials
from torchbrdf.kinds import STRATEGIES
from torchbrdf.recipe import RECIPES, RunFolder
from torchbrdf.study.simulation import NOISE

GROVE = "grove"
# Of the scenes; a quick run has a quarter of them.
NODES, LIGHTS = 256, 1024
OTHER = "another strategy to compare with, or none"


@RECIPES.register("fores2012")
@dataclass(frozen=True)
class Fores2012(FitGridRecipe):
    """Fit, score, draw, ask simulated observers and report.

    Its defaults are the paper's, on the bundled stand-ins and the bundled light.
    """

    name = "fores2012"

    diffuse: str = field(default="45:0", metadata={"help": "45:0 as in the paper, or fit: every loss chooses its own"})
    lobes: int = field(default=2, metadata={"help": "specular lobes; 1 also fits two and compares", **LOBE_COUNTS})
    compare_strategy: str | None = field(default="staged", metadata={"help": OTHER})
    environment: str = field(default=GROVE, metadata={"help": "grove, studio, or an .exr or .hdr light probe"})
    shape: str = field(default="blob", metadata={"help": "blob, sphere, or a mesh file"})
    size: int = field(default=400, metadata={"help": "pixels of a side", **PICTURE_SIDES})
    turn: float = field(
        default=15.0, metadata={"help": "degrees between the reference's view and the fits'", "low": -360, "high": 360}
    )
    observers: tuple[int, ...] = field(
        default=(15, 20), metadata={"help": "simulated, of experiments 1 and 2", "low": 2, "high": 1000}
    )
    noise: float = field(
        default=NOISE, metadata={"help": "of what simulated observers see, in Delta E", "low": 0.001, "high": 1000}
    )

    # What people who are asked are told, where it is not `torchbrdf.study.plan.TEXTS`, and who may take part.
    texts: ClassVar[Mapping[str, str]] = {}
    screening: ClassVar[Mapping[str, tuple[str, ...]]] = {}

    def __post_init__(self) -> None:
        if len(self.observers) != 2:
            raise UsageError(f"fores2012: observers: expected two numbers, found {len(self.observers)}")
        if self.compare_strategy is not None:
            STRATEGIES.check(self.compare_strategy)
            if self.compare_strategy == self.strategy:
                raise UsageError(f"fores2012: compare_strategy: expected another than {self.strategy}, or none")
        super().__post_init__()

    def steps(self, folder: RunFolder) -> Path:
        """Fits, pictures, observers, report."""
        from torchbrdf.experiment import ONLY, SHOWN_DIFFERENCES, Pictures, simulate_responses
        from torchbrdf.losses import LOSSES, make_loss
        from torchbrdf.render import Camera, Environment, Scene, find_mesh
        from torchbrdf.report import write_grid_report

        groups, bad = load_materials(self.materials, folder, self.quick)
        mesh, environment = find_mesh(self.shape), Environment.find(self.environment)
        size, models, compared = self.size, self.models, self.compare_strategy
        nodes, lights = NODES, LIGHTS
        if self.quick:
            size, nodes, lights = min(size, 64), NODES // 4, LIGHTS // 4
            # What somebody asked for is not left out.
            models = models[:1] if models == type(self).models else models
            compared = None if compared == type(self).compare_strategy else compared
        scene, turned = (Scene(mesh, Camera(turn), environment, size, nodes, lights) for turn in (0.0, self.turn))
        losses = {LOSSES.canonical(name): make_loss(name) for name in self.losses}
        lobes = (1, 2) if self.lobes == 1 else (self.lobes,)
        grid = self.make_grid(folder, groups, losses, models=models, lobes=lobes, compare_strategy=compared)
        grid.fit()
        pictures = Pictures(grid, {ONLY: scene}, SHOWN_DIFFERENCES)
        pictures.draw()
        pictures.measure_tones(fits=True)
        pictures.draw_turned(turned, "turned")
        pictures.compare()
        observers = self.observers[0], self.observers[1]
        responses = simulate_responses(pictures, observers, self.noise, self.texts, self.screening)
        light = "the project's own grove" if self.environment == GROVE else Path(self.environment).name
        title = "Which error metric looks right?"
        return write_grid_report(pictures, title, f"Light: {light}.", self.turn, bad, responses)
