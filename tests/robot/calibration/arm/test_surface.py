"""Samples, silhouettes and contours, against hulls of the boxes' corners."""

from dataclasses import replace

import cv2
import numpy as np
from boxed_arm import CAMERA, SIDE, K, boxed_arm, hulls

from jaxcam.robot.calibration.arm.surface import Surface, contour, silhouette
from jaxcam.robot.calibration.projection import placed

ANGLES = np.array([0.3, -0.2, 0.6])


def drawn():
    mask = np.zeros((SIDE, SIDE), np.uint8)
    for outline in hulls(ANGLES, CAMERA):
        cv2.fillConvexPoly(mask, np.rint((outline - 0.5) * 16).astype(np.int32), 1, shift=4)
    return mask > 0


def poses():
    return np.linalg.inv(CAMERA) @ boxed_arm().poses(ANGLES[None])[0]


def test_samples_fill_the_silhouette():
    points, owners = Surface.of(boxed_arm().parts).samples(0.005)
    there = placed(poses()[owners], points[:, None])[:, 0]
    pixels = there[:, :2] / there[:, 2:] @ K[:2, :2].T + K[:2, 2]
    mask, true = silhouette(pixels, (SIDE, SIDE)), drawn()
    assert (mask & true).sum() / (mask | true).sum() > 0.94


def test_a_contour_lies_on_the_outline_and_looks_outwards():
    true = drawn()
    got = contour(Surface.of(boxed_arm().parts), poses(), K, true, spacing=1.0)
    assert len(got.pixels) > 100
    outlines = hulls(ANGLES, CAMERA)
    sides = []
    for pixel, normal in zip(got.pixels, got.normals, strict=True):
        distances = [abs(cv2.pointPolygonTest(o, tuple(map(float, pixel)), True)) for o in outlines]
        assert min(distances) < 0.02
        out, inside = pixel + 2 * normal, pixel - 2 * normal
        sides.append((true[int(out[1]), int(out[0])], true[int(inside[1]), int(inside[0])]))
    outside, within = np.mean(sides, 0)
    assert outside < 0.02  # where two boxes meet, one lies beyond the other
    assert within > 0.98


def test_contour_points_are_points_of_links():
    got = contour(Surface.of(boxed_arm().parts), poses(), K, drawn())
    there = placed(poses()[got.owners], got.points[:, None])[:, 0]
    pixels = there[:, :2] / there[:, 2:] @ K[:2, :2].T + K[:2, 2]
    np.testing.assert_allclose(pixels, got.pixels, atol=0.3)


def test_each_edge_has_the_faces_on_its_sides():
    surface = Surface.of(boxed_arm().parts)
    part, edges = surface.parts[0], surface.edges[0]
    assert len(edges) == 18  # a box of twelve triangles
    for a, b, one, other in edges:
        assert {a, b} <= set(part.faces[one])
        assert {a, b} <= set(part.faces[other])
        assert one != other


def test_a_wall_within_a_wall_gives_no_contour_of_its_own():
    """Two pixels within, where the silhouette does not tell them apart."""
    parts = boxed_arm().parts
    middle = [part.vertices.mean(0) for part in parts]
    within = [replace(p, vertices=m + 0.96 * (p.vertices - m))
              for p, m in zip(parts, middle, strict=True)]  # fmt: skip
    both = Surface.of([*parts, *within])
    got = contour(both, np.concatenate([poses()] * 2), K, drawn())
    alone = contour(Surface.of(parts), poses(), K, drawn())
    assert (got.owners >= len(parts)).mean() < 0.1
    assert (got.owners < len(parts)).sum() > 0.8 * len(alone.owners)
