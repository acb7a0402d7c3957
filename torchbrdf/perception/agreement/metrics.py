"""Anything that says how far apart BRDFs are as a metric: a loss, its name, a function, or where one is found."""

import copy
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from torchbrdf.errors import UsageError, shown
from torchbrdf.losses import LOSSES, FunctionLoss, Loss, as_loss, make_loss
from torchbrdf.losses.learned import cosines
from torchbrdf.names import check_name
from torchbrdf.pairs import Pairs

Metric = str | Callable[..., Any]
"""The name of a registered loss or of one of `FORMULAS`; `module:name`; a Loss; or a function or module of
(prediction, target, pairs)."""


# Added to values times cosines before the logarithm.
_DARKEST = 1e-3


def mean_log_difference(prediction: Tensor, target: Tensor, pairs: Pairs) -> Tensor:
    """Mean of |log(x + 1e-3) - log(y + 1e-3)|, x = max(M, 0) cos_i cos_o: the best plain formula so far, `(...)`."""
    one, other = ((values.clamp_min(0) * cosines(pairs) + _DARKEST).log() for values in (prediction, target))
    return (one - other).abs().mean((-2, -1))


FORMULAS: dict[str, Callable[[], Loss]] = {
    "mean_log_difference": lambda: CallableMetric(mean_log_difference),
}
"""Metrics that are no losses to fit under, but have their rows in the table."""


class CallableMetric(Loss):
    """A function or module of (prediction, target, pairs) as a loss that gives the distance of each material.

    It is called with values `(B, N, 3)` in 1/sr and Pairs `(N,)`, and returns distances `(B,)`, a tensor or an array.
    One that returns a single number, whatever it is given, is called for one material after the other. A module is
    called with values of the dtype, and on the device, of its own parameters.

    Args:
        function: What is called.
        name: What it is called in tables; by default its own name.

    Example:
        >>> from torchbrdf.perception import uniform_pairs
        >>> metric = CallableMetric(lambda prediction, target, pairs: (prediction - target).abs().mean((-2, -1)))
        >>> metric(torch.full((2, 5, 3), 3.0), torch.ones(2, 5, 3), uniform_pairs(5))
        tensor([2., 2.])
    """

    objective = "autograd"
    is_root = False

    def __init__(self, function: Callable[..., Any], name: str = "") -> None:
        super().__init__("none")
        self.function = function
        self.name = name or getattr(function, "__name__", type(function).__name__)
        parameters = list(function.parameters()) if isinstance(function, nn.Module) else []
        floating = [one for one in parameters if one.is_floating_point()]
        self._home = (floating[0].device, floating[0].dtype) if floating else None
        self._one_by_one = False

    @property
    def registered_name(self) -> str:
        """What it is called in tables."""
        return self.name

    def error(
        self, prediction: Tensor, target: Tensor, pairs: Pairs | None = None, weight: Tensor | None = None
    ) -> Tensor:
        """What the function says, `(B,)`, float64."""
        self._check(prediction, target, pairs, weight)
        if weight is not None:
            raise UsageError(f"{self.name}: expected no weights: a function of (prediction, target, pairs) takes none")
        if not self._one_by_one:
            found = self._call(prediction, target, pairs)
            if found.shape == prediction.shape[:-2]:
                return found
            if found.dim() or prediction.dim() != 3:
                raise UsageError(
                    f"{self.name}: expected distances {(*prediction.shape[:-2],)} of values {(*prediction.shape,)}, "
                    f"found {(*found.shape,)}"
                )
            self._one_by_one = True
        return torch.stack([self._alone(one, other, pairs) for one, other in zip(prediction, target, strict=True)])

    def _alone(self, prediction: Tensor, target: Tensor, pairs: Pairs | None) -> Tensor:
        found = self._call(prediction[None], target[None], pairs)
        if found.numel() != 1:
            raise UsageError(f"{self.name}: expected one distance of one material, found {(*found.shape,)}")
        return found.reshape(())

    def _call(self, prediction: Tensor, target: Tensor, pairs: Pairs | None) -> Tensor:
        """What the function says, as float64 where the values are."""
        device = prediction.device
        if self._home is not None:
            prediction, target = (values.to(*self._home) for values in (prediction, target))
            pairs = None if pairs is None else pairs.to(*self._home)
        found = self.function(prediction, target, pairs)
        if isinstance(found, np.ndarray | np.number | float | int):
            found = torch.from_numpy(np.asarray(found))
        if not isinstance(found, Tensor) or found.is_complex():
            kind = str(found.dtype) if isinstance(found, Tensor) else type(found).__name__
            raise UsageError(f"{self.name}: expected a tensor of distances, found {kind}")
        return found.detach().to(device, torch.float64)


def as_metric(metric: Metric, name: str = "") -> Loss:
    """What `score` takes as a loss that gives the distance of each material.

    A function of two arguments, such as `torch.nn.MSELoss()`, is one, too: `FunctionLoss`. A third argument is given
    where it is needed, or called `pairs`.

    Args:
        metric: A name, `module:name` (see `find_metric`), a Loss of any reduction, or a function or a module.
        name: What to call a function in tables.

    Returns:
        A loss of reduction "none".

    Raises:
        UsageError: It is none of these.

    Example:
        >>> from torchbrdf.losses import CubeRootLoss
        >>> as_metric(CubeRootLoss()), as_metric("rms")
        (CubeRootLoss(reduction='none'), RMSLoss(reduction='none'))
    """
    if isinstance(metric, str):
        return find_metric(metric)
    if isinstance(metric, type):
        raise UsageError(f"metric: expected an instance or a function, found the class {shown(metric.__name__)}")
    if not callable(metric):
        raise UsageError(f"metric: expected a name, a Loss or a function of (prediction, target, pairs), "
                         f"found {shown(metric)}")  # fmt: skip
    if not isinstance(metric, Loss):
        return CallableMetric(metric, name) if _takes_pairs(metric) else FunctionLoss(metric, "none")
    loss = as_loss(metric)
    if loss is metric and loss.reduction != "none":
        loss = copy.copy(loss)
    loss.reduction = "none"
    return loss


def find_metric(text: str) -> Loss:
    """Find a metric by the name of a registered loss or of one of `FORMULAS`, or by `module:name`, or `file.py:name`.

    A module is a program, and finding its metric runs it, with all that you may do: give only what you trust. Modules
    are looked for where Python runs, and in the working directory. A class is made without arguments.

    Args:
        text: Such as "cube_root", "my_metrics:distance" or "my_metrics.py:distance".

    Returns:
        A loss of reduction "none".

    Raises:
        UsageError: There is no such loss, module or name; it cannot be loaded, or is no metric.

    Example:
        >>> find_metric("cube_root")
        CubeRootLoss(reduction='none')
    """
    where, colon, name = text.rpartition(":")
    if text in FORMULAS:
        return FORMULAS[text]()
    if not colon:
        return make_loss(text, "none")
    if not (where and name and all(part.isidentifier() for part in name.split("."))):
        raise UsageError(f"metric: expected module:name or file.py:name, found {shown(text)}")
    try:
        found: Any = _load(where, text)
        for part in name.split("."):
            found = getattr(found, part)
        if isinstance(found, type):
            found = found(reduction="none") if issubclass(found, Loss) else found()
    except UsageError:
        raise
    except (Exception, SystemExit) as error:  # whatever other people's code raises
        raise UsageError(f"metric {shown(text)}: cannot be loaded: {type(error).__name__}: {error}") from error
    return as_metric(found, metric_label(text))


def metric_label(text: str) -> str:
    """What a metric that was found by a name is called in tables: without the folders of a file.

    Example:
        >>> metric_label("cuberoot"), metric_label("lab/my_metrics.py:distance")
        ('cube_root', 'my_metrics.py:distance')
    """
    return Path(text).name if ":" in text else LOSSES.canonical(text)


def named_metrics(metric: Metric | Mapping[str, Metric]) -> dict[str, Loss]:
    """One metric, or several by name, as losses by the name that each has in a table.

    Args:
        metric: As `as_metric` takes it.

    Raises:
        UsageError: There is none, or as `as_metric` says.
        DataError: A name is none.
    """
    if isinstance(metric, Mapping):
        if not metric:
            raise UsageError("metrics: expected at least one, found none")
        return {check_name(name, "metrics"): as_metric(one, name) for name, one in metric.items()}
    loss = as_metric(metric)
    return {metric_label(metric) if isinstance(metric, str) else loss.registered_name: loss}


def _load(where: str, text: str) -> Any:
    """A module by its name, or by the path of its file."""
    folder = str(Path.cwd())
    if where.endswith(".py"):
        path = Path(where)
        if not path.is_file():
            raise UsageError(f"metric {shown(text)}: no such file")
        folder = str(path.resolve().parent)
    elif not all(part.isidentifier() for part in where.split(".")):
        raise UsageError(f"metric: expected module:name or file.py:name, found {shown(text)}")
    sys.path.insert(0, folder)
    try:
        if not where.endswith(".py"):
            return importlib.import_module(where)
        spec = importlib.util.spec_from_file_location(f"torchbrdf_metric_{path.stem}", path)
        if spec is None or spec.loader is None:
            raise UsageError(f"metric {shown(text)}: expected a Python file")
        module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module
    finally:
        sys.path.remove(folder)


def _takes_pairs(function: Callable[..., Any]) -> bool:
    """Whether a function needs a third argument, or has one that is called pairs."""
    inner = function.forward if isinstance(function, nn.Module) else function
    try:
        parameters = inspect.signature(inner).parameters.values()
    except (TypeError, ValueError):  # written in C, which does not say
        return False
    places = [one for one in parameters if one.kind in (one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD)]
    if any(one.kind == one.VAR_POSITIONAL for one in parameters):
        return True
    return len(places) > 2 and (places[2].default is inspect.Parameter.empty or places[2].name == "pairs")
