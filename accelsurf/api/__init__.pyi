from .segment import segment as segment
from .segment import segment_objects as segment_objects
from .warmup import MIDDLE as MIDDLE
from .warmup import START as START
from .warmup import ball as ball
from .warmup import small_segmentations as small_segmentations
