"""Rendering with Mitsuba 3 (images, shadows, de-projection) by its CUDA, LLVM or scalar variant."""

from boresight.renderers.mitsuba3.bsdf import register_bsdfs
from boresight.renderers.mitsuba3.llvm import find_llvm
from boresight.renderers.mitsuba3.pair import PairRenderer, outlines_m
from boresight.renderers.mitsuba3.renderer import MitsubaRenderer
from boresight.renderers.mitsuba3.tiled import BodyRenderer, TiledRenderer, renderer_version
from boresight.renderers.mitsuba3.variant import Variant, choose_variant, code_generator, gpu_status, limit_threads

__all__ = [
    "BodyRenderer",
    "MitsubaRenderer",
    "PairRenderer",
    "TiledRenderer",
    "Variant",
    "choose_variant",
    "code_generator",
    "find_llvm",
    "gpu_status",
    "limit_threads",
    "outlines_m",
    "register_bsdfs",
    "renderer_version",
]
