"""Rendering of two bodies that hide and shadow each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from boresight.renderers.mitsuba3.rays import outline_points
from boresight.renderers.mitsuba3.renderer import MitsubaRenderer
from boresight.renderers.mitsuba3.tiled import BodyRenderer
from boresight.scenarios.arrays import FloatArray, SingleArray
from boresight.scenarios.geometry import Pose, SurfaceHits, TriangleMesh, View


@dataclass(eq=False)
class PairRenderer:
    """Renderer of a body and of a second one, whose pose is in the view, as one mesh in the body frame.

    ``renderer_of`` makes the renderer of a mesh with an outline. The scene of the last pose is kept. A view without a
    second body shows the first alone. The albedo of the second is ``albedo_ratio`` times that of its mesh.
    """

    first: TriangleMesh
    second: TriangleMesh
    albedo_ratio: float
    renderer_of: Callable[[TriangleMesh, FloatArray], MitsubaRenderer]
    _pose: Pose | None = None
    _renderer: MitsubaRenderer = field(init=False)

    def __post_init__(self) -> None:
        self.outline_m, self.second_outline_m = outline_points(self.first), outline_points(self.second)
        self._renderer = self.renderer_of(self.first, self.outline_m)

    def render(self, view: View) -> SingleArray:
        """Radiance factor I/F of every pixel, (H, W); 0 off both bodies and in shadow.

        Raise `BoresightError` if the camera is inside one of them.
        """
        return self._posed(view).render(view)

    def surface(self, view: View, uv_px: FloatArray) -> SurfaceHits:
        """De-project pixel positions (N, 2) to the first points on either body, all in the frame of the first.

        Facets of the second are numbered after those of the first.
        """
        return self._posed(view).surface(view, uv_px)

    def _posed(self, view: View) -> MitsubaRenderer:
        pose = view.T_body_second
        if not _same(pose, self._pose):
            outline_m = np.concatenate(outlines_m(self, view))
            self._renderer, self._pose = self.renderer_of(self.mesh(pose), outline_m), pose
        return self._renderer

    def mesh(self, T_body_second: Pose | None) -> TriangleMesh:
        """Return both bodies as one mesh."""
        first, second = self.first, self.second
        if T_body_second is None:
            return first
        albedo = [np.ones(len(one.vertices_m)) if one.albedo is None else one.albedo for one in (first, second)]
        return TriangleMesh(
            np.concatenate([first.vertices_m, T_body_second.transform(second.vertices_m)]),
            np.concatenate([first.faces, second.faces + np.int32(len(first.vertices_m))]),
            np.concatenate([albedo[0], self.albedo_ratio * albedo[1]]),
        )


def outlines_m(renderer: BodyRenderer, view: View) -> list[FloatArray]:
    """Points (N, 3) of the body frame whose hull holds a body, of each body in a view."""
    if not isinstance(renderer, PairRenderer) or view.T_body_second is None:
        return [renderer.outline_m]
    return [renderer.outline_m, view.T_body_second.transform(renderer.second_outline_m)]


def _same(one: Pose | None, other: Pose | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one.rotation, other.rotation) and np.array_equal(one.translation_m, other.translation_m)
