"""Cup models: parameters in, edges and developable panels out."""

from brafit.cup.base import Cup
from brafit.cup.frames import FramesCup
from brafit.cup.shape import CupShape
from brafit.cup.strips import StripsCup
from brafit.cup.wire import Wire

__all__ = ["Cup", "CupShape", "FramesCup", "StripsCup", "Wire"]
