"""Rotations as quaternions and matrices.

Quaternions are ``wxyz`` (3DGS, PLY files, gsplat) unless a name says ``xyzw`` (scipy, VGGT's pose encoding).
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


def wxyz_from_xyzw(quaternions: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4"]:
    """Move the real part to the front."""
    return quaternions.roll(1, dims=-1)


def xyzw_from_wxyz(quaternions: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4"]:
    """Move the real part to the back."""
    return quaternions.roll(-1, dims=-1)


def matrix_from_wxyz(quaternions: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrices of quaternions of any norm; that of the zero quaternion is the identity."""
    w, x, y, z = F.normalize(quaternions, dim=-1).unbind(-1)
    entries = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(entries, dim=-1).unflatten(-1, (3, 3))


def wxyz_from_matrix(matrices: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 4"]:
    """Unit quaternions of rotation matrices, with ``w`` at least 0.

    The columns of the outer product ``q qᵀ`` are linear in the matrix; the one with the largest diagonal entry is
    normalised, which is accurate for every angle, half turns included.
    """
    m = matrices
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    entries = [
        1 + xx + yy + zz, wx, wy, wz,
        wx, 1 + xx - yy - zz, xy, xz,
        wy, xy, 1 - xx + yy - zz, yz,
        wz, xz, yz, 1 - xx - yy + zz,
    ]  # fmt: skip
    outer = torch.stack(entries, dim=-1).unflatten(-1, (4, 4))  # ... 4 4, four times q qᵀ
    best = outer.diagonal(dim1=-2, dim2=-1).argmax(dim=-1)  # ...
    column = torch.take_along_dim(outer, best[..., None, None], dim=-2).squeeze(-2)  # ... 4
    unit = F.normalize(column, dim=-1)
    return torch.where(unit[..., :1] < 0, -unit, unit)


def multiply(left: Float[Tensor, "*batch 4"], right: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4"]:
    """Hamilton products: the rotation that turns by ``right`` first and by ``left`` then."""
    a, b, c, d = left.unbind(-1)
    w, x, y, z = right.unbind(-1)
    products = [
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    ]
    return torch.stack(products, dim=-1)


def slerp(
    start: Float[Tensor, "*batch 4"], end: Float[Tensor, "*batch 4"], amount: "float | Float[Tensor, '*batch']"
) -> Float[Tensor, "*batch 4"]:
    """The rotation at ``amount`` in [0, 1] of the shorter way from ``start`` to ``end``, at constant speed.

    Args:
        start: Quaternions of any norm but 0.
        end: The same; its sign does not matter.
        amount: One for all, or one each.
    """
    start, end = F.normalize(start, dim=-1), F.normalize(end, dim=-1)
    cosine = (start * end).sum(-1, keepdim=True)
    end = torch.where(cosine < 0, -end, end)
    # atan2 of chord lengths, where acos of the cosine would lose half of the digits of a small angle.
    angle = 2 * torch.atan2((end - start).norm(dim=-1, keepdim=True), (end + start).norm(dim=-1, keepdim=True))
    share = torch.as_tensor(amount, dtype=start.dtype, device=start.device).expand(start.shape[:-1])[..., None]
    # sinc(x) is sin(pi x) / (pi x): sin(s angle) / sin(angle) without a division by 0 for equal rotations.
    whole = torch.sinc(angle / torch.pi)
    first = (1 - share) * torch.sinc((1 - share) * angle / torch.pi) / whole
    second = share * torch.sinc(share * angle / torch.pi) / whole
    return F.normalize(first * start + second * end, dim=-1)
