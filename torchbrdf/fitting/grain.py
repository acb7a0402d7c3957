"""Fits of lobes with a grain: to what they can be fitted, and whether its direction is known then."""

import math
from collections.abc import Mapping

from torchbrdf.errors import UsageError
from torchbrdf.fitting.intervals import Intervals
from torchbrdf.lobes import LOBES, Lobe
from torchbrdf.lobes.parameter_dict import ParameterDict, component_names
from torchbrdf.losses import CombinedLoss, ImageLoss, Loss
from torchbrdf.measured import Measured

# Widths that differ by less, relative, have no direction.
_EQUAL = 0.01
# An interval of the rotation of this length says nothing: half of a turn is all there is.
_ANYWHERE = math.pi / 2


def check_grain(model: Lobe, measured: Measured, loss: Loss) -> None:
    """Refuse to fit a lobe with a grain to what does not tell how the surface is turned.

    Args:
        model: of the fit.
        measured: what it is fitted to.
        loss: under which.

    Raises:
        UsageError: the measurement is isotropic, or the loss compares pictures of a scene whose pairs are those of
            isotropic materials.
    """
    with_grain = [type(one) for one in model.components() if one.is_anisotropic]
    if not with_grain:
        return
    lobe = LOBES.name_of(with_grain[0]) or with_grain[0].__name__
    if not measured.may_be_anisotropic:
        raise UsageError(
            f"{lobe}: expected an anisotropic measurement, found {measured.names[0]} ({measured.source.format}), "
            "which does not say how the surface is turned; fit an isotropic lobe"
        )
    pictures = loss.rendered if isinstance(loss, CombinedLoss) else loss
    if isinstance(pictures, ImageLoss) and not pictures.pairs.is_oriented:
        raise UsageError(
            f"{lobe}: expected pictures of a scene whose pairs know the tangent, Scene(..., oriented=True), for "
            f"{loss.registered_name}, found one whose pairs do not"
        )


def without_grain(model: Lobe, values: ParameterDict, intervals: Mapping[str, Intervals]) -> list[int]:
    """Of which materials a fit leaves the direction of a grain open.

    Args:
        model: of the fit.
        values: what was found, for M materials.
        intervals: of the parameters, by method.

    Returns:
        Indices of materials, rising: both widths of a lobe are equal, or the interval of its rotation is a
        quarter of a turn long.
    """
    found: set[int] = set()
    for component, names in zip(model.components(), component_names(model), strict=True):
        if not component.is_anisotropic or "rotation" not in names:
            continue
        rotation, axes = names["rotation"], getattr(component, "axes", ())
        open_ = [(ends.high[rotation] - ends.low[rotation])[:, 0] >= _ANYWHERE for ends in intervals.values()]
        if len(axes) == 2:
            first, second = (values[names[name]][:, 0] for name in axes)
            open_.append(((first / second).log().abs() < _EQUAL).cpu())
        for one in open_:
            found |= {row for row, is_open in enumerate(one.tolist()) if is_open}
    return sorted(found)
