"""The search of `seek` without its sense of touch: its belief changes between visits only, for an ablation.

mjx-fit evaluate insertion --policy experiments/gentle/blind.py:blind --methods full ...
"""

from mjx_fit.config.files import read_config
from mjx_fit.task.seek import seek
from mjx_fit.utils import resources

blind = seek(read_config([resources.folder("configs") / "gentle.yaml"], []))
