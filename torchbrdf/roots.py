"""Square roots and quotients whose gradients are finite wherever their values are: 0, where there is no true one."""

import torch
from torch import Tensor


def safe_sqrt(x: Tensor) -> Tensor:
    """Square root with gradient 0 at 0, where the true one is infinite; nan below 0, and of nan.

    Args:
        x: any shape.

    Returns:
        The shape of x.

    Example:
        >>> import torch
        >>> x = torch.tensor([4.0, 0.0], requires_grad=True)
        >>> safe_sqrt(x).sum().backward()
        >>> x.grad
        tensor([0.2500, 0.0000])
    """
    if not x.requires_grad:
        return x.sqrt()
    none = x == 0
    return torch.where(none, 0, torch.where(none, 1, x).sqrt())


def safe_norm(vectors: Tensor, dim: int = -1) -> Tensor:
    """Euclidean length over one dimension, with gradient 0, and second derivatives 0, at 0.

    Args:
        vectors: any shape.
        dim: what the components lie along.

    Returns:
        The shape without that dimension.

    Example:
        >>> import torch
        >>> safe_norm(torch.tensor([[3.0, 4.0], [0.0, 0.0]]))
        tensor([5., 0.])
    """
    return safe_sqrt(vectors.square().sum(dim))


def safe_ratio(numerator: Tensor | float, denominator: Tensor) -> Tensor:
    """A quotient by numbers of at least 0, with gradient 0 where it is so large that its own could overflow.

    That is where the denominator is below tiny^0.4, 7e-16 in float32, or the quotient beyond its reciprocal. A
    denominator of 0 counts as the smallest normal number, so that the quotient stays finite or honestly huge.

    Args:
        numerator: any shape.
        denominator: at least 0, any shape.

    Returns:
        Their shape.

    Example:
        >>> import torch
        >>> safe_ratio(torch.tensor([3.0, 0.0]), torch.tensor([2.0, 0.0]))
        tensor([1.5000, 0.0000])
    """
    tiny = torch.finfo(denominator.dtype).tiny
    value = numerator / torch.where(denominator < tiny, tiny, denominator)
    if not value.requires_grad:
        return value
    least = tiny**0.4
    steep = (denominator < least) | (denominator <= abs(numerator) * least)
    return torch.where(steep, value.detach(), numerator / torch.where(steep, 1, denominator))
