"""The displays of orbit determination."""

from __future__ import annotations

import numpy as np
import pandas as pd

from boresight.campaign.inspection.recompute import Case, Recomputed
from boresight.campaign.inspection.show import (
    CaseFigures,
    CaseFiles,
    EstimatorRun,
    Flight,
    Show,
    camera_scale,
    coarsened,
    finite_or_dash,
    middle_and_worst,
)
from boresight.campaign.kinds.orbit_determination import (
    DeterminedOrbit,
    craters_of_numbers,
    orbit_errors,
    residual_records,
    wrong_sightings,
)
from boresight.estimators.orbit.contract import Orbit
from boresight.reports.figures.craters import draw_orbit_case_errors, draw_residuals, draw_sightings_used
from boresight.reports.figures.named import NamedFigure
from boresight.reports.pages.view3d import FAILED, CameraSet, PointSet, View3D
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.dynamics.field import UniformRotation
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.orbits.draw import OrbitTruth
from boresight.scenarios.orbits.true_orbit import DAY_S

_NOTE = (
    "The trial of median error and the worst one, in the axes of the turning body. A landmark stands where the orbit's"
    " solution has it, a camera where it truly was."
)


def look_at_orbits(scene: EstimatorRun) -> View3D:
    """Show the trial in the middle and the worst one; also solutions that were rejected.

    Raise BoresightError if neither came to an orbit.
    """
    marks, seen, world = [], [], None
    for name, colour, again in middle_and_worst(scene):
        shown, orbit = again.shown, None if again.shown is None else _solution(again.shown)
        if orbit is None:
            continue
        world = again.trials.world
        sightings = sightings_of(shown, orbit)
        marks += orbit_marks(orbit, shown.truth, sightings, name)
        seen += image_sets(shown, sightings, world.rotation, again.case, (name, colour))
    if world is None:
        raise BoresightError(
            f"{scene.folder.path}: --look: neither the middle nor the worst trial of {scene.title} came to an orbit:"
            " choose another --scenario or --estimator, or see why with --worst 1"
        )
    body = coarsened(world.asteroid.mesh)
    factor, told = camera_scale(np.concatenate([cameras.points_m for cameras in seen]), body.radius_m)
    drawn = [CameraSet(cameras.name, cameras.colour, cameras.points_m / factor, cameras.texts) for cameras in seen]
    return View3D(scene.title, _NOTE + told, body.vertices_m, body.faces, marks, drawn)


def _solution(shown: DeterminedOrbit) -> Orbit | None:
    """Return the solution of a trial, also one that was rejected."""
    return None if shown.estimate is None else shown.estimate.orbit


def sightings_of(shown: DeterminedOrbit, orbit: Orbit) -> pd.DataFrame:
    """List the sightings: image, number, true crater, whether used, and squared length of the residual, px^2."""
    pictures = shown.observation.pictures
    return pd.DataFrame(
        {
            "image": pictures.image,
            "number": pictures.landmark,
            "crater": shown.truth.crater,
            "used": orbit.used,
            "square": np.where(orbit.used, np.square(orbit.residuals_px).sum(axis=1), np.nan),
        }
    )


def orbit_marks(orbit: Orbit, truth: OrbitTruth, sightings: pd.DataFrame, name: str) -> list[PointSet]:
    """Colour the landmarks of a solution by their errors, where the truth has places for craters, and residuals."""
    grouped = sightings.groupby("number")
    at = orbit.numbers
    hits, used = grouped.size().reindex(at).to_numpy(), grouped["used"].sum().reindex(at).to_numpy()
    residual = np.sqrt(grouped["square"].mean().reindex(at).to_numpy(dtype=np.float64))
    errors = landmark_errors(orbit, truth, sightings)
    texts = [
        f"landmark {number}<br>seen in {h:.0f} images, used in {u:.0f}<br>error {finite_or_dash(error, 'm')}"
        f"<br>residual, RMS {finite_or_dash(rms, 'px')}"
        for number, h, u, error, rms in zip(at, hits, used, errors, residual, strict=True)
    ]
    marks = [PointSet(f"residual, {name} trial", orbit.points_body_m, residual, texts, "px")]
    if np.isfinite(errors).any():
        marks.insert(0, PointSet(f"landmark error, {name} trial", orbit.points_body_m, errors, texts, "m"))
    return marks


def landmark_errors(orbit: Orbit, truth: OrbitTruth, sightings: pd.DataFrame) -> FloatArray:
    """(L',) distance, m, of each landmark from the crater of its number; NaN if the truth has none."""
    known = sightings[(sightings["crater"] >= 0) & (sightings["crater"] < len(truth.points_body_m))]
    craters = craters_of_numbers(orbit, known["number"].to_numpy(), known["crater"].to_numpy())
    gaps = [
        np.linalg.norm(truth.points_body_m[craters[int(number)]] - point, axis=1)
        for number, point in zip(orbit.numbers, orbit.points_body_m, strict=True)
    ]
    return np.array([gap.min() if len(gap) else np.nan for gap in gaps])


def image_sets(
    shown: DeterminedOrbit, sightings: pd.DataFrame, rotation: UniformRotation, case: Case, called: tuple[str, str]
) -> list[CameraSet]:
    """Place the images of a trial in body axes: those that the orbit rests on, and those without a used sighting."""
    (name, colour), times = called, shown.observation.pictures.times_s
    places = np.einsum("nij,nj->ni", rotation.at(times), shown.truth.image_states[:, :3])
    grouped, every = sightings.groupby("image"), np.arange(len(times))
    hits = grouped.size().reindex(every).fillna(0).to_numpy()
    used = grouped["used"].sum().reindex(every).fillna(0).to_numpy()
    residual = np.sqrt(grouped["square"].mean().reindex(every).to_numpy(dtype=np.float64))
    if (fixes := shown.observation.fixes) is not None:
        used = used + np.isin(every, fixes.image)
    texts = np.array(
        [
            f"trial {case.trial}, image {i}<br>day {times[i] / DAY_S:.3g}, {np.linalg.norm(places[i]):.4g} m away"
            f"<br>{hits[i]:.0f} sightings, {used[i]:.0f} used<br>residual, RMS {finite_or_dash(residual[i], 'px')}"
            for i in every
        ],
        dtype=object,
    )
    sets = ((f"images, {name} trial", colour, used > 0), (f"images of no use, {name} trial", FAILED, used == 0))
    return [CameraSet(what, shade, places[own], list(texts[own])) for what, shade, own in sets if own.any()]


def draw_orbit_case(again: Recomputed) -> CaseFigures:
    """Draw a solution, also one that was rejected; without any there is nothing to draw."""
    shown, what, orbit = again.shown, str(again.case), _solution(again.shown)
    if orbit is None:
        return CaseFigures([], notes=["There is nothing to draw: no solution came out."])
    truth, data = shown.truth, shown.observation
    errors = pd.DataFrame(orbit_errors(orbit, truth, data))
    residuals = pd.DataFrame(residual_records(orbit, data))
    placed = np.isfinite(orbit.residuals_px[:, 0])
    residuals = residuals.assign(wrong=wrong_sightings(orbit, truth, data)[placed])
    figures = [
        NamedFigure(
            "errors",
            draw_orbit_case_errors(errors, what),
            f"{what}. Error of the position in inertial space, and what the covariance foretells: the dashed line is"
            " the root of its trace. Right of the grey line no image is taken.",
            "Components of the error and its length over days.",
        ),
        *([] if residuals.empty else sighting_figures(residuals, what)),
    ]
    rejected = shown.estimate.status == "failed"
    return CaseFigures(figures, notes=[f"The solution was rejected: {shown.estimate.reason}."] if rejected else [])


def sighting_figures(residuals: pd.DataFrame, what: str) -> list[NamedFigure]:
    """Draw the residuals of sightings: those that were used, and all of them in classes."""
    return [
        NamedFigure(
            "residuals",
            draw_residuals(residuals, what),
            f"{what}. Residuals of the sightings that the filter used.",
            "Two scatters about zero over days.",
        ),
        NamedFigure(
            "sightings",
            draw_sightings_used(residuals, what),
            f"{what}. Residuals of all sightings: used or edited by the filter, right or of another crater than their"
            " number stands for.",
            "A scatter of residuals in four classes.",
        ),
    ]


def kept(shown: DeterminedOrbit) -> CaseFiles:
    """Return the orbit of a solution; nothing where none came out."""
    if shown.estimate is None or (orbit := shown.estimate.orbit) is None:
        return CaseFiles()
    solution = {
        "status": shown.estimate.status,
        "reason": shown.estimate.reason,
        "state_inertial": orbit.state.tolist(),
        "covariance": orbit.covariance.tolist(),
        "times_s": shown.observation.wanted_s.tolist(),
        "positions_inertial_m": orbit.positions_m.tolist(),
    }
    return CaseFiles({}, solution)


def flights(shown: DeterminedOrbit) -> dict[str, Flight]:
    """Return the true and the determined orbit, with the attitudes of the images by the star tracker."""
    if shown.estimate is None or shown.estimate.status != "ok" or (orbit := shown.estimate.orbit) is None:
        return {}
    times_s, pictures, true = shown.observation.wanted_s, shown.observation.pictures, shown.truth.states
    none = np.zeros(0), np.zeros((0, 3, 3))
    return {
        "truth": Flight(times_s, true[:, :3], true[:, 3:], *none),
        "estimate": Flight(times_s, orbit.positions_m, orbit.velocities_m_s, pictures.times_s, pictures.R_cam_inertial),
    }


SHOW = Show(draw=draw_orbit_case, kept=kept, look=look_at_orbits, flights=flights)
