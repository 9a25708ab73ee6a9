"""The reflectance models: each formula written once, for NumPy arrays and Dr.Jit arrays alike."""

from renderers.brdf.arrays import NUMPY, ArrayMath
from renderers.brdf.evaluate import brdf_value
from renderers.brdf.hapke import HapkeParameters, hapke
from renderers.brdf.lambert import lambert
from renderers.brdf.oren_nayar import OrenNayarParameters, oren_nayar

__all__ = [
    "NUMPY",
    "ArrayMath",
    "HapkeParameters",
    "OrenNayarParameters",
    "brdf_value",
    "hapke",
    "lambert",
    "oren_nayar",
]
