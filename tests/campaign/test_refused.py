"""Commands that are refused: one clear line on standard error (what, where, what to do), exit code 2, nothing written.

Files that are wrong are in test_bad_input.py, and runs that are not whole in test_bad_runs.py.
"""

from __future__ import annotations

import pytest

# Words of a command, with FILE for a campaign and RUN for a run of it: what the line must say.
COMMANDS: dict[str, str | list[str]] = {
    "": ["COMMAND", "boresight --help"],
    "fly": ["invalid choice: 'fly'", "boresight --help"],
    "run quickstrat": "quickstrat: no such campaign; did you mean quickstart?",
    "run no/such/campaign.yaml": "no/such/campaign.yaml: no such campaign",
    "run FILE --set camera.fov=3": "--set camera.fov=3: camera.fov: unknown key",
    "run FILE --set camera": "--set camera: write it as key=value",
    "run FILE --trials 0": ["--trials: 0 is below 1", "--help"],
    "run FILE --trials many": "--trials: 'many' is not a whole number",
    "run FILE --jobs 0": "--jobs: 0 is below 1",
    "run FILE --seed -1": "--seed: -1 is below 0",
    "run FILE --fast": "unrecognized arguments: --fast; see boresight --help",
    "run FILE --variant cuda": ["variant 'cuda' is unknown: choose", "scalar_rgb"],
    **{f"run FILE --trial-limit={limit}": "give a number of seconds above 0" for limit in ("0", "-1", "nan", "inf")},
    "run FILE --backend dask": "--backend dask: give either --scheduler ADDRESS or --local N",
    "run FILE --backend dask --local 2 --scheduler tcp://127.0.0.1:1": "give either",
    "run FILE --local 2": "--scheduler and --local are of --backend dask",
    "run FILE --backend dask --local 2 --keep-images": "--keep-images: workers of a cluster cannot write",
    "run FILE quickstart --out out": "--out is the folder of one run",
    "run FILE craters-real": "craters-real is a command of its own: boresight craters-real",
    "run FILE FILE": "is given twice: give each campaign once",
    "run FILE quickstrat": "quickstrat: no such campaign; did you mean quickstart?",
    "validate .": "is a folder, not a YAML file",
    "validate FILE --set camera.width_px=2.5": "--set camera.width_px=2.5: camera.width_px: 2.5 is not a whole number",
    "schema camera": ["invalid choice: 'camera'", "'scenario', 'campaign'"],
    "show itokawa": "itokawa: no such file, nor a name",
    "show landmark-ransack": "no such campaign, scenario or estimator; did you mean landmark-ransac?",
    "show quickstrt": "did you mean quickstart?",
    "show prior --set camera.fov_deg=3": "--set changes scenarios and campaigns",
    "show nosuch:Class": "cannot be imported",
    **{f"{command} nowhere": ["nowhere: no run there", "run it first"]
       for command in ("status", "report", "inspect", "compare")},
    "inspect RUN --trial 99": ["--trial 99: ", "holds trials 0 to 23"],
    "inspect RUN --estimator sift": "choose one of landmark-harris, prior",
    "inspect RUN --worst 2 --scenario moon": "--scenario moon",
    "inspect RUN --metric speed": "--metric speed",
    "inspect RUN --worst 2 --trial 1": "give one of them",
    "inspect RUN --worst 0": "0 is below 1",
    "inspect RUN --look --trial 1": "--trial: a look is at all trials",
    "inspect RUN --look --estimator sift": "choose one of landmark-harris",
    "compare RUN --metric speed": "--metric speed",
    "compare RUN --by weather": "--by weather",
    "compare RUN --by ,": "--by: empty",
    "compare RUN RUN": "a run is named twice",
    "export RUN --to csv --trial 99 --out out": "--trial 99: ",
    "export RUN --to tum --trial 99 --out out": "--trial 99: ",
    "export RUN --to colmap --estimator sift --out out": "choose one of landmark-harris, prior",
    "export RUN --to latex --trial 1 --out out": "--trial: the tables of a report are of the whole run",
    "export RUN --to kitti --out out": "invalid choice: 'kitti'",
    "board .": "no run in that folder",
    "bench FILE --blocks 0": "a benchmark needs at least 1 block of trials, not 0",
    "bench FILE --against FILE": "",
    "bench FILE --against none.json": "none.json",
    "bench quickstart --check": "'quickstart' has none",
    "fetch": "boresight fetch --list",
    "fetch eroz": "eroz: no such data set, campaign or paper; did you mean eros?",
    "fetch rowell2014": "did you mean rowell2015?",
    "fetch amica-20051001": "bring your own into images/hayabusa_amica_20051001; published at https://",
    "fetch eros --from /nowhere": "/nowhere/shapes/eros022540.tab: no such file",
    "fetch nothing.yaml": "nothing.yaml: no such campaign",
    **{f"figures all --trials-scale {share}": "--trials-scale" for share in ("0", "1.5", "much")},
    "figures rowell2015 --runs . --trials 3": "--run",
    "figures rowell2016": "rowell2015",
    "figures reality": "boresight fetch reality brings them",
    "sensitivity FILE --over camera.fov_dge=3:4": "boresight: --over camera.fov_dge=3:4: camera.fov_dge: unknown key",
    "sensitivity FILE --over camera.fov_deg=3": "KEY=LOW:HIGH",
    "sensitivity FILE --over camera.fov_deg=10:20 --over camera.fov_deg=1:2": "named twice",
    "sensitivity FILE --over camera.fov_deg=10:20 --samples 12": "power of two",
    "sensitivity FILE --over camera.fov_deg=10:20 --metric speed": "speed: choose one of position_error_m",
    "sensitivity FILE --over camera.fov_deg=10:20 --statistic mode": "--statistic mode: choose one of median",
    "sensitivity FILE --over camera.fov_deg=10:2000 --samples 2": "--over camera.fov_deg=10:2000: camera.fov_deg",
}  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_is_refused_in_one_line_and_leaves_nothing(tiny_run, refused, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path))
    before = sorted(tiny_run.folder.rglob("*"))
    places = {"FILE": str(tiny_run.file), "RUN": str(tiny_run.folder)}
    line = refused(*(places.get(word, word) for word in command.split()))
    parts = COMMANDS[command]
    assert all(part in line for part in ([parts] if isinstance(parts, str) else parts)), line
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(tiny_run.folder.rglob("*")) == before
