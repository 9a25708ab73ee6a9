"""A priori knowledge of the estimators by scenario: which parts are identical with the truth and which are not."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.onboard import onboard_spec
from boresight.scenarios.spec.body import AlbedoMapSpec, AlbedoSpec, BodySpec
from boresight.scenarios.spec.distribution import Law
from boresight.scenarios.spec.orbit import OrbitSpec
from boresight.scenarios.spec.scenario import ScenarioSpec
from boresight.scenarios.spec.sequence import SequenceSpec
from boresight.scenarios.spec.stars import ARTIFICIAL, HIPPARCOS
from boresight.scenarios.spec.vectors import Law3
from boresight.scenarios.stars import STARS_OF_HIPPARCOS

ALBEDO = "albedo variation"
REAL_TRACKS = (
    "The tracks are real: errors are against reference poses, which are not exact, and what is told beside the tracks"
    " is drawn about them"
)
_OF_IMAGES = ("", "single-image", "crater-detection", "landmark-database", "pose-convergence")
"""Kinds of trial of single views; '' where a scenario is described without a campaign."""
THRESHOLDS = (
    "The thresholds of the crater detectors were chosen in the world of eros-like-msi (its body, reflectance, camera,"
    " noise, renderer and crater statistics) on other craters and views; the network of crater-learned was trained on"
    " another body, with other craters and by another renderer"
)


@dataclass(frozen=True, slots=True)
class Item:
    """One part of the truth and its a priori knowledge on board.

    ``exactly`` known is identical with the truth, ``not`` different from it or unknown. ``absent``: the truth has no
    such effect, which favours the estimators. ``partly``: exact or absent in some scenarios only. The ``detail`` is by
    how much it differs, or why it is absent.
    """

    name: str
    standing: Literal["exactly", "not", "absent", "partly"]
    detail: str = ""

    def words(self, short: bool) -> str:
        """Return name and detail; the short form keeps the detail of absent parts only."""
        named = f"no {self.name}" if self.standing == "absent" else self.name
        wanted = self.detail and (not short or self.standing == "absent")
        return f"{named} ({self.detail})" if wanted else named


@dataclass(frozen=True, slots=True)
class Known:
    """A priori knowledge on board: items in the order of the line, each name once.

    ``remarks`` are sentences about further dependences of the estimators on the truth, ``aligned`` names of reference
    poses that were determined by methods like those that are evaluated against them.
    """

    items: tuple[Item, ...]
    remarks: tuple[str, ...] = ()
    aligned: tuple[str, ...] = ()

    def line(self, short: bool = False) -> str:
        """Return the record as one line; the short one is without details and remarks."""
        said = {
            standing: [item.words(short) for item in self.items if item.standing == standing]
            for standing in ("exactly", "absent", "partly", "not")
        }
        sentences = ["; ".join([f"Perfect knowledge of: {', '.join(said['exactly']) or 'nothing'}", *said["absent"]])]
        if said["partly"]:
            sentences.append(f"In some scenarios only: {', '.join(said['partly'])}")
        sentences.append(f"Imperfect or no knowledge of: {', '.join(said['not']) or 'nothing'}")
        sentences += [*([] if short else self.remarks), *map(correlated, self.aligned)]
        return " ".join(f"{sentence}." for sentence in sentences)


def correlated(reference: str) -> str:
    """Return the remark on a reference pose that was determined by aligning renderings."""
    return (
        f"Errors against {reference} are correlated with those of methods that align renderings of the shape, for"
        f" {reference} was found by doing so"
    )


def merged(several: Sequence[Known]) -> Known:
    """Merge the knowledge of several scenarios.

    A part that only some scenarios have becomes ``not`` if it is unknown there, and ``partly`` if it is exact there. It
    stays ``exactly`` if it is absent from the other scenarios. A detail is kept if all have the same.
    """
    items = []
    for name in dict.fromkeys(one.name for known in several for one in known.items):
        own = [one for known in several for one in known.items if one.name == name]
        standings, details = {one.standing for one in own}, {one.detail for one in own}
        everywhere = len(own) == len(several)
        if standings == {"exactly", "absent"} and everywhere:
            items.append(Item(name, "exactly"))
        elif standings == {"not"} or (len(standings) == 1 and everywhere):
            items.append(Item(name, own[0].standing, own[0].detail if len(details) == 1 else ""))
        else:
            items.append(Item(f"no {name}" if standings == {"absent", "not"} else name, "partly"))
    remarks = dict.fromkeys(line for known in several for line in known.remarks)
    aligned = dict.fromkeys(name for known in several for name in known.aligned)
    return Known(tuple(items), tuple(remarks), tuple(aligned))


def known_on_board(spec: ScenarioSpec, experiment: str = "") -> Known:
    """Return which parts of the truth an estimator has exactly, with errors, or not at all, in a kind of trials."""
    if spec.sequence is not None:
        real = () if spec.sequence.tracks is None else (REAL_TRACKS,)
        return Known(tuple(_of_sequences(spec.sequence)), real)
    if spec.orbit is not None and experiment == "approach-orbit":
        return Known((*_exacts("shape", "reflectance"), *_of_orbits(spec.orbit, "approach"), *_unmodelled(spec)))
    if spec.orbit is not None:
        rendered = spec.orbit.imaging is not None and spec.orbit.imaging.detections != "drawn"
        if experiment == "image-survey" or not rendered:
            return Known(tuple(_of_orbits(spec.orbit, "planning" if experiment == "image-survey" else "craters")))
        return Known((*_of_orbits(spec.orbit), *_nots("reflectance"), *_unmodelled(spec)), (THRESHOLDS,))
    if spec.crater_pairs is not None:
        known = (_shape(spec), *_exacts("camera", "Sun", "spin"), *_pose(spec), *_nots("rims"))
        if spec.crater_pairs.images is not None:
            return Known((*known, *_unmodelled(spec)), (THRESHOLDS,))
        return Known((*known, *_nots("heights of craters above the shape")))
    if spec.images is not None and spec.real:
        # No model of a real body is exact, but priors are drawn about the reference pose.
        onboard, lens = spec.onboard, ["lens"] if spec.camera.distortion is not None else []
        unknown = ["shape", ALBEDO, "reflectance", "camera", *lens, "spin", "renderer", "blur", "noise"]
        sun = _errors(f"Sun as the pose {spec.images.truth} has it", {"": onboard.sun_error_deg})
        survey = ("Images of the survey are at their reference poses",) if spec.images.survey else ()
        return Known((sun, *_pose(spec), *_nots(*unknown)), ("The images are real", *survey), spec.images.aligned)
    if experiment not in _OF_IMAGES:
        raise BoresightError(f"experiment: {experiment!r}: it is not stated what is known on board in such trials")
    if experiment == "pose-convergence":  # landmark errors are drawn from the covariances that solvers use
        exact = _exacts("camera", "which landmark is which", "covariances that the landmarks are drawn from")
        return Known((*exact, *_pose(spec), *_nots("places of the landmarks")))
    hipparcos = [STARS_OF_HIPPARCOS] if spec.stars is not None and spec.stars.catalog == HIPPARCOS else []
    if experiment == "crater-detection":  # an image and the Sun's direction, no model of the body
        optics = (item for item in _optics(spec) if item.name != "spin")
        nothing = _nots("craters", "shape", "reflectance", "pose")
        return Known((*optics, *nothing, *_unmodelled(spec), *_stars(spec)), (THRESHOLDS, *hipparcos))
    cratered = _exacts(*(["craters in the images of data bases"] if spec.craters is not None else []))
    true, believed = spec.brdf, onboard_spec(spec).brdf
    named = f"{believed.kind} for {true.kind}" if believed.kind != true.kind else f"{true.kind} of other parameters"
    reflectance = _item("reflectance", believed == true, named)
    lent = (_shape(spec), _albedo(spec), *cratered, reflectance, *_optics(spec), *_exacts("renderer"))
    if experiment == "landmark-database":  # built and counted, not compared with a truth
        ideal = (Item("blur", "absent"), Item("noise", "absent", "data bases are made of ideal images"))
        return Known((*lent, *_exacts("poses of the images that data bases are made of"), *ideal))
    remarks = [*([] if spec.craters is None else [THRESHOLDS]), *hipparcos]
    second = _nots(*(["second body"] if spec.second_body is not None else []))
    return Known((*lent, *second, *_pose(spec), *_stars(spec), *_exposure(spec)), tuple(remarks))


def _exacts(*names: str) -> list[Item]:
    return [Item(name, "exactly") for name in names]


def _nots(*names: str) -> list[Item]:
    return [Item(name, "not") for name in names]


def _item(name: str, exact: bool, detail: str = "") -> Item:
    """Make an item that is exact or not; the detail applies to the latter."""
    return Item(name, "exactly") if exact else Item(name, "not", detail)


def _wrong(name: str, *parts: str) -> Item:
    """Make an item that is exact unless a part of it is said to be wrong."""
    detail = _listed(parts)
    return _item(name, not detail, detail)


def _listed(parts: Iterable[str]) -> str:
    return ", ".join(part for part in parts if part)


def _share(value: float, words: str = "") -> str:
    """Format a share in per cent with what it is of, for example " wrong"; '' for none."""
    return f"{100.0 * value:g} %{words}" if value else ""


# --- single images ----------------------------------------------------------------------------------------------------


def _shape(spec: ScenarioSpec) -> Item:
    onboard, detail = spec.onboard, spec.body.detail
    wrong = onboard.height_error.rms_m if onboard.height_error is not None else 0.0
    parts = [
        "another shape" if onboard.body is not None else "",
        f"{onboard.facets:,} facets of {detail.facets:,}" if onboard.facets and detail is not None else "",
        f"other relief below {onboard.relief.below_m:g} m" if onboard.relief is not None else "",
        f"heights wrong by {wrong:g} m" if wrong else "",
    ]
    smooth = "smooth shape" if spec.craters is not None else "shape"
    return _item(smooth, _form(onboard_spec(spec).body) == _form(spec.body), _listed(parts))


def _form(body: BodySpec) -> BodySpec:
    """Return a body without its albedo and without a height error of zero, for comparison."""
    detail = None if body.detail is None else body.detail.model_copy(update={"albedo": None})
    wrong = body.height_error if body.height_error is not None and body.height_error.rms_m > 0.0 else None
    return body.model_copy(update={"detail": detail, "height_error": wrong, "albedo_map": None})


def _albedo(spec: ScenarioSpec) -> Item:
    """Compare the variation of the albedo with that of the onboard shape; none in both is knowledge too."""
    true, believed = _variation(spec.body), _variation(onboard_spec(spec).body)
    if true is believed is None:
        return Item(ALBEDO, "absent")
    return _item(ALBEDO, believed == true, "taken as uniform" if believed is None else "another")


def _variation(body: BodySpec) -> tuple[AlbedoSpec | AlbedoMapSpec, ...] | None:
    pattern = None if body.detail is None else body.detail.albedo
    drawn = pattern if pattern is not None and pattern.sigma > 0.0 else None
    return tuple(one for one in (drawn, body.albedo_map) if one is not None) or None


def _unmodelled(spec: ScenarioSpec) -> list[Item]:
    """List what images show and no model of the body is used for: albedo variation, blur and noise."""
    return [Item(ALBEDO, "absent" if _variation(spec.body) is None else "not"), *_exposure(spec)]


def _exposure(spec: ScenarioSpec) -> list[Item]:
    """Return blur and noise of the detector and the brightness of images, which have no onboard model."""
    detector, bright = spec.detector, _nots("brightness") if spec.lighting.brightness != 1.0 else []
    bright += _nots("exposure") if spec.law_of("detector.exposure_s") is not None else []
    if detector is None:
        return [Item("blur", "absent"), Item("noise", "absent", "no `detector`"), *bright]
    blurred = detector.psf_sigma_px > 0.0
    blur = Item("blur", "not", f"{detector.psf_sigma_px:g} px") if blurred else Item("blur", "absent")
    return [blur, Item("noise", "not"), *_nots(*detector.artefacts), *bright]


def _optics(spec: ScenarioSpec) -> Iterator[Item]:
    """Yield camera, lens, Sun and spin."""
    onboard, believed = spec.onboard, onboard_spec(spec).camera
    du, dv = onboard.principal_point_error_px
    focal = f"focal length wrong by {100.0 * onboard.focal_error:g} %" if onboard.focal_error else ""
    middle = f"principal point by ({du:g}, {dv:g}) px" if du or dv else ""
    told = onboard.camera_sigma
    sigmas = f"declared to {100.0 * told.focal:g} % and {told.principal_point_px:g} px" if told is not None else ""
    pinholes = [camera.model_copy(update={"distortion": None}) for camera in (believed, spec.camera)]
    yield _item("camera", pinholes[0] == pinholes[1] and told is None, _listed([focal, middle, sigmas]))
    if spec.camera.distortion is not None:
        wrong = f"distortion wrong by {100.0 * onboard.distortion_error:g} %"
        yield _item("lens", believed.distortion == spec.camera.distortion, wrong)
    yield _errors("Sun", {"": onboard.sun_error_deg})
    yield _errors("spin", {"pole ": onboard.pole_error_deg, "rotation ": onboard.rotation_error_deg})


def _errors(name: str, laws: dict[str, Law | None]) -> Item:
    """Make an item whose parts have errors of these distributions, degrees."""
    return _wrong(name, *(f"{part}{law.text('deg')}" for part, law in laws.items() if law and not _nothing(law)))


def _nothing(law: Law | Law3 | None) -> bool:
    """Return whether a distribution draws only zeros."""
    return law is None or not any(np.any(value) for name, value in law if name not in {"within", "student_t"})


def _pose(spec: ScenarioSpec) -> list[Item]:
    """List the pose and the error distributions of its prior and of an altimeter."""
    wrong = spec.pose_error
    places = (wrong.position_cam_m, wrong.position_cam_px, wrong.position_body_m, wrong.position_rtn_m)
    turns = (wrong.attitude.angle_deg, wrong.attitude.rotation_vector_deg)
    if _nothing(wrong.pose_cam_deg_m) if wrong.pose_cam_deg_m is not None else all(map(_nothing, (*places, *turns))):
        return _exacts("pose")
    law = _item("law of the pose errors", spec.believed_pose_error == wrong, "another is believed in")
    altimeter = ["law of the altimeter's error"] if spec.sensors.altimeter is not None else []
    return [law, *_exacts(*altimeter), *_nots("pose")]


def _stars(spec: ScenarioSpec) -> list[Item]:
    """List the catalogue of stars and the attitude of a star tracker."""
    if spec.stars is None:
        return []
    sigma = spec.stars.tracker_sigma_deg
    tracker = "lost in space" if sigma is None else f"star tracker to {', '.join(f'{one:g}' for one in sigma)} deg"
    real = [Item("real stars", "absent", "drawn at random")] if spec.stars.catalog == ARTIFICIAL else []
    return [*_exacts("places of the stars"), *real, Item("attitude among the stars", "not", tracker)]


# --- orbits and sequences ---------------------------------------------------------------------------------------------


def _spin(pole_sigma_deg: float, rate_sigma: float) -> Item:
    rate = f"rate {_share(rate_sigma)}" if rate_sigma else ""
    return _wrong("spin", f"pole {pole_sigma_deg:g} deg" if pole_sigma_deg else "", rate)


def _of_orbits(section: OrbitSpec, part: Literal["craters", "planning", "approach"] = "craters") -> Iterator[Item]:
    """Yield the knowledge of orbit filters and of the chains from images to an orbit, or of planning alone."""
    known, pointing, imaging = section.knowledge, section.pointing, section.imaging
    yield _spin(known.pole_sigma_deg, known.spin_sigma)
    yield from _exacts("centre of mass", "Sun and Earth", "law of the forces")
    if part != "approach":
        yield from _exacts("RMS error of the shape on board")
    yield Item("orbit", "not", f"{known.position_m:g} m at the epoch")
    yield _wrong("GM", _share(known.gm_sigma))
    yield _wrong("solar pressure", _share(known.light_sigma))
    if section.light.noise_share:
        yield Item("accelerations that nothing models", "not", _share(section.light.noise_share, " of it"))
    if part != "approach":
        yield Item("shape", "not", f"harmonics of degree {known.shape_degree}")
    yield Item("gravity", "not", "that of the shape on board")
    yield _item("camera", not pointing.focal_error, f"focal length to {_share(pointing.focal_error)}")
    yield Item("attitude", "not", f"{pointing.attitude_urad:g} microrad")
    yield _item("mounting of the camera", not pointing.misalignment_urad, f"{pointing.misalignment_urad:g} microrad")
    if part == "planning":
        return
    # The law of the sightings' errors is exact only if sightings are drawn from it.
    yield from _exacts("laws of all errors but those of sightings" if imaging else "laws of all errors")
    if part == "approach":
        return
    yield from _nots("places of the craters")
    if imaging is not None:
        yield Item("which crater is which", "not", "matched")
    else:
        shares = section.sightings
        yield _wrong(
            "which crater is which", _share(shares.wrong_share, " wrong"), _share(shares.merged_share, " merged")
        )


def _of_sequences(section: SequenceSpec) -> Iterator[Item]:
    """Yield the knowledge of sequence estimators, which get tracks, attitudes, predicted motion and ranges."""
    known, forces, vision = section.knowledge, section.orbit.forces, section.vision
    sighted = section.images or section.tracks
    if section.tracks is None:
        yield from _exacts("camera")
    else:
        yield Item("camera", "not", "as calibrated")
    sigmas = {"each": known.attitude_sigma_deg, "the camera's alignment": known.misalignment_sigma_deg}
    yield _wrong("attitude", *(f"{name} {sigma:g} deg" for name, sigma in sigmas.items() if sigma))
    yield _spin(known.pole_sigma_deg, known.spin_sigma)
    yield _item("first position", not known.position_sigma_m, f"{known.position_sigma_m:g} m")
    yield _wrong("motion from frame to frame", _share(known.motion_error, " of each"))
    if known.ranges:
        yield Item("ranges", "not", f"{known.range_sigma_m:g} m")
        if known.range_to == "lasting":
            yield from _exacts("how long tracks will last")
    if known.dynamics:
        yield _item("law of gravity", forces.gravity == "point-mass", "a point mass for the body's shape")
        yield _wrong("GM", _share(known.gm_sigma))
        yield from _exacts("Sun")
        yield _wrong("solar pressure", _share(known.radiation_sigma))
        yield _item("first velocity", not known.velocity_sigma_m_s, f"{known.velocity_sigma_m_s:g} m/s")
        exact = known.noise_m_s2 is None or known.noise_m_s2 == forces.noise_m_s2
        noise = f"{known.noise_m_s2} for {forces.noise_m_s2:g} m/s2"
        yield _item("size of what is not modelled", exact, noise)
    px = math.hypot(known.walk_px or 0.0, known.drift_px or 0.0)
    share = f"{known.contraction:g} of the distance from the centre" if known.contraction else ""
    stated = f"{px:g} px" if px else "", share
    adding = " and ".join(part for part in stated if part)
    adding = f"errors that accumulate by {adding} a frame" if adding else ""
    yield from _exacts(
        "laws of all errors" + (" but those of pixels" if sighted or vision.track_errors or adding else "")
    )
    if sighted is not None:
        yield Item("which landmark is which", "not", "matched in images")
        told = f"{sighted.sigma_px:g} px{adding and f' and {adding}'} are told"
        yield Item("pixel noise", "not", f"{told}, {'numbers' if adding else 'a number'} of the scenario")
    else:
        shares = {"mismatches": vision.mismatch_share, "outliers": vision.outlier_share, "mistaken": vision.mistaken}
        yield _wrong("which landmark is which", *(_share(share, f" {name}") for name, share in shares.items()))
        if adding or vision.track_errors is not None:
            told = f"{vision.noise_px:g} px are told, and {adding or 'nothing of errors that accumulate'}"
            yield Item("pixel noise", "not", told)
        elif not vision.noise_px:
            yield Item("pixel noise", "absent")
    yield from _nots("landmarks")
