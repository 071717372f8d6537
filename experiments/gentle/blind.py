"""The search of `seek` without its sense of touch: its belief changes between visits only, for an ablation.

mjx-fit evaluate insertion --policy experiments/gentle/blind.py:blind --methods full ...
"""

from pathlib import Path

from mjx_fit.config.files import read_config
from mjx_fit.task.seek import seek

blind = seek(read_config([Path(__file__).parent / "gentle.yaml"], []))
