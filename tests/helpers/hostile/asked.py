"""Readers of what is asked for: scenarios, campaigns, data sets, overrides, options, published values."""

from __future__ import annotations

from collections.abc import Callable
from importlib import resources
from pathlib import Path

from boresight.campaign.runs.read import CATALOG as CAMPAIGNS
from boresight.estimators.landmark.robust.estimator import ConsensusOptions
from boresight.estimators.options import parse_options
from boresight.estimators.slam.options import BundleOptions
from boresight.reports.published import parse as parse_published
from boresight.scenarios.data.datasets import read_registry
from boresight.scenarios.designs import grid_cells
from boresight.scenarios.load import canonical_json, digest, file_kind, load_campaign, load_scenario
from boresight.scenarios.load.yaml_text import parse_yaml
from hostile.target import Target


def targets() -> dict[str, Target]:
    """YAML in each of its parts."""
    return {
        "yaml": Target(_yaml, lambda: (_SCENARIO, _CAMPAIGN, _SEQUENCE, b"a: &x [1, 2]\nb: {c: *x}\n"), _YAML),
        "scenario": Target(_scenario, lambda: (_SCENARIO, _SEQUENCE, _ORBIT), (*_YAML, *_KEYS)),
        "campaign": Target(_campaign, lambda: (_CAMPAIGN, _GRID), (*_YAML, *_KEYS)),
        "data-set": Target(_data_sets, lambda: (_DATA_SETS,), _YAML),
        "override": Target(_override, lambda: (b"camera.fov_deg=20", b"body.detail={facets: 100, seed: 2}"), _YAML),
        "options": Target(_options, lambda: _OPTIONS, _YAML),
        "published": Target(_published, _published_seeds, _YAML),
    }


_YAML = (
    b"&a ", b"*a", b"*x", b"!!python/object/apply:os.system [id]", b"!!binary aGk=", b"!!set {a}", b"<<: *a", b"? ",
    b": ",
    b"- ", b"|\n", b">\n", b"---\n", b"...\n", b"%YAML 1.1\n", b"%TAG ! tag:x,2000:\n", b".nan", b".inf", b"0o777",
    b"&a [*a, *a]", b"a: &a [x, x]\nb: &b [*a, *a, *a, *a]\nc: &c [*b, *b, *b, *b]\n", b'"\\U00110000"', b'"\\ud800"',
    b"- " * 2000, b"{a: " * 2000, b"? " * 2000, b"2005-10-01", b"1:30:00", b"[]", b"{}", b"[[]]", b"[1, 2, 3]", b"~",
    b"yes", b'"\\e[31m"', b'"\\0"', b'"\\N"', b"\n  ", b"'", b"x: 1\nx: 2\n", b"\xe2\x80\xae",
)  # fmt: skip
_KEYS = (
    b"extends: x.yaml\n", b"extends: /dev/zero\n", b"extends: ../../../../etc/passwd\n", b"extends: [x, x]\n",
    b"extends: .\n", b"name: ../x\n", b"description: null\n", b"images: {folder: /etc}\n", b"kind: hapke", b"kind: x",
    b"uniform", b"normal", b"camera", b"body", b"viewpoint", b"orbit", b"sequence", b"onboard", b"sensors", b"craters",
    b"detail", b"values", b"levels", b"design: two-level", b"extends: quickstart\n", b"body: null\n",
    b"extends: apophis-sphere-sequence\n", b"distortion: {k1: 1e300}", b"set: {a.b.c: 1}\n", b'extends: "a\\0b"\n',
)  # fmt: skip
_SCENARIO = b"""body:
  shape: contact-binary
  detail: {facets: 190000, boulders: {count: 9, min_diameter_m: 6, max_diameter_m: 40}}
camera: {width_px: 64, height_px: 48, fov_deg: 18.3, distortion: {k1: 0.01}}
viewpoint: {range_m: 2000}
lighting: {phase_deg: {uniform: [0, 60]}}
brdf: {kind: hapke, w: 0.4, theta_bar_deg: 20}
pose_error:
  position_cam_m: {uniform: [[-50, 50], [-50, 50], [-5, 5]]}
  attitude: {angle_deg: {normal: 2}}
"""
_SEQUENCE = b"""extends: apophis-sphere-sequence
sequence:
  orbit: {model: propagated, forces: {area_to_mass_m2_kg: 0.01, noise_m_s2: 1.0e-7}}
  body_motion: {kind: spin, period_h: 30.4, axis_body: [0, 0.2, 1]}
  vision: {outlier_share: 0.01, field: fixed, recognised: 0.8}
  knowledge: {position_sigma_m: 2, range_every: 30, dynamics: true, gm_sigma: 0.05}
"""
_ORBIT = b"extends: eros-like-orbit\norbit: {arc: {days: 3}}\ncraters: {count: 100, seed: 4}\n"
_CAMPAIGN = b"""title: Tiny
scenarios: [quickstart, my_scene.yaml]
estimators: [prior, landmark-harris: {database: {images: 200}, label: x}]
trials: 60
seed: 20150709
set: {camera.width_px: 64, brdf: {albedo: 0.2}}
"""
_GRID = b"""scenarios: [quickstart]
estimators: [prior]
trials: 2
seed: 1
grid:
  design: two-level
  axes:
    range: {key: viewpoint.range_m, values: [1000, 2000, 3000]}
    law: {levels: {a: {brdf.kind: lambert}, b: {brdf: {kind: hapke}}}}
"""
_DATA_SETS = b"""some:
  title: Some
  folder: shapes
  credit: us
  licence: none
  repository: us/some
  commit: %s
  files:
    - {name: b.bin, bytes: 12, sha256: "%s", path: a/b.bin}
    - {name: c.bin, bytes: 12, sha256: "%s", by: icq, raw: {name: d.bin, bytes: 3, sha256: "%s"}}
yours: {title: Yours, folder: images/day, credit: you, licence: none, published: a paper, needed: [a.fit]}
""" % (b"0a" * 20, b"0" * 64, b"1" * 64, b"2" * 64)


_OPTIONS = (
    b"views: 25\nmotion: constant-gain\nsteps: full\nangle_max_deg: 30\nmotion_noise_m_s2: 1.0e-7\n",
    b"search: {hypotheses: minimal-sets, draws: 2000}\ncorners: {detector: surf}\nalignment: image\n",
)


def _laid(content: bytes, folder: Path) -> str:
    (folder / "x.yaml").write_bytes(content)
    return str(folder / "x.yaml")


def _text(read: Callable[[str], object]) -> Callable[[bytes, Path], object]:
    return lambda content, _folder: read(content.decode("utf-8", errors="replace"))


_yaml = _text(lambda text: parse_yaml(text, "x.yaml").plain())
_override = _text(lambda text: canonical_json(load_scenario("quickstart", [text]).spec))
_published = _text(lambda text: parse_published(text, "x.yaml"))


def _scenario(content: bytes, folder: Path) -> object:
    path = _laid(content, folder)
    file_kind(Path(path))
    spec = load_scenario(path).spec
    return canonical_json(spec), digest(spec), spec.camera.camera().matrix


def _campaign(content: bytes, folder: Path) -> object:
    spec = load_campaign(_laid(content, folder), CAMPAIGNS).spec
    return canonical_json(spec), digest(spec), None if spec.grid is None else grid_cells(spec.grid)


def _data_sets(content: bytes, folder: Path) -> object:
    home = (folder / "data").resolve()
    found = read_registry(Path(_laid(content, folder)))
    for one in found.values():
        for file in (*one.files, *(file.raw for file in one.files if file.raw)):
            assert (home / one.folder / file.name).resolve().is_relative_to(home), file
            assert "\n" not in one.url(file)
    return [one.provides("shapes/b.bin") for one in found.values()]


def _options(content: bytes, _folder: Path) -> object:
    plain = parse_yaml(content.decode("utf-8", errors="replace"), "x.yaml").plain()
    options = plain if isinstance(plain, dict) else {"views": plain}
    model = BundleOptions if "views" in options else ConsensusOptions
    return parse_options(model, options, "x")


def _published_seeds() -> tuple[bytes, ...]:
    text = (resources.files("boresight.reports.published") / "delpech2015.yaml").read_text(encoding="utf-8")
    first_value = text.index("\n", text.index("      - {")) + 1
    return text[:first_value].encode(), (
        b"source: us\nbounds: none\nmethods: [us]\ncomparisons:\n  a:\n    conditions: none\n    values:\n"
        b"      - {measure: position_error_m, stage: final, statistic: median, printed: '1,200 m', place: Table 1}\n"
    )
