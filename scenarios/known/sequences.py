"""A priori knowledge of estimators that track landmarks along an orbit."""

from __future__ import annotations

from collections.abc import Iterator

from boresight.scenarios.known.record import Item, Known, item, listed, spin_item
from boresight.scenarios.spec.sequence import SequenceKnowledgeSpec, SequenceSpec


def sequences(section: SequenceSpec) -> Known:
    """Return the knowledge of sequence estimators, which get tracks, attitudes, predicted motion and ranges."""
    known = section.knowledge
    laws = "laws of all errors" + (" but those of pixels" if section.images else "")
    return Known(
        (
            Item("camera", "exactly"),
            _attitude(known),
            spin_item(known.pole_sigma_deg, known.spin_sigma),
            item("first position", not known.position_sigma_m, f"{known.position_sigma_m:g} m"),
            item("motion from frame to frame", not known.motion_error, f"{100.0 * known.motion_error:g} % of each"),
            *_ranges(known),
            *_forces(section),
            Item(laws, "exactly"),
            *_tracks(section),
            Item("landmarks", "not"),
        )
    )


def _attitude(known: SequenceKnowledgeSpec) -> Item:
    parts = {"each": known.attitude_sigma_deg, "the camera's alignment": known.misalignment_sigma_deg}
    wrong = listed(f"{name} {sigma:g} deg" for name, sigma in parts.items() if sigma)
    return item("attitude", not wrong, wrong)


def _ranges(known: SequenceKnowledgeSpec) -> Iterator[Item]:
    if known.ranges:
        yield Item("ranges", "not", f"{known.range_sigma_m:g} m")
        if known.range_to == "lasting":
            yield Item("how long tracks will last", "exactly")


def _forces(section: SequenceSpec) -> Iterator[Item]:
    """Yield the knowledge of the forces, if estimators get a force model."""
    known, forces = section.knowledge, section.orbit.forces
    if not known.dynamics:
        return
    point = forces.gravity == "point-mass"
    yield item("law of gravity", point, "a point mass for the body's shape")
    yield item("GM", not known.gm_sigma, f"{100.0 * known.gm_sigma:g} %")
    yield Item("Sun", "exactly")
    yield item("solar pressure", not known.radiation_sigma, f"{100.0 * known.radiation_sigma:g} %")
    yield item("first velocity", not known.velocity_sigma_m_s, f"{known.velocity_sigma_m_s:g} m/s")
    told = known.noise_m_s2 is None or known.noise_m_s2 == forces.noise_m_s2
    yield item("size of what is not modelled", told, f"{known.noise_m_s2} for {forces.noise_m_s2:g} m/s2")


def _tracks(section: SequenceSpec) -> Iterator[Item]:
    """Yield the data association of landmarks and the pixel noise."""
    vision, images = section.vision, section.images
    if images is not None:
        yield Item("which landmark is which", "not", "matched in images")
        yield Item("pixel noise", "not", f"{images.sigma_px:g} px are told, a number of the scenario")
        return
    shares = {"mismatches": vision.mismatch_share, "outliers": vision.outlier_share, "mistaken": vision.mistaken}
    wrong = listed(f"{100.0 * share:g} % {name}" for name, share in shares.items() if share)
    yield item("which landmark is which", not wrong, wrong)
    if not vision.noise_px:
        yield Item("pixel noise", "absent")
