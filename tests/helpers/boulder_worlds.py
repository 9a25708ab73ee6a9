"""A rendered body with boulders as the assets of an estimator, and frames of it with a disturbed prior."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from boresight.renderers.mitsuba3 import MitsubaRenderer
from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.bodies import load_body
from boresight.scenarios.draw import draw_lit_view
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh, View
from boresight.scenarios.observation import Frame
from boresight.scenarios.spec.body import BodySpec, BoulderSpec, DetailSpec, RoughnessSpec
from boresight.scenarios.spec.brdf import LambertSpec, LommelSeeligerSpec
from boresight.scenarios.spec.distribution import Uniform
from boresight.scenarios.spec.world import LightingSpec, ViewpointSpec


def boulder_mesh(facets: int = 90_000, roughness: RoughnessSpec | None = None) -> TriangleMesh:
    boulders = BoulderSpec(count=700, min_diameter_m=8.0, max_diameter_m=45.0)
    detail = DetailSpec(facets=facets, seed=3, boulders=boulders, roughness=roughness)
    return load_body(BodySpec(shape="contact-binary", detail=detail), ()).mesh


class BoulderWorld:
    """The assets of an estimator; ``database`` is lent as every product, and ``asked`` keeps what was asked for."""

    brdf = LambertSpec()

    def __init__(self, camera: Camera, mesh: TriangleMesh, prior_sigmas: list[float]) -> None:
        self.camera, self.mesh, self.renderer = camera, mesh, MitsubaRenderer(mesh, self.brdf)
        self.prior_covariance = np.diag(prior_sigmas) ** 2
        self.database: object = None
        self.asked: list[tuple[str, object]] = []
        self._images: dict[int, Image] = {}

    def product(self, kind: str, options: object) -> object:
        self.asked.append((kind, options))
        return self.database

    def mesh_renderer(
        self, mesh: TriangleMesh, samples_per_pixel: int = 1, *, other_law: bool = False
    ) -> MitsubaRenderer:
        return MitsubaRenderer(
            mesh, LommelSeeligerSpec(kind="lommel-seeliger") if other_law else self.brdf, samples_per_pixel
        )

    def shape(self) -> TriangleMesh:
        return self.mesh

    def view(self, rng: np.random.Generator) -> View:
        lighting = LightingSpec(phase_deg=Uniform(uniform=(0.0, 60.0)))
        return draw_lit_view(ViewpointSpec(range_m=2000.0), lighting, self.camera, rng)

    def images(self, count: int) -> Iterator[tuple[View, Image]]:
        """Yield views for a data base, with their images."""
        for index in range(count):
            view = self.view(np.random.default_rng(1000 + index))
            yield view, self.renderer.render(view)

    def frame(self, trial: int, noise_dn: float = 0.0) -> tuple[View, Frame]:
        """Return a view, and its frame with a prior that is off by up to 2 degrees and (50, 50, 5) metres."""
        rng = np.random.default_rng(trial)
        view = self.view(rng)
        axis = rng.normal(size=3)
        angle = np.radians(rng.uniform(-2.0, 2.0)) / np.linalg.norm(axis)
        prior = view.T_cam_body.perturbed(angle * axis, rng.uniform((-50.0, -50.0, -5.0), (50.0, 50.0, 5.0)))
        if trial not in self._images:
            self._images[trial] = self.renderer.render(view)
        image = self._images[trial].copy()
        if noise_dn:
            image = (8000.0 * image + rng.normal(100.0, noise_dn, image.shape)).astype(np.float32)
        return view, Frame(image, view.T_cam_body.rotate(view.sun_dir_body), prior, self.prior_covariance)


def errors(view: View, pose: Pose) -> tuple[FloatArray, FloatArray]:
    """Return the errors of a pose: its turn in degrees, and the camera's displacement in metres."""
    offset = pose.camera_position_m - view.T_cam_body.camera_position_m
    return np.degrees(pose.angle_to(view.T_cam_body)), np.linalg.norm(offset)
