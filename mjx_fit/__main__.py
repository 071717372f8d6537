"""``python -m mjx_fit``."""

import sys

from mjx_fit.cli import main

sys.exit(main())
