"""Convex pieces: their bounds, how deep two of them interpenetrate, and how far one can fall onto another."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from simfoundry.lint.frames import Frame, Vec, cross, dot, minus, unit

CLOSE = 5e-5
"""Depths and heights are found to within this [m]: far below every threshold that they are held against."""

STEEP = 1e-9
"""A triangle whose normal rises by less than this is seen edge on from above, and says nothing of a height."""

ROUNDS = 80
"""Support points that are looked at for one pair; round shapes need about twenty."""


class Piece(NamedTuple):
    """The hull of ``points`` [m], of discs about them, or of balls about them.

    With ``radii`` each point is the centre of a disc at right angles to ``axis``; ``margin`` [m] is the radius of the
    balls. ``low`` and ``high`` are the corners of the bounds.
    """

    points: tuple[Vec, ...]
    margin: float = 0.0
    radii: tuple[float, ...] = ()
    axis: Vec = (0.0, 0.0, 1.0)
    low: Vec = (0.0, 0.0, 0.0)
    high: Vec = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, points: Iterable[Vec], margin: float = 0.0) -> Piece:
        """The hull of points, or of balls of one radius about them."""
        points = tuple(points)
        xs, ys, zs = zip(*points, strict=True)
        low = (min(xs) - margin, min(ys) - margin, min(zs) - margin)
        return cls(points, margin, (), (0.0, 0.0, 1.0), low, (max(xs) + margin, max(ys) + margin, max(zs) + margin))

    @classmethod
    def of_discs(cls, points: Iterable[Vec], radii: tuple[float, ...], axis: Vec = (0.0, 0.0, 1.0)) -> Piece:
        """The hull of discs."""
        points = tuple(points)
        sx, sy, sz = (math.sqrt(max(0.0, 1 - a * a)) for a in axis)
        low = (
            min(p[0] - r * sx for p, r in zip(points, radii, strict=True)),
            min(p[1] - r * sy for p, r in zip(points, radii, strict=True)),
            min(p[2] - r * sz for p, r in zip(points, radii, strict=True)),
        )
        high = (
            max(p[0] + r * sx for p, r in zip(points, radii, strict=True)),
            max(p[1] + r * sy for p, r in zip(points, radii, strict=True)),
            max(p[2] + r * sz for p, r in zip(points, radii, strict=True)),
        )
        return cls(points, 0.0, radii, axis, low, high)

    def moved(self, X_AB: Frame) -> Piece:
        """The same piece, given in the frame B, in the frame A of ``X_AB``."""
        a, b, c, d, e, f, g, h, i = X_AB.r
        px, py, pz = X_AB.p
        points = [
            (a * x + b * y + c * z + px, d * x + e * y + f * z + py, g * x + h * y + i * z + pz)
            for x, y, z in self.points
        ]
        if self.radii:
            return Piece.of_discs(points, self.radii, X_AB.turn(self.axis))
        return Piece.of(points, self.margin)

    def support(self, n: Vec) -> Vec:
        """A point of the piece that lies farthest in the direction ``n``."""
        nx, ny, nz = n
        if not self.radii:
            best = max(self.points, key=lambda p: p[0] * nx + p[1] * ny + p[2] * nz)
            if not self.margin:
                return best
            length = math.sqrt(nx * nx + ny * ny + nz * nz)
            s = self.margin / length if length > 0 else 0.0
            return (best[0] + nx * s, best[1] + ny * s, best[2] + nz * s)
        ax, ay, az = self.axis
        along = nx * ax + ny * ay + nz * az
        ux, uy, uz = nx - along * ax, ny - along * ay, nz - along * az
        length = math.sqrt(ux * ux + uy * uy + uz * uz)
        if length > 1e-12 * (abs(nx) + abs(ny) + abs(nz)):
            ux, uy, uz = ux / length, uy / length, uz / length
        else:
            ux = uy = uz = length = 0.0
        farthest, out = -math.inf, self.points[0]
        for (x, y, z), r in zip(self.points, self.radii, strict=True):
            value = x * nx + y * ny + z * nz + r * length
            if value > farthest:
                farthest, out = value, (x + r * ux, y + r * uy, z + r * uz)
        return out

    def extent(self, n: Vec) -> tuple[float, float]:
        """Lowest and highest value of ``n . p`` over the piece."""
        return dot(self.support((-n[0], -n[1], -n[2])), n), dot(self.support(n), n)


def apart(a: Piece, b: Piece, gap: float = 0.0) -> bool:
    """Whether the bounds of two pieces are more than ``gap`` apart, or with a negative one overlap by less."""
    (x0, y0, z0), (x1, y1, z1), (u0, v0, w0), (u1, v1, w1) = a.low, a.high, b.low, b.high
    return u0 - x1 > gap or x0 - u1 > gap or v0 - y1 > gap or y0 - v1 > gap or w0 - z1 > gap or z0 - w1 > gap


def penetration(a: Piece, b: Piece, ignored: float = 0.0) -> float:
    """How far one of the pieces must be moved to part them [m]; no more than ``ignored`` where that already parts them.

    The difference of the two, all ``b - a``, holds the origin where they overlap; how deep, its nearest face says. The
    difference is grown from a tetrahedron by support points, always at the face nearest to the origin, or farthest
    beyond it.
    """
    corners, faces = _tetrahedron(a, b)
    least = math.inf
    for _ in range(ROUNDS):
        if not faces:
            return 0.0  # flat: it has no inside
        nearest = min(faces, key=_distance)
        n, distance = nearest[3], nearest[4]
        w = _difference(a, b, n)
        reached = dot(w, n)
        least = min(least, reached)
        if least <= ignored or reached - distance < CLOSE:
            return least
        faces = _grown(corners, faces, nearest, w)
    return least


_Face = tuple[int, int, int, Vec, float]


def _distance(face: _Face) -> float:
    return face[4]


def _difference(a: Piece, b: Piece, n: Vec) -> Vec:
    p, q = b.support(n), a.support((-n[0], -n[1], -n[2]))
    return (p[0] - q[0], p[1] - q[1], p[2] - q[2])


def _face(corners: list[Vec], i: int, j: int, k: int) -> _Face:
    """A face with its outward normal and its distance from the origin; one without an area is infinitely far."""
    a = corners[i]
    n = cross(minus(corners[j], a), minus(corners[k], a))
    length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    if length < 1e-18:
        return (i, j, k, (0.0, 0.0, 0.0), math.inf)
    n = (n[0] / length, n[1] / length, n[2] / length)
    return (i, j, k, n, dot(n, a))


def _tetrahedron(a: Piece, b: Piece) -> tuple[list[Vec], list[_Face]]:
    """Four corners of the difference that span a volume, with outward faces; no faces where it is flat."""
    corners = [_difference(a, b, (1.0, 0.0, 0.0)), _difference(a, b, (-1.0, 0.0, 0.0))]
    edge = unit(minus(corners[1], corners[0]))
    side = unit(cross(edge, (0.0, 0.0, 1.0) if abs(edge[2]) < 0.9 else (0.0, 1.0, 0.0)))
    for _ in range(2):
        pair = [_difference(a, b, side), _difference(a, b, (-side[0], -side[1], -side[2]))]
        far = [abs(dot(minus(p, corners[0]), side)) for p in pair]
        corners.append(pair[0] if far[0] >= far[1] else pair[1])
        side = unit(cross(edge, minus(corners[2], corners[0])))
    height = dot(minus(corners[3], corners[0]), side)
    if abs(height) < 1e-9:
        return corners, []
    if height > 0:
        corners[0], corners[1] = corners[1], corners[0]
    return corners, [_face(corners, *ijk) for ijk in ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0))]


def _grown(corners: list[Vec], faces: list[_Face], nearest: _Face, w: Vec) -> list[_Face]:
    """The faces of the hull with one more corner, beyond the ``nearest`` of them; it is added to ``corners``.

    What ``w`` sees is followed from face to neighbour: judged each for itself, faces in one plane could leave a hole.
    """
    corners.append(w)
    last = len(corners) - 1
    wx, wy, wz = w
    beside = {}
    for face in faces:
        i, j, k = face[:3]
        beside[i, j] = beside[j, k] = beside[k, i] = face
    seen, todo = {nearest[:3]}, [nearest]
    rim: list[tuple[int, int]] = []
    while todo:
        i, j, k = todo.pop()[:3]
        for edge in ((i, j), (j, k), (k, i)):
            other = beside[edge[::-1]]
            if other[:3] in seen:
                continue
            n = other[3]
            if n[0] * wx + n[1] * wy + n[2] * wz - other[4] > 1e-10:
                seen.add(other[:3])
                todo.append(other)
            else:
                rim.append(edge)
    kept = [face for face in faces if face[:3] not in seen]
    return kept + [_face(corners, i, j, last) for i, j in rim]


def lift(a: Piece, b: Piece, sign: float = 1.0) -> float | None:
    """How far ``a`` must be raised so that it touches ``b`` from above [m]; negative where it would have to fall.

    With a ``sign`` of -1 the same from below: how far it must be raised at least so that the two meet. None where the
    one passes beside the other.

    It is where the vertical line leaves the difference of the two; a triangle of its points around the line is
    refined.
    """
    if a.high[0] < b.low[0] or b.high[0] < a.low[0] or a.high[1] < b.low[1] or b.high[1] < a.low[1]:
        return None
    triangle = _around_the_line(a, b)
    if triangle is None:
        return None
    p, q, r = triangle
    height = -math.inf
    for _ in range(ROUNDS):
        n = unit(cross(minus(q, p), minus(r, p)))
        if abs(n[2]) < STEEP:
            break
        if n[2] * sign < 0:
            n = (-n[0], -n[1], -n[2])
        height = dot(n, p) / n[2]
        w = _difference(a, b, n)
        if dot(n, minus(w, p)) < CLOSE * abs(n[2]):
            break
        p, q, r = _higher(p, q, r, w, sign)
    return height if math.isfinite(height) else None


def _around_the_line(a: Piece, b: Piece) -> tuple[Vec, Vec, Vec] | None:
    """Three points of the difference around the vertical line through the origin; None where it does not meet it."""
    middle = [(b.low[k] + b.high[k] - a.low[k] - a.high[k]) / 2 for k in range(2)]
    x, y = middle if math.hypot(*middle) > 1e-12 else (1.0, 0.0)
    n: Vec = (0.6 * y - 0.8 * x, -0.6 * x - 0.8 * y, 0.0)  # askew, or else the origin lies on a side of the triangle
    p = _difference(a, b, n)
    if p[0] * n[0] + p[1] * n[1] < 0:
        return None
    n = (-p[0], -p[1], 0.0) if math.hypot(p[0], p[1]) > 1e-12 else (-n[0], -n[1], 0.0)
    q = _difference(a, b, n)
    if q[0] * n[0] + q[1] * n[1] < 0:
        return None
    for _ in range(ROUNDS):
        ex, ey = q[0] - p[0], q[1] - p[1]
        side = ex * -p[1] - ey * -p[0]  # of the origin, left of the edge from p to q where positive
        n = (-ey, ex, 0.0) if side >= 0 else (ey, -ex, 0.0)
        r = _difference(a, b, n)
        if r[0] * n[0] + r[1] * n[1] < 0:
            return None
        if _beyond(q, r, p):
            p = r
        elif _beyond(p, r, q):
            q = r
        else:
            return p, q, r
    return None


def _beyond(p: Vec, q: Vec, inside: Vec) -> bool:
    """Whether the origin lies, seen from above, strictly on the other side of the line through p and q."""
    ex, ey = q[0] - p[0], q[1] - p[1]
    own = ex * (inside[1] - p[1]) - ey * (inside[0] - p[0])
    of_origin = ey * p[0] - ex * p[1]
    return own * of_origin < 0


def _higher(p: Vec, q: Vec, r: Vec, w: Vec, sign: float) -> tuple[Vec, Vec, Vec]:
    """Of the triangles that ``w`` makes with two of the corners, the highest over the origin of those around it."""
    found = [(_share(s, t, w), s, t) for s, t in ((p, q), (q, r), (r, p))]
    around = [item for item in found if item[0] > -1e-9] or [max(found)]
    _, s, t = max(around, key=lambda item: sign * _height(item[1], item[2], w))
    return s, t, w


def _height(p: Vec, q: Vec, r: Vec) -> float:
    """Where the plane through three points meets the vertical line through the origin."""
    n = unit(cross(minus(q, p), minus(r, p)))
    return dot(n, p) / n[2] if abs(n[2]) > STEEP else 0.0


def _share(p: Vec, q: Vec, r: Vec) -> float:
    """The least barycentric coordinate of the origin in a triangle seen from above: negative outside."""
    area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
    if abs(area) < 1e-15:
        return -math.inf
    shares = (q[0] * r[1] - q[1] * r[0], r[0] * p[1] - r[1] * p[0], p[0] * q[1] - p[1] * q[0])
    return min(share / area for share in shares)
