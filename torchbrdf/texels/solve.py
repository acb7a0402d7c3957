"""The fits of a tile: a coarse grid of texels from everywhere, the rest from their neighbours.

Texels are materials, and what fits materials fits them: the objectives of `torchbrdf.fitting`, whose dictionary gives
the coarse texels their starts, and Levenberg-Marquardt in large batches.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from torchbrdf.fitting.initialization import has_dictionary, starts_from_dictionary
from torchbrdf.fitting.objective import GaussNewtonObjective, make_objective
from torchbrdf.fitting.parameters import Parametrization, free_parameters
from torchbrdf.fitting.quasi_random import quasi_random_starts
from torchbrdf.fitting.task import Task, levenberg_marquardt_fit
from torchbrdf.lobes import Lobe
from torchbrdf.lobes.parameter_dict import ParameterDict, component_names, get_parameters, named_specs, take_materials
from torchbrdf.losses import Loss, Problem
from torchbrdf.precision import undisturbed
from torchbrdf.solvers import Solution, Status
from torchbrdf.solvers.status import RESOLUTION
from torchbrdf.texels.beside import coarse_texels, neighbours, places_of, with_columns
from torchbrdf.texels.problem import Reading, TexelProblem, texel_problem
from torchbrdf.texels.smoothing import smoothed_fit
from torchbrdf.texels.stack import TileData
from torchbrdf.texels.status import TexelStatus

Array = np.ndarray
Maps = dict[str, Array]
"""Maps `(h, w, ...)` by name."""

# Starts of a coarse texel: from the dictionary, or all over the bounds of a model that it does not serve.
STARTS, QUASI_RANDOM = 3, 12
# Texels that are solved together: enough that calls do not count, and few enough for the caches.
BATCH = 1024
# On a GPU as many as make so many numbers, of which some dozen arrays have to fit: 20 MB to 1 GB each.
GPU_NUMBERS = 1 << 22
# Coarse texels that give each other one its start.
NEAREST = 3
FTOL = 1e-5
# A texel whose error is so many times what most of those around it have begins again, as a coarse one, if it is among
# the worst: at most a share of all.
SUSPECT, WINDOW, MOST, RETRIED = 1.3, 7, 0.9, 1 / 8
# A texel whose shape is further from a quartile of those around it, in shares of its range, tries that, too.
QUARTILES, FAR = (0.25, 0.75), 0.1
# How many more steps than otherwise the last fits in float64 may take.
LONGER = 2


@dataclass(frozen=True)
class TexelFit:
    """How every texel is fitted.

    Args:
        model: where fits begin, and what is held; unbatched.
        loss: a mean over pairs.
        reading: how observations become BRDF values.
        held: names of parameters that stay as the model has them.
        smoothness: what differences of neighbours cost, see `fit_texels`.
        sweeps: how often neighbours pull at each other.
        max_iterations: of the solver.
        device: where problems are solved; all else is on the CPU.
    """

    model: Lobe
    loss: Loss
    reading: Reading
    held: tuple[str, ...] = ()
    smoothness: float = 0.0
    sweeps: int = 4
    max_iterations: int = 60
    device: str = "cpu"

    @property
    def margin(self) -> int:
        """How many texels around a tile its fits depend on."""
        return self.sweeps if self.smoothness else 0

    @cached_property
    def parametrization(self) -> Parametrization:
        """What solvers move."""
        free = free_parameters(self.model, range(len(self.model.components())))
        names = map_names(self.model)
        return Parametrization(
            self.model, [one for one in free if not {names[own] for own in one.names} & {*self.held}]
        )

    @undisturbed()
    def __call__(self, data: TileData) -> Maps:
        """The maps of a tile: parameters, NaN where nothing was fitted; error; status."""
        with torch.no_grad():
            return _TileFit(self, texel_problem(data, self.reading), data.shape).run()


class _TileFit:
    """The fits of the texels of a tile, and what of them is found so far.

    values: parameters, `(M, ...)`; error: `(M,)`; status: `(M,)`; good: the texels that can be fitted.
    """

    def __init__(self, fit: TexelFit, own: TexelProblem, shape: tuple[int, int]) -> None:
        self.fit, self.own, self.shape = fit, own, shape
        self.free = fit.parametrization
        self.values = get_parameters(fit.model.batched(len(own.counts)))
        self.error = torch.full((len(own.counts),), torch.nan, dtype=torch.float64, device="cpu")
        self.good, self.status = self._statuses()
        self.batch = batch_size(fit.device, own.problem.target[0].numel() if len(own.counts) else 1)

    def run(self) -> Maps:
        """All of it."""
        coarse = coarse_texels(self.good, self.shape)
        if len(coarse):
            self._from_everywhere(coarse)
            done = torch.zeros(len(self.error), dtype=torch.bool, device="cpu")
            done[coarse] = True
            self._from_neighbours(self.good[~done[self.good]], coarse)
            self._with_shapes_around()
            self._from_beside()
            self._from_everywhere(self._suspects())
            self._finish()
            if self.fit.smoothness:
                self._smooth()
        return self._maps()

    def _statuses(self) -> tuple[Tensor, Tensor]:
        """The texels that can be fitted, and what is to say of the others, so far."""
        counts, wanted = self.own.counts, sum(one.width for one in self.free.free)
        status = torch.full(counts.shape, TexelStatus.CONVERGED, dtype=torch.uint8, device="cpu")
        status[counts < wanted] = TexelStatus.TOO_FEW_SAMPLES
        status[counts == 0] = TexelStatus.NO_DATA
        status[(counts < wanted) & (counts + self.own.saturated >= wanted)] = TexelStatus.SATURATED
        return (status == TexelStatus.CONVERGED).nonzero()[:, 0], status

    def _objective(self, rows: Tensor, dtype: torch.dtype = torch.float32) -> GaussNewtonObjective:
        model, own = self.fit.model.batched(len(rows)).to(self.fit.device), self._problem(rows)
        if dtype != own.target.dtype:
            weight = None if own.weight is None else own.weight.to(dtype)
            own = Problem(own.pairs.to(dtype=dtype), own.target.to(dtype), weight)
        found = make_objective(model, own, self.fit.loss)
        assert isinstance(found, GaussNewtonObjective)  # as fit_texels saw to it
        return found

    def _problem(self, rows: Tensor) -> Problem:
        """That of some texels, where it is solved."""
        own, device = self.own.problem.select(rows), self.fit.device
        if device == "cpu":
            return own
        weight = None if own.weight is None else own.weight.to(device)
        return Problem(own.pairs.to(device), own.target.to(device), weight)

    def _there(self, values: ParameterDict) -> ParameterDict:
        """Parameters where problems are solved."""
        return {name: value.to(self.fit.device) for name, value in values.items()}

    def _from_everywhere(self, rows: Tensor) -> None:
        """The best of several starts all over the bounds, kept where it is better than what there is."""
        for own in rows.split(self.batch // 4) if len(rows) else ():
            objective, here = self._objective(own), self._there(take_materials(self.values, own))
            task = Task(self.fit.model, objective)
            if has_dictionary(self.fit.model):
                starts = starts_from_dictionary(self.fit.model, objective, here, bool(task.diffuse), STARTS)
            else:
                starts = quasi_random_starts(self.free, here, QUASI_RANDOM)
            count = len(next(iter(starts.values()))) // len(own)
            moved = {name for one in self.free.free for name in one.names}
            starts |= {name: value.repeat(count, 1) for name, value in here.items() if name not in moved}
            materials = objective.material_indices.repeat(count)
            values, found = self._solve(objective, starts, materials)
            best = found.value.nan_to_num(torch.inf).unflatten(0, (count, -1)).argmin(0)
            picked = best * len(own) + torch.arange(len(own), dtype=torch.int64, device="cpu")
            self._keep(own, take_materials(values, picked), _some(found, picked))

    def _from_neighbours(self, rows: Tensor, coarse: Tensor) -> None:
        """From the best of the nearest coarse texels' parameters, and what lies between them."""
        if not len(rows):
            return
        known = self.free.encode(take_materials(self.values, coarse))
        for own in rows.split(self.batch):
            objective = self._objective(own)
            away = places_of(own, self.shape)[:, None] - places_of(coarse, self.shape)
            distance, nearest = away.square().sum(-1).topk(min(NEAREST, len(coarse)), largest=False)
            near = known[nearest]
            weight = 1 / distance.clamp_min(0.5)[..., None]
            starts = torch.cat([near.transpose(0, 1), (near * weight).sum(1)[None] / weight.sum(1)])
            here = take_materials(self.values, own)
            best = self._best_start(objective, here, starts)
            self._keep(own, *self._solve(objective, here | self._decoded(best)))

    def _best_start(self, objective: GaussNewtonObjective, here: ParameterDict, starts: Tensor) -> Tensor:
        """Of S starts `(S, m, P)` of each problem the one with the least error, `(m, P)`."""
        count, problems = starts.shape[:2]
        every = {name: value.repeat(count, 1) for name, value in here.items()}
        bound = objective.bind(self.free, self._there(every), objective.material_indices.repeat(count))
        rows = torch.arange(count * problems, dtype=torch.int64, device="cpu")
        value, _ = bound.value_and_gradient(starts.flatten(0, 1).to(self.fit.device), rows.to(self.fit.device))
        best = value.cpu().nan_to_num(torch.inf).unflatten(0, (count, problems)).argmin(0)
        return starts[best, rows[:problems]]

    def _suspects(self) -> Tensor:
        """The texels whose errors stand out from nearly all around them, the worst first."""
        error = self.error[self.good]
        ratio = (error / self._around(error, MOST)).nan_to_num(0.0, 0.0, 0.0).numpy()
        worst = np.argsort(-ratio, kind="stable")[: int(len(ratio) * RETRIED) + 1]
        return self.good[torch.from_numpy(worst[ratio[worst] > SUSPECT])]

    def _with_shapes_around(self) -> None:
        """From the quartiles of the shapes around, where a texel's own is far from one: noise can look a highlight."""
        lower, upper = self.free.limits()
        shapes = self._shape_numbers
        for part in QUARTILES if len(shapes) else ():
            x = self.free.encode(take_materials(self.values, self.good))
            around = torch.stack([self._around(x[:, k], part) for k in shapes.tolist()], -1)
            far = ((x[:, shapes] - around).abs() > FAR * (upper - lower)[shapes]).any(-1).nonzero()[:, 0]
            x[:, shapes] = around
            for own in far.split(self.batch) if len(far) else ():
                rows = self.good[own]
                here = take_materials(self.values, rows)
                self._keep(rows, *self._solve(self._objective(rows), here | self._decoded(x[own])))

    def _from_beside(self) -> None:
        """From the parameters of a texel beside, where these are better than its own: edges are nobody's between."""
        error = self.error[self.good]
        rows = self.good[error > SUSPECT * self._around(error, 0.0)]
        for own in rows.split(self.batch) if len(rows) else ():
            beside = self._beside(own)
            x = self.free.encode(take_materials(self.values, beside.flatten())).unflatten(0, beside.shape)
            here, objective = take_materials(self.values, own), self._objective(own)
            best = self._best_start(objective, here, x)
            moved = (best != x[0]).any(-1).nonzero()[:, 0]
            if len(moved):
                there = own[moved]
                start = take_materials(self.values, there) | self._decoded(best[moved])
                self._keep(there, *self._solve(self._objective(there), start))

    def _beside(self, rows: Tensor) -> Tensor:
        """Texels `(m,)`, and the eight around each; itself, where there is none or none is fitted, `(9, m)`."""
        h, w = self.shape
        fitted = torch.zeros(h * w, dtype=torch.bool, device="cpu")
        fitted[self.good] = self.error[self.good].isfinite()
        found = []
        for down, right in [(0, 0), *((a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b)]:
            row, column = rows // w + down, rows % w + right
            inside = (row >= 0) & (row < h) & (column >= 0) & (column < w)
            there = torch.where(inside, row * w + column, rows)
            found.append(torch.where(fitted[there], there, rows))
        return torch.stack(found)

    def _finish(self) -> None:
        """In float64 where a fit has not converged: in float32 the end of a flat valley is not seen."""
        rows = self.good[(self.status[self.good] != TexelStatus.CONVERGED) & self.error[self.good].isfinite()]
        for own in rows.split(self.batch) if len(rows) else ():
            here = {name: value.double() for name, value in take_materials(self.values, own).items()}
            values, found = self._solve(self._objective(own, torch.float64), here, most=LONGER)
            self._keep(own, values, found, 1 + RESOLUTION)

    @property
    def _shape_numbers(self) -> Tensor:
        """Which of the P numbers are shapes: what values are neither linear in nor affine."""
        found = [not (one.spec.linear or one.spec.affine) for one in self.free.free for _ in range(one.width)]
        return torch.tensor(found, dtype=torch.bool, device="cpu").nonzero()[:, 0]

    def _around(self, values: Tensor, part: float) -> Tensor:
        """Of values of the G texels that can be fitted those that so large a part of the ones around lie below."""
        own = self.good.numpy()
        whole = np.full(self.shape[0] * self.shape[1], np.nan)
        whole[own] = values.numpy()
        wide = np.pad(whole.reshape(self.shape), WINDOW // 2, constant_values=np.nan)
        around = np.lib.stride_tricks.sliding_window_view(wide, (WINDOW, WINDOW))
        rising = np.sort(around.reshape(whole.size, -1)[own], 1)  # NaN comes last
        last = np.maximum(np.isfinite(rising).sum(1) - 1, 0)
        return torch.from_numpy(rising[np.arange(len(rising)), (last * part + 0.5).astype(int)])

    def _smooth(self) -> None:
        """Sweeps in which each texel is pulled to the mean of its neighbours before the sweep.

        In the first it also begins with their shapes: what noise made of its own is not near.
        """
        shapes = self._shape_numbers
        for sweep in range(self.fit.sweeps):
            x = torch.full((len(self.error), self._numbers), torch.nan, dtype=torch.float64, device="cpu")
            x[self.good] = self.free.encode(take_materials(self.values, self.good))
            mean, count = neighbours(x.unflatten(0, self.shape))
            found = [
                _here(
                    smoothed_fit(
                        self._objective(own),
                        self._there(take_materials(self.values, own)),
                        self.free,
                        [
                            one.to(self.fit.device)
                            for one in ([x[own], with_columns(x[own], mean[own], shapes)] if sweep == 0 else [x[own]])
                        ],
                        mean[own].to(self.fit.device),
                        (count[own] * self.fit.smoothness).to(self.fit.device),
                        max_iterations=self.fit.max_iterations,
                        ftol=FTOL,
                    )
                )
                for own in self.good.split(self.batch)
            ]
            for name, value in self._decoded(torch.cat([one.x for one in found])).items():
                self.values[name][self.good] = value.flatten(1)
            self.error[self.good] = torch.cat([one.value for one in found])
            self.status[self.good] = _codes([status for one in found for status in one.status])

    @property
    def _numbers(self) -> int:
        return sum(one.width for one in self.free.free)

    def _decoded(self, x: Tensor) -> ParameterDict:
        return self.free.decode(x, self.own.problem.target.dtype)

    def _solve(
        self, objective: GaussNewtonObjective, start: ParameterDict, materials: Tensor | None = None, most: int = 1
    ) -> tuple[ParameterDict, Solution]:
        values, found = levenberg_marquardt_fit(
            objective,
            self._there(start),
            self.free,
            max_iterations=most * self.fit.max_iterations,
            materials=materials,
            ftol=FTOL,
        )
        return {name: value.cpu() for name, value in values.items()}, _here(found)

    def _keep(self, rows: Tensor, values: ParameterDict, found: Solution, within: float = 1.0) -> None:
        """Take over fits where they are better than what there is, or within so many times its error."""
        before = self.error[rows] * within
        better = ~(found.value >= before) | before.isnan()
        own = rows[better]
        for name, value in values.items():
            self.values[name][own] = value[better].flatten(1).to(self.values[name])
        self.error[own] = found.value[better]
        self.status[own] = _codes(found.status)[better]

    def _maps(self) -> Maps:
        """What was found, as maps."""
        lost = self.good[~self.error[self.good].isfinite()]
        self.status[lost] = TexelStatus.NOT_FINITE
        unknown = self.status >= TexelStatus.NOT_FINITE
        found: Maps = {}
        for full, name in map_names(self.fit.model).items():
            value = torch.where(unknown[:, None], torch.nan, self.values[full])
            found[name] = value.float().numpy().reshape(*self.shape, -1)
        found["error"] = self.error.float().numpy().reshape(*self.shape, 1)
        found["status"] = self.status.numpy().reshape(*self.shape, 1)
        return found


def map_names(model: Lobe) -> dict[str, str]:
    """What the map of each parameter is called, by its full name: as the lobe calls it, numbered where several do.

    Example:
        >>> from torchbrdf.lobes import make_model
        >>> list(map_names(make_model("ggx", 1)).values())
        ['albedo', 'specular', 'roughness', 'f0']
        >>> list(map_names(make_model("ward", 2)).values())
        ['albedo', 'specular_1', 'roughness_1', 'specular_2', 'roughness_2']
    """
    own = [(full, name) for names in component_names(model) for name, full in names.items()]
    every = [name for _, name in own]
    found: dict[str, str] = {}
    for full, name in own:
        number = sum(1 for other in found if other.rpartition(".")[2] == name) + 1
        found[full] = f"{name}_{number}" if every.count(name) > 1 else name
    return found


def map_sizes(model: Lobe) -> dict[str, int]:
    """How many numbers a texel has in each map."""
    names, specs = map_names(model), named_specs(model)
    return {name: specs[full].size for full, name in names.items()} | {"error": 1, "status": 1}


def batch_size(device: str, numbers: int) -> int:
    """How many texels are solved together.

    Args:
        device: where.
        numbers: that a texel has, of all lights and channels.
    """
    return BATCH if torch.device(device).type == "cpu" else max(BATCH, GPU_NUMBERS // max(numbers, 1))


def _here(found: Solution) -> Solution:
    """A solution on the CPU."""
    return Solution(found.x.cpu(), found.value.cpu(), found.status, found.iterations.cpu())


def _some(found: Solution, rows: Tensor) -> Solution:
    status = [found.status[row] for row in rows.tolist()]
    return Solution(found.x[rows], found.value[rows], status, found.iterations[rows])


def _codes(status: list[Status]) -> Tensor:
    return torch.tensor([TexelStatus.of(one) for one in status], dtype=torch.uint8, device="cpu")
