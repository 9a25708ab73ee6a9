"""A campaign whose trials take milliseconds and render nothing: what is asked of stores and runners needs no more."""

from __future__ import annotations

from pathlib import Path

SCENE = """\
camera: {width_px: 1024, height_px: 1024, fov_deg: 30}
sequence:
  sphere_radius_m: 190
  orbit: {radius_m: 790, step_deg: 6, revolutions: 0.1}
"""


def write_sequences(folder: Path, trials: int) -> Path:
    """Write the campaign with its scenario; return the campaign's file."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "orbit.yaml").write_text(SCENE)
    (folder / "orbits.yaml").write_text(
        f"experiment: sequence\nscenarios: [orbit.yaml]\nestimators: [dead-reckoning]\ntrials: {trials}\nseed: 5\n"
    )
    return folder / "orbits.yaml"
