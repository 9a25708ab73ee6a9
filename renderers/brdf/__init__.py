"""The reflectance models: each formula written once, for NumPy arrays and Dr.Jit arrays alike."""

from renderers.brdf.arrays import NUMPY, ArrayMath, phase_angle, phase_of_rays
from renderers.brdf.evaluate import brdf_value
from renderers.brdf.hapke import HapkeParameters, hapke
from renderers.brdf.lambert import lambert
from renderers.brdf.lommel_seeliger import LommelSeeligerParameters, lommel_seeliger
from renderers.brdf.mcewen import McEwenParameters, mcewen
from renderers.brdf.models import MODELS, ReflectanceModel
from renderers.brdf.oren_nayar import OrenNayarParameters, oren_nayar

__all__ = [
    "MODELS",
    "NUMPY",
    "ArrayMath",
    "HapkeParameters",
    "LommelSeeligerParameters",
    "McEwenParameters",
    "OrenNayarParameters",
    "ReflectanceModel",
    "brdf_value",
    "hapke",
    "lambert",
    "lommel_seeliger",
    "mcewen",
    "oren_nayar",
    "phase_angle",
    "phase_of_rays",
]
