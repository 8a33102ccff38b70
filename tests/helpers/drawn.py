"""Pictures of flat prints, drawn by following each pixel's rays through a camera and its lens."""

from dataclasses import dataclass

import cv2
import numpy as np

from jaxcam.rays.lens import normalised, pack, sight_lines


@dataclass(frozen=True)
class Print:
    """A picture on a plane.

    Attributes:
        texture: Its grey levels, uint8 [h, w].
        width: Metres.
        height: Metres.
        pose: Of its upper left corner in the world, [4, 4]: x right, y down, z into the paper.
    """

    texture: np.ndarray
    width: float
    height: float
    pose: np.ndarray


@dataclass(frozen=True)
class Look:
    """What spoils pictures: blur and noise of the sensor, and light from one side."""

    blur: float = 0.7
    noise: float = 4.0
    light: float = 0.3


def rays_of(K, height, width, lens=(), kind="opencv", samples=3):
    """Directions of `samples` x `samples` rays a pixel, [height * samples, width * samples, 3]."""
    u = (np.arange(width * samples) + 0.5) / samples
    v = (np.arange(height * samples) + 0.5) / samples
    u, v = np.meshgrid(u, v)
    x, y = normalised(np.asarray(K, float), u, v)
    packed = np.asarray(pack(np.array(lens, float), kind)) if len(lens) else np.zeros(9)
    return np.stack(np.broadcast_arrays(*sight_lines(x, y, packed, kind)), -1)


def draw(rays, world_from_camera, prints, rng, look=Look(), samples=3):
    """A picture, uint8 [H, W, 3], of prints before a grey, uneven wall."""
    directions = (rays @ world_from_camera[:3, :3].T).astype(np.float32)
    centre = world_from_camera[:3, 3]
    height, width = rays.shape[:2]
    wall = rng.uniform(60, 190, (6, 8)).astype(np.float32)
    picture = cv2.resize(wall, (width, height), interpolation=cv2.INTER_CUBIC)
    nearest = np.full((height, width), np.inf)
    for part in prints:
        normal = part.pose[:3, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((part.pose[:3, 3] - centre) @ normal) / (directions @ normal.astype(np.float32))
            points = t[..., None] * directions + (centre - part.pose[:3, 3]).astype(np.float32)
            x = points @ part.pose[:3, 0].astype(np.float32) / part.width
            y = points @ part.pose[:3, 1].astype(np.float32) / part.height
        ahead = (t > 0) & (t < nearest) & (rays[..., 2] > 0)
        on = ahead & (x > 0) & (x < 1) & (y > 0) & (y < 1)
        rows, columns = part.texture.shape
        place = (x * columns - 0.5).astype(np.float32), (y * rows - 0.5).astype(np.float32)
        ink = cv2.remap(part.texture, *place, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        picture = np.where(on, ink, picture)
        nearest = np.where(on, t, nearest)
    small = cv2.resize(picture, (width // samples, height // samples), interpolation=cv2.INTER_AREA)
    small = 20 + 0.8 * small
    ramp = np.linspace(1 - look.light, 1 + look.light / 3, small.shape[1])
    small = small * (ramp if rng.random() < 0.5 else ramp[::-1])
    small = cv2.GaussianBlur(small, (0, 0), look.blur) if look.blur else small
    small = small + rng.normal(0, look.noise, small.shape)
    return np.repeat(np.clip(np.rint(small), 0, 255).astype(np.uint8)[..., None], 3, -1)


def boards_shown(rng, camera, board, count=20, look=Look(), samples=2):
    """Pictures of a board as somebody takes them who was told how: everywhere, and tilted.

    Args:
        rng: Generator.
        camera: K, (height, width), coefficients and kind of the lens.
        board: `jaxcam.robot.calibration.boards.Board`.
        count: Pictures.
        look: What spoils them.
        samples: Rays a pixel, each way.
    """
    K, (h, w), coefficients, kind = camera
    width, height, edge = board.columns * board.square, board.rows * board.square, board.square
    texture = np.pad(board.drawn(96), 96, constant_values=255)
    rays = rays_of(K, h, w, coefficients, kind, samples)
    packed = np.asarray(pack(np.array(coefficients, float), kind))
    for i in range(count):
        place = np.array([i % 3 - 1, i // 3 % 3 - 1]) * rng.uniform(0.7, 1, 2)
        pixel = np.array([w / 2, h / 2]) + place * np.array([w, h]) * 0.38
        sight = np.stack(sight_lines(*normalised(K, *pixel), packed, "opencv"))
        z = sight / np.linalg.norm(sight)
        far = rng.uniform(0.9, 1.6) * width * K[0, 0] / w
        far = far * (0.8 if kind == "fisheye" else 1.0)
        x = np.cross([0, 1, 0], z)
        x /= np.linalg.norm(x)
        turn = np.stack([x, np.cross(z, x), z], 1)
        way = 2.4 * i + rng.uniform(-0.5, 0.5)
        tilt = np.array([np.cos(way), np.sin(way), 0]) * rng.uniform(0.35, 0.8)
        roll = np.array([0, 0, rng.uniform(-0.5, 0.5) + np.pi / 2 * (i % 4 == 3)])
        pose = np.eye(4)
        pose[:3, :3] = turn @ cv2.Rodrigues(tilt)[0] @ cv2.Rodrigues(roll)[0]
        middle = pose[:3, :3] @ np.array([width / 2 + edge, height / 2 + edge, 0])
        pose[:3, 3] = far * z - middle
        paper = Print(texture, width + 2 * edge, height + 2 * edge, pose)
        yield draw(rays, np.eye(4), [paper], rng, look, samples)


def tag_print(family, number, size, pose):
    """A tag with a white margin of a cell; `pose` is its own: x right, y up, z out."""
    from jaxcam.robot.calibration.boards import dictionary_of

    dictionary = dictionary_of(family)
    cells = dictionary.markerSize + 2
    ink = cv2.aruco.generateImageMarker(dictionary, number, 40 * cells)
    texture = np.pad(ink, 40, constant_values=255)
    side = size * (cells + 2) / cells
    corner = np.eye(4)
    corner[:3, :3], corner[:3, 3] = np.diag([1, -1, -1]), (-side / 2, side / 2, 0)
    return Print(texture, side, side, pose @ corner)
