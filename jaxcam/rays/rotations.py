"""Rotations as matrices, rotation vectors and quaternions, for NumPy and JAX, batched."""

from jaxcam.rays._arrays import Array, array_namespace, matmul, rigid

__all__ = [
    "Array",
    "array_namespace",
    "matmul",
    "matrix_from_quaternion",
    "matrix_from_rotvec",
    "nearest_rotation",
    "quaternion_from_matrix",
    "rigid",
    "rotvec_from_matrix",
    "skew",
]


def matrix_from_rotvec(rotvec: Array) -> Array:
    """Rotation matrices [..., 3, 3] of rotation vectors (axis times angle, rad) [..., 3]."""
    xp = array_namespace(rotvec)
    squared = (rotvec**2).sum(-1)[..., None, None]
    small = squared < 1e-12
    safe = xp.where(small, 1.0, squared)
    angle = xp.sqrt(safe)
    sine = xp.where(small, 1 - squared / 6, xp.sin(angle) / angle)
    cosine = xp.where(small, 0.5 - squared / 24, (1 - xp.cos(angle)) / safe)
    cross = skew(rotvec)
    return xp.eye(3, dtype=cross.dtype) + sine * cross + cosine * matmul(cross, cross)


def rotvec_from_matrix(rotation: Array) -> Array:
    """Rotation vectors (rad) [..., 3] of matrices [..., 3, 3], angles in [0, pi]."""
    quaternion = quaternion_from_matrix(rotation)
    xp = array_namespace(rotation)
    w, xyz = quaternion[..., :1], quaternion[..., 1:]
    squared = (xyz**2).sum(-1, keepdims=True)
    small = squared < 1e-12
    norm = xp.sqrt(xp.where(small, 1.0, squared))
    angle = 2 * xp.arctan2(norm, w)
    return xyz * xp.where(small, 2.0, angle / norm)


def quaternion_from_matrix(rotation: Array) -> Array:
    """Quaternions wxyz [..., 4] with w >= 0 of matrices [..., 3, 3].

    Takes, of the four ways to read a quaternion off a matrix, the best conditioned (Shepperd 1978).
    """
    xp = array_namespace(rotation)
    r = rotation
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    a, b, c = r[..., 2, 1], r[..., 0, 2], r[..., 1, 0]
    d, e, f = r[..., 1, 2], r[..., 2, 0], r[..., 0, 1]
    rows = [
        [1 + xx + yy + zz, a - d, b - e, c - f],
        [a - d, 1 + xx - yy - zz, f + c, b + e],
        [b - e, f + c, 1 - xx + yy - zz, d + a],
        [c - f, b + e, d + a, 1 - xx - yy + zz],
    ]
    table = xp.stack([xp.stack(row, -1) for row in rows], -2)
    best = xp.argmax(xp.stack([rows[i][i] for i in range(4)], -1), -1)
    chosen = xp.take_along_axis(table, best[..., None, None], -2)[..., 0, :]
    chosen = chosen / xp.sqrt((chosen**2).sum(-1, keepdims=True))
    return xp.where(chosen[..., :1] < 0, -chosen, chosen)


def matrix_from_quaternion(quaternion: Array) -> Array:
    """Rotation matrices [..., 3, 3] of unit quaternions wxyz [..., 4]."""
    xp = array_namespace(quaternion)
    w, x, y, z = (quaternion[..., i] for i in range(4))
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return xp.stack([xp.stack(row, -1) for row in rows], -2)


def nearest_rotation(matrix: Array) -> Array:
    """The rotations [..., 3, 3] nearest to matrices, such as means of rotations, entry by entry."""
    xp = array_namespace(matrix)
    u, _, v = xp.linalg.svd(matrix)
    # -1 where the nearest orthogonal matrix is a mirror.
    sign = xp.linalg.det(matmul(u, v))[..., None, None]
    return matmul(u, xp.concatenate([v[..., :2, :], v[..., 2:, :] * sign], -2))


def skew(v: Array) -> Array:
    """Matrices [..., 3, 3] whose product with u is the cross product v x u, for v [..., 3]."""
    xp = array_namespace(v)
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    zero = xp.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return xp.stack([xp.stack(row, -1) for row in rows], -2)
