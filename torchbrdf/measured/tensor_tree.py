"""Tensor trees of Radiance, XML: BSDFs of three or four coordinates, finer where they change more.

Source: G. Ward, M. Kurt, N. Bonneel, Reducing Anisotropic BSDF Measurement to Common Practice, 2014,
doi:10.2312/mam.20141292; the map of a square to a disk is that of P. Shirley, K. Chiu, A Low Distortion Map Between
Disk and Square, 1997, doi:10.1080/10867651.1997.10487479.
"""

import math
import re
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.format import FORMATS, Interpolation
from torchbrdf.measured.listed import Listed
from torchbrdf.measured.tristimulus import rgb_of_reflected
from torchbrdf.measured.window import Block, WindowFormat, is_tree, is_window, numbers, read_window
from torchbrdf.reading import check_unpacked

_RANKS = {"tensortree3": 3, "tensortree4": 4}
_BASIS = "LBNL/Shirley-Chiu"
# How often the unit cube may be halved: Radiance's own coordinates have 16 bits.
_DEEPEST = 16
_PIECES = re.compile(r"[{}]|[^{}]+")
# Of a leaf while it is read, and of a node.
_BYTES_A_LEAF, _BYTES_A_NODE = 200, 2000


class Tree:
    """A unit cube that is halved along all of its axes, again and again, down to blocks of equal cells with a value.

    Args:
        path: The file, for errors.
        where: What of it, for errors.
        text: Its nodes in braces: the nodes of each half, the first axis varying fastest, or the numbers of cells, the
            last axis varying fastest.
        rank: How many axes there are.
    """

    def __init__(self, path: Path, where: str, text: str, rank: int) -> None:
        self.rank = rank
        self._error = f"{path}: {where}: "
        check_unpacked(path, _BYTES_A_NODE * text.count("{"))
        nodes: list[list[int]] = []
        blocks: list[tuple[int, int, np.ndarray, np.ndarray]] = []  # node, cells along an axis, corner, values
        corners: list[np.ndarray] = []
        opened: list[int] = []
        closed = False
        for piece in _PIECES.findall(text):
            if piece == "{":
                self._check(not closed and len(opened) <= _DEEPEST, f"one tree of up to {_DEEPEST} levels", "more")
                corners.append(self._corner(nodes, corners, opened))
                nodes.append([])
                opened.append(len(nodes) - 1)
            elif piece == "}":
                self._check(opened, "an opened node", "'}'")
                self._check_node(nodes[opened.pop()])
                closed = not opened
            elif words := piece.strip(" \t\r\n,"):
                self._check(opened and not nodes[opened[-1]], "numbers within a node without others", shown(words))
                values = numbers(path, where, words)
                size = round(len(values) ** (1 / rank))
                self._check(
                    size**rank == len(values) and size & (size - 1) == 0 and size <= 1 << _DEEPEST,
                    f"as many numbers as a cube of rank {rank} has",
                    str(len(values)),
                )
                blocks.append((opened[-1], size, corners[opened[-1]], values))
                nodes[opened[-1]] = [-len(blocks)]
        self._check(closed, "a tree in braces", "none, or one that is cut")
        self._build(path, nodes, blocks)

    def _check(self, good: object, expected: str, found: str) -> None:
        if not good:
            raise DataError(f"{self._error}expected {expected}, found {found}")

    def _check_node(self, node: list[int]) -> None:
        good = len(node) == 1 << self.rank or (len(node) == 1 and node[0] < 0)
        self._check(good, f"{1 << self.rank} nodes in a node, or numbers", str(len(node)))

    def _corner(self, nodes: list[list[int]], corners: list[np.ndarray], opened: list[int]) -> np.ndarray:
        """The lowest coordinates of the next node, which becomes a half of the last one opened; and its width."""
        if not opened:
            return np.array([0.0] * self.rank + [1.0])
        parent = nodes[opened[-1]]
        self._check(not (parent and parent[0] < 0), "nodes or numbers within a node", "both")
        self._check(len(parent) < 1 << self.rank, f"{1 << self.rank} nodes in a node", "more")
        half = np.array([len(parent) >> axis & 1 for axis in range(self.rank)])
        own = corners[opened[-1]]
        width = own[-1] / 2
        parent.append(len(nodes))
        return np.append(own[:-1] + half * width, width)

    def _build(self, path: Path, nodes: list[list[int]], blocks: list[tuple[int, int, np.ndarray, np.ndarray]]) -> None:
        """Tables to look cells up by, and where these are."""
        check_unpacked(path, _BYTES_A_LEAF * sum(len(values) for *_, values in blocks))
        children = np.zeros((len(nodes), 1 << self.rank), np.int64)
        for k, inner in enumerate(nodes):
            children[k] = inner if inner[0] >= 0 else k
        first, size = np.zeros(len(nodes), np.int64), np.zeros(len(nodes), np.int64)
        low, width, count = [], [], 0
        for node, own, corner, values in blocks:
            first[node], size[node] = count, own
            count += len(values)
            cells = np.stack(np.unravel_index(np.arange(len(values)), (own,) * self.rank), -1)
            low.append(corner[:-1] + cells * (corner[-1] / own))
            width.append(np.full(len(values), corner[-1] / own))
        self.children, self.first, self.size = map(torch.from_numpy, (children, first, size))
        self.low, self.width = np.concatenate(low), np.concatenate(width)
        self.values = np.concatenate([values for *_, values in blocks])

    def cells(self, place: Tensor) -> Tensor:
        """The cells that places `(N, rank)` are in, `(N,)`; places beyond the cube are moved to its edge."""
        children, first, size = (one.to(place.device) for one in (self.children, self.first, self.size))
        place = place.nan_to_num(0).clamp(0, 1 - 2.0**-20)
        axes = 1 << torch.arange(self.rank, dtype=torch.int64, device=place.device)
        node = torch.zeros(len(place), dtype=torch.int64, device=place.device)
        while (inner := size[node] == 0).any():
            half = (2 * place >= 1).to(torch.int64)
            node = torch.where(inner, children[node, (half * axes).sum(-1)], node)
            place = torch.where(inner[:, None], 2 * place - half, place)
        own = size[node]
        found = torch.zeros_like(node)
        for axis in place.unbind(-1):
            found = found * own + torch.minimum((axis * own).to(torch.int64), own - 1)
        return first[node] + found


class _Leaves:
    """The cells of a tree as pairs of directions: constant within, as in Radiance, whatever the interpolation.

    Args:
        tree: Of rank 3, by the sine of theta_i and by the viewer with the light towards -x; or of rank 4, by both.
        turn: 1 where azimuths are counted as in the file, -1 where the other way round.
    """

    def __init__(self, tree: Tree, turn: int) -> None:
        self.tree, self.turn = tree, turn
        self.is_anisotropic = tree.rank == 4
        # Of rank 3 the half of the first axis above 0.5 is not used.
        self._used = np.ones(len(tree.values), bool) if self.is_anisotropic else tree.low[:, 0] < 0.5
        self._rows = torch.from_numpy(np.cumsum(self._used) - 1)

    def values(self) -> np.ndarray:
        """Of the cells, `(N, 1)`."""
        return self.tree.values[self._used, None]

    def of(self, other: Tree) -> np.ndarray:
        """What another tree has at the middles of cells, `(N,)`."""
        middle = (self.tree.low + self.tree.width[:, None] / 2)[self._used]
        found: np.ndarray = other.values[other.cells(torch.from_numpy(middle)).numpy()]
        return found

    def angles(self) -> np.ndarray:
        """theta_i, phi_i, theta_o, phi_o of the middles of cells, radians, `(N, 4)`."""
        low, width = self.tree.low[self._used], self.tree.width[self._used]
        middle = low + width[:, None] / 2
        if self.is_anisotropic:
            x, y = _disk(middle[:, 0], middle[:, 1])
            theta_i, phi_i = np.arcsin(np.minimum(np.hypot(x, y), 1)), np.arctan2(-y, -x)
        else:
            theta_i = np.arcsin(np.clip(1 - low[:, 0] - np.minimum(low[:, 0] + width, 0.5), -1, 1))
            phi_i = np.full_like(theta_i, math.pi)
        x, y = _disk(middle[:, -2], middle[:, -1])
        theta_o, phi_o = np.arcsin(np.minimum(np.hypot(x, y), 1)), np.arctan2(y, x)
        return np.stack([theta_i, self.turn * phi_i, theta_o, self.turn * phi_o], -1)

    def around(self, wi: Tensor, wo: Tensor, interpolation: Interpolation) -> tuple[Tensor, Tensor]:
        """The cell of each pair."""
        turned = torch.tensor([1, self.turn], dtype=wi.dtype, device=wi.device)
        light, viewer = -wi[:, :2] * turned, wo[:, :2] * turned
        if self.is_anisotropic:
            place = torch.cat([_square(light), _square(viewer)], -1)
        else:
            radius = light.square().sum(-1, keepdim=True).sqrt()
            x, y = torch.where(radius > 0, light / torch.where(radius > 0, radius, 1), light.new_tensor([1, 0])).unbind(
                -1
            )
            turned = torch.stack([x * viewer[:, 0] + y * viewer[:, 1], x * viewer[:, 1] - y * viewer[:, 0]], -1)
            place = torch.cat([(0.5 - radius.clamp(max=1) / 2).clamp(max=0.5 - 2.0**-20), _square(turned)], -1)
        return self._rows.to(wi.device)[self.tree.cells(place)][:, None], torch.ones_like(wi[:, :1])


def _disk(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places in the unit disk of places in the unit square."""
    a, b = 2 * x - 1, 2 * y - 1
    wide = np.abs(a) >= np.abs(b)
    radius, other = np.where(wide, a, b), np.where(wide, b, a)
    turn = (math.pi / 4) * other / np.where(radius == 0, 1, radius)
    along, across = radius * np.cos(turn), radius * np.sin(turn)
    return np.where(wide, along, across), np.where(wide, across, along)


def _square(disk: Tensor) -> Tensor:
    """Places in the unit square of places `(N, 2)` in the unit disk."""
    x, y = disk.unbind(-1)
    wide = x.abs() >= y.abs()
    long, short = torch.where(wide, x, y), torch.where(wide, y, x)
    radius = disk.square().sum(-1).sqrt() * long.sign()
    other = radius * torch.atan(short / torch.where(long == 0, 1, long)) / (math.pi / 4)
    return (torch.stack([torch.where(wide, radius, other), torch.where(wide, other, radius)], -1) + 1) / 2


@FORMATS.register("tensor_tree")
class TensorTree(WindowFormat):
    """The format of Radiance's tensor trees, isotropic (rank 3) or anisotropic (rank 4), grey or in colour.

    Values are constant in each cell of the tree. Colours are in trees of their own, the chromaticities u' and v' of
    CIE 1976; a cell has those of its middle.
    """

    format = "tensor_tree"
    colors = ("visible", "cie-u", "cie-v")

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is such a file, by its root and the structure that it names."""
        return is_window(path, head) and is_tree(path)

    def gridded(self, path: Path) -> tuple[Listed, _Leaves]:
        """What a file says."""
        document = read_window(path)
        rank = _RANKS.get(document.structure.lower())
        if rank is None:
            found = shown(document.structure)
            raise DataError(f"{path}: IncidentDataStructure: expected TensorTree3 or TensorTree4, found {found}")
        chosen = self.chosen(path, document)
        tree, *chromaticity = (_tree(path, block, rank) for block in chosen.blocks.values())
        leaves = _Leaves(tree, 1 if chosen.side == "back" else -1)
        finest, coarsest = (round(1 / width) for width in (tree.width.min(), tree.width.max()))
        facts = {
            "angles": "squares mapped to the disk of directions; the mirror direction of light is where it goes on to",
            "tree": f"rank {rank}, {len(leaves.values())} cells of 1/{finest} to 1/{coarsest}; constant in each",
            **chosen.facts,
        }
        values = leaves.values()
        if chromaticity:
            values = rgb_of_reflected(_tristimulus(values[:, 0], *map(leaves.of, chromaticity)))
            facts["chromaticities"] = "of the middle of each cell; made linear RGB (BT.709); what reflects all is white"
        return Listed(leaves.angles(), values, None, self.setting("quantity", "brdf"), facts), leaves


def _tristimulus(luminance: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """X, Y and Z `(N, 3)` of luminance and u', v'; what reflects nothing is black, nan where these are none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        found = luminance * np.stack([9 * u / (4 * v), np.ones_like(v), (12 - 3 * u - 20 * v) / (4 * v)])
    known = (u >= 0) & (v > 0) & (3 * u + 20 * v <= 12)
    return np.where(luminance == 0, 0, np.where(known, found, np.nan)).T


def _tree(path: Path, block: Block, rank: int) -> Tree:
    basis = block.said("AngleBasis")
    if basis.lower() != _BASIS.lower():
        raise DataError(f"{path}: AngleBasis: expected {_BASIS}, found {shown(basis)}")
    return Tree(path, f"{block.direction}, {block.band}", block.said("ScatteringData"), rank)
