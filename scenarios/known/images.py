"""A priori knowledge of estimators that process single images, or pairs of crater views."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from boresight.scenarios.known.record import Item, Known, item, listed
from boresight.scenarios.onboard import onboard_spec
from boresight.scenarios.spec.body import AlbedoSpec, BodySpec
from boresight.scenarios.spec.camera import CameraSpec
from boresight.scenarios.spec.distribution import Law, Law3
from boresight.scenarios.spec.images import ImageSetSpec
from boresight.scenarios.spec.scenario import ScenarioSpec

ERROR_LAW = "law of the pose errors"
ALBEDO = "albedo variation"
THRESHOLDS = (
    "The thresholds of the crater detectors were chosen in the world of eros-like-msi (its body, reflectance, camera,"
    " noise, renderer and crater statistics) on other craters and views; the network of crater-learned was trained on"
    " another body, with other craters and by another renderer"
)


def single_images(spec: ScenarioSpec) -> Known:
    """Return the knowledge of single-image estimators: shape, renderings and data bases of the onboard model."""
    lent = [_shape(spec), _albedo(spec), *_craters(spec), _reflectance(spec), *_optics(spec)]
    remarks = () if spec.craters is None else (THRESHOLDS,)
    return Known((*lent, Item("renderer", "exactly"), *_pose(spec), *exposure(spec)), remarks)


def real_images(spec: ScenarioSpec, images: ImageSetSpec) -> Known:
    """Return the knowledge for real images: no model is exact, but priors are derived from the reference pose."""
    beliefs, sun = spec.onboard, f"Sun as the pose {images.truth} has it"
    lens = ["lens"] if spec.camera.distortion is not None else []
    unknown = ["shape", ALBEDO, "reflectance", "camera", *lens, "spin", "renderer", "blur", "noise"]
    items = [item(sun, _nothing(beliefs.sun_error_deg), _spread(beliefs.sun_error_deg)), *_pose(spec)]
    return Known((*items, *(Item(name, "not") for name in unknown)), ("The images are real",), images.aligned)


def crater_detection(spec: ScenarioSpec) -> Known:
    """Return the knowledge of crater detectors: an image and the Sun's direction, no model of the body."""
    unknown = ("craters", "shape", "reflectance")
    nothing = [Item(name, "not") for name in (*unknown, "pose")]
    return Known((*_optics(spec, spin=False), *nothing, *unmodelled(spec)), (THRESHOLDS,))


def crater_pairs(spec: ScenarioSpec) -> Known:
    """Return the knowledge of crater matchers: smooth shape, detections in two views and prior poses."""
    section = spec.crater_pairs
    rendered = section is not None and section.images is not None
    items = [_shape(spec), Item("camera", "exactly"), Item("Sun", "exactly"), Item("spin", "exactly")]
    seen = ["rims"] if rendered else ["rims", "heights of craters above the shape"]
    items += [*_pose(spec), *(Item(name, "not") for name in seen)]
    return Known((*items, *unmodelled(spec)), (THRESHOLDS,)) if rendered else Known(tuple(items))


def pose_solvers(spec: ScenarioSpec) -> Known:
    """Return the knowledge of pose solvers, whose landmark errors are drawn from the covariances that they use."""
    exact = ("camera", "which landmark is which", "covariances that the landmarks are drawn from")
    return Known((*(Item(name, "exactly") for name in exact), *_pose(spec), Item("places of the landmarks", "not")))


def data_bases(spec: ScenarioSpec) -> Known:
    """Return the knowledge for landmark data bases, which are built and counted but not compared with a truth."""
    lent = [_shape(spec), _albedo(spec), *_craters(spec), _reflectance(spec), *_optics(spec)]
    poses = Item("poses of the images that data bases are made of", "exactly")
    noise = [Item("blur", "absent"), Item("noise", "absent", "data bases are made of ideal images")]
    return Known((*lent, Item("renderer", "exactly"), poses, *noise))


def _shape(spec: ScenarioSpec) -> Item:
    smooth = "smooth shape" if spec.craters is not None else "shape"
    return item(smooth, _form(onboard_spec(spec).body) == _form(spec.body), _shape_error(spec))


def _albedo(spec: ScenarioSpec) -> Item:
    """Compare the variation of the albedo with that of the onboard shape; none in both is knowledge too."""
    true, believed = _variation(spec.body), _variation(onboard_spec(spec).body)
    if true is believed is None:
        return Item(ALBEDO, "absent")
    return item(ALBEDO, believed == true, "taken as uniform" if believed is None else "another")


def _variation(body: BodySpec) -> AlbedoSpec | None:
    pattern = None if body.detail is None else body.detail.albedo
    return pattern if pattern is not None and pattern.sigma > 0.0 else None


def unmodelled(spec: ScenarioSpec) -> Iterator[Item]:
    """Yield what images show and no model of the body is used for: albedo variation, blur and noise."""
    yield Item(ALBEDO, "absent" if _variation(spec.body) is None else "not")
    yield from exposure(spec)


def exposure(spec: ScenarioSpec) -> Iterator[Item]:
    """Yield blur and noise of the detector, which have no onboard model."""
    detector = spec.detector
    if detector is None:
        yield from (Item("blur", "absent"), Item("noise", "absent", "no `detector`"))
        return
    blurred = detector.psf_sigma_px > 0.0
    yield Item("blur", "not", f"{detector.psf_sigma_px:g} px") if blurred else Item("blur", "absent")
    yield Item("noise", "not")


def _form(body: BodySpec) -> BodySpec:
    """Return a body without its albedo and without a height error of zero, for comparison."""
    detail = None if body.detail is None else body.detail.model_copy(update={"albedo": None})
    wrong = body.height_error if body.height_error is not None and body.height_error.rms_m > 0.0 else None
    return body.model_copy(update={"detail": detail, "height_error": wrong})


def _shape_error(spec: ScenarioSpec) -> str:
    onboard, detail = spec.onboard, spec.body.detail
    wrong = onboard.height_error.rms_m if onboard.height_error is not None else 0.0
    return listed(
        [
            "another shape" if onboard.body is not None else "",
            f"{onboard.facets:,} facets of {detail.facets:,}" if onboard.facets and detail is not None else "",
            f"other relief below {onboard.relief.below_m:g} m" if onboard.relief is not None else "",
            f"heights wrong by {wrong:g} m" if wrong else "",
        ]
    )


def _craters(spec: ScenarioSpec) -> Iterator[Item]:
    """Yield the craters of a cratered body, which estimators have only in the images of data bases."""
    if spec.craters is not None:
        yield Item("craters in the images of data bases", "exactly")


def _reflectance(spec: ScenarioSpec) -> Item:
    true, believed = spec.brdf, onboard_spec(spec).brdf
    named = f"{believed.kind} for {true.kind}" if believed.kind != true.kind else f"{true.kind} of other parameters"
    return item("reflectance", believed == true, named)


def _optics(spec: ScenarioSpec, spin: bool = True) -> Iterator[Item]:
    """Yield camera, lens, Sun and spin."""
    onboard, believed = spec.onboard, onboard_spec(spec).camera
    du, dv = onboard.principal_point_error_px
    focal = f"focal length wrong by {100.0 * onboard.focal_error:g} %" if onboard.focal_error else ""
    middle = f"principal point by ({du:g}, {dv:g}) px" if du or dv else ""
    yield item("camera", _pinhole(believed) == _pinhole(spec.camera), listed([focal, middle]))
    if spec.camera.distortion is not None:
        wrong = f"distortion wrong by {100.0 * onboard.distortion_error:g} %"
        yield item("lens", believed.distortion == spec.camera.distortion, wrong)
    yield item("Sun", _nothing(onboard.sun_error_deg), _spread(onboard.sun_error_deg))
    if spin:
        laws = (("pole", onboard.pole_error_deg), ("rotation", onboard.rotation_error_deg))
        wrong = listed(f"{name} {_spread(law)}" for name, law in laws if not _nothing(law))
        yield item("spin", not wrong, wrong)


def _pinhole(camera: CameraSpec) -> CameraSpec:
    return camera.model_copy(update={"distortion": None})


def _pose(spec: ScenarioSpec) -> Iterator[Item]:
    """Yield the pose and the error distributions of its prior and of an altimeter."""
    wrong = spec.pose_error
    places = (wrong.position_cam_m, wrong.position_cam_px, wrong.position_body_m)
    laws = (*places, wrong.attitude.angle_deg, wrong.attitude.rotation_vector_deg)
    if all(map(_nothing, laws)):
        yield Item("pose", "exactly")
        return
    yield Item(ERROR_LAW, "exactly")
    if spec.sensors.altimeter is not None:
        yield Item("law of the altimeter's error", "exactly")
    yield Item("pose", "not")


def _nothing(law: Law | Law3 | None) -> bool:
    """Return whether a distribution draws only zeros."""
    return law is None or not any(np.any(value) for name, value in law if name != "within")


def _spread(law: Law | None) -> str:
    """Format the distribution of an angle."""
    return "" if law is None else law.text("deg")
