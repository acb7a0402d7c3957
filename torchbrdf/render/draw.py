"""From a BRDF and a scene to a picture."""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import accumulate, groupby, zip_longest

import torch
from torch import Tensor

from torchbrdf import memory
from torchbrdf.errors import UsageError
from torchbrdf.lobes import Lobe
from torchbrdf.lobes.parameter_dict import get_parameters, named_specs, take_materials, with_parameters
from torchbrdf.measured import Measured
from torchbrdf.measured.resampled import ForPictures
from torchbrdf.measured.tables import check_rgb
from torchbrdf.pairs import Pairs
from torchbrdf.parallel import thread_map
from torchbrdf.precision import undisturbed
from torchbrdf.progress import Progress
from torchbrdf.render.scene import Chunk, Scene

# Measured tables that are open at once.
_TABLES = 12
# Pictures of lobes from which on a transport is worth its making; of tables, one is.
SEVERAL = 4
# Pairs on which light and viewer change places, and the mean relative difference that is none.
_TRIED, _NONRECIPROCAL = 256, 1e-3

Shader = Callable[[Pairs], Tensor]
Brdf = Lobe | Measured | Shader


def render(brdf: Brdf | Sequence[Brdf], scene: Scene, progress: Progress | None = None) -> Tensor:
    """Draw BRDFs in a scene: linear pictures, without gradients.

    For pictures with gradients, multiply values by `scene.transport`.

    Args:
        brdf: A Lobe (batched or not), a Measured, or anything that gives values in 1/sr, `(m, N, 3)` or `(N, 3)`, on
            Pairs; or several of those, whose pictures follow each other. Geometry and light are worked out once. Where
            BRDFs are reciprocal, it is by the scene's transport: measured tables, four and more pictures, and all
            further ones of a scene that was drawn so. Anisotropic ones are drawn in the frames of the mesh's tangents.
        scene: What is drawn.
        progress: Is called with what is done and what there is to do as the work goes on.

    Returns:
        Radiance `(M, size, size, 3)`, float32, in the unit of the scene's light, 0 where there is no object.

    Raises:
        UsageError: There is no BRDF.
        DataError: Values are bands, and not linear RGB.

    Example:
        >>> from torchbrdf.lobes import Lambert
        >>> from torchbrdf.render import Scene, sphere
        >>> render(Lambert(albedo=0.5), Scene(sphere(2), size=8, nodes=8, light_samples=4)).shape
        torch.Size([1, 8, 8, 3])
    """
    brdfs = list(brdf) if isinstance(brdf, Sequence) else [brdf]
    if not brdfs:
        raise UsageError("render: expected at least one BRDF, found none")
    known = [one for one in brdfs if isinstance(one, Lobe | Measured)]
    if len(known) == len(brdfs) and worth_a_transport(known, sum(map(_pictures, known)), scene.is_compact):
        return render_by_transport(known, scene, progress)
    parts = [part for one in brdfs for part in _alike(one)]
    flat = list(map(_is_flat, parts))
    if any(flat) and not all(flat):
        return _in_two_ways(parts, flat, scene, progress)
    return render_directly(brdfs, scene, progress)


def _alike(brdf: Brdf) -> list[Brdf]:
    """A BRDF, or measured materials of scattered samples in parts, with a grain and without."""
    if not isinstance(brdf, Measured) or not brdf.is_scattered or not brdf.is_anisotropic:
        return [brdf]
    each = [brdf.batch([row]) for row in range(len(brdf))]
    runs = [len(list(run)) for _, run in groupby(each, lambda one: one.is_anisotropic)]
    ends = list(accumulate(runs))
    return [brdf.batch(list(range(end - run, end))) for run, end in zip(runs, ends, strict=True)]


def _is_flat(brdf: Brdf) -> bool:
    """Whether it is of scattered samples without a grain, which take long to look up, and have a transport."""
    return isinstance(brdf, Measured) and brdf.is_scattered and not brdf.is_anisotropic and is_reciprocal(brdf)


def _in_two_ways(parts: Sequence[Brdf], flat: Sequence[bool], scene: Scene, progress: Progress | None) -> Tensor:
    """Pictures of parts, by the transport where they are flat."""
    some = [one for one, is_flat in zip(parts, flat, strict=True) if isinstance(one, Measured) and is_flat]
    by_transport = iter(render_by_transport(some, scene))
    directly = iter(
        render_directly([one for one, is_flat in zip(parts, flat, strict=True) if not is_flat], scene, progress)
    )
    found = [
        next(by_transport if is_flat else directly)
        for one, is_flat in zip(parts, flat, strict=True)
        for _ in range(_pictures(one) if isinstance(one, Lobe | Measured) else 1)
    ]
    return torch.stack(found)


def worth_a_transport(brdfs: Sequence[Lobe | Measured], pictures: int, is_there: bool = False) -> bool:
    """Whether so many pictures are quicker by a transport, and these BRDFs are reciprocal, as it takes them to be.

    One that is there is quicker, and so are tables: a pair costs more to look up in one than to find its bin. It takes
    them to be isotropic, too.
    """
    if any(one.is_anisotropic for one in brdfs):
        return False
    tables = any(isinstance(one, Measured) and not one.stand_in for one in brdfs)
    return (pictures >= SEVERAL or tables or is_there) and all(map(is_reciprocal, brdfs))


def render_directly(brdfs: Sequence[Brdf], scene: Scene, progress: Progress | None = None) -> Tensor:
    """As `render`: every BRDF evaluated on all pairs of every pixel."""
    runs = list(zip_longest(*(_shaders(one) for one in brdfs), fillvalue=()))
    pictures: list[list[Tensor]] = [[] for _ in brdfs]
    done, total = 0, 2 * len(runs) * int(scene.mask.sum())
    # A function of somebody's own may ask for the surface's tangent; isotropic ones do not.
    jobs = scene.jobs(any(not isinstance(one, Lobe | Measured) or one.is_anisotropic for one in brdfs))
    for run in runs:
        shaders = [(owner, shader) for owner, own in enumerate(run) for shader in own]
        drawn: list[Tensor] = []
        for pixel, parts in thread_map(partial(_light, [shader for _, shader in shaders]), jobs):
            drawn = drawn or [
                torch.zeros(len(part), scene.size**2, 3, dtype=part.dtype, device=part.device) for part in parts
            ]
            for picture, part in zip(drawn, parts, strict=True):
                picture[:, pixel] += part
            done += len(pixel)
            if progress is not None:
                progress(done, total)
        for (owner, _), picture in zip(shaders, drawn, strict=True):
            pictures[owner].append(picture)
    return torch.cat([picture for own in pictures for picture in own]).unflatten(1, (scene.size, scene.size))


@torch.no_grad()
@undisturbed()
def render_by_transport(brdfs: Sequence[Lobe | Measured], scene: Scene, progress: Progress | None = None) -> Tensor:
    """As `render`: every BRDF evaluated on the scene's compact pairs, and one sparse product for many pictures.

    Raises:
        UsageError: One is anisotropic, and has no values on pairs that know no tangent.
    """
    if any(one.is_anisotropic for one in brdfs):
        raise UsageError("transport: expected isotropic BRDFs, found one with a grain; `render` draws it")
    shaders = [shader for one in brdfs for run in _shaders(one) for shader in run]
    compact = scene.compact
    bytes_each = 3 * torch.float32.itemsize * 2 * (len(compact.pairs) + compact.count)
    together = max(1, memory.limit() // 2 // bytes_each)
    pictures = sum(_pictures(one) for one in brdfs)
    share, done = sum(len(rows) for part in compact.parts for rows in part.groups), 0
    found: list[Tensor] = []

    def advance(rows: int) -> None:
        nonlocal done
        done += rows
        if progress is not None:
            progress(done, 2 * pictures * share)

    def drawn(values: Tensor) -> Tensor:
        return scene.picture(compact.pixels(values, lambda rows: advance(rows * len(values))))

    waiting: list[Tensor] = []
    for values in thread_map(partial(_values, compact.pairs), shaders):
        waiting.append(values)
        advance(len(values) * share)
        if sum(map(len, waiting)) >= together:
            found += map(drawn, torch.cat(waiting).split(together))
            waiting = []
    if waiting:
        found += map(drawn, torch.cat(waiting).split(together))
    return torch.cat(found)


@torch.no_grad()
def is_reciprocal(brdf: Lobe | Measured) -> bool:
    """Whether light and viewer can change places, as compact pairs have it."""
    if isinstance(brdf, Measured) and not brdf.stand_in:
        return brdf.source.is_reciprocal
    generator = torch.Generator("cpu").manual_seed(0)
    square = torch.rand(2, _TRIED, 3, generator=generator, dtype=torch.float32, device="cpu")
    wi, wo = torch.nn.functional.normalize(square * 2 - square.new_tensor([1, 1, 0]), dim=-1)
    ways = Pairs.from_directions(wi, wo), Pairs.from_directions(wo, wi)
    for shader in (shader for run in _shaders(brdf) for shader in run):
        there, back = (_values(way, shader) for way in ways)
        size = there.abs().sum((1, 2))
        if ((there - back).abs().sum((1, 2)) > _NONRECIPROCAL * size).any():
            return False
    return True


def _values(pairs: Pairs, shader: Shader) -> Tensor:
    """Values `(m, N, 3)`, float32."""
    return shader(pairs).reshape(-1, len(pairs), 3).float()


def _pictures(brdf: Lobe | Measured) -> int:
    """How many a BRDF makes."""
    if isinstance(brdf, Measured):
        return len(brdf)
    specs, values = named_specs(brdf), get_parameters(brdf)
    return max(len(value) if value.dim() > len(specs[name].shape) else 1 for name, value in values.items())


def _light(shaders: list[Shader], job: Callable[[], Chunk]) -> tuple[Tensor, list[Tensor]]:
    """The pixels of one chunk, and for each shader what it adds to them, `(m, p, 3)`."""
    pixel, pairs, weight = job()
    return pixel, [_lit(shader, pairs, weight) for shader in shaders]


def _lit(shader: Shader, pairs: Pairs, weight: Tensor) -> Tensor:
    """What a shader adds to pixels, `(m, p, 3)`."""
    if isinstance(shader, ForPictures):
        return shader.light(pairs, weight)
    return torch.stack([(own * weight).sum(1) for own in shader(pairs).reshape(-1, *weight.shape)])


def _shaders(brdf: Brdf) -> list[list[Shader]]:
    """What to evaluate, for each run over the scene: tables are big, so only some are open in a run.

    A batched lobe is taken apart, because the values of many materials at once would not fit a processor's cache.
    """
    if isinstance(brdf, Lobe | Measured):
        check_rgb(brdf, "render")
    if isinstance(brdf, Measured):
        rows = range(len(brdf))
        return [[ForPictures(brdf.batch(rows[start : start + _TABLES]))] for start in rows[::_TABLES]]
    if isinstance(brdf, Lobe):
        materials = _pictures(brdf)
        values = get_parameters(brdf.batched(materials))
        own = [take_materials(values, slice(k, k + 1)) for k in range(materials)]
        return [[with_parameters(brdf, one).to("cpu", torch.float32) for one in own]]
    return [[brdf]]
