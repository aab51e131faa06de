"""Command line as `python -m maglev_mj`.

For use without the script on the path.
"""

import sys

from maglev_mj.cli import main

if __name__ == "__main__":
    sys.exit(main())
