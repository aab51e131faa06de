"""Program `maglev-mj`, also as `python -m maglev_mj`."""

import _signal as signal  # type: ignore[import-not-found] # `signal` loads more first
import os
import sys

# where the program is started, not where it is looked at
if (__name__ == "__main__" or os.path.basename(sys.argv[0]).startswith("maglev-mj")) and (
    signal.getsignal(signal.SIGINT) is signal.default_int_handler
):
    # while it loads, and when it is done, nothing can be lost: an exception would be a traceback there
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))

from maglev_mj.cli.program import main

if __name__ == "__main__":
    sys.exit(main())
