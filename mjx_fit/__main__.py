"""``python -m mjx_fit``."""

import sys

from mjx_fit.cli.launch import main

if __name__ == "__main__":
    sys.exit(main())
