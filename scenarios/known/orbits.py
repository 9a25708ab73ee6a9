"""A priori knowledge in orbit determination, image planning and crater navigation."""

from __future__ import annotations

from collections.abc import Iterator

from boresight.scenarios.known.images import THRESHOLDS, unmodelled
from boresight.scenarios.known.record import Item, Known, item, listed, spin_item
from boresight.scenarios.spec.orbit import OrbitSpec
from boresight.scenarios.spec.scenario import ScenarioSpec

_SHARED = ("centre of mass", "Sun and Earth", "law of the forces", "RMS error of the shape on board")


def orbits(spec: ScenarioSpec, section: OrbitSpec) -> Known:
    """Return the knowledge of orbit filters and of the chain from images to an orbit."""
    imaging = section.imaging
    items = [*_world(section), *_camera(section), *_laws(section), *_sightings(section)]
    if imaging is None or imaging.detections == "drawn":
        return Known(tuple(items))
    seen = [Item("reflectance", "not"), *unmodelled(spec)]
    return Known((*items, *seen), (THRESHOLDS,))


def plans(section: OrbitSpec) -> Known:
    """Return the knowledge for image planning alone."""
    return Known((*_world(section), *_camera(section)))


def _world(section: OrbitSpec) -> Iterator[Item]:
    """Yield the body, its spin, the forces and the orbit."""
    known = section.knowledge
    yield spin_item(known.pole_sigma_deg, known.spin_sigma)
    yield from (Item(name, "exactly") for name in _SHARED)
    yield Item("orbit", "not", f"{known.position_m:g} m at the epoch")
    yield item("GM", not known.gm_sigma, f"{100.0 * known.gm_sigma:g} %")
    yield item("solar pressure", not known.light_sigma, f"{100.0 * known.light_sigma:g} %")
    if section.light.noise_share:
        yield Item("accelerations that nothing models", "not", f"{100.0 * section.light.noise_share:g} % of it")
    yield Item("shape", "not", f"harmonics of degree {known.shape_degree}")
    yield Item("gravity", "not", "that of the shape on board")


def _camera(section: OrbitSpec) -> Iterator[Item]:
    pointing = section.pointing
    yield item("camera", not pointing.focal_error, f"focal length to {100.0 * pointing.focal_error:g} %")
    yield Item("attitude", "not", f"{pointing.attitude_urad:g} microrad")
    mounting = f"{pointing.misalignment_urad:g} microrad"
    yield item("mounting of the camera", not pointing.misalignment_urad, mounting)


def _laws(section: OrbitSpec) -> Iterator[Item]:
    """Yield the error distributions; those of sightings are exact only if sightings are drawn from them."""
    yield Item("laws of all errors but those of sightings" if section.imaging else "laws of all errors", "exactly")


def _sightings(section: OrbitSpec) -> Iterator[Item]:
    """Yield the positions and the identification of craters."""
    yield Item("places of the craters", "not")
    if section.imaging is not None:
        yield Item("which crater is which", "not", "matched")
        return
    shares = {"wrong": section.sightings.wrong_share, "merged": section.sightings.merged_share}
    wrong = listed(f"{100.0 * share:g} % {name}" for name, share in shares.items() if share)
    yield item("which crater is which", not wrong, wrong)
