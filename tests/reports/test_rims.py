"""Scatter of detected rims: what was put in comes out, whatever single bad detections say."""

import numpy as np
import pandas as pd
import pytest

from boresight.reports.kinds.crater_detection import DetectorResults, rim_grid, rim_scatter


def seen(n=4000, wild=0.05):
    """Detections of known scatter, a share of them far off, false alarms, and those that are not kept."""
    rng = np.random.default_rng(4)
    radius = rng.uniform(6.0, 60.0, n)
    true = radius[:, None] * np.sqrt([1.25, 0.8])
    size, axes = 0.06 * rng.normal(size=n) + 0.02, 0.12 * rng.normal(size=n)
    found = true * np.exp(np.stack([size - 0.5 * axes, size + 0.5 * axes], axis=1))
    centre = np.hypot(0.3, 0.03 * radius)[:, None] * rng.normal(size=(n, 2))
    centre[: int(wild * n)] *= 20.0
    table = {"crater": np.arange(n), "kept": True, "major_px": found[:, 0], "minor_px": found[:, 1]}
    table |= {"centre_error_u_px": centre[:, 0], "centre_error_v_px": centre[:, 1]}
    table |= {"major_error_px": found[:, 0] - true[:, 0], "minor_error_px": found[:, 1] - true[:, 1]}
    good = pd.DataFrame(table)
    other = good.head(500).assign(centre_error_u_px=900.0, major_error_px=-300.0)
    return pd.concat([good, other.assign(crater=-1), other.assign(kept=False)], ignore_index=True)


def looks():
    """Craters by image: one detected in all three that it is well seen in, one in one of three, one once alone."""
    rows = [(7, image, True) for image in range(3)] + [(8, 0, True), (8, 1, False), (8, 2, False), (9, 0, True)]
    table = pd.DataFrame(rows, columns=["crater", "trial", "kept"]).assign(world="", in_frame=1.0, emission_deg=30.0)
    hidden = table.head(3).assign(kept=False, emission_deg=70.0)
    dark = table.head(3).assign(kept=False, emission_deg=30.0).assign(incidence_deg=85.0)
    return pd.concat([table.assign(incidence_deg=40.0), hidden.assign(incidence_deg=40.0), dark], ignore_index=True)


def detector(detections, craters):
    images = pd.DataFrame({"trial": np.arange(3), "unit": np.arange(3)})
    return DetectorResults("scene", "own", images, craters, detections)


def test_craters_of_one_number_in_several_worlds_are_several():
    """In worlds of their own, no crater is seen in two other images."""
    apart = looks().assign(world=lambda table: table["trial"])
    assert rim_scatter(detector(seen(), apart))["redetected"] == 0.0
    assert rim_scatter(detector(seen(), looks()))["redetected"] > 0.0


def test_the_scatter_that_was_put_in_comes_out():
    scatter = rim_scatter(detector(seen(), looks()))
    assert scatter["centre_sigma_px"] == pytest.approx(0.3, rel=0.15)
    assert scatter["centre_sigma_radii"] == pytest.approx(0.03, rel=0.1)
    assert scatter["size_sigma"] == pytest.approx(0.06, rel=0.05)
    assert scatter["axes_sigma"] == pytest.approx(0.12, rel=0.05)


def test_a_known_crater_counts_where_it_could_be_detected_again():
    # Of crater 7 each of three looks, seen twice elsewhere; of crater 8 two or none: it is known from one image alone.
    assert rim_scatter(detector(seen(), looks()))["redetected"] == pytest.approx(1.0)
    missed = pd.concat([looks(), looks().head(1).assign(trial=5, kept=False)], ignore_index=True)
    assert rim_scatter(detector(seen(), missed))["redetected"] == pytest.approx(0.75)


def test_too_few_detections_tell_nothing():
    few = detector(seen().head(49), looks())
    assert rim_scatter(few) is None
    assert rim_grid([few]).rows == (("scene", "own", "-", "-", "-", "-", "-"),)
