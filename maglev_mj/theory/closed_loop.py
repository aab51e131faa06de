"""Former name of `theory.loop_array`, for scripts of before version 0.3."""

from maglev_mj.theory.loop_array import LoopArray as SampledLoop

__all__ = ["SampledLoop"]
