"""``python -m mjx_fit``."""

import sys

from mjx_fit.launch import main

if __name__ == "__main__":
    sys.exit(main())
