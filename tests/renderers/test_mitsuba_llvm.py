"""The choice of a libLLVM and of the variant: every case ends in a renderer that works, or in one clear line."""

import ctypes.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from boresight.renderers.mitsuba3 import choose_variant, find_llvm, gpu_status, limit_threads, variant
from boresight.renderers.mitsuba3.llvm import HIDE_VARIABLE, PATH_VARIABLE
from boresight.renderers.mitsuba3.variant import variant_fault
from boresight.scenarios.errors import BoresightError

_PROCESSOR = Path("/proc/cpuinfo").read_text(encoding="utf-8") if Path("/proc/cpuinfo").exists() else ""

_RENDER = """
import numpy as np
from boresight.renderers.mitsuba3 import MitsubaRenderer, choose_variant
from boresight.scenarios.geometry import Camera, TriangleMesh, View, look_at
from boresight.scenarios.spec.brdf import HapkeSpec
corners = 10.0 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
at = np.array([0.0, -60.0, 0.0])
renderer = MitsubaRenderer(TriangleMesh(corners, np.array(faces)), HapkeSpec(kind="hapke"))
image = renderer.render(View(Camera.from_fov(16, 16, 0.5), look_at(at), at))
assert image.max() > 0.05, image.max()
print(renderer.variant.name, "|", renderer.variant.why)
"""


@pytest.fixture(autouse=True)
def nothing_hidden(monkeypatch):
    """Let each test hide what it wants hidden, also where the whole suite runs with BORESIGHT_HIDE_LLVM."""
    monkeypatch.delenv(HIDE_VARIABLE, raising=False)


def run(script: str, **environment: str) -> str:
    """Run a script in a process of its own, which must end well; its output."""
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def other_library() -> Path:
    """A shared library that is no LLVM: it loads, but has no LLVMGetVersion, like LLVM 14 and 15."""
    for line in Path("/proc/self/maps").read_text().splitlines() if Path("/proc/self/maps").exists() else ():
        if "libm.so" in line or "libm-" in line:
            return Path(line.split()[-1])
    pytest.skip("no libm.so found in /proc/self/maps to stand for an old LLVM")


@pytest.fixture(scope="module")
def fake_llvm(tmp_path_factory) -> Path:
    """A library that calls itself LLVM 16.0.6: new enough to tell, too old to use."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler (cc) to build a stand-in for LLVM 16")
    folder = tmp_path_factory.mktemp("llvm")
    source, library = folder / "llvm.c", folder / "libLLVM.so"
    source.write_text("void LLVMGetVersion(unsigned *a, unsigned *b, unsigned *c) { *a = 16; *b = 0; *c = 6; }")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
    return library


def test_every_library_that_is_found_is_new_enough():
    found = find_llvm().found
    if found is None:
        pytest.skip("no usable libLLVM on this machine")
    assert found.path.is_file()
    assert int(found.version.split(".")[0]) >= 17


def test_hidden_libraries_are_not_found(monkeypatch):
    search = find_llvm()
    for value in ("", "0"):
        monkeypatch.setenv(HIDE_VARIABLE, value)
        assert find_llvm() == search
    monkeypatch.setenv(HIDE_VARIABLE, "1")
    hidden = find_llvm()
    assert hidden.found is None
    assert hidden.rejected == ()


@pytest.mark.parametrize(
    ("library", "reason"), [("other_library", "too old"), ("fake_llvm", "LLVM 16.0.6 is too old: Dr.Jit needs 17")]
)
def test_a_users_old_library_is_turned_down_with_the_reason(monkeypatch, request, library, reason):
    path = request.getfixturevalue(library)
    monkeypatch.setenv(PATH_VARIABLE, str(path))
    search = find_llvm()
    assert search.rejected[0].path == path
    assert reason in search.rejected[0].reason
    assert search.found is None or search.found.path != path


@pytest.mark.parametrize("content", [None, b"", b"not a library"])
def test_a_broken_library_is_turned_down(monkeypatch, tmp_path, content):
    path = tmp_path / "libLLVM.so.19.1"
    if content is not None:
        path.write_bytes(content)
    monkeypatch.setenv(PATH_VARIABLE, str(path))
    first = find_llvm().rejected[0]
    assert first.path == path
    assert "\n" not in first.reason
    assert first.reason


@pytest.mark.parametrize("library", [pytest.param("other_library", marks=pytest.mark.long), "fake_llvm"])
def test_rendering_survives_a_users_old_library(request, library):
    output = run(_RENDER, DRJIT_LIBLLVM_PATH=str(request.getfixturevalue(library)))
    assert output.startswith(("llvm_ad_mono", "cuda_ad_mono", "scalar_rgb"))


@pytest.mark.parametrize("most", [1, pytest.param(3, marks=pytest.mark.long)])
def test_rendering_survives_old_llvms_of_the_system(most):
    """Real ones, where the system has some: Dr.Jit aborts the process with 15 and 16."""
    found = {path.resolve() for path in Path("/usr/lib").glob("*/libLLVM-1[456].so*")}  # one has several names
    old = [item.path for path in sorted(found) for item in _rejected_as(path)]
    if not old:
        pytest.skip("no LLVM 14, 15 or 16 in /usr/lib to try")
    for path in old[-most:]:
        assert run(_RENDER, DRJIT_LIBLLVM_PATH=str(path))


def _rejected_as(path: Path):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(PATH_VARIABLE, str(path))
        return [item for item in find_llvm().rejected if item.path == path]


@pytest.mark.usefixtures("llvm")
def test_a_program_that_imported_drjit_first_falls_back(other_library):
    """Dr.Jit has then taken what it was told, and no LLVM can be handed over any more."""
    output = run(f"import drjit\n{_RENDER}", DRJIT_LIBLLVM_PATH=str(other_library))
    assert output.startswith("scalar_rgb")
    assert "Dr.Jit could not start LLVM" in output


@pytest.mark.usefixtures("llvm")
def test_a_program_that_imported_drjit_with_an_old_llvm_falls_back():
    """LLVM 15 and 16 start well and abort later, so the version decides."""
    old = sorted(Path("/usr/lib").glob("*/libLLVM-1[56].so"))
    if not old:
        pytest.skip("no LLVM 15 or 16 in /usr/lib to try")
    output = run(f"import drjit\n{_RENDER}", DRJIT_LIBLLVM_PATH=str(old[0]))
    assert output.startswith("scalar_rgb")
    assert "with which it crashes" in output


def test_hidden_libraries_lead_to_the_fallback():
    assert run(_RENDER, BORESIGHT_HIDE_LLVM="1").startswith("scalar_rgb | no usable libLLVM was found")


def test_an_unknown_variant_is_refused():
    with pytest.raises(
        BoresightError, match="'llvm_ad_rgb' is unknown: choose cuda_ad_mono, llvm_ad_mono or scalar_rgb"
    ):
        choose_variant("llvm_ad_rgb")


def test_a_variant_that_cannot_work_is_refused_with_advice():
    script = """
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.errors import BoresightError
try:
    choose_variant("llvm_ad_mono")
except BoresightError as error:
    print(error)
"""
    output = run(script, BORESIGHT_HIDE_LLVM="1")
    assert "does not work here" in output
    assert "pip install" in output


def test_no_gpu_is_said_and_refused():
    if ctypes.util.find_library("cuda") is not None:
        pytest.skip("this machine has an NVIDIA driver")
    assert "no NVIDIA driver" in gpu_status()
    with pytest.raises(BoresightError, match="cuda_ad_mono does not work here"):
        choose_variant("cuda_ad_mono")


@pytest.fixture
def a_driver_that_finds_a_gpu(monkeypatch):
    """As on a machine whose driver finds a GPU; whether rays can be traced on it is asked as ever."""
    if ctypes.util.find_library("cuda") is not None:
        pytest.skip("this machine has an NVIDIA driver")
    import drjit

    choose_variant()
    monkeypatch.setattr(variant, "nvidia_gpus", lambda: (1, ""))
    monkeypatch.setattr(drjit, "has_backend", lambda _: True)
    monkeypatch.delenv(variant.CUDA_PROBED, raising=False)
    variant._cuda_status.cache_clear()
    yield
    variant._cuda_status.cache_clear()


def test_a_gpu_on_which_no_ray_is_traced_is_not_chosen(a_driver_that_finds_a_gpu, monkeypatch):
    assert "finds 1 GPU, but Mitsuba traces no rays on it: " in gpu_status()
    assert choose_variant().name != "cuda_ad_mono"
    with pytest.raises(BoresightError, match=r"cuda_ad_mono does not work here: .*traces no rays"):
        choose_variant("cuda_ad_mono")
    variant._cuda_status.cache_clear()
    monkeypatch.setattr(variant, "variant_fault", lambda _: "")
    assert choose_variant().name == choose_variant("cuda_ad_mono").name == "cuda_ad_mono"


def test_the_probe_sees_rays_where_there_are_some_and_says_what_fails():
    assert variant_fault("scalar_rgb").startswith(("TypeError", "AttributeError")), "its rays are not arrays"
    assert variant_fault("llvm_ad_mono", timeout_s=0.01) == "no answer in 0.01 s"
    if choose_variant().name == "llvm_ad_mono":
        assert variant_fault("llvm_ad_mono") == ""


@pytest.mark.skipif("avx2" not in _PROCESSOR or find_llvm().found is None, reason="needs AVX2 and a libLLVM")
def test_wider_vectors_than_those_of_avx2_are_not_used():
    """Pixels at the edges of facets, and recognition with them, would depend on the processor."""
    script = """
import ctypes, pathlib, cv2
from boresight.renderers.mitsuba3 import choose_variant, code_generator
print(code_generator(choose_variant("llvm_ad_mono")).split()[-1])
import drjit
core = ctypes.CDLL(str(pathlib.Path(drjit.__file__).with_name("libdrjit-core.so")))
print(core._Z21jit_llvm_vector_widthv())
print(cv2.ipp.getIppVersion())
"""
    target, width, ipp = run(script).splitlines()
    assert (target, width) == ("haswell", "8")
    assert "AVX2" in ipp


def test_threads_are_limited():
    assert (
        run(
            "from boresight.renderers.mitsuba3 import limit_threads; limit_threads(1)\n"
            "import drjit; print(drjit.thread_count())"
        )
        == "1\n"
    )
    with pytest.raises(BoresightError, match="at least 1 thread, not 0"):
        limit_threads(0)
