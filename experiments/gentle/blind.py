"""The search of `seek` without its sense of touch: its belief changes between visits only, for an ablation.

mjx-fit evaluate insertion --policy experiments/gentle/blind.py:blind --methods full ...
"""

from mjx_fit.config.worlds import preset
from mjx_fit.task.seek import seek

blind = seek(preset("gentle"))
