"""Construct a closed surface through all landmarks: a concave hull of Delaunay tetrahedra (section 2.4).

The paper removes every tetrahedron whose circumcentre lies outside the convex hull. That rule alone can leave landmarks
inside the solid and surfaces that are not closed. Here tetrahedra are removed one by one, and only where the solid
remains a topological ball: the surface is closed, has Euler characteristic 2 and, with n landmarks, 2n - 4 facets.

1. The paper's rule, the largest circumsphere first.
2. While landmarks are buried in the solid: a facet spans a hollow if its edges are long compared with its distance to a
   buried landmark. Of the tetrahedra whose longest edge on the surface exceeds that distance, the one with the longest
   edge is removed first.
3. Landmarks that cannot be brought to the surface are dropped, and the others are triangulated again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, Delaunay, QhullError, cKDTree

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError

IndexArray = NDArray[np.intp]

# Row i: the face opposite to corner i, counter-clockwise seen from outside where the volume is positive.
_FACES = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])
_HULL_TOLERANCE = 1e-9
_FLAT = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class ConcaveHull:
    """A closed triangle surface.

    ``kept`` (N,) are ascending rows of the points that are on the surface, ``facets`` (2N - 4, 3) indices into
    ``kept``, counter-clockwise seen from outside, equation (1), and ``dropped`` ascending rows of points that could not
    be brought to the surface, or that coincide with another point.
    """

    kept: IndexArray
    facets: IndexArray
    dropped: IndexArray


def concave_hull(points_m: FloatArray) -> ConcaveHull:
    """Construct a closed surface through points (N, 3): at least four landmarks, not in one plane.

    Raise BoresightError if the points do not span a volume.
    """
    kept = np.arange(len(points_m))
    while True:
        solid = _Solid(points_m[kept])
        solid.carve_by_circumcentre()
        solid.raise_buried()
        on_surface = solid.on_surface()
        if on_surface.all():
            return ConcaveHull(kept, solid.surface(), np.setdiff1d(np.arange(len(points_m)), kept))
        # Dropped and triangulated anew, until all that are left are on the surface.
        kept = kept[on_surface]


def circumspheres(corners_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centres (T, 3) and radii (T,) of the spheres through the corners (T, 4, 3) of tetrahedra; inf where flat."""
    # |c - x0|^2 = |c - xi|^2 for the other three corners: linear in c - x0, e_i . (c - x0) = |e_i|^2 / 2.
    edges = corners_m[:, 1:] - corners_m[:, :1]
    flat = np.abs(np.linalg.det(edges)) <= _FLAT * np.linalg.norm(edges, axis=2).prod(axis=1)
    solvable = np.where(flat[:, None, None], np.eye(3), edges)
    half_squares = 0.5 * np.einsum("tij,tij->ti", edges, edges)
    offset = np.linalg.solve(solvable, half_squares[:, :, None])[:, :, 0]
    offset[flat] = np.inf
    return corners_m[:, 0] + offset, np.linalg.norm(offset, axis=1)


class _Solid:
    """Delaunay tetrahedra, of which some have been removed; always a topological ball."""

    def __init__(self, points_m: FloatArray) -> None:
        extent_m = float(np.ptp(points_m)) if len(points_m) else 0.0
        if not extent_m > 0.0:
            raise BoresightError(_no_volume(len(points_m)))
        # Centred and scaled to unit extent, so that tolerances do not depend on the size of the body.
        self._points: FloatArray = (points_m - points_m.mean(axis=0)) / extent_m
        try:
            delaunay, hull = Delaunay(self._points), ConvexHull(self._points)
        except QhullError as error:
            raise BoresightError(_no_volume(len(points_m))) from error
        corners = self._points[delaunay.simplices]
        # Qhull does not orient tetrahedra: the faces of those with negative volume are reversed.
        mirrored = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0.0
        self._tetrahedra = delaunay.simplices.astype(np.intp)
        self._neighbours = delaunay.neighbors.astype(np.intp)
        self._faces = self._tetrahedra[:, _FACES]  # (T, 4, 3)
        self._faces[mirrored] = self._faces[mirrored][:, :, ::-1]
        centres, self._radii = circumspheres(corners)
        # Flat tetrahedra have their circumcentre at infinity: outside.
        self._centre_outside = ~np.isfinite(self._radii)
        bounded = np.flatnonzero(~self._centre_outside)
        # Heights above the planes of the convex hull: a point outside is above at least one of them.
        height = centres[bounded] @ hull.equations[:, :3].T + hull.equations[:, 3]
        self._centre_outside[bounded] = (height > _HULL_TOLERANCE).any(axis=1)
        self._in_solid = np.ones(len(self._tetrahedra), dtype=bool)
        self._vertex_uses = np.zeros(len(points_m), dtype=np.intp)
        self._edge_uses: dict[tuple[int, int], int] = {}
        for face in self.surface():
            self._use(face, 1)

    def _use(self, face: IndexArray, change: int) -> None:
        """Count a surface facet in (+1) or out (-1) at its vertices and edges."""
        corners = face.tolist()
        for i, corner in enumerate(corners):
            edge = _edge(corner, corners[i - 1])
            self._vertex_uses[corner] += change
            self._edge_uses[edge] = self._edge_uses.get(edge, 0) + change

    def _surface_faces(self) -> NDArray[np.bool_]:
        """(T, 4): faces on the surface, of the tetrahedra that are left."""
        outside = np.append(~self._in_solid, True)  # the neighbour -1 is the outside
        mask: NDArray[np.bool_] = self._in_solid[:, None] & outside[self._neighbours]
        return mask

    def surface(self) -> IndexArray:
        """(F, 3) outward facets, in the order of their tetrahedra."""
        return self._faces[self._surface_faces()]

    def on_surface(self) -> NDArray[np.bool_]:
        """(N,): points that a surface facet touches."""
        return self._vertex_uses > 0

    def _surface_faces_of(self, tetrahedron: int) -> IndexArray:
        across = self._neighbours[tetrahedron]
        return np.flatnonzero((across < 0) | ~self._in_solid[across])

    def _removable(self, tetrahedron: int) -> bool:
        """Return whether the solid without this tetrahedron is still a ball.

        With one face on the surface, the opposite vertex must be inside the solid; with two, the edge opposite to the
        one that they share.
        """
        faces = self._surface_faces_of(tetrahedron)
        corners = self._tetrahedra[tetrahedron]
        if len(faces) == 1:
            # The face is replaced by the other three, which meet at the opposite vertex: on the surface already, it
            # would be pinched.
            return bool(self._vertex_uses[corners[faces[0]]] == 0)
        if len(faces) == 2:
            # Two faces are replaced by the other two, which meet in the opposite edge: on the surface already, it would
            # have four facets.
            return self._edge_uses.get(_edge(int(corners[faces[0]]), int(corners[faces[1]])), 0) == 0
        # Three faces: their common landmark would leave the solid. Four or none: there is no surface to carve into.
        return False

    def _remove(self, tetrahedron: int) -> None:
        on_surface = self._surface_faces_of(tetrahedron)
        self._in_solid[tetrahedron] = False
        for index, face in enumerate(self._faces[tetrahedron]):
            self._use(face, -1 if index in on_surface else 1)

    def carve_by_circumcentre(self) -> None:
        """Remove tetrahedra whose circumcentre lies outside the convex hull, the largest circumsphere first."""
        wanted = np.flatnonzero(self._centre_outside)
        waiting = wanted[np.argsort(-self._radii[wanted], kind="stable")].tolist()
        # A removal can make earlier candidates removable: repeated until none is.
        progress = True
        while progress:
            progress = False
            for tetrahedron in list(waiting):
                if self._removable(tetrahedron):
                    self._remove(tetrahedron)
                    waiting.remove(tetrahedron)
                    progress = True

    def raise_buried(self) -> None:
        """Remove tetrahedra towards buried points until none is buried, or no tetrahedron can be removed."""
        while True:
            inside = np.unique(self._tetrahedra[self._in_solid])
            buried = inside[self._vertex_uses[inside] == 0]
            if not buried.size:
                return
            choice = self._longest_bridging(buried)
            if choice is None:
                choice = self._nearest_removable(buried)
            if choice is None:
                return
            self._remove(choice)

    def _longest_bridging(self, buried: IndexArray) -> int | None:
        """Find the removable tetrahedron with the longest surface edge that exceeds the distance to a buried point."""
        surface_faces = self._surface_faces()
        rows = np.flatnonzero(surface_faces.any(axis=1))
        corners = self._points[self._faces[rows]]  # (R, 4, 3, 3)
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=2), axis=3).max(axis=2)
        longest = np.where(surface_faces[rows], edges, 0.0).max(axis=1)
        # The mean of the centres of the tetrahedron's facets on the surface: from there the depth of a point is
        # measured.
        weight = surface_faces[rows][:, :, None]
        centre = (corners.mean(axis=2) * weight).sum(axis=1) / weight.sum(axis=1)
        distance, _ = cKDTree(self._points[buried]).query(centre)
        bridging = np.flatnonzero(distance <= longest)
        order = bridging[np.argsort(-longest[bridging], kind="stable")]
        return next((int(rows[i]) for i in order if self._removable(int(rows[i]))), None)

    def _nearest_removable(self, buried: IndexArray) -> int | None:
        """Find the removable tetrahedron that is the fewest neighbours away from a buried point.

        Of several, the one with the largest circumsphere.
        """
        level = np.flatnonzero(self._in_solid & np.isin(self._tetrahedra, buried).any(axis=1))
        seen = ~self._in_solid
        while level.size:
            removable = [t for t in level.tolist() if self._removable(t)]
            if removable:
                return max(removable, key=lambda t: float(self._radii[t]))
            seen[level] = True
            across = np.unique(self._neighbours[level])
            across = across[across >= 0]
            level = across[~seen[across]]
        return None


def _no_volume(n_points: int) -> str:
    return (
        f"{n_points} landmarks span no volume: a mesh needs at least 4 that are not in one plane;"
        " use more images or a lower min_observations"
    )


def _edge(a: int, b: int) -> tuple[int, int]:
    return (a, b) if a < b else (b, a)
